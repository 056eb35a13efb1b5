"""Sweeps: axes over JSON pointers of a base scene, expanded to cells."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.job import JsonDict

MAX_CELLS = 10_000
MAX_AXES = 16
SOURCES = ("values", "linspace", "logspace")
KEYS = {"pointer", "label", "labels", *SOURCES}


@dataclass(frozen=True)
class Axis:
    """One axis: where its values go, the values, and what to call them."""

    pointers: tuple[str, ...]
    values: tuple[Any, ...]
    label: str
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Cell:
    """One combination: its scene, its parameters by axis label, and a line of text."""

    index: int
    scene: JsonDict
    parameters: JsonDict
    label: str
    place: tuple[int, ...]  # index on every axis


def parse_axes(raw: Any, base: Mapping[str, Any], mode: str) -> list[Axis]:
    """Check axes against the base scene. Raises SceneValidationError with all faults."""
    faults: list[Fault] = []
    if mode not in ("grid", "zip"):
        faults.append(Fault("/mode", "unknown_value", f"mode is grid or zip, not {mode!r}"))
    if not isinstance(raw, list | tuple) or not 1 <= len(raw) <= MAX_AXES:
        faults.append(Fault("/axes", "wrong_length", f"a sweep needs 1 to {MAX_AXES} axes"))
        raise SceneValidationError(faults)
    axes = [_axis(axis, f"/axes/{i}", base, faults) for i, axis in enumerate(raw)]
    if faults:
        raise SceneValidationError(faults)
    lengths = [len(axis.values) for axis in axes]
    names = [axis.label for axis in axes]
    for i, name in enumerate(names):
        if name in names[:i]:
            why = f"two axes are called {name!r}; give one of them another 'label'"
            faults.append(Fault(f"/axes/{i}/label", "duplicate", why))
    if mode == "zip" and len(set(lengths)) > 1:
        why = f"mode zip needs axes of one length, got {', '.join(map(str, lengths))}"
        faults.append(Fault("/axes", "wrong_length", why))
    cells = lengths[0] if mode == "zip" else math.prod(lengths)
    if cells > MAX_CELLS:
        why = f"{cells:,} cells are too many; a sweep holds at most {MAX_CELLS:,}"
        faults.append(Fault("/axes", "limit_exceeded", why))
    if faults:
        raise SceneValidationError(faults)
    return axes


def expand(base: Mapping[str, Any], axes: Sequence[Axis], mode: str) -> Iterator[Cell]:
    """Yield cells; in a grid the last axis runs fastest."""
    counts = [range(len(axis.values)) for axis in axes]
    places = zip(*counts, strict=True) if mode == "zip" else itertools.product(*counts)
    for index, place in enumerate(places):
        scene = copy.deepcopy(dict(base))
        parameters, texts = {}, []
        for axis, i in zip(axes, place, strict=True):
            for pointer in axis.pointers:
                set_value(scene, pointer, copy.deepcopy(axis.values[i]))
            parameters[axis.label] = axis.values[i]
            texts.append(axis.labels[i])
        yield Cell(index, scene, parameters, ", ".join(filter(None, texts)), tuple(place))


def guess_columns(axes: Sequence[Axis], mode: str, cells: int) -> int:
    """Return the columns of a contact sheet: the last axis that varies, else nearly square."""
    lengths = [len(axis.values) for axis in axes if len(axis.values) > 1]
    if mode == "grid" and len(lengths) > 1 and lengths[-1] <= 32:
        return lengths[-1]
    return cells if cells <= 8 else math.ceil(math.sqrt(cells))


# -- JSON pointers (RFC 6901) -------------------------------------------------------------------
def split_pointer(pointer: str) -> list[str]:
    """Return the unescaped parts of a pointer."""
    return [part.replace("~1", "/").replace("~0", "~") for part in pointer.split("/")[1:]]


def set_value(scene: Any, pointer: str, value: Any) -> None:
    """Put a value where the pointer says; its parent exists (checked by `parse_axes`)."""
    *parents, last = split_pointer(pointer)
    for part in parents:
        scene = scene[int(part)] if isinstance(scene, list) else scene[part]
    if isinstance(scene, list):
        scene[int(last)] = value
    else:
        scene[last] = value


def _pointer_fault(pointer: Any, base: Any) -> str | None:
    if not isinstance(pointer, str) or not pointer.startswith("/"):
        return "a pointer starts with '/', for example /materials/ball/alpha"
    parts = split_pointer(pointer)
    for depth, part in enumerate(parts):
        here = "/" + "/".join(parts[:depth])
        if isinstance(base, list):
            if not part.isdigit() or int(part) >= len(base):
                return f"{here} has {len(base)} entries; {part!r} is none of them"
            base = base[int(part)]
        elif isinstance(base, Mapping):
            if part not in base:
                if depth == len(parts) - 1:
                    return None  # a key that the base leaves at its default
                known = ", ".join(map(str, list(base)[:8]))
                return f"the base scene has no {here.rstrip('/')}/{part}; there is: {known}"
            base = base[part]
        else:
            return f"{here} of the base scene is a plain value and has nothing inside"
    return None


# -- axes ---------------------------------------------------------------------------------------
def _axis(raw: Any, at: str, base: Mapping[str, Any], faults: list[Fault]) -> Axis:
    empty = Axis((), (), "", ())
    if not isinstance(raw, Mapping):
        faults.append(Fault(at, "wrong_type", "an axis is an object with 'pointer' and 'values'"))
        return empty
    before = len(faults)
    for key in set(raw) - KEYS:
        why = f"unknown key {key!r}; an axis has {', '.join(sorted(KEYS))}"
        faults.append(Fault(f"{at}/{key}", "unknown_key", why))
    pointers = _pointers(raw, at, base, faults)
    values = _values(raw, at, faults)
    label = raw.get("label")
    if label is None:
        label = pointers[0].rsplit("/", 1)[-1] if pointers else ""
    if not isinstance(label, str):
        faults.append(Fault(f"{at}/label", "wrong_type", "label is a text"))
    labels = raw.get("labels")
    if labels is None:
        labels = [_text(value) for value in values]
    elif not isinstance(labels, Sequence) or not all(isinstance(t, str) for t in labels):
        faults.append(Fault(f"{at}/labels", "wrong_type", "labels is a list of texts"))
    elif len(labels) != len(values):
        why = f"one label per value: {len(values)}, got {len(labels)}"
        faults.append(Fault(f"{at}/labels", "wrong_length", why))
    if len(faults) > before:
        return empty
    return Axis(tuple(pointers), tuple(values), str(label), tuple(labels))


def _pointers(
    raw: Mapping[str, Any], at: str, base: Mapping[str, Any], faults: list[Fault]
) -> list[str]:
    if "pointer" not in raw:
        faults.append(Fault(at, "missing_key", "an axis needs 'pointer'"))
        return []
    given = raw["pointer"]
    many = isinstance(given, list)
    pointers = given if many else [given]
    if not pointers:
        faults.append(Fault(f"{at}/pointer", "wrong_length", "give at least one pointer"))
    for i, pointer in enumerate(pointers):
        if why := _pointer_fault(pointer, base):
            where = f"{at}/pointer/{i}" if many else f"{at}/pointer"
            faults.append(Fault(where, "bad_pointer", why))
    return list(pointers)


def _values(raw: Mapping[str, Any], at: str, faults: list[Fault]) -> list[Any]:
    given = [key for key in SOURCES if key in raw]
    if len(given) != 1:
        why = "an axis needs exactly one of 'values', 'linspace', 'logspace'"
        faults.append(Fault(at, "missing_key" if not given else "exclusive_keys", why))
        return []
    key = given[0]
    value = raw[key]
    if key == "values":
        if not isinstance(value, list) or not value:
            faults.append(Fault(f"{at}/values", "wrong_type", "values is a list, not empty"))
            return []
        return list(value)
    return _spaced(key, value, f"{at}/{key}", faults)


def _spaced(key: str, value: Any, at: str, faults: list[Fault]) -> list[float]:
    good = isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))
    if not good or value[2] != int(value[2]) or not 1 <= value[2] <= MAX_CELLS:
        why = f"{key} is [first, last, count] with finite numbers and count 1 to {MAX_CELLS:,}"
        faults.append(Fault(at, "wrong_type", why))
        return []
    first, last, count = float(value[0]), float(value[1]), int(value[2])
    if key == "logspace" and not (first > 0 and last > 0):
        why = "logspace is [first, last, count] with first and last above 0 (not exponents)"
        faults.append(Fault(at, "out_of_range", why))
        return []
    if count == 1:
        return [value[0]]
    steps = [i / (count - 1) for i in range(count)]
    if key == "linspace":
        inner = [first + (last - first) * t for t in steps]
    else:
        inner = [first * (last / first) ** t for t in steps]
    spaced = [first, *inner[1:-1], last]
    whole = isinstance(value[0], int) and all(x == int(x) for x in spaced)
    return [int(x) for x in spaced] if whole else spaced  # seeds and spp are whole numbers


def _is_number(value: Any) -> bool:
    good = isinstance(value, int | float) and not isinstance(value, bool)
    return good and math.isfinite(value)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        named = [str(value[k]) for k in ("type", "metal", "name") if k in value]
        return " ".join(named) or "..."
    return str(value)
