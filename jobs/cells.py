"""Cells of a sweep inside a child: from the stored plan to scenes, keys and small films.

A sweep lies in one artifact: base scene, axes, and what makes jobs of its cells. Cells are looked
up by number, so that 100,000 of them cost the service neither memory nor a moment of silence.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matiere.errors import SceneValidationError
from matiere.jobs.artifacts import Artifacts
from matiere.jobs.job import JsonDict
from matiere.jobs.limits import BYTES_PER_SAMPLE_SUM, Limits
from matiere.jobs.sweep import SweepPlan

KEPT_SWEEPS = 4
VERSION = 1
# A small film is rendered, folded and stored by one child at once, many to a file.
SMALL_BYTES = 2**22
SMALL_SAMPLES = 2**20
STOP_KEYS = ("spp", "seconds", "target_error")
Locate = Callable[[str], str]


def document(plan: SweepPlan, base: Mapping[str, Any], request: JsonDict) -> bytes:
    """Return the bytes of a sweep's artifact; `request` as `OpenSweep` takes it."""
    whole = {"version": VERSION, "plan": plan.to_dict(), "base": base, "request": request}
    return json.dumps(whole, allow_nan=False, separators=(",", ":")).encode()


def with_stop(scene: Mapping[str, Any], stop: Mapping[str, Any] | None) -> JsonDict:
    """Put the request's stop rule in place of the scene's, as `mt.render` does."""
    given = {key: value for key, value in (stop or {}).items() if value is not None}
    render = scene.get("render", {})
    if not given or not isinstance(render, Mapping):
        return dict(scene)
    kept = {key: value for key, value in render.items() if key not in STOP_KEYS}
    return {**scene, "render": {**kept, **given}}


def film_scene(scene: Mapping[str, Any]) -> JsonDict:
    """Return a scene without output and stop rule: what its film is of."""
    render = {k: v for k, v in scene.get("render", {}).items() if k not in STOP_KEYS}
    return {k: v for k, v in scene.items() if k != "output"} | {"render": render}


def is_small(facts: JsonDict, spp_cap: int) -> bool:
    """Tell whether a film is rendered whole: little, and ended by its samples alone."""
    stop, scene = facts["stop"], facts["scene"]
    render = scene.get("render", {})
    pixels = facts["width"] * facts["height"]
    plain = not render.get("adaptive") and not scene.get("film", {}).get("aovs")
    by_spp = bool(stop.get("spp")) and not stop.get("seconds") and not stop.get("target_error")
    return (
        plain
        and by_spp
        and pixels * spp_cap <= SMALL_SAMPLES
        and pixels * facts["replicates"] * BYTES_PER_SAMPLE_SUM <= SMALL_BYTES
    )


class OpenSweep:
    """A sweep ready to have its cells looked at."""

    def __init__(self, work: Any, plan: SweepPlan, request: JsonDict, files: Any) -> None:
        """Take a plan and what makes jobs of its cells: stop, root, pins, limits."""
        self._work, self.plan, self.request, self._files = work, plan, request, files

    @classmethod
    def read(cls, work: Any, data: bytes, root: str) -> OpenSweep:
        """Open what `document` wrote; its files lie below `root`."""
        stored = json.loads(data)
        plan, request = SweepPlan.from_dict(stored["plan"], stored["base"]), stored["request"]
        files = work.asset_folder(Path(root), request["pins"])
        return cls(work, plan, request, files)

    def scene(self, cell: int) -> JsonDict:
        """Return the scene of a cell under the stop rule of the sweep."""
        return with_stop(self.plan.scene(cell), self.request["stop"])

    def facts(self, cell: int) -> JsonDict:
        """Return what `work.inspect` says of a cell. Raises SceneValidationError."""
        facts: JsonDict = self._work.inspect(self.scene(cell), self._files)
        Limits.of(self.request).check(facts)
        return facts

    def row(self, cell: int, facts: JsonDict) -> JsonDict:
        """Return what the database keeps of a cell and its film."""
        plan = self._work.plan(facts["width"], facts["height"], facts["replicates"])
        spp_cap = int(plan.round_up(facts["stop"]["spp"] or self._work.OPEN_ENDED_SPP))
        small = is_small(facts, spp_cap)
        kept = ("film_key", "geometry_key", "width", "height", "replicates", "pins", "stop",
                "output")  # fmt: skip
        return {key: facts[key] for key in kept} | {
            "cell": cell,
            "spp_cap": spp_cap,
            "parameters": self.plan.parameters(cell),
            "label": self.plan.label(cell),
            "small": small,
            "scene": None if small else facts["scene"],
        }


class Sweeps:
    """The sweeps a child has opened lately."""

    def __init__(self, work: Any, folder: Artifacts, locate: Locate) -> None:
        """Open sweeps from `folder`; `locate` finds the folder of a film's files."""
        self._work, self._folder, self._locate = work, folder, locate
        self._open: OrderedDict[tuple[str, str], OpenSweep] = OrderedDict()

    def get(self, plan: str, assets: JsonDict) -> OpenSweep:
        """Return the sweep in an artifact. Raises DamagedFile."""
        root = str(self.located(assets)["root"])
        key = plan, root
        if key not in self._open:
            self._open[key] = OpenSweep.read(self._work, self._folder.read(plan), root)
            while len(self._open) > KEPT_SWEEPS:
                self._open.popitem(last=False)
        self._open.move_to_end(key)
        return self._open[key]

    def located(self, assets: JsonDict) -> JsonDict:
        """Return the assets of a film with the folder where they lie now."""
        return assets | {"root": self._locate(assets["root"])}

    def expand(self, request: JsonDict) -> JsonDict:
        """Return the rows of cells [first, end): `{"cells": [...]}`, bad ones with `fault`."""
        sweep = self.get(request["plan"], request["assets"])
        return {"cells": [_row(sweep, i) for i in range(request["first"], request["end"])]}


def _row(sweep: OpenSweep, cell: int) -> JsonDict:
    try:
        return sweep.row(cell, sweep.facts(cell))
    except SceneValidationError as error:
        fault = sweep.plan.blame(cell, error.faults[0])
        about = {"cell": cell, "parameters": sweep.plan.parameters(cell)}
        about["label"] = sweep.plan.label(cell)
        why = {"code": fault.code, "message": fault.message, "pointer": fault.pointer}
        return about | {"fault": why}
