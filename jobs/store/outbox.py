"""The outbox: what is to be told to webhooks, written in the transaction of the event itself.

A row stays until its receiver took it or the last attempt failed. Whoever sends claims rows for a
while first; of a sender that was killed the claims run out, so a message may come twice, under one
id, and never not at all.
"""

from __future__ import annotations

import json
import time
from collections.abc import Collection, Sequence
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection
from uuid6 import uuid7

from matiere.jobs.job import JsonDict
from matiere.jobs.store.tables import delivery, webhook


def enqueue(
    c: Connection, kind: str, about: Sequence[tuple[str | None, str | None, JsonDict]]
) -> None:
    """Put one event each of many jobs (job, its sweep, data) into the outbox of who wants it."""
    rows = []
    for hook in c.execute(sa.select(webhook).where(webhook.c.disabled.is_(None))).all():
        if kind not in json.loads(hook.kinds):
            continue
        for job_id, sweep_id, data in about:
            if hook.cells or not (job_id and sweep_id):
                rows.append(_row(hook.id, _body(kind, job_id, sweep_id, data)))
    if rows:
        c.execute(sa.insert(delivery), rows)


def _body(kind: str, job_id: str | None, sweep_id: str | None, data: JsonDict) -> JsonDict:
    links = {"job": f"/v1/jobs/{job_id}" if job_id else None,
             "sweep": f"/v1/sweeps/{sweep_id}" if sweep_id else None}  # fmt: skip
    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    told = {"job_id": job_id, "sweep_id": sweep_id, "links": links, **data}
    return {"type": kind, "timestamp": now, "data": told}


def _row(webhook_id: str, body: JsonDict) -> JsonDict:
    now = time.time()
    return {
        "id": f"msg_{uuid7().hex}",
        "webhook_id": webhook_id,
        "body": json.dumps(body, allow_nan=False),
        "tries": 0,
        "due": now,
        "created": now,
    }


# -- webhooks -------------------------------------------------------------------------------------
def add(c: Connection, **values: Any) -> None:
    """Insert a webhook."""
    c.execute(sa.insert(webhook).values(**values))


def rows(c: Connection) -> Sequence[Any]:
    """Return all webhooks with the number of messages that wait, oldest first."""
    waiting = (
        sa.select(sa.func.count())
        .where(delivery.c.webhook_id == webhook.c.id)
        .scalar_subquery()
        .label("waiting")
    )
    return c.execute(sa.select(webhook, waiting).order_by(webhook.c.created, webhook.c.id)).all()


def remove(c: Connection, webhook_id: str) -> bool:
    """Remove a webhook and what waits for it; tell whether there was one."""
    c.execute(sa.delete(delivery).where(delivery.c.webhook_id == webhook_id))
    return c.execute(sa.delete(webhook).where(webhook.c.id == webhook_id)).rowcount > 0


# -- sending --------------------------------------------------------------------------------------
def due(c: Connection, now: float, without: Collection[str], limit: int) -> list[Any]:
    """Return messages to send now (with `url` and `secret`), the longest due first."""
    wanted = (
        sa.select(delivery, webhook.c.url, webhook.c.secret)
        .join(webhook, webhook.c.id == delivery.c.webhook_id)
        .where(delivery.c.due <= now, webhook.c.id.not_in(without))
        .order_by(delivery.c.due)
        .limit(limit)
    )
    return list(c.execute(wanted).all())


def claim(c: Connection, ids: Sequence[str], now: float, until: float) -> set[str]:
    """Count an attempt of messages that are still due, hold them; return which those are."""
    still = sa.select(delivery.c.id).where(delivery.c.id.in_(ids), delivery.c.due <= now)
    got = set(c.execute(still.with_for_update(skip_locked=True)).scalars())
    held = {"due": until, "tries": delivery.c.tries + 1, "held": True}
    c.execute(sa.update(delivery).where(delivery.c.id.in_(got)).values(held))
    return got


def release(c: Connection, now: float) -> None:
    """Let go of what a sender held that is dead; for a store that no other process writes."""
    c.execute(sa.update(delivery).where(delivery.c.held).values(due=now, held=False))


def delivered(c: Connection, message_id: str, webhook_id: str) -> None:
    """Forget a message that was taken."""
    c.execute(sa.delete(delivery).where(delivery.c.id == message_id))
    mine = sa.update(webhook).where(webhook.c.id == webhook_id)
    c.execute(mine.values(error=None, delivered=webhook.c.delivered + 1))


def put_off(c: Connection, message_id: str, webhook_id: str, error: str, until: float) -> None:
    """Send a message again later."""
    mine = sa.update(delivery).where(delivery.c.id == message_id)
    c.execute(mine.values(due=until, held=False))
    c.execute(sa.update(webhook).where(webhook.c.id == webhook_id).values(error=error))


def give_up(c: Connection, message_id: str, webhook_id: str, error: str) -> None:
    """Drop a message after its last attempt."""
    c.execute(sa.delete(delivery).where(delivery.c.id == message_id))
    mine = sa.update(webhook).where(webhook.c.id == webhook_id)
    c.execute(mine.values(error=error, given_up=webhook.c.given_up + 1))


def disable(c: Connection, webhook_id: str, why: str) -> None:
    """Send nothing any more; what waits is dropped."""
    c.execute(sa.delete(delivery).where(delivery.c.webhook_id == webhook_id))
    mine = sa.update(webhook).where(webhook.c.id == webhook_id)
    c.execute(mine.values(disabled=why, error=why))
