"""Ageing, deadlines, dependencies and the history of requeued jobs."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add columns and tables; what is queued ages from its submission."""
    op.add_column("sweep", sa.Column("blockers", sa.Integer(), server_default="0", nullable=False))
    for name, kind, default in (
        ("rank", sa.Float(), "0"),
        ("queued", sa.Float(), "0"),
        ("blockers", sa.Integer(), "0"),
        ("attempt", sa.Integer(), "1"),
    ):
        op.add_column("job", sa.Column(name, kind, server_default=default, nullable=False))
    op.add_column("job", sa.Column("deadline", sa.Float(), nullable=True))
    op.execute("UPDATE job SET queued = created, rank = priority * 60.0 - created")
    op.drop_index("ix_job_queue", "job")
    op.create_index("ix_job_queue", "job", ["state", "rank", "id"], unique=False)
    op.create_index("ix_job_deadline", "job", ["deadline"], unique=False)
    op.create_table(
        "dependency",
        sa.Column("waiter", sa.String(length=36), nullable=False),
        sa.Column("needs", sa.String(length=36), nullable=False),
        sa.PrimaryKeyConstraint("waiter", "needs", name=op.f("pk_dependency")),
    )
    op.create_index(op.f("ix_dependency_needs"), "dependency", ["needs"], unique=False)
    op.create_table(
        "job_history",
        sa.Column("job_id", sa.String(length=36), nullable=False),
        sa.Column("attempt", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("queued", sa.Float(), nullable=False),
        sa.Column("started", sa.Float(), nullable=True),
        sa.Column("finished", sa.Float(), nullable=True),
        sa.Column("error_code", sa.String(length=64), nullable=True),
        sa.Column("error_message", sa.Text(), nullable=True),
        sa.Column("error_pointer", sa.Text(), nullable=True),
        sa.Column("error_log", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["job_id"], ["job.id"], name=op.f("fk_job_history_job_id")),
        sa.PrimaryKeyConstraint("job_id", "attempt", name=op.f("pk_job_history")),
    )
