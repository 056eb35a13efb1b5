"""Which parameters were treated as limits: found by asking whether another value undoes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from matiere.errors import MatiereError
from matiere.stability.measures import direction
from matiere.stability.views import SPECULAR, Scatterer

OTHER_VALUES = (0.3, 1.5, 5.0)
NO_SHAPE = ("emission", "priority", "opacity")  # properties that do not scatter
WORDS = {
    "delta": "treated as a delta: sampled exactly, never evaluated",
    "null": "treated as if nothing were there: light passes straight through",
}

Path = tuple[str | int, ...]
Build = Callable[[Mapping[str, Any]], Scatterer]


def has_delta(bsdf: Scatterer) -> bool:
    """Tell whether any lobe is a delta."""
    return bool(int(getattr(bsdf, "lobes", 0)) & SPECULAR)


def is_nothing(bsdf: Scatterer) -> bool:
    """Tell whether all light passes straight through, unchanged."""
    wo = direction(45)
    s = bsdf.sample(wo, np.random.default_rng(3).random((64, 3)))
    straight = np.abs(np.asarray(s.wi, dtype=float) + wo).max() < 1e-6
    return bool(straight and (np.asarray(s.weight) == 1).all())


def find_limits(
    description: Mapping[str, Any], defaults: Mapping[str, Any], bsdf: Scatterer, build: Build
) -> list[dict[str, Any]]:
    """Return a row `{pointer, value, limit, text}` for every parameter whose value is a limit.

    A model that is a delta whatever its parameters are (a mirror) has none.
    """
    rows: dict[Path, dict[str, Any]] = {}
    for limit, holds in (("null", is_nothing), ("delta", has_delta)):
        if not holds(bsdf):
            continue
        for path, value in _numbers(description, defaults):
            if path not in rows and _undone(description, path, value, holds, build):
                pointer = "".join(f"/{part}" for part in path)
                name = ".".join(map(str, path))
                text = f"{name} = {value:g} is {WORDS[limit]}"
                rows[path] = {"pointer": pointer, "value": value, "limit": limit, "text": text}
    return list(rows.values())


def _numbers(
    description: Mapping[str, Any], defaults: Mapping[str, Any]
) -> Iterator[tuple[Path, float]]:
    """Yield every number in the material, nested materials too, and those it leaves to defaults."""
    yield from _leaves(description, ())
    for name, value in defaults.items():
        if name not in description and _is_number(value):
            yield (name,), float(value)


def _leaves(value: Any, path: Path) -> Iterator[tuple[Path, float]]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            if name not in NO_SHAPE:
                yield from _leaves(inner, (*path, name))
    elif isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
        for index, inner in enumerate(value):
            yield from _leaves(inner, (*path, index))
    elif _is_number(value):
        yield path, float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _undone(
    description: Mapping[str, Any],
    path: Path,
    value: float,
    holds: Callable[[Scatterer], bool],
    build: Build,
) -> bool:
    for other in OTHER_VALUES:
        if other == value:
            continue
        changed: Any = deepcopy(dict(description))
        place = changed
        for part in path[:-1]:
            place = place[part]
        place[path[-1]] = other
        try:
            if not holds(build(changed)):
                return True
        except MatiereError:
            continue  # this parameter cannot have that value
    return False
