"""Fold chunks into a film's prefix and apply the stop rules.

The fold follows the film's course in double, so the prefix at a given spp has the same bits however
the chunks were grouped, whoever rendered them and however often somebody was killed. Merging ends
at the first boundary where a job's stop rule fires: that job gets exactly this film.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from matiere.errors import Cancelled
from matiere.jobs.artifacts import Artifacts, pack, unpack
from matiere.jobs.course import AdaptiveCourse, Course
from matiere.jobs.job import JsonDict

COURSE = 16384  # chunks of an adaptive film that are told in advance


class ChunkSource:
    """Chunk records by plan index, read from their files when first needed."""

    def __init__(self, folder: Artifacts, files: Sequence[JsonDict]) -> None:
        """Take files as `{"digest", "chunks": [...]}`."""
        self._folder = folder
        self._file_of = {i: f["digest"] for f in files for i in f["chunks"]}
        self._open: dict[str, tuple[JsonDict, list[memoryview]]] = {}
        self._left = {f["digest"]: len(f["chunks"]) for f in files}

    def __contains__(self, index: int) -> bool:
        """Tell whether a chunk is available."""
        return index in self._file_of

    def fold_into(self, fold: Any, index: int) -> float:
        """Add a chunk to `fold` and return its seconds. Raises DamagedFile."""
        digest = self._file_of.pop(index)
        if digest not in self._open:
            self._open[digest] = unpack(self._folder.read(digest))
        header, records = self._open[digest]
        place = header["chunks"].index(index)
        self._left[digest] -= 1
        if self._left[digest] == 0:
            del self._open[digest]
        fold.add(records[place])
        seconds: float = header["seconds"][place]
        return seconds


class MadeHere:
    """Chunks rendered when they are wanted, by the scene at hand."""

    def __init__(self, scene: Any, flag: Any, slots: int, end: int) -> None:
        """Render chunks below `end`; `slots` as in the seconds of any chunk."""
        self._scene, self._flag, self._slots, self._end = scene, flag, slots, end
        self.seconds = 0.0

    def __contains__(self, index: int) -> bool:
        """Tell whether a chunk is to be had."""
        return index < self._end

    def fold_into(self, fold: Any, index: int) -> float:
        """Add a chunk to `fold` and return its seconds. Raises Cancelled."""
        begin = time.monotonic()
        part = self._scene.render_part(index, self._flag)
        if part is None:
            raise Cancelled("the render was cancelled")
        seconds = (time.monotonic() - begin) / self._slots
        self.seconds += seconds
        fold.add_part(part)
        return seconds


Source = ChunkSource | MadeHere


def open_film(folder: Artifacts, digest: str, record: int) -> tuple[JsonDict, memoryview]:
    """Return header and bytes of a stored film, alone in its file or one of many."""
    header, records = unpack(folder.read(digest))
    return header["films"][record] if "films" in header else header, records[record]


class PackCache:
    """Reads signatures out of files of many films, the last file kept open."""

    def __init__(self, folder: Artifacts) -> None:
        """Read from `folder`."""
        self._folder = folder
        self._digest, self._records = "", list[memoryview]()
        self._films = 0

    def signature(self, digest: str, record: int) -> bytes | None:
        """Return the signature of one film; None in a file without. Raises DamagedFile."""
        if digest != self._digest:
            header, self._records = unpack(self._folder.read(digest))
            self._digest, self._films = digest, len(header.get("films", ()))
        return bytes(self._records[self._films + record]) if self._films else None


class Prefix:
    """The merged film so far, with its log of error against time."""

    def __init__(self, work: Any, request: JsonDict, folder: Artifacts) -> None:
        """Open the stored prefix of the request, or an empty film."""
        adaptive = request.get("adaptive", False)
        size = request["width"], request["height"], request["replicates"]
        self.plan = work.plan(*size, adaptive)
        self.chunks, self.seconds, self.log = 0, 0.0, list[JsonDict]()
        stored: memoryview | None = None
        if request["prefix"] is not None:
            header, stored = open_film(folder, request["prefix"], request.get("record", 0))
            self.chunks, self.seconds = header["chunks"], header["seconds"]
            self.log = header["log"]
        self.fold = work.open_fold(self.plan, stored)
        self.course = AdaptiveCourse(self.plan, self.chunks, 0) if adaptive else Course(self.plan)
        self.decided()

    @property
    def spp(self) -> int:
        """Samples per pixel merged so far."""
        return self.course.spp(self.chunks)

    def decided(self) -> JsonDict | None:
        """Take over what the film has decided about its next chunks, and return it."""
        if not isinstance(self.course, AdaptiveCourse):
            return None
        self.course.tell(self.fold.course(COURSE))
        return self.course.news

    def advance(self, source: Source) -> bool:
        """Fold in the next whole round, if all its chunks are there."""
        wanted = range(self.chunks, self.course.following(self.chunks))
        if not wanted or not all(index in source for index in wanted):
            return False
        for index in wanted:
            self.seconds += source.fold_into(self.fold, index)
        self.chunks = wanted.stop
        if self.course.waits(self.chunks):
            self.decided()
        return True

    def look(self) -> JsonDict:
        """Return (and log) the estimate at this boundary."""
        if self.log and self.log[-1]["spp"] == self.spp:
            return self.log[-1]
        row: JsonDict = self.fold.look(self.spp, self.seconds)
        self.log.append(row)
        return row

    def measured(self, stop: JsonDict, row: JsonDict) -> JsonDict:
        """Add to this boundary's row what the job's own target needs: the view is the job's."""
        target = stop.get("target_error")
        if not target or "display" not in target or row["spp"] != self.spp:
            return row
        added: JsonDict = self.fold.measured(stop, row)
        return added

    def header(self) -> JsonDict:
        """Return what is stored beside the film."""
        return {"spp": self.spp, "chunks": self.chunks, "seconds": self.seconds, "log": self.log}

    def facts(self) -> JsonDict:
        """Return what the database keeps of the film."""
        row = self.log[-1] if self.log else {}
        facts = {"spp": self.spp, "seconds": self.seconds}
        return facts | {key: row.get(key) for key in ("relmse", "lower", "upper")}


def merge(work: Any, request: JsonDict, folder: Artifacts) -> JsonDict:
    """Merge what is there up to the first boundary that ends a job; return the new state.

    `request`: width, height, replicates, prefix (digest or None), files, jobs (`id`, `stop`,
    `spp_cap`, `fresh`: not looked at yet). The answer holds digest and size of the new prefix
    (None when nothing was merged), chunks, facts, `ended` jobs with reason, `shares` by job of the
    way to its target error, and the `course` that an adaptive film has decided on.
    """
    prefix = Prefix(work, request, folder)
    start = prefix.chunks
    source = ChunkSource(folder, request["files"])
    shares: dict[str, float] = {}
    ended = settle(work, prefix, source, request["jobs"], shares)
    digest, size = None, 0
    if prefix.chunks > start:
        digest, size = folder.write(pack(prefix.header(), [prefix.fold.to_bytes()]))
    return {"digest": digest, "size": size, "chunks": prefix.chunks, "facts": prefix.facts(),
            "ended": ended, "shares": shares, "course": prefix.decided()}  # fmt: skip


def settle(
    work: Any, prefix: Prefix, source: Source, jobs: Sequence[JsonDict], shares: dict[str, float]
) -> list[JsonDict]:
    """Fold in what `source` has up to the first boundary that ends a job; return those that end."""
    ended = _ended(work, prefix, jobs, shares) if prefix.chunks else []
    while not ended and prefix.advance(source):
        if any(work.look_due(prefix.plan, job["stop"], prefix.spp) for job in jobs):
            prefix.look()
        ended = _ended(work, prefix, jobs, shares)
    if ended and prefix.chunks:
        prefix.look()
    facts = prefix.facts()
    for job in ended:
        job |= facts
    return ended


def _ended(
    work: Any, prefix: Prefix, jobs: Sequence[JsonDict], shares: dict[str, float]
) -> list[JsonDict]:
    found = list[JsonDict]()
    for job in jobs if prefix.course.ends_round(prefix.chunks) else ():
        newest = prefix.log[-1] if prefix.log else None
        if job["fresh"] and job["stop"].get("target_error"):
            newest = prefix.look()
        if newest is not None:
            newest = prefix.measured(job["stop"], newest)
            share = work.target_share(job["stop"], newest)
            if share is not None:
                shares[job["id"]] = share
        reason = work.stop_reason(prefix.plan, job["stop"], prefix.spp, prefix.seconds, newest)
        if reason is None and prefix.spp >= job["spp_cap"]:
            reason = "spp"
        if reason is None:
            reason = job.get("late")
        if reason is not None:
            found.append({"job_id": job["id"], "reason": reason})
    return found
