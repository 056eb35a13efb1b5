"""Alembic migrations of the job database, run at start from inside the package."""
