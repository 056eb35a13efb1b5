"""Which service a command talks to: `--url`, `MATIERE_URL`, the data directory's, the default."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from matiere.service.client import DEFAULT_URL, Client
from matiere.service.lockfile import Announcement, read_announcement

if TYPE_CHECKING:
    from matiere.service.settings import Settings


def data_dir(data: Path | None) -> Path:
    """Return the data directory that `matiere serve` would use here."""
    from matiere.service.settings import resolve

    return resolve({"data": data}).settings.data


def client_of(url: str | None, data: Path | None) -> Client:
    """Return a client of the service that the options point at."""
    if url is None and data is None:
        url = os.environ.get("MATIERE_URL")
    if url is None:
        if found := read_announcement(data_dir(data)):
            return client_for(found)
        url = DEFAULT_URL
    return Client(url)


def client_for(found: Announcement) -> Client:
    """Return a client of the service that announced itself in a data directory of ours."""
    return Client(found.url, socket_path=found.socket_path, key=found.token)


@contextlib.contextmanager
def running(data: Path | None, url: str | None) -> Iterator[tuple[Client | None, Settings]]:
    """Give a client of the service at `url` or of the data directory; None where none runs."""
    from matiere.service.settings import resolve

    settings = resolve({"data": data}).settings
    found = None if url else read_announcement(settings.data)
    if not (url or found):
        yield None, settings
        return
    with client_for(found) if found else Client(url or "") as client:
        yield client, settings
