"""Sweeps: what a request asks for, checked, as a plan of cells over a base scene.

    plan = parse_sweep({"axes": [...], "mode": "grid", "where": [...], ...}, base)
    len(plan), plan.label(7), plan.parameters(7), plan.scene(7)

`docs/sweep.md` describes the language; `sweep_plan.py` makes the cells, `axes.py` reads axes,
`condition.py` conditions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from matiere.errors import Fault, SceneValidationError, pointer
from matiere.jobs.axes import MAX_AXES, SOURCES, Axis, did_you_mean, named_sets, parse_axis
from matiere.jobs.budget import STOP_KEYS, parse_budget
from matiere.jobs.condition import Condition, ConditionError, parse_condition
from matiere.jobs.job import JsonDict
from matiere.jobs.pointers import last_part, lies_in, pointer_fault
from matiere.jobs.sweep_plan import MODES, Cell, Override, Row, SweepPlan

__all__ = ["MAX_AXES", "MAX_CELLS", "SOURCES", "Axis", "Cell", "SweepPlan",
           "expand", "guess_columns", "parse_axes", "parse_sweep"]  # fmt: skip

MAX_CELLS = 100_000
MAX_TRIED = 10  # times MAX_CELLS: what conditions may choose from
MAX_CONDITIONS = 32
MAX_OVERRIDES = 100
PARTS = ("axes", "mode", "sobol", "list", "sets", "where", "overrides", "baseline",
         "budget")  # fmt: skip


def parse_sweep(
    raw: Mapping[str, Any], base: Mapping[str, Any], *, max_cells: int = MAX_CELLS
) -> SweepPlan:
    """Check a sweep (see docs/sweep.md) against its base scene and return the plan of its cells.

    Cells are not made and their scenes not checked. Raises SceneValidationError with all faults;
    their pointers lead into `raw`.
    """
    return _Reader(raw, base, max_cells).plan()


def parse_axes(raw: Any, base: Mapping[str, Any], mode: str) -> list[Axis]:
    """Check the axes of a grid or zip of at most 10,000 cells, as `parse_sweep` does."""
    return list(parse_sweep({"axes": raw, "mode": mode}, base, max_cells=10_000).axes)


def expand(base: Mapping[str, Any], axes: Sequence[Axis], mode: str) -> Iterator[Cell]:
    """Yield the cells of a grid or zip; in a grid the last axis runs fastest."""
    return SweepPlan(base, axes, mode).cells()


def guess_columns(axes: Sequence[Axis], mode: str, cells: int) -> int:
    """Return the columns of a contact sheet: the last axis that varies, else nearly square."""
    lengths = [len(axis.values) for axis in axes if len(axis.values) > 1]
    full = cells == math.prod(lengths)  # no condition leaves gaps
    if mode == "grid" and full and len(lengths) > 1 and lengths[-1] <= 32:
        return lengths[-1]
    return cells if cells <= 8 else math.ceil(math.sqrt(cells))


class _Reader:
    """Reads one request, collecting what is wrong with it."""

    def __init__(self, raw: Mapping[str, Any], base: Mapping[str, Any], max_cells: int) -> None:
        self.raw, self.base, self.max_cells = raw, base, max_cells
        self.mode = raw.get("mode", "grid")
        self.faults: list[Fault] = []

    def fault(self, at: str, code: str, why: str) -> None:
        self.faults.append(Fault(at, code, why))

    def check(self) -> None:
        if self.faults:
            raise SceneValidationError(self.faults)

    def plan(self) -> SweepPlan:
        for key in sorted(set(self.raw) - set(PARTS)):
            self.fault(pointer(key), "unknown_key", f"a sweep has {', '.join(PARTS)}, no {key!r}")
        if self.mode not in MODES:
            why = f"mode is {', '.join(MODES[:-1])} or {MODES[-1]}, not {self.mode!r}"
            self.fault("/mode", "unknown_value", why)
            self.mode = "grid"
        for mode in ("sobol", "list"):
            if (mode in self.raw) != (self.mode == mode):
                code = "missing_key" if self.mode == mode else "exclusive_keys"
                self.fault(f"/{mode}", code, f"mode {mode} and the key '{mode}' go together")
        axes = self._axes()
        rows: list[Row] = []
        if self.mode == "list" and "list" in self.raw:
            axes, rows = self._list(axes)
        points = self._points() if "sobol" in self.raw else (0, 0)
        self._check_axes(axes, points[0] or len(rows))
        self.check()
        names = [axis.label for axis in axes]
        where = self._conditions(names)
        overrides = self._overrides(names, axes)
        self.check()
        plan = SweepPlan(
            self.base, axes, self.mode,
            points=points, rows=rows, where=where, overrides=overrides,
        )  # fmt: skip
        self._check_cells(plan)
        plan.baseline = self._baseline(plan)
        plan.budget = self._budget(plan)
        self.check()
        return plan

    # -- axes and their modes ---------------------------------------------------------------------
    def _axes(self) -> list[Axis]:
        given = self.raw.get("axes")
        if self.mode == "list":
            return self._list_axes(given)
        if not isinstance(given, list | tuple) or not 1 <= len(given) <= MAX_AXES:
            self.fault("/axes", "wrong_length", f"a sweep needs 1 to {MAX_AXES} axes")
            self.check()
            return []
        sets = named_sets(self.raw.get("sets"), self.faults)
        axes = []
        for number, raw in enumerate(given):
            at = f"/axes/{number}"
            axis = parse_axis(raw, at, self.base, sets, self.max_cells, self.faults)
            if axis is not None and axis.range is not None and self.mode != "sobol":
                why = f"{axis.source} is for mode sobol; {self.mode} needs values or their count"
                self.fault(f"{at}/{axis.source}", "exclusive_keys", why)
            if axis is not None:
                axes.append(axis)
        self.check()
        return axes

    def _list_axes(self, given: Any) -> list[Axis]:
        """Return the axes of a list: pointers with a name, their values stand in the list."""
        axes: list[Axis] = []
        if given is not None and not isinstance(given, list | tuple):
            self.fault("/axes", "wrong_type", "axes is a list")
            return axes
        for number, raw in enumerate(given or ()):
            at = f"/axes/{number}"
            if isinstance(raw, Mapping) and (more := sorted(set(raw) - {"pointer", "label"})):
                why = "in mode list an axis has 'pointer' and 'label'; its values stand in 'list'"
                self.fault(f"{at}/{more[0]}", "exclusive_keys", why)
                continue
            filled = {**raw, "values": [None]} if isinstance(raw, Mapping) else raw
            axis = parse_axis(filled, at, self.base, {}, 1, self.faults)
            if axis is not None:
                axes.append(Axis(axis.pointers, (), axis.label, ()))
        self.check()
        return axes

    def _list(self, axes: list[Axis]) -> tuple[list[Axis], list[Row]]:
        given = self.raw["list"]
        if not isinstance(given, list) or not given:
            self.fault("/list", "wrong_type", "list is a list of cells, not empty")
            return axes, []
        if len(given) > self.max_cells:
            self._too_many(len(given), "/list")
            return axes, []
        axes = list(axes)
        names = {axis.label: axis.label for axis in axes}
        names |= {axis.pointers[0]: axis.label for axis in axes if len(axis.pointers) == 1}
        rows = []
        for number, entry in enumerate(given):
            at = f"/list/{number}"
            if not isinstance(entry, Mapping) or not entry:
                why = "a cell is an object: axis label or pointer -> value, not empty"
                self.fault(at, "wrong_type", why)
                continue
            values = {}
            for key, value in entry.items():
                if key == "label":
                    if not isinstance(value, str):
                        self.fault(f"{at}/label", "wrong_type", "label is a text")
                    continue
                name = names.get(key) or self._new_axis(key, axes, names, at)
                if name in values:
                    self.fault(at + pointer(key), "duplicate", f"{name!r} has two values")
                values[name] = value
            rows.append(Row(values, entry.get("label")))
            if len(self.faults) > 100:
                break
        return axes, rows

    def _new_axis(self, key: str, axes: list[Axis], names: dict[str, str], at: str) -> str:
        if not key.startswith("/"):
            hint = did_you_mean(key, [*names, "label"])
            why = f"no axis is called {key!r}; {hint} A pointer starts with '/'"
            self.fault(at + pointer(key), "unknown_name", why)
            return key
        if why_not := pointer_fault(key, self.base):
            self.fault(at + pointer(key), "bad_pointer", why_not)
            return key
        taken = {axis.label for axis in axes} | {"label"}
        short = last_part(key)
        label = key if short in taken or not short else short
        axes.append(Axis((key,), (), label, (), "pointer"))
        names[key] = names[label] = label
        return label

    def _points(self) -> tuple[int, int]:
        given = self.raw["sobol"]
        if not isinstance(given, Mapping) or not set(given) <= {"count", "seed"}:
            self.fault("/sobol", "wrong_type", "sobol is an object with 'count' and 'seed'")
            return 0, 0
        count: Any = given.get("count")
        seed: Any = given.get("seed", 1)
        most = self.max_cells * (MAX_TRIED if self.raw.get("where") else 1)
        if not _whole(count) or not 1 <= count <= most:
            why = f"count is a whole number, 1 to {most:,}"
            self.fault("/sobol/count", "out_of_range", why)
            return 0, 0
        if not _whole(seed) or not 0 <= seed < 2**32:
            self.fault("/sobol/seed", "out_of_range", "seed is a whole number, 0 to 4294967295")
            return 0, 0
        return count, seed

    def _check_axes(self, axes: list[Axis], cells: int) -> None:
        """Refuse axes that do not fit each other, and too many cells."""
        if len(axes) > MAX_AXES:
            self.fault("/list", "wrong_length", f"a sweep varies at most {MAX_AXES} things")
        for i, axis in enumerate(axes):
            at = f"/axes/{i}"
            if axis.label in [other.label for other in axes[:i]]:
                why = f"two axes are called {axis.label!r}; give one of them another 'label'"
                self.fault(f"{at}/label", "duplicate", why)
            if self.mode == "list" and axis.label == "label":
                why = "'label' is the text of a cell; give this axis another 'label'"
                self.fault(f"{at}/label", "duplicate", why)
            for inner in (p for other in axes[:i] for p in other.pointers):
                if outer := next((p for p in axis.pointers if lies_in(inner, p)), None):
                    why = f"this axis replaces {outer} and with it {inner} of an axis before"
                    self.fault(f"{at}/pointer", "duplicate", why + "; put it first, or leave it")
        lengths = [len(axis.values) for axis in axes]
        if self.mode == "zip" and len(set(lengths)) > 1:
            why = f"mode zip needs axes of one length, got {', '.join(map(str, lengths))}"
            self.fault("/axes", "wrong_length", why)
        if self.mode in ("grid", "zip"):
            cells = lengths[0] if self.mode == "zip" else math.prod(lengths)
        if cells > self.max_cells * (MAX_TRIED if self.raw.get("where") else 1):
            self._too_many(cells, "/axes")

    def _too_many(self, cells: int, at: str) -> None:
        why = f"{cells:,} cells are too many; a sweep holds at most {self.max_cells:,}"
        self.fault(at, "limit_exceeded", why)

    # -- conditions -------------------------------------------------------------------------------
    def _conditions(self, names: list[str]) -> list[Condition]:
        given = self.raw.get("where", [])
        if not isinstance(given, list) or len(given) > MAX_CONDITIONS:
            why = f"where is a list of at most {MAX_CONDITIONS} conditions"
            self.fault("/where", "wrong_type", why)
            return []
        read = [self._condition(text, names, f"/where/{i}") for i, text in enumerate(given)]
        return [condition for condition in read if condition is not None]

    def _condition(self, text: Any, names: list[str], at: str) -> Condition | None:
        try:
            condition = parse_condition(text)
        except ConditionError as error:
            self.fault(at, "bad_condition", str(error))
            return None
        for name in condition.names:
            if name not in names:
                why = f"no axis is called {name!r}; {did_you_mean(name, names)}"
                self.fault(at, "unknown_name", why)
                return None
        return condition

    def _overrides(self, names: list[str], axes: list[Axis]) -> list[Override]:
        given = self.raw.get("overrides", [])
        if not isinstance(given, list) or len(given) > MAX_OVERRIDES:
            why = f"overrides is a list of at most {MAX_OVERRIDES} objects"
            self.fault("/overrides", "wrong_type", why)
            return []
        found = []
        for number, raw in enumerate(given):
            at = f"/overrides/{number}"
            good = isinstance(raw, Mapping) and {"when", "set"} <= set(raw) <= {
                "when", "set", "label"}  # fmt: skip
            if not good or not isinstance(raw["set"], Mapping) or not raw["set"]:
                why = "an override is an object with 'when', 'set' (pointer -> value) and 'label'"
                self.fault(at, "wrong_type", why)
                continue
            when = self._condition(raw["when"], names, f"{at}/when")
            for to in raw["set"]:
                # What an axis puts there is seen only in the cells.
                inside = any(lies_in(str(to), p) for axis in axes for p in axis.pointers)
                if not inside and (why_not := pointer_fault(to, self.base)):
                    self.fault(f"{at}/set{pointer(to)}", "bad_pointer", why_not)
            label = raw.get("label", "")
            if not isinstance(label, str):
                self.fault(f"{at}/label", "wrong_type", "label is a text")
            if when is not None:
                found.append(Override(when, dict(raw["set"]), str(label)))
        return found

    # -- cells ------------------------------------------------------------------------------------
    def _check_cells(self, plan: SweepPlan) -> None:
        if not len(plan):
            self.fault("/where", "no_cells", "no cell satisfies all conditions")
        elif len(plan) > self.max_cells:
            self._too_many(len(plan), "/axes")
        self.check()
        for number in sorted(set(range(len(plan.overrides))) - plan.used_overrides()):
            why = f"no cell satisfies {plan.overrides[number].when.text!r}"
            self.fault(f"/overrides/{number}/when", "no_cells", why)

    def _baseline(self, plan: SweepPlan) -> int | None:
        given = self.raw.get("baseline")
        if given is None:
            return None
        if _whole(given):
            if not 0 <= given < len(plan):
                why = f"the baseline is cell 0 to {len(plan) - 1}, not {given}"
                self.fault("/baseline", "out_of_range", why)
            return int(given)
        if not isinstance(given, Mapping) or not given:
            why = "baseline is the number of a cell or an object axis label -> value"
            self.fault("/baseline", "wrong_type", why)
            return None
        names = [axis.label for axis in plan.axes]
        for name in set(given) - set(names):
            why = f"no axis is called {name!r}; {did_you_mean(str(name), names)}"
            self.fault(f"/baseline{pointer(name)}", "unknown_name", why)
        self.check()
        fitting = [i for i in range(len(plan)) if plan.matches(i, given)]
        if len(fitting) == 1:
            return fitting[0]
        if not fitting:
            self.fault("/baseline", "no_cells", "no cell has these values")
        else:
            why = f"{len(fitting)} cells have these values; name more axes, or the cell's number"
            self.fault("/baseline", "ambiguous", why)
        return None

    def _budget(self, plan: SweepPlan) -> JsonDict | None:
        if self.raw.get("budget") is None:
            return None
        budget, faults = parse_budget(self.raw["budget"])
        self.faults += faults
        own = [p for axis in plan.axes for p in axis.pointers]
        own += [str(to) for override in plan.overrides for to in override.set]
        for key in STOP_KEYS:
            if any(lies_in(f"/render/{key}", p) for p in own):
                why = f"the budget says when cells end; no axis or override may set /render/{key}"
                self.fault("/budget", "exclusive_keys", why)
        return budget


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
