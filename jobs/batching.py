"""Small films and unexpanded sweeps as the scheduler sees them: what to hand out next, and reports.

A claim is about a second of work: cells to make jobs of, or films to render whole.
"""

from __future__ import annotations

import itertools
import logging
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from matiere.jobs.children import LEASE_S, Child
from matiere.jobs.errors import JobsError
from matiere.jobs.job import JobError, JsonDict
from matiere.jobs.limits import BYTES_PER_SAMPLE_SUM
from matiere.jobs.slots import Held
from matiere.jobs.store import batches, cells
from matiere.jobs.store.batches import BatchReport, SmallFilm
from matiere.jobs.store.cells import Expansion
from matiere.jobs.store.files import Blob, FileGone

if TYPE_CHECKING:
    from matiere.jobs.scheduler import Scheduler

log = logging.getLogger("matiere.jobs.batching")

WINDOW = 2048  # small films that are looked at together
FEW = 512  # below so many that wait a sweep is expanded further
SLICE = 256  # cells of one expansion
MOST_SLICES = 6  # of one sweep that are looked at at once
MOST_FILMS = 512  # of one claim
MOST_BYTES = 2**24  # of the films of one claim: a file is read whole to show one of them
FIRST_SAMPLES = 30_000.0  # of a claim before anything was measured
CLAIM_S = 1.0
OVERHEAD_SAMPLES = 2000  # what opening a scene costs, in samples


@dataclass
class Ahead:
    """How far a sweep is looked at beyond the cells that have jobs."""

    expanded: int  # cells [0, expanded) have jobs
    cursor: int  # cells [0, cursor) are handed out
    flying: set[int] = field(default_factory=set)  # first cells of slices that children hold
    ready: dict[int, list[JsonDict]] = field(default_factory=dict)  # rows, waiting for their turn


@dataclass(frozen=True)
class Slice:
    """Cells [first, end) of a sweep."""

    sweep_id: str
    first: int
    end: int


class Batching:
    """Hands out cells to expand and small films to render; lives in the scheduler thread."""

    def __init__(self, scheduler: Scheduler) -> None:
        """Serve `scheduler`."""
        self._scheduler = scheduler
        self._films: OrderedDict[int, SmallFilm] = OrderedDict()
        self._sweeps: list[Expansion] = []
        self._ahead: dict[str, Ahead] = {}
        self._tokens = itertools.count(-1, -1)  # of expansions, which need no fence
        self._rates: dict[str, float] = {}
        self._bad: dict[str, int] = {}  # expansions of a sweep that failed, one after the other
        self._full = False  # there may be more films than the window shows

    # -- what there is to do ----------------------------------------------------------------------
    def read_queue(self) -> None:
        """Read what waits, leaving out what a child holds."""
        found = self._scheduler.db.read(lambda c: batches.waiting_films(c, WINDOW))
        self._films = OrderedDict((f.id, f) for f in found)
        self._full = len(found) >= WINDOW // 2
        self._press()
        self._sweeps = self._scheduler.db.read(cells.unexpanded)
        known = {sweep.sweep_id for sweep in self._sweeps}
        self._ahead = {name: ahead for name, ahead in self._ahead.items() if name in known}

    def _press(self) -> None:
        """Cancel claims of films that nobody wants any more."""
        s = self._scheduler
        for slot in s.slots:
            for held in list(slot.child.inflight.values()) if slot.child else []:
                if held.kind != "batch" or held.cancelled is not None or slot.child is None:
                    continue
                if not s.db.read(batches.any_wanted, held.token):
                    held.cancelled = time.monotonic()
                    slot.child.send("cancel", token=held.token)

    def rank(self) -> tuple[int, str] | None:
        """Return how urgent the first film is, to be compared with other films; None: no film."""
        first = next(iter(self._films.values()), None)
        return first.rank if first else None

    def expansion_due(self) -> Expansion | None:
        """Return the sweep to make more jobs of, if its jobs run out."""
        for sweep in self._sweeps:
            ahead = self._ahead.setdefault(sweep.sweep_id, Ahead(sweep.expanded, sweep.expanded))
            slices = len(ahead.flying) + len(ahead.ready)
            if ahead.cursor < sweep.cells and slices < MOST_SLICES and sweep.waiting < FEW + SLICE:
                return sweep
        return None

    # -- handing out ------------------------------------------------------------------------------
    def expand(self, child: Child, sweep: Expansion, now: float) -> Held:
        """Ask a child for the next slice of a sweep."""
        ahead = self._ahead[sweep.sweep_id]
        part = Slice(sweep.sweep_id, ahead.cursor, min(ahead.cursor + SLICE, sweep.cells))
        ahead.cursor = part.end
        ahead.flying.add(part.first)
        token = next(self._tokens)
        child.send("expand", token=token, plan=sweep.plan, assets={"root": sweep.root},
                   first=part.first, end=part.end)  # fmt: skip
        return Held(token, -1, [], 0, now, kind="expand", detail=part)

    def claim(self, child: Child, now: float) -> Held | None:
        """Give a child the most urgent films that share their geometry; None if none is left."""
        wanted = self._take(child)
        if not wanted:
            return None
        s = self._scheduler
        instance, ids = s.term.instance_id, [f.id for f in wanted]
        try:
            got = s.db.write(lambda c: batches.claim_films(c, ids, instance, child.pid, LEASE_S))
        except JobsError:
            s.dirty()
            raise
        if got is None:  # cancelled a moment ago
            s.dirty()
            return None
        token, mine = got
        films = [f for f in wanted if f.id in mine]
        child.send("batch", token=token, films=[_request(f) for f in films])
        child.geometry = films[0].geometry_key
        held = {f.id: f for f in films}
        return Held(token, -1, [], sum(f.samples for f in films), now, kind="batch", detail=held)

    def _take(self, child: Child) -> list[SmallFilm]:
        if not self._films:
            return []
        first = next(iter(self._films.values()))
        urgent = [f for f in self._films.values() if f.rank[0] == first.rank[0]]
        same = next((f for f in urgent if f.geometry_key == child.geometry), first)
        rate = self._rates.get(same.geometry_key)
        aim = FIRST_SAMPLES if rate is None else rate * CLAIM_S
        share = -(-len(urgent) // (2 * self._scheduler.hands))  # the tail is shared out
        most = MOST_FILMS if self._full or self._sweeps else min(MOST_FILMS, max(share, 1))
        taken: list[SmallFilm] = []
        room = MOST_BYTES
        for f in urgent:
            if f.geometry_key != same.geometry_key:
                continue
            taken.append(f)
            aim -= f.samples + OVERHEAD_SAMPLES
            room -= f.width * f.height * f.replicates * BYTES_PER_SAMPLE_SUM
            if aim <= 0 or room <= 0 or len(taken) >= most:
                break
        for f in taken:
            del self._films[f.id]
        return taken

    # -- reports ----------------------------------------------------------------------------------
    def expanded(self, held: Held, body: JsonDict) -> None:
        """Keep the cells that a child has looked at, and make jobs of all whose turn it is."""
        part: Slice = held.detail
        self._bad.pop(part.sweep_id, None)
        self._insert(part, body["cells"])

    def _insert(self, part: Slice, rows: list[JsonDict]) -> None:
        s, ahead = self._scheduler, self._ahead.get(part.sweep_id)
        if ahead is None or part.first not in ahead.flying:
            return  # of a course that was given up
        ahead.flying.discard(part.first)
        ahead.ready[part.first] = rows
        while (rows := ahead.ready.pop(ahead.expanded, [])) and part.sweep_id in self._ahead:
            of, first = part.sweep_id, ahead.expanded
            if not s.db.write(cells.insert_cells, of, first, rows):
                del self._ahead[part.sweep_id]  # cancelled
            ahead.expanded += len(rows)
            s.health.counters["cells_expanded"] += len(rows)
        s.dirty()
        s.utility.sweeps_may_have_ended()

    def rendered(self, held: Held, body: JsonDict) -> None:
        """Store films and end jobs; count what failed against its own film alone."""
        s, films = self._scheduler, held.detail
        blob = Blob(body["digest"], body["size"]) if body["digest"] else None
        if blob is not None and not s.folder.has(blob.digest, blob.size):
            self.lost(held, "void", JobError("file_missing", "a file just written is gone"))
            return
        self._measure(films, body)
        if failed := body["failed"]:
            self._failed(failed)
        samples = {f["id"]: _rendered(films[f["id"]], f) for f in body["films"]}
        told = body.get("printed", "")
        report = BatchReport(held.token, blob, body["films"], samples, told)
        try:
            accepted = s.db.write(lambda c: batches.complete_films(c, report))
        except FileGone as error:
            self.lost(held, "void", JobError(error.code, error.message))
            return
        s.health.counters["claims_done" if accepted else "reports_superseded"] += 1
        if accepted:
            s.telemetry.rendered_films(held, body)
            s.health.counters["jobs_succeeded"] += sum(len(f["ended"]) for f in body["films"])
            s.health.counters["chunks_rendered"] += sum(f["rendered_chunks"] for f in body["films"])
        s.garbage()
        s.dirty()
        s.utility.sweeps_may_have_ended()

    def _measure(self, films: dict[int, SmallFilm], body: JsonDict) -> None:
        work = sum(f.samples + OVERHEAD_SAMPLES for f in films.values())
        rate = work / max(body["render_s"], 1e-3)
        key = next(iter(films.values())).geometry_key
        known = self._rates.get(key, rate)
        self._rates[key] = 0.5 * (rate + known)

    def _failed(self, failed: list[JsonDict]) -> None:
        s = self._scheduler
        for f in failed:
            s.health.counters[f"failed_{f['error']}"] += 1
            error = JobError(f["error"], f["message"], f["pointer"])
            if f["error"] == "disk_full":
                s.pause_for_disk(f["message"])
            elif f["error"] == "damaged_file":
                s.db.write(batches.forget_prefix, f["digest"])
            elif f["permanent"]:
                s.fail_film(f["id"], error)
            else:
                s.db.write(batches.blame, [f["id"]], "failed")
                self._fail_if_hopeless(f["id"], error)

    def lost(self, held: Held, state: str, error: JobError | None = None) -> None:
        """Take back what a child does not finish; `state` as in `give_back_films`."""
        s = self._scheduler
        if held.kind == "expand":
            self._expansion_lost(held.detail, state, error)
        else:
            s.telemetry.films_lost(held, state, error.code if error else "")
            begun = [held.begun] if held.begun is not None else list(held.detail)[:1]
            guilty = s.db.write(
                lambda c: batches.give_back_films(c, held.token, state, error, begun)
            )
            if error is not None:
                for film_id in guilty:
                    self._fail_if_hopeless(film_id, error)
        s.dirty()

    def _fail_if_hopeless(self, film_id: int, error: JobError) -> None:
        from matiere.jobs.scheduler import MAX_LOSSES, MAX_TRIES

        s = self._scheduler
        tries, losses = s.db.read(lambda c: batches.counted(c, film_id))
        if tries >= MAX_TRIES or losses >= MAX_LOSSES:
            why = f"gave up after {max(tries, losses)} attempts: {error.message}"
            s.fail_film(film_id, JobError(error.code, why, error.pointer, error.log_tail))

    def _expansion_lost(self, part: Slice, state: str, error: JobError | None) -> None:
        """Begin again where jobs end; a slice that fails again and again fails as a whole."""
        from matiere.jobs.scheduler import MAX_TRIES

        if state == "failed" and error is not None:
            self._bad[part.sweep_id] = self._bad.get(part.sweep_id, 0) + 1
            if self._bad[part.sweep_id] >= MAX_TRIES:
                del self._bad[part.sweep_id]
                self._insert(part, _failed_rows(part, error))
                return
        self._ahead.pop(part.sweep_id, None)


def _failed_rows(part: Slice, error: JobError) -> list[JsonDict]:
    fault = {"code": error.code, "message": error.message, "pointer": error.pointer}
    return [
        {"cell": i, "parameters": {}, "label": f"cell {i}", "fault": fault}
        for i in range(part.first, part.end)
    ]


def _request(f: SmallFilm) -> JsonDict:
    jobs: list[JsonDict] = [
        {"id": job.id, "stop": job.stop, "spp_cap": job.spp_cap, "fresh": True} for job in f.jobs
    ]
    return {
        "id": f.id,
        "film_key": f.film_key,
        "plan": f.plan,
        "cell": f.cell,
        "assets": f.assets,
        "width": f.width,
        "height": f.height,
        "replicates": f.replicates,
        "prefix": f.prefix,
        "record": f.record,
        "jobs": jobs,
    }


def _rendered(f: SmallFilm, made: JsonDict) -> int:
    return max(int(made["spp"]) - f.prefix_spp, 0) * f.width * f.height
