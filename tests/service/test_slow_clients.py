"""Clients that send slowly, or nothing: they are told and closed, and others do not notice."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psutil
import pytest
from fake_engine import BODY_TIMEOUT_S, FakeEngine

from matiere.service.app import create_app
from matiere.service.patience import PatientProtocol
from matiere.service.server import BackgroundServer, bind, url_of
from matiere.service.settings import Settings

IDLE = 300
GROWTH_BYTES = 64 * 2**20


@pytest.fixture
def hasty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Serve with a second for each header."""
    monkeypatch.setattr(PatientProtocol, "header_s", 1.0)
    settings = Settings(data=tmp_path, body_timeout_s=BODY_TIMEOUT_S)
    sock = bind("127.0.0.1", 0)
    url = url_of(sock)
    with BackgroundServer(create_app(FakeEngine(tmp_path), settings), sock):
        yield url


def connect(url: str) -> socket.socket:
    """Open a connection that sends nothing."""
    where = urlsplit(url)
    return socket.create_connection((where.hostname, where.port), timeout=20)


def answer(sock: socket.socket) -> tuple[int, dict[str, object]]:
    """Read status and problem until the server closes."""
    data = b""
    with contextlib.suppress(ConnectionResetError):
        while piece := sock.recv(65536):
            data += piece
    head, _, body = data.partition(b"\r\n\r\n")
    assert b"application/problem+json" in head, data
    return int(head.split()[1]), json.loads(body)


@pytest.mark.parametrize(
    "begin", [b"", b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: 1"], ids=["nothing", "cut"]
)
def test_a_header_that_does_not_come_is_408(hasty: str, begin: bytes) -> None:
    with connect(hasty) as sock:
        sock.sendall(begin)
        status, problem = answer(sock)
    assert (status, problem["code"]) == (408, "request_timeout")


def test_drips_do_not_give_a_header_more_time(hasty: str) -> None:
    begun = time.monotonic()
    with connect(hasty) as sock:
        sock.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n")
        sock.settimeout(0.1)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            while time.monotonic() - begun < 20:
                sock.sendall(b"X-A: b\r\n")
                with contextlib.suppress(TimeoutError):
                    if not sock.recv(65536, socket.MSG_PEEK) or True:
                        break
        sock.settimeout(20)
        assert answer(sock)[0] == 408


def test_drips_do_not_keep_a_body_coming(hasty: str) -> None:
    with connect(hasty) as sock:
        sock.sendall(
            b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Content-Length: 1000000\r\n\r\n"
        )
        status = 0
        for _ in range(200):  # never a pause of BODY_TIMEOUT_S
            sock.sendall(b" ")
            sock.settimeout(BODY_TIMEOUT_S / 5)
            with contextlib.suppress(TimeoutError):
                status = int(sock.recv(65536).split()[1])
                break
    assert status == 408


def test_an_ordinary_connection_is_kept_between_requests(hasty: str) -> None:
    with httpx.Client(base_url=hasty) as client:
        for _ in range(3):
            assert client.get("/healthz").status_code == 200
            time.sleep(0.6)


def test_what_is_no_http_gets_a_problem(hasty: str) -> None:
    for text in (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\r\n\r\n", b"GET\r\n\r\n",
                 b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 20_000):  # fmt: skip
        with connect(hasty) as sock:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                sock.sendall(text)
            status, problem = answer(sock)
        assert (status, problem["code"]) in ((400, "bad_request"), (431, "bad_request"))


def test_hundreds_of_idle_connections_stop_nobody(url: str, client: httpx.Client) -> None:
    """Of all kinds: silent, cut within the header, cut within the body."""
    process = psutil.Process(os.getpid())
    client.get("/healthz")
    before = process.memory_info().rss
    begins = [
        b"", b"GET / HTTP/1.1\r\nHost: ",
        b"PUT /v1/assets/" + b"0" * 64 + b" HTTP/1.1\r\nHost: localhost\r\n"
        b"Content-Type: application/octet-stream\r\nContent-Length: 9\r\n\r\n",
    ]  # fmt: skip
    with contextlib.ExitStack() as stack:
        for number in range(IDLE):
            sock = stack.enter_context(connect(url))
            if number % 10 == 0:
                sock.sendall(begins[2])
            else:
                sock.sendall(begins[number % 2])
        for _ in range(20):
            assert client.get("/healthz").status_code == 200
            assert client.post("/v1/jobs", json={"scene": {"version": 1}}).status_code == 202
        assert process.memory_info().rss - before < GROWTH_BYTES


def test_too_many_connections_are_told_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("matiere.service.server.raise_file_limit", lambda: 5)
    sock = bind("127.0.0.1", 0)
    url = url_of(sock)
    app = create_app(FakeEngine(tmp_path), Settings(data=tmp_path))
    with BackgroundServer(app, sock), contextlib.ExitStack() as stack:
        for _ in range(5):
            stack.enter_context(connect(url))
        with connect(url) as sixth:
            status, problem = answer(sixth)
        assert (status, problem["code"]) == (503, "busy")
        stack.close()
        until = time.monotonic() + 20
        while time.monotonic() < until:
            with contextlib.suppress(httpx.HTTPError):
                if httpx.get(f"{url}/healthz").status_code == 200:
                    return
            time.sleep(0.1)
        raise AssertionError("not served again")
