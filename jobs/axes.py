"""Axes of a sweep: where values go in the base scene, which values, and what they are called."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matiere.errors import Fault
from matiere.jobs.job import JsonDict
from matiere.jobs.pointers import last_part, pointer_fault

MAX_AXES = 16
SPACES = ("linspace", "logspace")
RANGES = ("uniform", "loguniform")
SOURCES = ("values", *SPACES, "set", *RANGES)
KEYS = {"pointer", "label", "labels", *SOURCES}
LARGEST = 1e300  # differences and ratios of two such numbers are finite or refused
DIGITS = 9  # of a value taken from a range: the same on every machine

Sets = Mapping[str, tuple[tuple[Any, ...], tuple[str, ...]]]  # name -> values, their texts


@dataclass(frozen=True)
class Axis:
    """One axis: where its values go, the values or their range, and what to call them."""

    pointers: tuple[str, ...]
    values: tuple[Any, ...]
    label: str
    labels: tuple[str, ...]
    source: str = "values"  # key of the request that gave the values
    range: tuple[float, float] | None = None  # of `uniform` and `loguniform`

    def in_range(self, u: float) -> float:
        """Return the value at `u` in (0, 1) of the axis's range."""
        assert self.range is not None
        low, high = self.range
        x = low * (high / low) ** u if self.source == "loguniform" else low + (high - low) * u
        return min(max(float(f"{x:.{DIGITS}g}"), low), high)

    def to_dict(self) -> JsonDict:
        """Return the axis as plain JSON, with all its values."""
        plain: JsonDict = {"pointer": list(self.pointers), "label": self.label}
        if self.range is not None:
            return {**plain, self.source: list(self.range)}
        plain |= {"values": list(self.values), "labels": list(self.labels)}
        return plain if self.source == "values" else {**plain, "source": self.source}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Axis:
        """Return the axis that `to_dict` wrote."""
        pointers, label = tuple(plain["pointer"]), plain["label"]
        for key in RANGES:
            if key in plain:
                low, high = plain[key]
                return cls(pointers, (), label, (), key, (low, high))
        values, labels = tuple(plain["values"]), tuple(plain["labels"])
        return cls(pointers, values, label, labels, plain.get("source", "values"))


def named_sets(raw: Any, faults: list[Fault]) -> Sets:
    """Return the sets that axes may name: the request's own, and `metals`."""
    from matiere.materials import metals

    names = tuple(metals())
    sets: dict[str, tuple[tuple[Any, ...], tuple[str, ...]]] = {"metals": (names, names)}
    if raw is None:
        return sets
    if not isinstance(raw, Mapping):
        faults.append(Fault("/sets", "wrong_type", "sets is an object: name -> list of values"))
        return sets
    for name, given in raw.items():
        if isinstance(given, Mapping) and given:
            sets[name] = (tuple(given.values()), tuple(map(str, given)))
        elif isinstance(given, list) and given:
            sets[name] = (tuple(given), tuple(map(text_of, given)))
        else:
            why = "a set is a list of values or an object label -> value, not empty"
            faults.append(Fault(f"/sets/{name}", "wrong_type", why))
    return sets


def parse_axis(
    raw: Any, at: str, base: Mapping[str, Any], sets: Sets, most: int, faults: list[Fault]
) -> Axis | None:
    """Read one axis; add what is wrong to `faults` and return None."""
    if not isinstance(raw, Mapping):
        faults.append(Fault(at, "wrong_type", "an axis is an object with 'pointer' and 'values'"))
        return None
    before = len(faults)
    for key in sorted(set(raw) - KEYS):
        why = f"unknown key {key!r}; an axis has {', '.join(sorted(KEYS))}"
        faults.append(Fault(f"{at}/{key}", "unknown_key", why))
    pointers = _pointers(raw, at, base, faults)
    source, values, texts, span = _source(raw, at, sets, most, faults)
    label = raw.get("label")
    if label is None:
        label = last_part(pointers[0]) if len(faults) == before else ""
    if not isinstance(label, str):
        faults.append(Fault(f"{at}/label", "wrong_type", "label is a text"))
    labels = _labels(raw.get("labels"), texts, at, faults)
    if len(faults) > before:
        return None
    return Axis(tuple(pointers), values, str(label), labels, source, span)


def text_of(value: Any) -> str:
    """Return a value as people read it in a label."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        named = [str(value[k]) for k in ("type", "metal", "name") if k in value]
        return " ".join(named) or "..."
    return str(value)


def did_you_mean(name: str, known: Sequence[str]) -> str:
    """Return the end of a message about an unknown name: the names there are, or a close one."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f"did you mean {close[0]!r}?" if close else f"there is: {', '.join(known[:16])}"


# -- parts of an axis ---------------------------------------------------------------------------
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
        if why := pointer_fault(pointer, base):
            where = f"{at}/pointer/{i}" if many else f"{at}/pointer"
            faults.append(Fault(where, "bad_pointer", why))
    return list(pointers)


def _labels(given: Any, texts: tuple[str, ...], at: str, faults: list[Fault]) -> tuple[str, ...]:
    if given is None:
        return texts
    if not isinstance(given, list | tuple) or not all(isinstance(t, str) for t in given):
        faults.append(Fault(f"{at}/labels", "wrong_type", "labels is a list of texts"))
        return texts
    if len(given) != len(texts):
        why = f"one label per value: {len(texts)}, got {len(given)}"
        faults.append(Fault(f"{at}/labels", "wrong_length", why))
    return tuple(given)


_Source = tuple[str, tuple[Any, ...], tuple[str, ...], tuple[float, float] | None]


def _source(raw: Mapping[str, Any], at: str, sets: Sets, most: int, faults: list[Fault]) -> _Source:
    given = [key for key in SOURCES if raw.get(key) is not None]
    if len(given) != 1:
        why = "an axis needs exactly one of " + ", ".join(f"'{key}'" for key in SOURCES)
        faults.append(Fault(at, "missing_key" if not given else "exclusive_keys", why))
        return "values", (), (), None
    key, value, where = given[0], raw[given[0]], f"{at}/{given[0]}"
    if key in RANGES:
        return key, (), (), _range(key, value, where, faults)
    if key == "set":
        if not isinstance(value, str) or value not in sets:
            why = f"no set is called {value!r}; {did_you_mean(str(value), list(sets))}"
            faults.append(Fault(where, "unknown_name", why))
            return key, (), (), None
        return key, *sets[value], None
    if key == "values":
        if not isinstance(value, list) or not value:
            faults.append(Fault(where, "wrong_type", "values is a list, not empty"))
            return key, (), (), None
        return key, tuple(value), tuple(map(text_of, value)), None
    spaced = tuple(_spaced(key, value, where, most, faults))
    return key, spaced, tuple(map(text_of, spaced)), None


def _range(key: str, value: Any, at: str, faults: list[Fault]) -> tuple[float, float] | None:
    good = isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))
    if not good or value[0] >= value[1]:
        why = f"{key} is [low, high] with finite numbers, low below high"
        faults.append(Fault(at, "wrong_type", why))
        return None
    if key == "loguniform" and value[0] <= 0:
        faults.append(Fault(at, "out_of_range", "loguniform is [low, high] with low above 0"))
        return None
    return float(value[0]), float(value[1])


def _spaced(key: str, value: Any, at: str, most: int, faults: list[Fault]) -> list[float]:
    good = isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))
    if not good or value[2] != int(value[2]) or not 1 <= value[2] <= most:
        why = f"{key} is [first, last, count] with finite numbers and count 1 to {most:,}"
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
        inner = [first + (last - first) * i / (count - 1) for i in range(count)]
    else:
        inner = [first * (last / first) ** t for t in steps]
    spaced = [first, *inner[1:-1], last]
    whole = isinstance(value[0], int) and all(x == int(x) for x in spaced)
    return [int(x) for x in spaced] if whole else spaced  # seeds and spp are whole numbers


def _is_number(value: Any) -> bool:
    good = isinstance(value, int | float) and not isinstance(value, bool)
    return good and abs(value) <= LARGEST
