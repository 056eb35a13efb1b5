"""One reader of the event log for all who listen over HTTP: no thread or connection for each.

A stream first reads from the store what happened after the number it starts from, then what the
broadcaster hands it. Both overlap and the numbers decide, so nothing is missing and nothing comes
twice. A listener that falls behind is not buffered without end: it reads from the store again.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from starlette.concurrency import run_in_threadpool

from matiere.jobs.engine import Engine
from matiere.jobs.job import Event
from matiere.service.schemas import EventView

HEARTBEAT_S = 15.0
RETRY_MS = 2000  # after which a browser connects again
PAGE = 500  # events of one reading
MAX_WAITING = 1000  # events handed to a listener that has not sent them yet
MAX_LISTENERS = 2000
IDLE_POLL_S = 0.5  # another service on the same database may write
GATHER_S = 0.02  # a busy queue commits often

log = logging.getLogger("matiere.service.events")


class Topic(NamedTuple):
    """What a stream is about: a job, a sweep with its cells, or everything."""

    job_id: str | None = None
    sweep_id: str | None = None


@dataclass(eq=False)
class _Listener:
    """What one stream has not sent yet."""

    topic: Topic
    waiting: deque[tuple[int, bytes]] = field(default_factory=deque)
    woken: asyncio.Event = field(default_factory=asyncio.Event)
    behind: bool = False

    def tell(self, seq: int, text: bytes) -> None:
        if len(self.waiting) >= MAX_WAITING:
            self.waiting.clear()
            self.behind = True
        if not self.behind:
            self.waiting.append((seq, text))
        self.woken.set()


class Broadcaster:
    """Reads new events once and hands them to every stream they concern."""

    def __init__(self, engine: Callable[[], Engine]) -> None:
        """Serve the events of the queue that `engine` returns."""
        self._engine = engine
        self._listeners: dict[Topic, set[_Listener]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._pump: asyncio.Task[None] | None = None
        self._starting = asyncio.Lock()
        self._woken = asyncio.Event()
        self._position = 0
        self._ended = False

    @property
    def listeners(self) -> int:
        """How many streams are open."""
        return sum(map(len, self._listeners.values()))

    @property
    def full(self) -> bool:
        """Tell whether no further stream is taken."""
        return self._ended or self.listeners >= MAX_LISTENERS

    def end(self) -> None:
        """End every stream; call it from any thread. Clients connect again by themselves."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._end)

    def _end(self) -> None:
        self._ended = True
        self._woken.set()
        for listener in [one for group in self._listeners.values() for one in group]:
            listener.woken.set()

    async def stream(self, topic: Topic, after: int, first: bytes = b"") -> AsyncGenerator[bytes]:
        """Yield, as text of the protocol, `first` and then every event with a number > `after`."""
        yield format_sse_event(data_str=None, retry=RETRY_MS) + first
        while not self._ended:
            listener = await self._join(topic)
            try:
                while page := await self._read(after, topic):
                    after = page[-1].seq
                    yield b"".join(text_of(event) for event in page)
                    if len(page) < PAGE:
                        break
                async for text, reached in self._live(listener, after):
                    after = reached
                    yield text
            finally:
                self._leave(listener)

    async def _live(self, listener: _Listener, after: int) -> AsyncIterator[tuple[bytes, int]]:
        """Yield what the listener is told, with the number reached, until it falls behind."""
        while not (listener.behind or self._ended):
            try:
                await asyncio.wait_for(listener.woken.wait(), HEARTBEAT_S)
            except TimeoutError:
                yield KEEPALIVE_COMMENT, after
                continue
            listener.woken.clear()
            texts = []
            while listener.waiting:
                seq, text = listener.waiting.popleft()
                if seq > after:
                    texts.append(text)
                    after = seq
            if texts:
                yield b"".join(texts), after

    async def _read(self, after: int, topic: Topic) -> list[Event]:
        def read() -> list[Event]:
            return self._engine().events(
                after, job_id=topic.job_id, sweep_id=topic.sweep_id, limit=PAGE
            )

        return await run_in_threadpool(read)

    # -- the reader -----------------------------------------------------------------------------
    async def _join(self, topic: Topic) -> _Listener:
        """Return a listener that is told of all that is committed from now on."""
        async with self._starting:
            if self._pump is None or self._pump.done():
                self._loop = asyncio.get_running_loop()
                self._position = (await run_in_threadpool(self._engine().event_range))[1]
                self._woken.clear()
                self._pump = asyncio.create_task(self._run())
            listener = _Listener(topic)
            self._listeners.setdefault(topic, set()).add(listener)
            return listener

    def _leave(self, listener: _Listener) -> None:
        group = self._listeners[listener.topic]
        group.discard(listener)
        if not group:
            del self._listeners[listener.topic]
            if not self._listeners and self._pump is not None:
                self._pump.cancel()
                self._pump = None

    def _wake(self) -> None:
        """Say that something was committed; called in the writer thread."""
        loop = self._loop
        if loop is not None and not self._woken.is_set():
            try:
                loop.call_soon_threadsafe(self._woken.set)
            except RuntimeError:  # the loop has ended
                pass

    async def _run(self) -> None:
        unwatch = self._engine().watch(self._wake)
        try:
            while not self._ended:
                try:
                    await asyncio.wait_for(self._woken.wait(), IDLE_POLL_S)
                except TimeoutError:
                    pass
                self._woken.clear()
                try:
                    page = await self._read(self._position, Topic())
                except Exception:  # a database that is away for a moment: nothing is lost
                    log.warning("cannot read events; trying again", exc_info=True)
                    await asyncio.sleep(1.0)
                    continue
                for event in page:
                    self._tell(event)
                if len(page) == PAGE:
                    self._woken.set()
                else:
                    await asyncio.sleep(GATHER_S)
        finally:
            unwatch()

    def _tell(self, event: Event) -> None:
        self._position = event.seq
        topics = [Topic()]
        topics += [Topic(job_id=event.job_id)] if event.job_id else []
        topics += [Topic(sweep_id=event.sweep_id)] if event.sweep_id else []
        groups = [group for topic in topics if (group := self._listeners.get(topic))]
        if groups:
            text = text_of(event)
            for group in groups:
                for listener in group:
                    listener.tell(event.seq, text)


def text_of(event: Event) -> bytes:
    """Return an event as text of the protocol; its number is the id to resume from."""
    data = EventView.of(event).model_dump_json()
    return format_sse_event(data_str=data, id=str(event.seq))


def named(name: str, number: int, data: Any) -> bytes:
    """Return an event of a name of its own: `snapshot` or `reset`."""
    return format_sse_event(data_str=json.dumps(data), event=name, id=str(number))
