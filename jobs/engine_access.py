"""The part of the engine about others: API keys, what the queue takes from each, webhooks."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from matiere.jobs.keys import Keys
from matiere.jobs.limits import check_key, check_queue
from matiere.jobs.store import keys, views
from matiere.jobs.webhooks import Webhooks

if TYPE_CHECKING:
    from matiere.jobs.limits import Limits
    from matiere.jobs.store.database import Database


class EngineAccess:
    """Keys and admission."""

    _db: Database
    _limits: Limits

    @property
    def keys(self) -> Keys:
        """The API keys of the store."""
        return Keys(self._db)

    @property
    def webhooks(self) -> Webhooks:
        """Who is told of which events, and the outbox."""
        return Webhooks(self._db)

    def _admit(
        self, count: int, samples: float, submit: Callable[[Any], str], key_id: str | None
    ) -> str:
        """Submit `count` jobs of so many `samples` if there is room for them; return the id.

        Counting and submission are one transaction, so that none slips in between. Raises
        `QueueFull`, `KeyLimit`, and `SceneValidationError` for what never fits.
        """

        def write(c: Any) -> str:
            check_queue(views.live(c), count, self._limits)
            if key_id is None:
                return submit(c)
            check_key(keys.load(c, key_id), (count, samples), self._limits)
            made = submit(c)
            keys.note_owner(c, made, key_id, samples)
            return made

        return self._db.write(write)
