"""A served queue that renders for real, shared by the tests that need one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from matiere.jobs.engine import Engine, open_engine
from matiere.service.app import create_app
from matiere.service.server import BackgroundServer, bind, url_of
from matiere.service.settings import Settings


@contextmanager
def served_queue(data: Path) -> Iterator[tuple[Engine, str]]:
    """Serve a queue with one render child; give it and its URL once it is ready."""
    sock = bind("127.0.0.1", 0)
    url = url_of(sock)
    with (
        open_engine(data, children=1) as engine,
        BackgroundServer(create_app(engine, Settings(data=data)), sock),
    ):
        end = time.monotonic() + 60
        while not engine.readiness().ready:
            assert time.monotonic() < end, engine.readiness()
            time.sleep(0.05)
        yield engine, url
