"""The page: server-rendered views of the queue, beside the API and from the same functions."""
