"""Turn JSON text, or a dict with numpy inside, into plain values that can be checked.

Done before any model sees the scene: size and depth limits, duplicate keys, NaN and infinity.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from matiere.errors import Fault, SceneValidationError, pointer

MAX_BYTES = 64 * 2**20
WORDS = frozenset((str, bool, type(None)))
SCALARS = WORDS | {float, int}  # exactly these types, not their heirs: most values of a scene
MAX_DEPTH = 64
MANY_ROWS = 1000  # from here on rows are taken as an array, not number by number


class _Object(dict[str, Any]):
    """A JSON object that remembers the keys that were written more than once."""

    repeated: tuple[str, ...] = ()


def _pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
    result = _Object(items)
    if len(result) != len(items):
        seen: set[str] = set()
        result.repeated = tuple(k for k, _ in items if k in seen or seen.add(k))  # type: ignore[func-returns-value]
    return result


def read(path: str | os.PathLike[str]) -> Any:
    """Read and parse a scene file; raise SceneValidationError if it is no JSON or too large."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        why = f"cannot read the scene file {str(path)!r}: {error.strerror}"
        raise SceneValidationError([Fault("", "asset_missing", why)]) from None
    return parse(data)


def parse(data: bytes | str) -> Any:
    """Parse JSON text; raise SceneValidationError if it is no JSON, too large or too deep."""
    if len(data) > MAX_BYTES:
        why = (
            f"the scene is larger than {MAX_BYTES >> 20} MiB; "
            "put large meshes and images into files of their own"
        )
        raise SceneValidationError([Fault("", "limit_exceeded", why)])
    try:
        return json.loads(data, object_pairs_hook=_pairs)
    except json.JSONDecodeError as error:
        why = f"not valid JSON: {error.msg} at line {error.lineno}, column {error.colno}"
        raise SceneValidationError([Fault("", "invalid_json", why)]) from None
    except UnicodeDecodeError as error:
        why = f"not valid JSON: the text is not UTF-8 (byte {error.start})"
        raise SceneValidationError([Fault("", "invalid_json", why)]) from None
    except RecursionError:
        raise SceneValidationError([_too_deep("")]) from None
    except ValueError:  # a whole number of thousands of digits
        why = "not valid JSON for a scene: a number has too many digits"
        raise SceneValidationError([Fault("", "invalid_json", why)]) from None


def _too_deep(at: str) -> Fault:
    return Fault(at, "too_deep", f"nested deeper than {MAX_DEPTH} levels; scenes need far fewer")


def plain(document: Any) -> tuple[Any, list[Fault]]:
    """Return `document` made of dict, list, str, numbers and arrays, and what is wrong with it."""
    found: list[Fault] = []
    return _plain(document, (), found), found


def _plain(value: Any, at: tuple[str | int, ...], found: list[Fault]) -> Any:
    if type(value) in WORDS:
        return value
    if type(value) in SCALARS:
        return _number(value, at, found)
    if isinstance(value, str | bool | None):
        return value
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int | float):
        return _number(value, at, found)
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if len(at) >= MAX_DEPTH and isinstance(value, Mapping | list | tuple):
        found.append(_too_deep(pointer(*at)))
        return None
    if isinstance(value, Mapping):
        for key in getattr(value, "repeated", ()):
            why = f"the key {key!r} is written twice; keep one"
            found.append(Fault(pointer(*at, key), "duplicate_key", why))
        return {(k := str(key)): _plain(v, (*at, k), found) for key, v in value.items()}
    if isinstance(value, list | tuple):
        if len(value) >= MANY_ROWS and (array := _rows(value)) is not None:
            return array
        return [_plain(v, (*at, i), found) for i, v in enumerate(value)]
    if hasattr(value, "model_dump"):
        return _plain(value.model_dump(exclude_unset=True), at, found)
    why = f"a scene cannot hold a value of type {type(value).__name__}"
    found.append(Fault(pointer(*at), "wrong_type", why))
    return None


def _rows(value: list[Any] | tuple[Any, ...]) -> np.ndarray[Any, Any] | None:
    """Return a long list of rows of numbers as an array at once; None if it is anything else."""
    first = value[0]
    if not isinstance(first, list | tuple) or not first or isinstance(first[0], bool | str):
        return None
    try:
        array = np.array(value)
    except (ValueError, TypeError, OverflowError):
        return None
    return array if array.ndim == 2 and array.dtype.kind in "iuf" else None


def _number(value: float, at: tuple[str | int, ...], found: list[Fault]) -> int | float:
    try:
        finite = math.isfinite(value)
    except OverflowError:
        finite = False
    if not finite:
        said = repr(value) if isinstance(value, float) else "a number beyond double precision"
        why = f"must be a finite number, got {said}"
        found.append(Fault(pointer(*at), "not_finite", why))
        return 1.0  # a stand-in, so that the search for further faults goes on
    return value
