"""From a request to rows: check the scene, pin its files, key its film. Touches no pixels:

meshes and images are read by the utility child, once for each set of files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.cells import OpenSweep, document, with_stop
from matiere.jobs.datadir import DataDir
from matiere.jobs.job import MAX_PRIORITY, MIN_PRIORITY, JsonDict
from matiere.jobs.limits import Limits, film_bytes
from matiere.jobs.store.files import Blob
from matiere.jobs.store.jobs import FilmSpec, JobSpec, SweepSpec
from matiere.jobs.sweep import SweepPlan, guess_columns, parse_sweep

STOP_KEYS = ("spp", "seconds", "target_error")
MAX_FAULTS = 100
FIRST_CELLS = 256  # become jobs in the transaction of the submission, the others as work goes on
MOST_CHECKED = 1000  # cells that are checked before a sweep is accepted
MAX_REMEMBERED = 10_000

FileCheck = Callable[[JsonDict, JsonDict], list[JsonDict]]


@dataclass(frozen=True)
class Request:
    """What the caller wants beside the scene."""

    stop: Mapping[str, Any] | None
    assets: Mapping[str, str]
    priority: int
    label: str
    deadline: float | None = None  # Unix seconds
    after: tuple[str, ...] = ()


class Submitter:
    """Makes JobSpecs of scenes with the engine's work module."""

    def __init__(self, data: DataDir, work: Any, limits: Limits, check_files: FileCheck) -> None:
        """Check scenes against `data`'s assets; refuse what is above `limits`."""
        self._data, self._work, self._limits = data, work, limits
        self._check_files = check_files
        self._good_files: set[str] = set()  # keys of file sets that were read without a fault

    def job(self, scene: Mapping[str, Any], request: Request) -> JobSpec:
        """Return the rows of one job. Raises SceneValidationError or AssetMissing."""
        _check_request(request)
        return self._specify(scene, request, self._files(request))

    def sweep(
        self,
        base: Mapping[str, Any],
        raw: Mapping[str, Any],
        request: Request,
        columns: int | None,
    ) -> tuple[SweepSpec, list[JsonDict]]:
        """Return a sweep and the rows of its first cells; all faults found are raised at once.

        Of up to MOST_CHECKED cells each is checked. Of more, those that hold, together, every value
        of every axis (`SweepPlan.probes`), or as many; the others when they become jobs.
        """
        _check_request(request)
        plan = parse_sweep(raw, base)
        files = self._files(request)
        about = {
            "stop": _stop_of(plan, request),
            "root": self._data.relative(files.root),
            "pins": dict(request.assets),
            "limits": self._limits.to_dict(),
            "deadline": request.deadline,
        }
        opened = OpenSweep(self._work, plan, about, files)
        rows = self._checked(opened, files, bool(request.assets))
        if columns is None:
            columns = guess_columns(plan.axes, plan.mode, len(plan))
        digest, size = self._data.artifacts.write([document(plan, base, about)])
        axes = [axis.to_dict() for axis in plan.axes]
        spec = SweepSpec(
            label=request.label,
            mode=plan.mode,
            axes=axes,
            base=dict(base),
            columns=columns,
            cells=len(plan),
            priority=request.priority,
            plan=Blob(digest, size),
            request=about,
            after=request.after,
            baseline=plan.baseline,
            budget=plan.budget,
        )
        return spec, rows

    def _checked(self, sweep: OpenSweep, files: Any, uploaded: bool) -> list[JsonDict]:
        """Check cells and return the rows of the first; raises all faults at once."""
        plan = sweep.plan
        faults: dict[tuple[str, str], Fault] = {}
        rows: list[JsonDict] = []
        wanted = range(len(plan)) if len(plan) <= MOST_CHECKED else _some(plan.probes())
        for i in sorted({*range(min(len(plan), FIRST_CELLS)), *wanted}):
            try:
                facts = self._facts(sweep, i, files, uploaded)
            except SceneValidationError as error:
                for fault in error.faults:
                    placed = plan.blame(i, _on_stop(fault, sweep.request["stop"]))
                    faults.setdefault((placed.pointer, placed.message), placed)
                if len(faults) > MAX_FAULTS:
                    break
            else:
                if i < FIRST_CELLS:
                    rows.append(sweep.row(i, facts))
        if faults:
            raise SceneValidationError(list(faults.values())[:MAX_FAULTS])
        return rows

    def _facts(self, sweep: OpenSweep, cell: int, files: Any, uploaded: bool) -> JsonDict:
        if uploaded:
            for name in self._work.file_names(sweep.scene(cell)):
                self._data.link_named(files.root, name)
        facts = sweep.facts(cell)
        self._read_files(facts, {"root": str(files.root), "pins": facts["pins"]})
        return facts

    def _files(self, request: Request) -> Any:
        return self._work.asset_folder(self._data.view(request.assets), request.assets)

    def _specify(self, scene: Mapping[str, Any], request: Request, files: Any) -> JobSpec:
        for name in self._work.file_names(scene) if request.assets else ():
            self._data.link_named(files.root, name)
        try:
            facts = self._work.inspect(with_stop(scene, request.stop), files)
            self._limits.check(facts)
        except SceneValidationError as error:
            raise SceneValidationError([_on_stop(f, request.stop) for f in error.faults]) from None
        assets = {"root": self._data.relative(files.root), "pins": facts["pins"]}
        self._read_files(facts, assets)
        film = FilmSpec(
            film_key=facts["film_key"],
            geometry_key=facts["geometry_key"],
            scene=facts["scene"],
            assets=assets,
            width=facts["width"],
            height=facts["height"],
            replicates=facts["replicates"],
        )
        plan = self._work.plan(film.width, film.height, film.replicates)
        stop = facts["stop"]
        return JobSpec(
            film=film,
            stop=stop,
            spp_cap=int(plan.round_up(stop["spp"] or self._work.OPEN_ENDED_SPP)),
            output=facts["output"],
            priority=request.priority,
            label=request.label,
            deadline=request.deadline,
            after=request.after,
        )

    def _read_files(self, facts: JsonDict, assets: JsonDict) -> None:
        film = film_bytes(facts)
        key = f"{facts['files_key']}:{film}"
        if key in self._good_files:
            return
        limits = {"limits": self._limits.to_dict() | {"film": film}}
        if faults := self._check_files(facts["scene"], assets | limits):
            raise SceneValidationError(
                Fault(f["pointer"], f["code"], f["message"], f.get("suggestion")) for f in faults
            )
        if len(self._good_files) > MAX_REMEMBERED:
            self._good_files.clear()
        self._good_files.add(key)


def body_hash(*parts: Any) -> str:
    """Return a digest that tells two requests apart."""
    text = json.dumps(parts, sort_keys=True, default=_plain, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else dict(value)


def _check_request(request: Request) -> None:
    faults = []
    if not MIN_PRIORITY <= request.priority <= MAX_PRIORITY:
        why = f"priority is {MIN_PRIORITY} to {MAX_PRIORITY}, not {request.priority}"
        faults.append(Fault("/priority", "out_of_range", why))
    for key in request.stop or {}:
        if key not in STOP_KEYS:
            why = f"unknown key {key!r}; a stop rule has {', '.join(STOP_KEYS)}"
            faults.append(Fault(f"/stop/{key}", "unknown_key", why))
    if faults:
        raise SceneValidationError(faults)


def _stop_of(plan: SweepPlan, request: Request) -> JsonDict | None:
    """Return the stop rule of the cells; those that share a budget go on to its target."""
    if plan.budget is None:
        return dict(request.stop) if request.stop else None
    if request.stop:
        why = "a sweep has a budget or a stop rule, not both; its budget names the target_error"
        raise SceneValidationError([Fault("/stop", "exclusive_keys", why)])
    return {"target_error": plan.budget["target_error"]}


def _some(cells: Sequence[int]) -> Sequence[int]:
    """Return at most MOST_CHECKED of the cells, spread evenly."""
    step = -(-len(cells) // MOST_CHECKED)
    return cells[:: max(step, 1)]


def _on_stop(fault: Fault, stop: Mapping[str, Any] | None) -> Fault:
    """Point at `/stop/...` where the bad value came from there."""
    for key in stop or {}:
        at = f"/render/{key}"
        if fault.pointer == at or fault.pointer.startswith(at + "/"):
            moved = "/stop/" + fault.pointer.removeprefix("/render/")
            return Fault(moved, fault.code, fault.message, fault.suggestion)
    return fault
