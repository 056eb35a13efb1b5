"""Make room for sweeps that are expanded as they go and for small films rendered whole."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

SERIAL = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Add the columns; sweeps known so far have all their jobs."""
    no = sa.false()
    op.add_column("film", sa.Column("whole", sa.Boolean(), nullable=False, server_default=no))
    op.add_column("film", sa.Column("plan", sa.String(64)))
    op.add_column("film", sa.Column("cell", sa.Integer()))
    op.add_column("film", sa.Column("claim_token", SERIAL))
    for name in ("tries", "losses", "prefix_record"):
        op.add_column("film", _number(name))
    op.create_index("ix_film_claim_token", "film", ["claim_token"])
    op.add_column("sweep", _number("expanded"))
    for name in ("cancelled", "paused"):
        op.add_column("sweep", sa.Column(name, sa.Boolean(), nullable=False, server_default=no))
    op.add_column("sweep", _number("priority", 50))
    op.add_column("sweep", sa.Column("request", sa.Text(), nullable=False, server_default="{}"))
    op.execute("UPDATE sweep SET expanded = cells")
    op.add_column("job", _number("film_record"))
    op.create_index("ix_job_sweep_state", "job", ["sweep_id", "state"])
    with op.batch_alter_table("attempt") as attempt:
        attempt.alter_column("film_id", existing_type=SERIAL, nullable=True)


def _number(name: str, default: int = 0) -> sa.Column[int]:
    return sa.Column(name, sa.Integer(), nullable=False, server_default=str(default))
