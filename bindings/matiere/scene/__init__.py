"""Scene JSON v1: load, check, flatten, digest."""
