"""The job database: the only modules that import SQLAlchemy (with `matiere.jobs.migrations`)."""
