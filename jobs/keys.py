"""API keys: made, listed, rotated, revoked. Only their SHA-256 is stored.

A key reads `mt_<id>_<43 characters>`: the id is no secret and names it in lists and logs, the rest
are 32 random bytes. A scope includes those before it: `read`, `submit`, `admin`.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import re
import secrets
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.datadir import DataDir
from matiere.jobs.errors import JobNotFound
from matiere.jobs.store import keys
from matiere.jobs.store.database import Database

SCOPES = ("read", "submit", "admin")
DAY_S = 86400.0
MAX_NAME = 100
_FORM = re.compile(r"mt_([0-9a-f]{8})_([0-9A-Za-z_-]{43})")


class KeyNotFound(JobNotFound):
    """There is no such key."""

    default_code = "key_not_found"


@dataclass(frozen=True)
class Key:
    """What is known of a key; times are Unix seconds."""

    id: str
    name: str
    scope: str
    digest: str  # SHA-256 of the whole key, lower-case hex
    created: float
    expires: float | None
    revoked: float | None

    def valid(self, now: float) -> bool:
        """Tell whether it opens anything now."""
        return self.revoked is None and (self.expires is None or now < self.expires)

    def allows(self, scope: str) -> bool:
        """Tell whether its scope includes another."""
        return SCOPES.index(self.scope) >= SCOPES.index(scope)


class Keys:
    """The keys of one store."""

    def __init__(self, database: Database, clock: Callable[[], float] = time.time) -> None:
        """Use an open store; `clock` gives Unix seconds."""
        self._db, self._clock = database, clock

    def create(self, name: str, scope: str, days: float | None = None) -> tuple[Key, str]:
        """Make a key that expires after `days` (None: never); return it and its only full text.

        Raises `SceneValidationError` for a bad scope, name or number of days.
        """
        _check(name, scope, days)
        key_id = secrets.token_hex(4)
        text = f"mt_{key_id}_{secrets.token_urlsafe(32)}"
        now = self._clock()
        expires = None if days is None else now + days * DAY_S
        key = Key(key_id, name, scope, _digest(text), now, expires, None)
        self._db.write(lambda c: keys.add(c, **vars(key)))
        return key, text

    def list(self) -> list[Key]:
        """Return all keys, oldest first, the dead ones too."""
        return [Key(**row._mapping) for row in self._db.read(keys.rows)]

    def get(self, key_id: str) -> Key:
        """Return a key. Raises `KeyNotFound`."""
        for key in self.list():
            if key.id == key_id:
                return key
        raise KeyNotFound(f"no key {key_id[:40]!r}")

    def revoke(self, key_id: str) -> Key:
        """End a key at once. Raises `KeyNotFound`."""
        key = self.get(key_id)
        if key.revoked is None:
            self._db.write(lambda c: keys.change(c, key_id, revoked=self._clock()))
        return self.get(key_id)

    def rotate(
        self, key_id: str, *, days: float | None = None, overlap_hours: float = 24.0
    ) -> tuple[Key, str]:
        """Make a successor of the same name and scope; the old one ends after `overlap_hours`.

        Raises `KeyNotFound`, and `SceneValidationError` for a key that has ended.
        """
        old, now = self.get(key_id), self._clock()
        if not old.valid(now):
            raise SceneValidationError([Fault("", "key_ended", f"key {key_id} has ended")])
        made = self.create(old.name, old.scope, days)
        end = now + max(0.0, overlap_hours) * 3600.0
        end = end if old.expires is None else min(end, old.expires)
        self._db.write(lambda c: keys.change(c, key_id, expires=end))
        return made


def match(text: str, known: dict[str, Key]) -> Key | None:
    """Return the key (of id -> key) that a text is, in time that tells nothing about it."""
    form = _FORM.fullmatch(text)
    key = known.get(form[1]) if form else None
    same = hmac.compare_digest(_digest(text), key.digest if key else "0" * 64)
    return key if same else None


@contextlib.contextmanager
def open_keys(root: Path, database_url: str | None = None) -> Iterator[Keys]:
    """Give the keys of a data directory that no service has open. Raises `DataDirLocked`."""
    with contextlib.closing(DataDir.open(root)) as data:
        database = Database(None if database_url else data.store, database_url)
        with contextlib.closing(database):
            yield Keys(database)


def any_valid(root: Path, database_url: str | None = None) -> bool:
    """Tell whether there is a key that opens something now; nothing is made to find out."""
    if not (database_url or (root / "store.sqlite").exists()):
        return False
    with open_keys(root, database_url) as keys:
        return any(key.valid(time.time()) for key in keys.list())


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def _check(name: str, scope: str, days: float | None) -> None:
    faults = []
    if scope not in SCOPES:
        faults.append(Fault("/scope", "unknown_scope", f"must be one of {', '.join(SCOPES)}"))
    if not 1 <= len(name) <= MAX_NAME or not name.isprintable():
        why = f"must have 1 to {MAX_NAME} printable characters"
        faults.append(Fault("/name", "wrong_length", why))
    if days is not None and not 0 < days <= 36500:
        faults.append(Fault("/days", "out_of_range", "must be above 0 and at most 36500"))
    if faults:
        raise SceneValidationError(faults)
