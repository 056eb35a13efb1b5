"""Let deleted sweeps be hidden while their rows go; find idempotency keys by what they made."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column and the index."""
    op.add_column(
        "sweep", sa.Column("deleted", sa.Boolean(), nullable=False, server_default=sa.false())
    )
    op.create_index("ix_idempotency_target_id", "idempotency", ["target_id"])
