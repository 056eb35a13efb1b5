"""One film that jobs wait for, as the scheduler sees it: which chunks to hand out, when to merge.

All decisions here are about order and grouping. They never change the bits of a result: those are
fixed by the plan, and stop rules are applied by `merge` at boundaries of the merged film alone.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Sequence
from typing import Any

from matiere.jobs.course import AdaptiveCourse, Course, is_adaptive
from matiere.jobs.job import AGEING_S, JsonDict
from matiere.jobs.limits import BYTES_PER_SAMPLE_SUM
from matiere.jobs.store.files import Blob
from matiere.jobs.store.films import FilmRow

MERGE_EVERY_S = 2.0  # progress and previews of long jobs
MERGE_BYTES_PER_S = 20 * 2**20  # a large prefix is rewritten less often
MERGE_BYTES = 64 * 2**20  # unmerged chunk files beyond this, or beyond two passes, are folded in
SECONDS_SLACK = 1.05


class FilmWork:
    """A film in the scheduler's window."""

    def __init__(self, row: FilmRow, work: Any, now: float) -> None:
        """Take over the stored state."""
        self.row = row
        self.id, self.key, self.geometry_key = row.id, row.film_key, row.geometry_key
        self.adaptive = is_adaptive(row.scene)
        self.plan = work.plan(row.width, row.height, row.replicates, self.adaptive)
        self.course = (
            AdaptiveCourse(self.plan, row.prefix_chunks, row.prefix_spp)
            if self.adaptive
            else Course(self.plan)
        )
        self._work = work
        self.jobs = row.jobs
        self.prefix, self.prefix_chunks = row.prefix, row.prefix_chunks
        self.record = row.prefix_record
        self.done = dict(row.done)
        self.files = dict(row.files)
        self.tries, self.losses = dict(row.tries), dict(row.losses)
        self.claimed: dict[int, int] = {}
        self.merging = False
        self.evaluated: set[str] = set()  # jobs the merger has seen at this prefix or later
        self.late: dict[str, str] = {}  # why jobs are to end with the next round
        self.ahead = 1.0  # times its samples it may go before the next look at its error
        self.seconds, self.pixel_samples = row.seconds, row.pixel_samples
        self.merged_at = now
        self.last_child = ""
        self._returned: list[int] = []
        self._cursor = row.prefix_chunks

    # -- facts --------------------------------------------------------------------------------
    @property
    def urgency(self) -> int:
        """Highest place in the queue of the jobs that wait, in whole points of priority."""
        return int(max((job.rank for job in self.jobs), default=0.0) // AGEING_S)

    @property
    def prefix_spp(self) -> int:
        """Merged samples per pixel."""
        return self.course.spp(self.prefix_chunks)

    @property
    def pixels(self) -> int:
        """Pixels of the film."""
        return self.row.width * self.row.height

    def samples(self, index: int) -> int:
        """Samples of one chunk."""
        return self.course.samples(index)

    def ready_chunks(self) -> int:
        """Position up to which every chunk is merged or done, cut down to a whole round."""
        end = self.prefix_chunks
        while end in self.done:
            end += 1
        return self.course.whole(end)

    # -- handing out --------------------------------------------------------------------------
    def horizon(self) -> int:
        """Position below which chunks are wanted now."""
        spp = max((self._wanted_spp(job.stop, job.spp_cap) for job in self.jobs), default=0)
        if self.jobs and not self.course.ends_round(self.prefix_chunks):
            spp = max(spp, int(self.plan.round_up(self.prefix_spp + 1)))
        return self.course.end(spp)

    def _wanted_spp(self, stop: JsonDict, cap: int) -> int:
        following = int(self.plan.round_up(self.prefix_spp + 1))
        wanted = cap
        if stop.get("target_error"):
            look = following
            least = self.ahead * self.prefix_spp
            while look < cap and (look < least or not self._work.look_due(self.plan, stop, look)):
                look = int(self.plan.round_up(look + 1))
            wanted = min(wanted, look)
        if stop.get("seconds"):
            wanted = min(wanted, max(following, self._spp_after(stop["seconds"])))
        return min(cap, wanted)

    def _spp_after(self, seconds: float) -> int:
        """Return the last boundary expected within `seconds`, or 0."""
        if self.pixel_samples == 0 or self.seconds <= 0.0:
            return 0
        spp = seconds * SECONDS_SLACK * self.pixel_samples / (self.seconds * self.pixels)
        above = int(self.plan.round_up(max(1, min(int(spp) + 1, self._work.OPEN_ENDED_SPP))))
        ranges = int(self.plan.ranges(above))
        return int(self.plan.boundary(ranges - 1))

    def available(self, limit: int = 1) -> bool:
        """Tell whether at least one chunk can be handed out."""
        self._skip()
        return bool(self._returned) or self._cursor < self.horizon()

    def next_range(self) -> tuple[int, bool]:
        """Return the samples that the next range lacks, and whether some of it was given out."""
        self._skip()
        position = min([*self._returned[:1], self._cursor])
        start = self.course.whole(position)
        wanted = range(start, self.course.following(start))
        if position not in wanted:  # not decided yet
            return 0, True
        lacking = sum(i not in self.done and i not in self.claimed for i in wanted)
        return lacking * self.samples(position), lacking < len(wanted)

    def take(self, samples: float, most: int) -> list[int]:
        """Return the next chunks to render: about `samples` samples, at least one chunk."""
        chunks: list[int] = []
        total, end = 0, self.horizon()
        while len(chunks) < most and (not chunks or total < samples):
            self._skip()
            if self._returned and self._returned[0] < end:
                index = heapq.heappop(self._returned)
            elif self._cursor < end:
                index = self._cursor
                self._cursor += 1
            else:
                break
            chunks.append(index)
            total += self.samples(index)
        return chunks

    def put_back(self, chunks: list[int]) -> None:
        """Take chunks back that nobody renders any more."""
        for index in chunks:
            self.claimed.pop(index, None)
            if index >= self.prefix_chunks and index not in self.done:
                heapq.heappush(self._returned, index)

    def _skip(self) -> None:
        while self._cursor in self.done or self._cursor in self.claimed:
            self._cursor += 1
        while self._returned and (
            self._returned[0] in self.done
            or self._returned[0] in self.claimed
            or self._returned[0] < self.prefix_chunks
        ):
            heapq.heappop(self._returned)

    # -- merging ------------------------------------------------------------------------------
    def merge_due(self, now: float) -> bool:
        """Tell whether merging could end a job, or has been put off long enough."""
        if self.merging or not self.jobs:
            return False
        if self.prefix_chunks and any(job.id not in self.evaluated for job in self.jobs):
            return True
        if not self.course.told:
            return True
        if self.late and self.course.ends_round(self.prefix_chunks):
            return True
        ready = self.ready_chunks()
        if ready <= self.prefix_chunks:
            return False
        spp = self.course.spp(ready)
        if self.course.waits(ready) or any(
            self._may_end(job.stop, job.spp_cap, spp) for job in self.jobs
        ):
            return True
        waiting = sum(blob.size for blob in self.files.values())
        size = self.pixels * self.row.replicates * BYTES_PER_SAMPLE_SUM
        pause = max(MERGE_EVERY_S, size / MERGE_BYTES_PER_S)
        return now - self.merged_at > pause or waiting > max(MERGE_BYTES, 2 * size)

    def _may_end(self, stop: JsonDict, cap: int, spp: int) -> bool:
        if spp >= cap or spp >= self._wanted_spp(stop, cap):
            return True
        return bool(stop.get("seconds")) and self.seconds >= 0.9 * stop["seconds"]

    def merge_request(self) -> JsonDict:
        """Describe for the utility child what to fold and which stop rules to apply."""
        by_token: dict[int, list[int]] = {}
        for index in range(self.prefix_chunks, self.ready_chunks()):
            by_token.setdefault(self.done[index], []).append(index)
        return {
            "width": self.row.width,
            "height": self.row.height,
            "replicates": self.row.replicates,
            "adaptive": self.adaptive,
            "prefix": self.prefix.digest if self.prefix else None,
            "record": self.record,
            "files": [
                {"digest": self.files[token].digest, "chunks": chunks}
                for token, chunks in by_token.items()
            ],
            "jobs": [
                {
                    "id": job.id,
                    "stop": job.stop,
                    "spp_cap": job.spp_cap,
                    "fresh": job.id not in self.evaluated,
                    "late": self.late.get(job.id),
                }
                for job in self.jobs
            ],
        }

    def adopt(
        self, prefix: Blob | None, chunks: int, seen: Sequence[str], course: JsonDict | None = None
    ) -> None:
        """Record a committed merge that applied the stop rules of the jobs `seen`."""
        self.merging = False
        self.merged_at = time.monotonic()
        self.evaluated |= set(seen)
        self.late = {name: why for name, why in self.late.items() if name not in seen}
        if chunks == self.prefix_chunks or prefix is not None:
            self.course.tell(course)
        if prefix is None:
            return
        self.prefix, self.prefix_chunks, self.record = prefix, chunks, 0
        self.done = {i: token for i, token in self.done.items() if i >= chunks}
        left = set(self.done.values())
        self.files = {token: blob for token, blob in self.files.items() if token in left}
        self._cursor = max(self._cursor, chunks)

    def forget_file(self, digest: str) -> dict[int, int]:
        """Drop a damaged chunk file; return samples lost by the token that made it."""
        lost: dict[int, int] = {}
        for token in [t for t, blob in self.files.items() if blob.digest == digest]:
            chunks = [i for i, t in self.done.items() if t == token]
            for index in chunks:
                del self.done[index]
            del self.files[token]
            self.put_back(chunks)
            lost[token] = sum(map(self.samples, chunks))
        return lost
