"""Let the cells of a sweep share a budget of render seconds."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; older sweeps have no budget."""
    op.add_column("sweep", sa.Column("budget", sa.Text()))
    op.add_column("sweep", _column("budget_spent_s", sa.Float(), "0"))
    op.add_column("sweep", _column("budget_closed", sa.Boolean(), sa.false()))


def _column(name: str, kind: Any, default: Any) -> sa.Column[Any]:
    return sa.Column(name, kind, nullable=False, server_default=default)
