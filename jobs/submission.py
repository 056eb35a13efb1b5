"""From a request to rows: check the scene, pin its files, key its film. Touches no pixels:

meshes and images are read by the utility child, once for each set of files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from matiere.errors import Fault, SceneValidationError
from matiere.jobs import sweep as sweeps
from matiere.jobs.datadir import DataDir
from matiere.jobs.film_work import BYTES_PER_SAMPLE_SUM
from matiere.jobs.job import MAX_PRIORITY, MIN_PRIORITY, JsonDict
from matiere.jobs.store.jobs import FilmSpec, JobSpec, SweepSpec

STOP_KEYS = ("spp", "seconds", "target_error")
MAX_FAULTS = 100
MAX_CELLS = 10_000
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

    def __init__(
        self, data: DataDir, work: Any, max_film_bytes: int, check_files: FileCheck
    ) -> None:
        """Check scenes against `data`'s assets; refuse films larger than `max_film_bytes`."""
        self._data, self._work, self._max_film_bytes = data, work, max_film_bytes
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
    ) -> tuple[SweepSpec, list[JobSpec]]:
        """Return the rows of a sweep; every cell is checked, all faults are raised at once."""
        _check_request(request)
        plan = sweeps.parse_sweep(raw, base, max_cells=MAX_CELLS)
        files = self._files(request)
        faults: dict[tuple[str, str], Fault] = {}
        specs: list[JobSpec] = []
        for i in range(len(plan)):
            mine = replace(request, label=plan.label(i))
            try:
                spec = self._specify(plan.scene(i), mine, files, i, plan.parameters(i))
            except SceneValidationError as error:
                for fault in error.faults:
                    placed = plan.blame(i, fault)
                    faults.setdefault((placed.pointer, placed.message), placed)
                if len(faults) > MAX_FAULTS:
                    break
            else:
                specs.append(spec)
        if faults:
            raise SceneValidationError(list(faults.values())[:MAX_FAULTS])
        if columns is None:
            columns = sweeps.guess_columns(plan.axes, plan.mode, len(specs))
        axes = [axis.to_dict() for axis in plan.axes]
        made = SweepSpec(request.label, plan.mode, axes, dict(base), columns,
                         request.after, plan.baseline)  # fmt: skip
        return made, specs

    def _files(self, request: Request) -> Any:
        return self._work.asset_folder(self._data.view(request.assets), request.assets)

    def _specify(
        self,
        scene: Mapping[str, Any],
        request: Request,
        files: Any,
        cell: int | None = None,
        parameters: JsonDict | None = None,
    ) -> JobSpec:
        for name in self._work.file_names(scene) if request.assets else ():
            self._data.link_named(files.root, name)
        try:
            facts = self._work.inspect(_with_stop(scene, request.stop), files)
        except SceneValidationError as error:
            raise SceneValidationError([_on_stop(f, request.stop) for f in error.faults]) from None
        size = facts["width"] * facts["height"] * facts["replicates"] * BYTES_PER_SAMPLE_SUM
        if size > self._max_film_bytes:
            why = (
                f"a film of {facts['width']} x {facts['height']} pixels with "
                f"{facts['replicates']} replicates needs {size / 2**30:.1f} GiB; "
                f"this service allows {self._max_film_bytes / 2**30:.1f} GiB"
            )
            raise SceneValidationError([Fault("/film", "memory_limit", why)])
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
            cell=cell,
            parameters=parameters or {},
            deadline=request.deadline,
            after=request.after,
        )

    def _read_files(self, facts: JsonDict, assets: JsonDict) -> None:
        key = facts["files_key"]
        if key in self._good_files:
            return
        if faults := self._check_files(facts["scene"], assets):
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


def _with_stop(scene: Mapping[str, Any], stop: Mapping[str, Any] | None) -> JsonDict:
    """Put the request's stop rule in place of the scene's, as `mt.render` does."""
    given = {key: value for key, value in (stop or {}).items() if value is not None}
    render = scene.get("render", {})
    if not given or not isinstance(render, Mapping):
        return dict(scene)
    kept = {key: value for key, value in render.items() if key not in STOP_KEYS}
    return {**scene, "render": {**kept, **given}}


def _on_stop(fault: Fault, stop: Mapping[str, Any] | None) -> Fault:
    """Point at `/stop/...` where the bad value came from there."""
    for key in stop or {}:
        at = f"/render/{key}"
        if fault.pointer == at or fault.pointer.startswith(at + "/"):
            moved = "/stop/" + fault.pointer.removeprefix("/render/")
            return Fault(moved, fault.code, fault.message, fault.suggestion)
    return fault
