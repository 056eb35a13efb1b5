"""A sweep as a plan: any cell is made when it is asked for, none is kept.

A plan of 100,000 cells costs its axes and, if conditions leave cells out, one array of numbers.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from matiere.errors import Fault, SceneValidationError, pointer
from matiere.jobs.axes import Axis, text_of
from matiere.jobs.condition import Condition, ConditionError, equal, parse_condition
from matiere.jobs.job import JsonDict
from matiere.jobs.pointers import copy_json, lies_in, set_value
from matiere.jobs.sobol import Sobol

VERSION = 1
MAX_REMEMBERED = 10_000
MODES = ("grid", "zip", "sobol", "list")


@dataclass(frozen=True)
class Override:
    """Further settings of the cells for which a condition holds."""

    when: Condition
    set: JsonDict  # pointer -> value
    label: str = ""


@dataclass(frozen=True)
class Row:
    """One cell of a list: its values by axis label, and its own text."""

    values: JsonDict
    label: str | None = None


@dataclass(frozen=True)
class Cell:
    """One cell: its scene, its parameters by axis label, and a line of text."""

    index: int
    scene: JsonDict
    parameters: JsonDict
    label: str
    place: tuple[int, ...]  # index on every axis


@dataclass(frozen=True)
class Patch:
    """One setting of a cell, and the place in the request that asks for it."""

    pointer: str
    value: Any
    source: str
    verbatim: bool = True  # `source` holds the value itself, not what it is reckoned from


class SweepPlan:
    """What `parse_sweep` makes of a request; cell `i` is one of `range(len(plan))`."""

    def __init__(
        self,
        base: Mapping[str, Any],
        axes: Sequence[Axis],
        mode: str = "grid",
        *,
        points: tuple[int, int] = (0, 0),
        rows: Sequence[Row] = (),
        where: Sequence[Condition] = (),
        overrides: Sequence[Override] = (),
    ) -> None:
        """Take checked parts; `points` is count and seed of a Sobol sweep."""
        self.base, self.axes, self.mode = base, tuple(axes), mode
        self.rows, self.where, self.overrides = tuple(rows), tuple(where), tuple(overrides)
        self.points = points
        self.baseline: int | None = None
        self.budget: JsonDict | None = None  # seconds for all cells, target_error of each
        self._number = {axis.label: k for k, axis in enumerate(self.axes)}
        self._lengths = tuple(len(axis.values) for axis in self.axes)
        self._sobol = Sobol(len(self.axes), points[1]) if mode == "sobol" else None
        # What a condition sees of a value: itself, or for an object its text.
        self._plain = [tuple(map(plain_value, axis.values, axis.labels)) for axis in self.axes]

    # -- cells ------------------------------------------------------------------------------------
    @property
    def unconstrained(self) -> int:
        """Return the number of cells before conditions leave some out."""
        if self.mode == "sobol":
            return self.points[0]
        if self.mode == "list":
            return len(self.rows)
        return self._lengths[0] if self.mode == "zip" else math.prod(self._lengths)

    def __len__(self) -> int:
        """Return the number of cells."""
        return self.unconstrained if self._kept is None else len(self._kept)

    def place(self, i: int) -> tuple[int, ...]:
        """Return the index of the cell's value on every axis.

        On an axis without values (a range, or any of a list) it is the number of the point or row.
        """
        raw = self._raw(i)
        spots = self._spots(raw)
        return tuple(
            spot if isinstance(spot, int) and axis.values else raw
            for axis, spot in zip(self.axes, spots, strict=True)
        )

    def parameters(self, i: int) -> JsonDict:
        """Return the cell's values by axis label."""
        raw = self._raw(i)
        if self.mode == "list":
            return {a.label: v for a in self.axes if (v := self._cell_value(raw, a)) is not MISSING}
        spots = self._spots(raw)
        return {
            axis.label: axis.values[int(spot)] if axis.values else spot
            for axis, spot in zip(self.axes, spots, strict=True)
        }

    def label(self, i: int) -> str:
        """Return a line of text that tells the cell from its neighbours."""
        raw = self._raw(i)
        if self.mode == "list":
            row = self.rows[raw]
            texts = (
                [row.label] if row.label is not None else list(map(text_of, row.values.values()))
            )
        else:
            texts = [
                axis.labels[int(spot)] if axis.values else text_of(spot)
                for axis, spot in zip(self.axes, self._spots(raw), strict=True)
            ]
        texts += [override.label for _, override in self._overriding(raw)]
        return ", ".join(filter(None, texts))

    def patches(self, i: int) -> list[tuple[str, Any]]:
        """Return what makes the cell from the base: (pointer, value), in order; do not change."""
        return [(patch.pointer, patch.value) for patch in self._patches(i)]

    def scene(self, i: int) -> JsonDict:
        """Return a copy of the cell's scene. SceneValidationError if a setting has no place."""
        scene: JsonDict = copy_json(dict(self.base))
        for patch in self._patches(i):
            try:
                set_value(scene, patch.pointer, copy_json(patch.value))
            except (LookupError, TypeError, ValueError):
                why = f"cell {i} ({self.label(i)}) has no place for {patch.pointer}"
                raise SceneValidationError([Fault(patch.source, "bad_pointer", why)]) from None
        return scene

    def cell(self, i: int) -> Cell:
        """Return all of a cell."""
        return Cell(i, self.scene(i), self.parameters(i), self.label(i), self.place(i))

    def cells(self) -> Iterator[Cell]:
        """Yield every cell, one at a time."""
        return map(self.cell, range(len(self)))

    # -- checks -----------------------------------------------------------------------------------
    def probes(self) -> list[int]:
        """Return cells that hold, together, every value of every axis and every override.

        All cells, unless the sweep is a grid: there the first cell for each value.
        """
        if self.mode != "grid":
            return list(range(len(self)))
        found: dict[Any, int] = {}
        wanted = sum(self._lengths) + len(self.overrides)
        for i in self._likely_probes():
            raw = self._raw(i)
            for spot in enumerate(self._spots(raw)):
                found.setdefault(spot, i)
            for number, _ in self._overriding(raw):
                found.setdefault(("override", number), i)
            if len(found) == wanted:
                break
        return sorted(set(found.values()))

    def used_overrides(self) -> set[int]:
        """Return the overrides that some cell meets."""
        used: set[int] = set()
        for i in range(len(self)) if self.overrides else ():
            used.update(number for number, _ in self._overriding(self._raw(i)))
            if len(used) == len(self.overrides):
                break
        return used

    def _likely_probes(self) -> Iterator[int]:
        if self._kept is None:
            stride = 1
            for length in reversed(self._lengths):
                yield from range(0, stride * length, stride)
                stride *= length
            if not self.overrides:
                return
        yield from range(len(self))

    def blame(self, i: int, fault: Fault) -> Fault:
        """Point at the part of the request that put the bad value into the cell's scene."""
        for patch in reversed(self._patches(i)):
            if lies_in(fault.pointer, patch.pointer):
                inner = fault.pointer.removeprefix(patch.pointer)
                at = patch.source + (inner if patch.verbatim else "")
                return Fault(at, fault.code, fault.message, fault.suggestion)
        return fault

    def matches(self, i: int, wanted: Mapping[str, Any]) -> bool:
        """Tell whether the cell has these values (or texts) on the axes named."""
        get = self._getter(self._raw(i))
        mine = self.parameters(i)
        return all(
            name in mine and (equal(mine[name], value) or equal(get(name), value))
            for name, value in wanted.items()
        )

    # -- storing ----------------------------------------------------------------------------------
    def to_dict(self) -> JsonDict:
        """Return the plan without its base as plain JSON, for `from_dict`."""
        plain: JsonDict = {
            "version": VERSION,
            "mode": self.mode,
            "axes": [axis.to_dict() for axis in self.axes],
        }
        if self.mode == "sobol":
            plain["sobol"] = {"count": self.points[0], "seed": self.points[1]}
        if self.mode == "list":
            plain["list"] = [
                row.values if row.label is None else {**row.values, "label": row.label}
                for row in self.rows
            ]
        if self.where:
            plain["where"] = [condition.text for condition in self.where]
        if self.overrides:
            plain["overrides"] = [
                {"when": o.when.text, "set": o.set, "label": o.label} for o in self.overrides
            ]
        if self.baseline is not None:
            plain["baseline"] = self.baseline
        if self.budget is not None:
            plain["budget"] = self.budget
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any], base: Mapping[str, Any]) -> SweepPlan:
        """Return the plan that `to_dict` wrote."""
        if plain["version"] != VERSION:
            raise ValueError(f"a sweep plan of version {plain['version']} is not known here")
        points = plain.get("sobol", {"count": 0, "seed": 0})
        plan = cls(
            base,
            [Axis.from_dict(axis) for axis in plain["axes"]],
            plain["mode"],
            points=(points["count"], points["seed"]),
            rows=[row_of(entry) for entry in plain.get("list", ())],
            where=[parse_condition(text) for text in plain.get("where", ())],
            overrides=[
                Override(parse_condition(o["when"]), o["set"], o["label"])
                for o in plain.get("overrides", ())
            ],
        )
        plan.baseline, plan.budget = plain.get("baseline"), plain.get("budget")
        return plan

    # -- inside -----------------------------------------------------------------------------------
    @cached_property
    def _kept(self) -> array[int] | None:
        """Numbers of the cells that satisfy every condition; None if there is none.

        Raises SceneValidationError if a condition makes no sense for a value.
        """
        if not self.where:
            return None
        kept = array("I")
        known: list[dict[tuple[Any, ...], bool]] = [{} for _ in self.where]
        named = [tuple(self._number[name] for name in c.names) for c in self.where]
        # In a grid the same few values meet a condition again and again.
        few = [
            self.mode == "grid" and math.prod(self._lengths[k] for k in ks) <= MAX_REMEMBERED
            for ks in named
        ]
        for raw in range(self.unconstrained):
            spots = self._spots(raw)
            for number, condition in enumerate(self.where):
                key = tuple(spots[k] for k in named[number]) if few[number] else ()
                holds = known[number].get(key) if few[number] else None
                if holds is None:
                    holds = self._judge(condition, raw, spots, f"/where/{number}")
                    if few[number]:
                        known[number][key] = holds
                if not holds:
                    break
            else:
                kept.append(raw)
        return kept

    def _judge(self, condition: Condition, raw: int, spots: tuple[float, ...], at: str) -> bool:
        try:
            return condition(self._getter(raw, spots))
        except ConditionError as error:
            raise SceneValidationError([Fault(at, "bad_condition", str(error))]) from None

    def _raw(self, i: int) -> int:
        if not 0 <= i < len(self):
            raise IndexError(f"cell {i} of {len(self)}")
        return i if self._kept is None else self._kept[i]

    def _spots(self, raw: int) -> tuple[float, ...]:
        """Return for every axis the index of its value; on a range the value itself."""
        if self.mode == "grid":
            spots = []
            for length in reversed(self._lengths):
                raw, spot = divmod(raw, length)
                spots.append(spot)
            return tuple(reversed(spots))
        if self._sobol is None:
            return (raw,) * len(self.axes)
        return tuple(
            min(int(u * length), length - 1) if length else axis.in_range(u)
            for axis, length, u in zip(
                self.axes, self._lengths, self._sobol.point(raw), strict=True
            )
        )

    def _cell_value(self, raw: int, axis: Axis) -> Any:
        return self.rows[raw].values.get(axis.label, MISSING)

    def _getter(self, raw: int, spots: tuple[float, ...] | None = None) -> Any:
        """Return a function from axis label to what a condition sees of the cell's value."""
        if self.mode == "list":
            values = self.rows[raw].values
            return lambda name: plain_value(v := values.get(name), text_of(v))
        here = self._spots(raw) if spots is None else spots

        def get(name: str) -> Any:
            k = self._number[name]
            return self._plain[k][int(here[k])] if self._lengths[k] else here[k]

        return get

    def _overriding(self, raw: int) -> Iterator[tuple[int, Override]]:
        if not self.overrides:
            return
        spots = self._spots(raw)
        for number, override in enumerate(self.overrides):
            if self._judge(override.when, raw, spots, f"/overrides/{number}/when"):
                yield number, override

    def _patches(self, i: int) -> list[Patch]:
        raw = self._raw(i)
        patches = []
        spots = self._spots(raw) if self.mode != "list" else ()
        for k, axis in enumerate(self.axes):
            if self.mode == "list":
                value = self._cell_value(raw, axis)
                if value is MISSING:
                    continue
                key = axis.pointers[0] if axis.source == "pointer" else axis.label
                source = pointer("list", raw, key)
            else:
                value = axis.values[int(spots[k])] if axis.values else spots[k]
                source = pointer("axes", k, axis.source)
                source += f"/{spots[k]}" if axis.source == "values" else ""
            verbatim = self.mode == "list" or axis.source == "values"
            patches += [Patch(at, value, source, verbatim) for at in axis.pointers]
        for number, override in self._overriding(raw):
            at = pointer("overrides", number, "set")
            patches += [Patch(to, v, at + pointer(to)) for to, v in override.set.items()]
        return patches


MISSING = object()  # of a parameter that a cell of a list leaves to the base


def plain_value(value: Any, text: str) -> Any:
    """Return what a condition compares: the value, or the text of an object or list."""
    return value if value is None or isinstance(value, str | int | float) else text


def row_of(entry: Mapping[str, Any]) -> Row:
    """Return the cell of a list that an object with resolved axis labels stands for."""
    values = {key: value for key, value in entry.items() if key != "label"}
    return Row(values, entry.get("label"))
