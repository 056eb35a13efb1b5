"""Add pins, when a film was last of use, and what the collector looks for."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; a film was last of use when it was made, as far as is known."""
    no = sa.false()
    op.add_column("job", sa.Column("pinned", sa.Boolean(), nullable=False, server_default=no))
    op.add_column("sweep", sa.Column("pinned", sa.Boolean(), nullable=False, server_default=no))
    op.add_column("film", sa.Column("used", sa.Float(), nullable=False, server_default="0"))
    op.execute("UPDATE film SET used = created")
    op.create_index("ix_job_finished", "job", ["finished"])
    op.create_index("ix_film_used", "film", ["used"])
