"""What every scene model shares: strict frozen nodes, and faults worded for people.

Each node turns pydantic's own complaints into ours (a code and a sentence that says what to do)
as soon as they arise, so that the class, and with it the list of known keys, is still at hand.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from typing import Annotated, Any

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PlainValidator,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

Loc = tuple[str | int, ...]
Line = tuple[Loc, PydanticCustomError]

FLOAT_MAX = 3.4028234e38  # the core calculates in single precision
MIN_LENGTH = 1e-18  # the square of a direction must not vanish in single precision
MAX_COORDINATE = 1e15  # metres; squares and products of it still fit single precision


def fault(code: str, message: str, suggestion: str | None = None) -> PydanticCustomError:
    """Return a fault that a validator can raise; `code` must be listed in `CODES`."""
    assert code in CODES, code
    return PydanticCustomError(
        code,
        "{message}",
        {"message": message, **({"suggestion": suggestion} if suggestion else {})},
    )


def faults(lines: Iterable[Line]) -> ValidationError:
    """Return one exception that carries several faults, each with its place below this value."""
    details = [InitErrorDetails(type=what, loc=where, input=None) for where, what in lines]
    return ValidationError.from_exception_data("scene", details)


CODES = frozenset({
    "invalid_json", "duplicate_key", "too_deep", "limit_exceeded", "wrong_version",
    "unknown_key", "missing_key", "exclusive_keys", "wrong_type", "wrong_length", "unknown_choice",
    "out_of_range", "not_finite", "degenerate", "index_out_of_range",
    "unknown_type", "unknown_material", "unknown_texture", "unknown_metal", "unknown_name",
    "unknown_view", "film_too_large", "unsupported", "wrong_color_space",
    "asset_missing", "asset_outside_root", "asset_format", "asset_unreadable", "asset_changed",
})  # fmt: skip


class Node(BaseModel):
    """Base of every scene model: frozen, strict, unknown keys refused."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, arbitrary_types_allowed=True
    )

    def problems(self) -> Iterable[Line]:
        """Yield what is wrong between fields that are each right on their own."""
        return ()

    @classmethod
    def key_problems(cls, keys: Set[str]) -> Iterable[Line]:
        """Yield what is wrong with keys standing together, whatever their values."""
        return ()

    @model_validator(mode="wrap")
    @classmethod
    def _explain(cls, data: Any, handler: ModelWrapValidatorHandler[Any]) -> Any:
        keys = set(data) if isinstance(data, Mapping) else set()
        lines: list[Line] = list(cls.key_problems(keys)) if keys else []
        try:
            node = handler(data)
        except ValidationError as error:
            found = error.errors(include_url=False)
            lines = [(line["loc"], _explained(cls, line, data)) for line in found] + lines
        else:
            lines += node.problems()
        if lines:
            raise faults(lines)
        return node


def closest(name: object, known: Iterable[str]) -> str | None:
    """Return the known name most like `name`, or None when none is alike."""
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.6)
    return near[0] if near else None


def choose(what: str, name: object, known: Iterable[str]) -> tuple[str, str | None]:
    """Return the sentence (and suggestion) for a name that is none of `known`."""
    names = sorted(known)
    near = closest(name, names)
    listed = ", ".join(repr(n) for n in names[:40]) + (" ..." if len(names) > 40 else "")
    hint = f"did you mean {near!r}? " if near else ""
    return f"{what} {shown(name)} is not known; {hint}choose one of {listed or '(none)'}", near


def shown(value: object) -> str:
    """Return `value` as it may appear inside a message: short, on one line."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if isinstance(value, Mapping):
        return "an object"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"a list of {len(value)}"
    text = f"{value!r}" if isinstance(value, str | int | float) else type(value).__name__
    return text if len(text) <= 60 else text[:57] + "..."


_EXPECTED = {
    "float_type": "a number", "float_parsing": "a number", "int_type": "a whole number",
    "int_from_float": "a whole number", "int_parsing": "a whole number",
    "int_parsing_size": "a whole number", "bool_type": "true or false",
    "bool_parsing": "true or false", "string_type": "a string", "dict_type": "an object",
    "model_type": "an object", "model_attributes_type": "an object", "list_type": "a list",
    "tuple_type": "a list", "mapping_type": "an object",
}  # fmt: skip

_RANGES = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}


def _explained(cls: type[Node], line: ErrorDetails, data: Any) -> PydanticCustomError:
    kind, value, context = line["type"], line["input"], line.get("ctx", {})
    if kind in CODES:
        return fault(kind, line["msg"], context.get("suggestion"))
    name = line["loc"][-1] if line["loc"] else ""
    if kind == "extra_forbidden":
        return unknown_key(str(name), list(cls.model_fields), data)
    if kind == "missing":
        doc = cls.model_fields[str(name)].description
        return fault("missing_key", f"{name!r} is missing here" + (f" ({doc})" if doc else ""))
    if kind in _EXPECTED:
        return fault("wrong_type", f"expected {_EXPECTED[kind]}, got {shown(value)}")
    if kind in _RANGES:
        key, words = _RANGES[kind]
        return fault("out_of_range", f"must be {words} {context[key]:g}, got {shown(value)}")
    if kind == "literal_error":
        known = [word.strip().strip("'") for word in _split_expected(context["expected"])]
        return fault("unknown_choice", *choose("the value", value, known))
    return fault("wrong_type", f"{line['msg']} (got {shown(value)})")


def _split_expected(text: str) -> list[str]:
    return text.replace(" or ", ", ").split(", ")


def unknown_key(name: str, known: Sequence[str], data: Any) -> PydanticCustomError:
    """Return the fault for a key that is none of `known`, with the one probably meant."""
    used = set(data) if isinstance(data, Mapping) else set()
    near = closest(name, [k for k in known if k not in used]) or closest(name, known)
    hint = f"did you mean {near!r}? " if near else ""
    return fault("unknown_key", f"unknown key {name!r}; {hint}known here: {', '.join(known)}", near)


# Numbers and vectors


def number(value: Any, *, what: str = "a number") -> float:
    """Return `value` as a float, refusing booleans, strings, and what is not finite."""
    if isinstance(value, bool | str) or not isinstance(value, int | float | np.number):
        raise fault("wrong_type", f"expected {what}, got {shown(value)}")
    result = float(value)
    if not np.isfinite(result):
        raise fault("not_finite", f"must be a finite number, got {result}")
    if abs(result) > FLOAT_MAX:
        raise fault("out_of_range", f"{result:g} is too large for single precision")
    return result


def numbers(value: Any, count: int, what: str) -> tuple[float, ...]:
    """Return `value` as a tuple of `count` finite floats; every bad element is reported."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        raise fault("wrong_type", f"expected {what}, got {shown(value)}")
    if len(value) != count:
        raise fault("wrong_length", f"expected {what}, got {len(value)} values")
    result, bad = [], []
    for index, item in enumerate(value):
        try:
            result.append(number(item))
        except PydanticCustomError as error:
            bad.append(((index,), error))
    if bad:
        raise faults(bad)
    return tuple(result)


def vec3(value: Any) -> tuple[float, ...]:
    """Return `value` as three floats no further from zero than MAX_COORDINATE."""
    result = numbers(value, 3, "[x, y, z]")
    if bad := [i for i, x in enumerate(result) if abs(x) > MAX_COORDINATE]:
        why = f"must lie within {MAX_COORDINATE:g} m of the origin"
        raise faults(((i,), fault("out_of_range", why)) for i in bad)
    return result


def direction(value: Any) -> tuple[float, ...]:
    """Return `value` as three floats that are not all (next to) zero."""
    result = vec3(value)
    if max(map(abs, result)) < MIN_LENGTH:
        raise fault("degenerate", "a direction must not be [0, 0, 0], nor as short as that")
    return result


def color(value: Any) -> tuple[float, ...]:
    """Return a colour: one number (for all channels) or linear Rec.709 [r, g, b], none negative."""
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        result: tuple[float, ...] = (number(value),) * 3
        if result[0] < 0:
            raise fault("out_of_range", f"must be at least 0, got {shown(value)}")
        return result
    result = numbers(value, 3, "a number or [r, g, b]")
    if bad := [(i, x) for i, x in enumerate(result) if x < 0]:
        raise faults(
            ((i,), fault("out_of_range", f"must be at least 0, got {x:g}")) for i, x in bad
        )
    return result


def _triple_schema(minimum: float | None = None) -> dict[str, Any]:
    item: dict[str, Any] = {"type": "number"}
    if minimum is not None:
        item["minimum"] = minimum
    return {"type": "array", "items": item, "minItems": 3, "maxItems": 3}


VEC3_SCHEMA = _triple_schema()
COLOR_SCHEMA = {"anyOf": [{"type": "number", "minimum": 0}, _triple_schema(0)]}

Name = Annotated[str, Field(min_length=1)]
Float3 = tuple[float, float, float]
Vec3 = Annotated[Float3, PlainValidator(vec3), WithJsonSchema(VEC3_SCHEMA)]
Direction = Annotated[Float3, PlainValidator(direction), WithJsonSchema(VEC3_SCHEMA)]
Color = Annotated[Float3, PlainValidator(color), WithJsonSchema(COLOR_SCHEMA)]


def tagged(key: str, table: Mapping[str, type[Node]], what: str) -> Callable[[Any], Any]:
    """Return a validator that picks the model by the value of `key`."""

    def check(value: Any) -> Any:
        if isinstance(value, Node):
            return value
        if not isinstance(value, Mapping):
            raise fault("wrong_type", f"expected an object, got {shown(value)}")
        if key not in value:
            message = f"{key!r} is missing here; choose one of " + ", ".join(map(repr, table))
            raise faults([((key,), fault("missing_key", message))])
        name = value[key]
        if not isinstance(name, str) or name not in table:
            raise faults([((key,), fault("unknown_type", *choose(f"the {what}", name, table)))])
        return table[name].model_validate(value)

    return check
