"""Rendering claims inside a child: scenes kept by key, one thread per chunk, one file per claim."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from matiere.errors import Cancelled
from matiere.jobs.artifacts import Artifacts, pack
from matiere.jobs.job import JsonDict

KEPT_SCENES = 4  # built scenes kept per child, least recently used goes first


class Renderer:
    """Renders chunks of films; keeps the scenes it built."""

    def __init__(self, work: Any, threads: int, slots: int) -> None:
        """Start `threads` render threads."""
        self._work, self._threads, self._slots = work, threads, slots
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="render")
        self._scenes: OrderedDict[str, Any] = OrderedDict()

    def render(
        self,
        request: JsonDict,
        folder: Artifacts,
        flag: Any,
        reading: Callable[..., None] = lambda on: None,
    ) -> JsonDict | None:
        """Render the claimed chunks into one artifact; None if cancelled meanwhile.

        `reading` is told when files begin to be read (`on=True`), which nothing stops, and when
        they have been.
        """
        start = time.monotonic()
        try:
            scene = self._scene(request, flag, reading)
        except Cancelled:
            return None
        built = time.monotonic()

        def one(index: int) -> tuple[bytes, float] | None:
            begin = time.monotonic()
            data = scene.render_chunk(index, flag)
            return None if data is None else (data, time.monotonic() - begin)

        indices: list[int] = request.get("indices") or request["chunks"]
        results = list(self._pool.map(one, indices))
        done = [result for result in results if result is not None]
        if len(done) < len(results):
            return None
        slots = request.get("slots", self._slots)
        seconds = [thread_s / slots for _, thread_s in done]
        header = {"film": request["film_key"], "chunks": request["chunks"], "seconds": seconds}
        digest, size = folder.write(pack(header, [data for data, _ in done]))
        now = time.monotonic()
        return {"digest": digest, "size": size, "seconds": sum(seconds),
                "build_s": built - start, "render_s": now - built}  # fmt: skip

    def _scene(self, request: JsonDict, flag: Any, reading: Callable[..., None]) -> Any:
        key = request["film_key"]
        if key in self._scenes:
            self._scenes.move_to_end(key)
            return self._scenes[key]
        reading(on=True)
        scene = self._work.open_scene(
            request["scene"],
            request["assets"],
            request["replicates"],
            self._threads,
            flag,
            lambda: reading(on=False),
        )
        self._scenes[key] = scene
        while len(self._scenes) > KEPT_SCENES:
            self._scenes.popitem(last=False)
        return scene
