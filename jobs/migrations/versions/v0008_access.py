"""Add API keys, and who submitted what."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the table; what is older was submitted by nobody in particular."""
    op.create_table(
        "api_key",
        sa.Column("id", sa.String(16), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("scope", sa.String(16), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("created", sa.Float(), nullable=False),
        sa.Column("expires", sa.Float()),
        sa.Column("revoked", sa.Float()),
        sa.PrimaryKeyConstraint("id", name="pk_api_key"),
    )
    for table in ("job", "sweep"):
        op.add_column(table, sa.Column("owner", sa.String(16)))
        op.add_column(table, sa.Column("samples", sa.Float(), nullable=False, server_default="0"))
