"""Finding the server of a data directory: `server.json`, written by the process that holds it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Announcement:
    """Where the running server of a data directory listens."""

    url: str
    pid: int
    socket_path: str | None = None
    token: str | None = None  # opens what keys guard; the folder is its owner's alone


def read_announcement(data: Path) -> Announcement | None:
    """Return what `<data>/server.json` says, or None if there is none or its process is gone."""
    try:
        content = json.loads((data / "server.json").read_text(encoding="utf-8"))
        found = Announcement(
            str(content["url"]), int(content["pid"]), content.get("socket"), content.get("token")
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None
    if not found.url.startswith("http") or not _alive(found.pid):
        return None
    return found


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
