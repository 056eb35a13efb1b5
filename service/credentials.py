"""What a client needs to know of a service: where it listens, and the key that opens it."""

from __future__ import annotations

import os
from pathlib import Path

from matiere.errors import MatiereError

KEY, KEY_FILE = "MATIERE_API_KEY", "MATIERE_API_KEY_FILE"
UNIX = "unix:"


class NoKeyFile(MatiereError):
    """The file that should hold the API key cannot be read."""

    default_code = "no_key_file"


def key_of_environment() -> str | None:
    """Return the API key of MATIERE_API_KEY, or of the file that MATIERE_API_KEY_FILE names."""
    if key := os.environ.get(KEY):
        return key.strip()
    if not (name := os.environ.get(KEY_FILE)):
        return None
    try:
        return Path(name).read_text(encoding="utf-8").strip()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is not text"
        raise NoKeyFile(f"{KEY_FILE} names {name}, which cannot be read: {why}") from None


def place_of(url: str) -> tuple[str, str | None]:
    """Return the base URL of requests, and the Unix socket of `unix:/path`, if it is one."""
    if url.startswith(UNIX):
        return "http://localhost", url.removeprefix(UNIX)
    return url.rstrip("/"), None
