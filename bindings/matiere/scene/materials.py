"""Material models made from the core's parameter tables (`_core.materials()`).

A parameter is a number, a colour, a word, a flag, `{"texture": name}`, a material or a list of
objects with parameters of their own. What the core's table says about ranges, defaults and rules is
checked here, so that the faults carry their place in the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, PlainValidator, TypeAdapter, WithJsonSchema, create_model

from matiere.materials import metals
from matiere.scene.checks import (
    Line,
    Node,
    choose,
    color,
    fault,
    faults,
    number,
    shown,
    tagged,
)

TEXTURE_SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {"texture": {"type": "string", "minLength": 1}},
    "required": ["texture"],
    "additionalProperties": False,
}
# What the surface has whatever its model; only the outermost of nested materials has them.
PROPERTIES = (
    "emission", "opacity", "normal_map", "bump_map", "bump_height", "two_sided", "priority"
)  # fmt: skip
COMMON = ("type", *PROPERTIES)


Places = dict[tuple[str, ...], str]  # of parameters, nested ones too: key, key, ... -> name


class TextureRef(Node):
    """A reference to one of the scene's `textures`."""

    texture: str = Field(min_length=1, description="a key of `textures`")


def _map(value: Any) -> TextureRef:
    if isinstance(value, TextureRef):
        return value
    if not isinstance(value, Mapping):
        raise fault("wrong_type", f'expected {{"texture": name}}, got {shown(value)}')
    return TextureRef.model_validate(value)


MapRef = Annotated[TextureRef, PlainValidator(_map), WithJsonSchema(TEXTURE_SCHEMA)]


class FileName(str):
    """The name of a file under the asset root."""

    __slots__ = ()


class ParamNode(Node):
    """An object whose keys are parameters of one of the core's tables."""

    ROW: ClassVar[Mapping[str, Any]] = {}  # the core's table, set by each made model

    @classmethod
    def key_problems(cls, keys: Set[str]) -> Iterable[Line]:
        """Yield the faults of parameters that contradict or need each other."""
        return rule_lines(cls.ROW, keys)

    def params(self) -> dict[str, Any]:
        """Return the model's own parameters that were given; the core fills in the others."""
        own = (name for name in type(self).model_fields if name not in COMMON)
        return {name: getattr(self, name) for name in own if name in self.model_fields_set}

    def filled(self) -> dict[str, Any]:
        """Return every key that has a value: given, by default, or implied by what is absent."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        given = self.model_fields_set
        exclusive = self.ROW.get("exclusive", ())
        taken = {n for names in exclusive if not given.isdisjoint(names) for n in names}
        for row in self.ROW["params"]:
            name, implied = row["name"], row.get("implied")
            if values[name] is None and implied is not None and name not in taken:
                values[name] = color(implied) if row["kind"] == "color" else implied
        return {name: value for name, value in values.items() if value is not None}

    def parts(self) -> Iterator[tuple[tuple[str, ...], ParamNode]]:
        """Yield place and object of every parameter that has parameters of its own."""
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, ParamNode):
                yield (name,), value
            elif isinstance(value, tuple):
                items = enumerate(value)
                yield from (((name, str(k)), v) for k, v in items if isinstance(v, ParamNode))

    def textures(self) -> dict[tuple[str, ...], str]:
        """Return place -> texture name for the parameters that are textures, nested ones too."""
        values = ((name, getattr(self, name)) for name in type(self).model_fields)
        found: Places = {(name,): v.texture for name, v in values if isinstance(v, TextureRef)}
        for at, part in self.parts():
            found |= {(*at, *place): texture for place, texture in part.textures().items()}
        return found

    def files(self) -> dict[tuple[str, ...], str]:
        """Return place -> file name for the parameters that are files, nested ones too."""
        values = ((name, getattr(self, name)) for name in type(self).model_fields)
        found: Places = {(name,): str(v) for name, v in values if isinstance(v, FileName)}
        for at, part in self.parts():
            found |= {(*at, *place): file for place, file in part.files().items()}
        return found

    def row_of(self, place: tuple[str, ...]) -> Mapping[str, Any]:
        """Return the table row of the parameter at a place that `textures` gave."""
        for at, part in self.parts():
            if place[: len(at)] == at:
                return part.row_of(place[len(at) :])
        rows = (EMISSION_ROW, OPACITY_ROW, *MAP_ROWS, *self.ROW["params"])
        return next(row for row in rows if row["name"] == place[0])


class MaterialModel(ParamNode):
    """What every material has beside the parameters of its type."""

    type: str
    emission: Any = Field(default=(0.0, 0.0, 0.0))
    opacity: Any = Field(default=1.0)
    normal_map: MapRef | None = Field(
        None, description="texture of tangent-space normals, n = 2 rgb - 1, x along u, y along v"
    )
    bump_map: MapRef | None = Field(None, description="texture of heights, first channel")
    bump_height: float = Field(
        0.01, ge=-1e6, le=1e6, description="height of the bump map's value 1, metres"
    )
    two_sided: bool = Field(True, description="false: the back of an opaque material is black")
    priority: int = Field(
        0, ge=-1000, le=1000, description="of the interior: the higher one wins where two overlap"
    )


def scalar_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of a number (or texture) parameter."""

    def check(value: Any) -> Any:
        if isinstance(value, Mapping | TextureRef):
            return _texture(row, value)
        what = "a number" + (' or {"texture": name}' if takes_texture(row) else "")
        result = number(value, what=what)
        if why := out_of_range(row, result):
            raise fault("out_of_range", f"{why}, got {shown(value)}")
        return result

    return check


def color_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of a colour (or texture) parameter."""

    def check(value: Any) -> Any:
        if isinstance(value, Mapping | TextureRef):
            return _texture(row, value)
        if not isinstance(value, list | tuple | int | float | np.ndarray | np.number):
            more = ' or {"texture": name}' if takes_texture(row) else ""
            raise fault("wrong_type", f"expected a number, [r, g, b]{more}, got {shown(value)}")
        result = color(value)
        bad = [(i, why) for i, x in enumerate(result) if (why := out_of_range(row, x))]
        if bad and isinstance(value, list | tuple | np.ndarray):
            raise faults(
                ((i,), fault("out_of_range", f"{why}, got {result[i]:g}")) for i, why in bad
            )
        if bad:
            raise fault("out_of_range", f"{bad[0][1]}, got {shown(value)}")
        return result

    return check


def _texture(row: Mapping[str, Any], value: Any) -> TextureRef:
    if not takes_texture(row):
        raise fault("wrong_type", f"{row['name']!r} is constant; it takes no texture")
    return value if isinstance(value, TextureRef) else TextureRef.model_validate(value)


def takes_texture(row: Mapping[str, Any]) -> bool:
    """Say whether a parameter may be a texture."""
    numeric = row["kind"] in ("scalar", "color")
    return bool(numeric and row.get("texture", True) and not row.get("constant_only", False))


def out_of_range(row: Mapping[str, Any], value: float) -> str | None:
    """Return the sentence for a value outside the row's range, or None."""
    low, high, open_low = row.get("min"), row.get("max"), row.get("min_exclusive", False)
    if low is not None and (value < low or (open_low and value == low)):
        why = f" ({row['reason']})" if row.get("reason") else ""
        return f"must be {'greater than' if open_low else 'at least'} {low:g}{why}"
    if high is not None and value > high:
        return f"must be at most {high:g}"
    return None


def enum_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of a parameter that is one of a few words."""

    def check(value: Any) -> Any:
        if not isinstance(value, str) or value not in row["choices"]:
            raise fault("unknown_choice", *choose(f"the {row['name']}", value, row["choices"]))
        return value

    return check


def metal_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of the name of a metal."""

    def check(value: Any) -> Any:
        if not isinstance(value, str) or value not in metals():
            raise fault("unknown_metal", *choose("the metal", value, metals()))
        return value

    return check


def material_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of a material inside another one."""

    def check(value: Any) -> Any:
        made = check_material(value)
        own = [name for name in PROPERTIES if name in made.model_fields_set]
        if own:
            why = "belongs to the surface; give it to the outermost material"
            raise faults(((name,), fault("unsupported", f"{name!r} {why}")) for name in own)
        return made

    return check


def file_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of a file's name."""

    def check(value: Any) -> Any:
        if not isinstance(value, str) or not value:
            raise fault("wrong_type", f"expected the name of a file, got {shown(value)}")
        return FileName(value)

    return check


def bool_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of a flag."""

    def check(value: Any) -> Any:
        if not isinstance(value, bool):
            raise fault("wrong_type", f"expected true or false, got {shown(value)}")
        return value

    return check


def int_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of a whole number."""

    def check(value: Any) -> Any:
        if isinstance(value, bool) or not isinstance(value, int):
            raise fault("wrong_type", f"expected a whole number, got {shown(value)}")
        if why := out_of_range(row, value):
            raise fault("out_of_range", f"{why}, got {value}")
        return value

    return check


def list_param(row: Mapping[str, Any]) -> Callable[[Any], Any]:
    """Return the validator of a list of objects."""
    item: Any = _item_model(row)
    adapter: TypeAdapter[list[ParamNode]] = TypeAdapter(list[item])
    low, high = int(row["min"]), int(row["max"])

    def check(value: Any) -> Any:
        if not isinstance(value, list | tuple):
            raise fault("wrong_type", f"expected a list of objects, got {shown(value)}")
        if not low <= len(value) <= high:
            raise fault("wrong_length", f"expected {low} to {high} objects, got {len(value)}")
        return tuple(adapter.validate_python(list(value)))

    return check


def _item_model(row: Mapping[str, Any]) -> type[ParamNode]:
    fields: dict[str, Any] = {item["name"]: _field(item) for item in row["items"]}
    name = row["name"].capitalize() + "Item"
    made = create_model(name, __base__=ParamNode, __doc__=row["doc"], **fields)
    made.ROW = {"params": row["items"]}
    return made


KINDS: dict[str, Callable[[Mapping[str, Any]], Callable[[Any], Any]]] = {
    "scalar": scalar_param, "color": color_param, "enum": enum_param, "metal": metal_param,
    "bool": bool_param, "int": int_param, "material": material_param,
    "file": file_param, "list": list_param,
}  # fmt: skip


def param_schema(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of one parameter."""
    kind = row["kind"]
    if kind == "enum":
        return {"enum": list(row["choices"])}
    if kind == "metal":
        return {"enum": sorted(metals())}
    if kind == "bool":
        return {"type": "boolean"}
    if kind == "file":
        return {"type": "string", "minLength": 1}
    if kind == "list":
        bounds = {"minItems": int(row["min"]), "maxItems": int(row["max"])}
        return {"type": "array", "items": _item_model(row).model_json_schema(), **bounds}
    if kind == "material":
        return {"type": "object"}  # `schema` puts the reference to all materials here
    one: dict[str, Any] = {"type": "integer" if kind == "int" else "number"}
    if row.get("min") is not None:
        one["exclusiveMinimum" if row.get("min_exclusive") else "minimum"] = row["min"]
    if row.get("max") is not None and np.isfinite(row["max"]):
        one["maximum"] = row["max"]
    options = [one]
    if kind == "color":
        options.append({"type": "array", "items": one, "minItems": 3, "maxItems": 3})
    if takes_texture(row):
        options.append(TEXTURE_SCHEMA)
    return options[0] if len(options) == 1 else {"anyOf": options}


def _default(row: Mapping[str, Any]) -> Any:
    value = row.get("default")
    if value is None:
        return None
    if row["kind"] == "color":
        return color(list(value) if isinstance(value, tuple) else value)
    if row["kind"] == "list":
        return list_param(row)(value)
    return value


def _field(row: Mapping[str, Any]) -> tuple[Any, Any]:
    validator = PlainValidator(KINDS[row["kind"]](row))
    kind = Annotated[Any, validator, WithJsonSchema(param_schema(row))]
    doc = row["doc"] + (f" [{row['unit']}]" if row.get("unit") else "")
    if row.get("required"):
        return kind, Field(description=doc)
    # Values and null mean the same as an absent key only where the schema says so: never here.
    return kind, Field(default=_default(row), description=doc)


def rule_lines(row: Mapping[str, Any], given: Set[str]) -> Iterable[Line]:
    """Yield the faults of parameters that must, or must not, be given together."""
    clashing: set[str] = set()  # one contradiction is told once
    for names in row.get("exclusive", ()):
        used = [n for n in names if n in given]
        if len(used) > 1:
            clashing.update(used[1:])
            said = " and ".join(map(repr, used))
            why = f"{said} say the same thing; give one of {', '.join(map(repr, names))}"
            yield (used[1],), fault("exclusive_keys", why)
    for names in row.get("one_of", ()):
        if given.isdisjoint(names):
            yield (), fault("missing_key", f"needs one of {', '.join(map(repr, names))}")
    for names in row.get("together", ()):
        used = [n for n in names if n in given and n not in clashing]
        for name in names:
            if used and name not in given:
                yield (name,), fault("missing_key", f"{used[0]!r} is given, so {name!r} is needed")
    for name, other in row.get("requires", ()):
        if name in given and name not in clashing and other not in given:
            yield (other,), fault("missing_key", f"{name!r} is given, so {other!r} is needed too")


EMISSION_ROW: dict[str, Any] = {
    "name": "emission", "kind": "color", "min": 0.0, "default": 0.0, "unit": "W/m^2/sr",
    "doc": "radiance the surface emits",
}  # fmt: skip

OPACITY_ROW: dict[str, Any] = {
    "name": "opacity", "kind": "scalar", "min": 0.0, "max": 1.0, "default": 1.0,
    "doc": "share of the surface that is there; the rest lets light straight through",
}  # fmt: skip

# Numbers as they are, not colours: an sRGB texture is refused.
MAP_ROWS = ({"name": "normal_map", "kind": "scalar"}, {"name": "bump_map", "kind": "scalar"})


def _make(row: Mapping[str, Any]) -> type[MaterialModel]:
    kind = row["type"]

    fields: dict[str, Any] = {
        "type": (Literal[kind], Field(description="the model")),
        "emission": _field(EMISSION_ROW),
        "opacity": _field(OPACITY_ROW),
        **{param["name"]: _field(param) for param in row["params"]},
    }
    name = "".join(word.capitalize() for word in kind.split("_")) + "Material"
    made = create_model(name, __base__=MaterialModel, __doc__=row["doc"], **fields)
    made.ROW = row
    return made


@lru_cache(maxsize=1)
def material_models() -> dict[str, type[MaterialModel]]:
    """Return material type -> model, made once from the core's tables."""
    from matiere.materials import materials

    return {row["type"]: _make(row) for row in materials()}


def _material(value: Any) -> Any:
    return tagged("type", material_models(), "material type")(value)


def check_material(value: Any) -> MaterialModel:
    """Return the model of one material object; raise pydantic's ValidationError with our faults."""
    made: MaterialModel = TypeAdapter(Material).validate_python(value)
    return made


Material = Annotated[MaterialModel, PlainValidator(_material), WithJsonSchema({"type": "object"})]
