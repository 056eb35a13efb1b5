"""Webhooks: who is told of which events, and what waits to be sent. `service` sends.

A secret signs messages, so unlike an API key it is stored as it is, in a folder of mode 0700.
"""

from __future__ import annotations

import base64
import json
import random
import secrets
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from uuid6 import uuid7

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.errors import JobNotFound
from matiere.jobs.job import FINAL_STATES
from matiere.jobs.store import outbox
from matiere.jobs.store.database import Database

ENDS = (*sorted(state.value for state in FINAL_STATES), "sweep_finished")
KINDS = (*ENDS, "deleted", "paused", "queued", "running", "sweep_deleted", "sweep_queued")
MOST_WEBHOOKS = 20
MOST_TRIES = 10
HELD_S = 60.0  # a claim; longer than an attempt may take
FIRST_PAUSE_S, LONGEST_PAUSE_S = 5.0, 86400.0


class WebhookNotFound(JobNotFound):
    """There is no such webhook."""

    default_code = "webhook_not_found"


@dataclass(frozen=True)
class Webhook:
    """A receiver and how it fares; times are Unix seconds."""

    id: str
    url: str
    kinds: tuple[str, ...]
    cells: bool  # also events of the cells of sweeps
    created: float
    delivered: int
    given_up: int
    waiting: int
    error: str | None  # of the newest attempt, None once one succeeded
    disabled: str | None


@dataclass(frozen=True)
class Message:
    """What is sent to one receiver."""

    id: str
    webhook_id: str
    url: str
    secret: str
    body: bytes
    tries: int  # this one included


class Webhooks:
    """The webhooks and the outbox of one store."""

    def __init__(self, database: Database, clock: Callable[[], float] = time.time) -> None:
        """Use an open store; `clock` gives Unix seconds."""
        self._db, self._clock = database, clock

    def create(
        self, url: str, kinds: Collection[str] = ENDS, *, cells: bool = False
    ) -> tuple[Webhook, str]:
        """Tell `url` of events of these kinds; return the webhook and its secret.

        Raises `SceneValidationError` for an unknown kind, or for one webhook too many.
        """
        faults = [
            Fault(f"/kinds/{i}", "unknown_kind", f"must be one of {', '.join(KINDS)}")
            for i, kind in enumerate(kinds)
            if kind not in KINDS
        ]
        if not kinds:
            faults.append(Fault("/kinds", "wrong_length", "must name at least one kind"))
        if len(self.list()) >= MOST_WEBHOOKS:
            why = f"there are {MOST_WEBHOOKS} webhooks already; remove one first"
            faults.append(Fault("", "limit_exceeded", why))
        if faults:
            raise SceneValidationError(faults)
        webhook_id = str(uuid7())
        secret = "whsec_" + base64.b64encode(secrets.token_bytes(32)).decode()
        named = json.dumps(sorted(set(kinds)))
        self._db.write(
            lambda c: outbox.add(
                c, id=webhook_id, url=url, kinds=named, cells=cells, secret=secret,
                created=self._clock(),
            )
        )  # fmt: skip
        return self.get(webhook_id), secret

    def list(self) -> list[Webhook]:
        """Return all webhooks, oldest first."""
        return [
            Webhook(
                r.id, r.url, tuple(json.loads(r.kinds)), r.cells, r.created, r.delivered,
                r.given_up, r.waiting, r.error, r.disabled,
            )
            for r in self._db.read(outbox.rows)
        ]  # fmt: skip

    def get(self, webhook_id: str) -> Webhook:
        """Return a webhook. Raises `WebhookNotFound`."""
        for one in self.list():
            if one.id == webhook_id:
                return one
        raise WebhookNotFound(f"no webhook {webhook_id[:40]!r}")

    def remove(self, webhook_id: str) -> None:
        """Tell it nothing any more; what waits is dropped. Raises `WebhookNotFound`."""
        if not self._db.write(lambda c: outbox.remove(c, webhook_id)):
            raise WebhookNotFound(f"no webhook {webhook_id[:40]!r}")

    # -- sending --------------------------------------------------------------------------------
    def recover(self) -> None:
        """Let go of what a killed sender held, where this process alone writes the store."""
        if not self._db.shared:
            self._db.write(lambda c: outbox.release(c, self._clock()))

    def claim(self, limit: int, without: Collection[str] = ()) -> Sequence[Message]:
        """Hold up to `limit` messages that are due, none of the webhooks in `without`."""
        now = self._clock()
        found = self._db.read(lambda c: outbox.due(c, now, without, limit))
        if not found:
            return []
        ids = [r.id for r in found]
        got = self._db.write(lambda c: outbox.claim(c, ids, now, now + HELD_S))
        return [
            Message(r.id, r.webhook_id, r.url, r.secret, r.body.encode(), r.tries + 1)
            for r in found
            if r.id in got
        ]

    def delivered(self, message: Message) -> None:
        """Say that a message was taken."""
        self._db.write(lambda c: outbox.delivered(c, message.id, message.webhook_id))

    def failed(self, message: Message, error: str) -> None:
        """Say that an attempt failed: the next one is put off, or this was the last."""
        of = (message.id, message.webhook_id, error)
        if message.tries >= MOST_TRIES:
            self._db.write(lambda c: outbox.give_up(c, *of))
            return
        until = self._clock() + pause_s(message.tries)
        self._db.write(lambda c: outbox.put_off(c, *of, until))

    def gone(self, message: Message, error: str) -> None:
        """Say that a receiver wants nothing any more."""
        self._db.write(lambda c: outbox.disable(c, message.webhook_id, error))


def pause_s(tries: int, jitter: Callable[[], float] = random.random) -> float:
    """Return the pause after so many attempts: 5 s, 20 s, 80 s ... a day, within a half of it."""
    return min(FIRST_PAUSE_S * 4.0 ** (tries - 1), LONGEST_PAUSE_S) * (0.5 + jitter())
