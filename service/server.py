"""Running the application: sockets, start, announcement, signals, drain, end.

Uvicorn runs in a thread of its own; the main thread waits for signals. On the first SIGTERM or
SIGINT the queue drains while HTTP still answers (`/readyz` and submissions say 503), then all
stops with exit code 0. A second signal ends the process at once: render children end when their
control pipe closes, and the store is safe at any moment.
"""

from __future__ import annotations

import contextlib
import errno
import gc
import logging
import os
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import psutil
import uvicorn
from fastapi import FastAPI

from matiere.errors import MatiereError
from matiere.service.broadcast import Broadcaster
from matiere.service.lockfile import read_announcement
from matiere.service.logs import open_log
from matiere.service.patience import PatientProtocol, raise_file_limit
from matiere.service.settings import Settings

LISTEN_BACKLOG = 512
KEEP_ALIVE_S = 30
STALL_S = 60.0
SWITCH_S = 0.001  # a handler gives way at every question to the store, and waits for its turn
START_TIMEOUT_S = 20.0

log = logging.getLogger("matiere.service")


class ServeError(MatiereError):
    """The service cannot start as asked."""

    default_code = "cannot_serve"


class PortBusy(ServeError):
    """Another process listens on the port."""

    default_code = "port_busy"


def check_keys(settings: Settings) -> None:
    """Raise `ServeError` for a service that others can reach and that has no key.

    Raises `DataDirLocked` and `StoreError` as opening the queue does.
    """
    from matiere.jobs.keys import any_valid

    if settings.asks_for_keys and not any_valid(settings.data, settings.database_url):
        where = " with require_key" if settings.loopback else f" on {settings.host}"
        raise ServeError(
            f"matiere serve{where} asks every client for an API key, and there is none that is "
            "valid. Make one:\n"
            f"  matiere key create --name me --scope admin --data {settings.data}\n"
            "or keep to loopback and reach it from elsewhere through a tunnel, for example "
            "`ssh -L 8470:127.0.0.1:8470 <this machine>`."
        )


def bind_unix(path: Path) -> socket.socket:
    """Return a bound Unix socket that only its owner may connect to (mode 0600).

    Raises `PortBusy` while another process listens there; what a dead one left is replaced.
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    mask = os.umask(0o177)
    try:
        if path.is_socket():
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
                probe.settimeout(1.0)
                if probe.connect_ex(str(path)) == 0:
                    raise PortBusy(f"another process listens on {path}")
            path.unlink()
        sock.bind(str(path))
    except OSError as error:
        sock.close()
        raise ServeError(f"cannot listen on {path}: {error.strerror or error}") from None
    except BaseException:
        sock.close()
        raise
    finally:
        os.umask(mask)
    return sock


def bind(host: str, port: int) -> socket.socket:
    """Return a bound socket that does not listen yet; raise `PortBusy` naming the holder."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # With the protocol named, asyncio turns off the delay of small packets (else 40 ms an answer).
    sock = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a restart need not wait
    # A client that does not read, or has gone without a word, is cut; connections inherit this.
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * STALL_S))
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        if error.errno == errno.EADDRINUSE:
            raise PortBusy(
                f"port {port} on {host} is in use by {_holder(port)}; stop it, or choose another "
                "port (`matiere serve --port 0` takes any free one)"
            ) from None
        if error.errno == errno.EACCES:
            raise ServeError(
                f"this user may not listen on port {port}; choose one above 1023"
            ) from None
        raise ServeError(f"cannot listen on {host}:{port}: {error.strerror}") from None
    return sock


def url_of(sock: socket.socket) -> str:
    """Return the base URL of a bound TCP socket."""
    host, port = sock.getsockname()[:2]
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # every address: this one too
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _holder(port: int) -> str:
    with contextlib.suppress(psutil.Error, OSError):
        for connection in psutil.net_connections("tcp"):
            listening = connection.status == psutil.CONN_LISTEN
            if listening and connection.laddr.port == port and connection.pid:
                command = " ".join(psutil.Process(connection.pid).cmdline())[:120]
                return f"process {connection.pid} ({command})"
    return "another process (of another user, so its name is hidden)"


class BackgroundServer:
    """Uvicorn in a thread: `with BackgroundServer(app, sock):` serves until the block ends."""

    def __init__(self, app: FastAPI, sock: socket.socket) -> None:
        config = uvicorn.Config(
            app,
            http=_protocol(),
            log_config=None,
            access_log=log.isEnabledFor(logging.INFO),
            server_header=False,
            proxy_headers=False,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=5,
            h11_max_incomplete_event_size=64 * 2**10,
            ws="none",
        )
        self._server = _Quiet(config)
        self._streams: Broadcaster = app.state.broadcaster
        self._sock = sock
        self._thread = threading.Thread(target=self._run, name="http", daemon=True)
        self._failure: BaseException | None = None

    def _run(self) -> None:
        sys.setswitchinterval(SWITCH_S)
        try:
            self._server.run(sockets=[self._sock])
        except BaseException as error:
            self._failure = error

    def __enter__(self) -> BackgroundServer:
        """Start, and return once requests are answered."""
        self._sock.listen(LISTEN_BACKLOG)
        self._thread.start()
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                self.stop()
                raise ServeError("the HTTP server did not start") from self._failure
            time.sleep(0.005)
        return self

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()

    @property
    def alive(self) -> bool:
        """Tell whether requests are still answered."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Answer the requests that have begun, then close."""
        self._server.should_exit = True
        self._streams.end()
        self._thread.join(10)
        self._sock.close()


def _protocol() -> type[PatientProtocol]:
    class Protocol(PatientProtocol):
        most_connections = raise_file_limit()

    return Protocol


class _Quiet(uvicorn.Server):
    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals to the main thread."""
        yield


@contextlib.contextmanager
def private_socket() -> Iterator[tuple[socket.socket, str]]:
    """Give a Unix socket that only this user can reach, and its path."""
    with tempfile.TemporaryDirectory(prefix="matiere-") as folder:  # mode 0700
        path = str(Path(folder, "http.sock"))
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sock.bind(path)
        try:
            yield sock, path
        finally:
            sock.close()


def wait_for_signal(server: BackgroundServer) -> str:
    """Block until SIGTERM or SIGINT (a second one ends the process) and return its name."""
    arrived = threading.Event()
    names: list[str] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        names.append(signal.Signals(number).name)
        if len(names) > 1:
            os._exit(1)
        arrived.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, on_signal)
    while not arrived.wait(1.0):
        if not server.alive:
            raise ServeError("the HTTP server stopped by itself; see the log")
    return names[0]


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def refuse_second(data: Path, busy: PortBusy, port: int) -> ServeError:
    """Tell a busy port held by this very data directory's server from any other."""
    other = read_announcement(data)
    if other is not None and other.url.rstrip("/").endswith(f":{port}"):
        return ServeError(
            f"matiere serves {data} already, at {other.url} (pid {other.pid}); "
            f"talk to that one, or stop it with `kill {other.pid}`"
        )
    return busy


def _renderers(settings: Settings, children: int, threads: int) -> str:
    """Say what renders, where, with how many threads."""
    of = f"of {_count(threads, 'thread', 'threads')}"
    if settings.executor == "ray":
        address = settings.ray_address or "the Ray cluster of this machine"
        return f"tasks {of} on the nodes of {address}, 1 utility process here"
    return f"{_count(children, 'render process', 'render processes')} {of}, 1 utility process"


def run(settings: Settings, announce: Callable[[list[tuple[str, str]]], None]) -> None:
    """Serve until a signal comes; `announce` is given (name, value) lines once all runs.

    Raises `ServeError`, `DataDirLocked` or `StoreError` when it cannot start.
    """
    from matiere.jobs import tracing
    from matiere.jobs.engine import open_engine
    from matiere.service.app import create_app
    from matiere.service.webhook_sender import Sender

    check_keys(settings)
    uds = settings.uds
    try:
        sock = bind_unix(uds) if uds else bind(settings.host, settings.port)
    except PortBusy as busy:
        raise refuse_second(settings.data, busy, settings.port) from None
    url = "http://localhost" if uds else url_of(sock)
    with contextlib.ExitStack() as stack:
        stack.callback(sock.close)
        if uds:
            stack.callback(uds.unlink, missing_ok=True)
        engine = stack.enter_context(
            open_engine(
                settings.data,
                limits=settings.limits(),
                webhooks=settings.webhooks,
                **settings.engine_options(),
            )
        )
        log_path = open_log(settings.data, settings.log_level, settings.log_format)
        if settings.tracing:
            tracing.enable()
            stack.callback(tracing.disable)
        app = create_app(engine, settings)
        server = stack.enter_context(BackgroundServer(app, sock))
        if settings.webhooks:
            stack.enter_context(Sender(engine.webhooks, app.state.guard))
        token: str = app.state.gate.owner_token
        engine.announce(url, socket=str(uds) if uds else None, token=token)
        log.info("serving %s from %s", uds or url, settings.data)
        announce(
            [
                ("socket", str(uds)) if uds else ("url", url),
                ("data directory", str(settings.data)),
                ("log", str(log_path)),
                ("children", _renderers(settings, engine.children, engine.threads_per_child)),
            ]
        )
        gc.collect()
        gc.freeze()  # else a full collection walks all that start-up made, and all wait 0.1 s
        name = wait_for_signal(server)
        announce([(name, "finishing the running chunks; send it again to stop at once")])
        log.info("%s: draining", name)
        finished = engine.drain(settings.drain_timeout_s)
        log.info("drained" if finished else "drain time is up; unfinished chunks start again later")
    announce([("stopped", "accepted jobs are kept and go on at the next start")])
