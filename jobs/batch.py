"""Small films rendered whole inside a child: every chunk, the fold and the stop rules, one file.

The fold is that of `merge`, in the same order, so the bits are those of a film whose chunks went
through the queue one by one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from matiere.errors import Cancelled
from matiere.jobs.artifacts import Artifacts, pack
from matiere.jobs.cells import Sweeps, film_scene
from matiere.jobs.job import JsonDict
from matiere.jobs.merge import MadeHere, Prefix, settle

Made = tuple[JsonDict, bytes, bytes]  # facts, film, signature
Describe = Callable[[BaseException], JsonDict]


class BatchRenderer:
    """Renders claims of many small films; keeps geometry from one to the next."""

    def __init__(
        self, work: Any, sweeps: Sweeps, describe: Describe, threads: int, slots: int
    ) -> None:
        """Render with one thread per film; `describe` puts an exception into a report."""
        self._work, self._sweeps, self._describe, self._slots = work, sweeps, describe, slots
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="films")
        self._like: Any = None  # the scene built last: its geometry serves the next

    def render(
        self, request: JsonDict, folder: Artifacts, flag: Any, begun: Callable[[int], None]
    ) -> JsonDict | None:
        """Render the claimed films into one artifact; None if cancelled meanwhile.

        `begun(film_id)` is called before each, so that a crash is laid at the right door.
        """
        start = time.monotonic()

        def one(film: JsonDict) -> Made | None:
            begun(film["id"])
            try:
                return self._film(film, folder, flag, request.get("slots", self._slots))
            except Cancelled:
                return None
            except Exception as error:
                return {"id": film["id"], **self._describe(error)}, b"", b""

        made = list(self._pool.map(one, request["films"]))
        good = [film for film in made if film is not None]
        if len(good) < len(made):
            return None
        stored = [made for made in good if "error" not in made[0]]
        answer: JsonDict = {"digest": None, "size": 0, "render_s": time.monotonic() - start}
        if stored:
            header = {"films": [facts.pop("header") for facts, _, _ in stored]}
            records = [film for _, film, _ in stored] + [signed for _, _, signed in stored]
            answer["digest"], answer["size"] = folder.write(pack(header, records))
        for record, (facts, _, _) in enumerate(stored):
            facts["record"] = record
        answer["films"] = [facts for facts, _, _ in stored]
        answer["failed"] = [facts for facts, _, _ in good if "error" in facts]
        return answer

    def _film(self, film: JsonDict, folder: Artifacts, flag: Any, slots: int) -> Made:
        prefix = Prefix(self._work, film, folder)
        wanted = max(job["spp_cap"] for job in film["jobs"])
        begin = prefix.chunks
        opened = self._open(film, flag)
        source = MadeHere(opened, flag, slots, prefix.plan.chunk_count(wanted))
        ended = settle(self._work, prefix, source, film["jobs"], {})
        facts = {"id": film["id"], "ended": ended, "chunks": prefix.chunks, **prefix.facts()}
        facts |= {"rendered_s": source.seconds, "rendered_chunks": prefix.chunks - begin}
        signed = self._work.sign(prefix.fold, opened, film["film_key"])
        return facts | {"header": prefix.header()}, bytes(prefix.fold.to_bytes()), signed

    def _open(self, film: JsonDict, flag: Any) -> Any:
        sweep = self._sweeps.get(film["plan"], film["assets"])
        scene = film_scene(sweep.scene(film["cell"]))
        opened = self._work.open_scene(
            scene,
            self._sweeps.located(film["assets"]),
            film["replicates"],
            1,
            flag,
            like=self._like,
        )
        self._like = opened
        return opened
