"""Keep which cell of a sweep the others are compared with."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; older sweeps have no baseline."""
    op.add_column("sweep", sa.Column("baseline", sa.Integer()))
