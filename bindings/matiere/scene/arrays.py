"""Arrays of scene JSON: lists in JSON, numpy arrays in Python, kept as read-only arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from pydantic import PlainValidator, WithJsonSchema

from matiere.scene.checks import FLOAT_MAX, Line, fault, faults, shown


def _bad_elements(value: Any, columns: int, integer: bool) -> list[Line]:
    """Find what keeps `value` from being rows of `columns` numbers (the first few places)."""
    if isinstance(value, np.ndarray):
        if not integer or value.ndim != 2 or value.dtype.kind != "f":
            return []
        places = [tuple(int(i) for i in at) for at in np.argwhere(value % 1 != 0)[:5]]
        what = "expected a whole number, got "
        return [(at, fault("wrong_type", f"{what}{value[at]}")) for at in places]
    found: list[Line] = []
    noun = "whole numbers" if integer else "numbers"
    for row, item in enumerate(value):
        if not isinstance(item, list | tuple | np.ndarray) or _length(item) != columns:
            got = shown(item)
            found.append(((row,), fault("wrong_length", f"expected {columns} {noun}, got {got}")))
        else:
            for column, entry in enumerate(item):
                good = isinstance(entry, int if integer else int | float)
                if not good or isinstance(entry, bool):
                    what = f"expected a {'whole ' if integer else ''}number, got {shown(entry)}"
                    found.append(((row, column), fault("wrong_type", what)))
        if len(found) >= 5:
            break
    return found


def _length(value: Any) -> int:
    """Return the length of a list or array, -1 for an array without dimensions."""
    return -1 if isinstance(value, np.ndarray) and value.ndim == 0 else len(value)


def rows(columns: int, integer: bool = False) -> Callable[[Any], Any]:
    """Return a validator for an (N, `columns`) array of finite numbers."""
    what = f"a list of {columns}-element lists of {'whole ' if integer else ''}numbers"

    def check(value: Any) -> Any:
        if not isinstance(value, list | tuple | np.ndarray):
            raise fault("wrong_type", f"expected {what}, got {shown(value)}")
        if _length(value) == 0:
            raise fault("wrong_length", f"expected {what}, got an empty list")
        array = _as_array(value)
        wanted = "iu" if integer else "iuf"
        if (
            array is None
            or array.ndim != 2
            or array.shape[1] != columns
            or (array.dtype.kind not in wanted)
        ):
            bad = _bad_elements(value, columns, integer)
            if bad:
                raise faults(bad)
            raise fault("wrong_type", f"expected {what}, got {shown(value)}")
        return frozen(_finite(array, integer))

    return check


def _as_array(value: Any) -> np.ndarray[Any, Any] | None:
    try:
        return np.asarray(value)
    except (ValueError, TypeError, OverflowError):
        return None


def _finite(array: np.ndarray[Any, Any], integer: bool) -> np.ndarray[Any, Any]:
    if integer:
        return array.astype(np.int64)
    result = array.astype(np.float64)
    bad = np.argwhere(~(np.abs(result) <= FLOAT_MAX))
    if len(bad):
        raise faults(
            (
                tuple(int(i) for i in at),
                fault("not_finite", f"must be finite, got {result[tuple(at)]}"),
            )
            for at in bad[:5]
        )
    return result


def frozen(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return `array` contiguous and read-only."""
    result = np.ascontiguousarray(array)
    if result is array or result.base is not None:
        result = result.copy()
    result.setflags(write=False)
    return result


def pixels(value: Any) -> Any:
    """Return an image as a read-only float32 (H, W, 3) array; (H, W) and (H, W, 1) are grey."""
    array = _as_array(value) if isinstance(value, list | tuple | np.ndarray) else None
    if array is None or array.dtype.kind not in "iuf" or array.ndim not in (2, 3):
        raise fault("wrong_type", f"expected an (H, W, 3) array of numbers, got {shown(value)}")
    if array.ndim == 2:
        array = array[:, :, None]
    if array.shape[2] not in (1, 3) or 0 in array.shape:
        raise fault("wrong_length", f"expected shape (H, W, 3) or (H, W), got {array.shape}")
    with np.errstate(over="ignore"):
        single = array.astype(np.float32)
    if not np.isfinite(single).all():
        at = tuple(int(i) for i in np.argwhere(~np.isfinite(single))[0])
        raise faults([(at, fault("not_finite", f"must be finite, got {array[at]}"))])
    return frozen(np.broadcast_to(single, (*single.shape[:2], 3)))


Array = np.ndarray[Any, np.dtype[Any]]


def _rows_schema(columns: int, kind: str) -> dict[str, Any]:
    row = {"type": "array", "items": {"type": kind}, "minItems": columns, "maxItems": columns}
    return {"type": "array", "items": row, "minItems": 1}


Points = Annotated[Array, PlainValidator(rows(3)), WithJsonSchema(_rows_schema(3, "number"))]
Points2 = Annotated[Array, PlainValidator(rows(2)), WithJsonSchema(_rows_schema(2, "number"))]
Triangles = Annotated[
    Array, PlainValidator(rows(3, integer=True)), WithJsonSchema(_rows_schema(3, "integer"))
]
Pixels = Annotated[
    Array, PlainValidator(pixels),
    WithJsonSchema({"type": "array", "items": {"type": "array"}, "minItems": 1}),
]  # fmt: skip
