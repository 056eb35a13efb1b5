"""Fixtures of the HTTP tests: the application over a queue in memory, on a real loopback port."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("fastapi", reason="needs the extra matiere[service]")

import httpx
from fake_engine import BODY_TIMEOUT_S, MAX_ASSET_BYTES, FakeEngine
from fastapi import FastAPI

from matiere.service.app import create_app
from matiere.service.server import BackgroundServer, bind, url_of
from matiere.service.settings import Settings


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[FastAPI, str]]:
    """Serve one application for the whole run, on a free loopback port."""
    folder = tmp_path_factory.mktemp("served")
    settings = Settings(data=folder, max_asset_bytes=MAX_ASSET_BYTES, body_timeout_s=BODY_TIMEOUT_S)
    app = create_app(FakeEngine(folder), settings)
    sock = bind("127.0.0.1", 0)
    url = url_of(sock)
    with BackgroundServer(app, sock):
        yield app, url


@pytest.fixture
def app(served: tuple[FastAPI, str]) -> FastAPI:
    """Return the application."""
    return served[0]


@pytest.fixture
def url(served: tuple[FastAPI, str]) -> str:
    """Return the URL of the application."""
    return served[1]


@pytest.fixture
def engine(app: FastAPI, tmp_path: Path) -> FakeEngine:
    """Put an empty queue behind the application and return it."""
    engine = FakeEngine(tmp_path)
    app.state.engine = engine
    return engine


@pytest.fixture
def client(url: str, engine: FakeEngine) -> Iterator[httpx.Client]:
    """Return an HTTP client of the application."""
    with httpx.Client(base_url=url, timeout=10) as client:
        yield client
