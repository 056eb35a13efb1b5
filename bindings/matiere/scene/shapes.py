"""Shapes of scene JSON v1 and the steps of their transforms."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator, WithJsonSchema

from matiere.scene.arrays import Points, Points2, Triangles
from matiere.scene.checks import (
    MAX_COORDINATE,
    Direction,
    Float3,
    Line,
    Name,
    Node,
    Vec3,
    closest,
    fault,
    number,
    numbers,
    shown,
    tagged,
    vec3,
)


class ScaleStep(Node):
    """Scale about the origin."""

    scale: Annotated[
        Float3,
        PlainValidator(lambda v: _scale(v)),
        WithJsonSchema(
            {"anyOf": [
                {"type": "number"},
                {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
            ]}
        ),
    ] = Field(description="one factor or [x, y, z]; none zero")  # fmt: skip


class RotateStep(Node):
    """Rotate about an axis through the origin, counter-clockwise seen against the axis."""

    rotate_deg: float = Field(description="angle, degrees")
    axis: Direction = Field(description="axis of the rotation")


class TranslateStep(Node):
    """Move."""

    translate: Vec3 = Field(description="metres")


class MatrixStep(Node):
    """Apply a 4 x 4 matrix to column vectors."""

    matrix: Annotated[
        tuple[float, ...],
        PlainValidator(lambda v: numbers(v, 16, "16 numbers, row after row")),
        WithJsonSchema(
            {"type": "array", "items": {"type": "number"}, "minItems": 16, "maxItems": 16}
        ),
    ] = Field(description="16 numbers, row after row; the last row is 0 0 0 1")

    def problems(self) -> Iterable[Line]:
        if tuple(self.matrix[12:]) != (0.0, 0.0, 0.0, 1.0):
            yield ("matrix",), fault("out_of_range", "the last row of a matrix must be 0 0 0 1")


STEPS: dict[str, type[Node]] = {
    "scale": ScaleStep, "rotate_deg": RotateStep, "translate": TranslateStep, "matrix": MatrixStep
}  # fmt: skip


def _scale(value: Any) -> tuple[float, ...]:
    single = isinstance(value, int | float) and not isinstance(value, bool)
    result = (number(value),) * 3 if single else vec3(value)
    if not all(result):
        raise fault("degenerate", "a scale must not be zero: it would flatten the shape")
    return result


def _step(value: Any) -> Any:
    if isinstance(value, Node):
        return value
    if not isinstance(value, dict):
        raise fault("wrong_type", f"expected a transform object, got {shown(value)}")
    named = [key for key in STEPS if key in value]
    if len(named) > 1:
        said = " and ".join(map(repr, named))
        raise fault("exclusive_keys", f"one step does one thing; split {said} into two steps")
    if not named:
        words = "a transform step is one of {scale}, {rotate_deg, axis}, {translate}, {matrix}"
        kind = "missing_key" if not value else "unknown_key"
        near = next((n for k in value if (n := closest(k, STEPS))), None)
        raise fault(kind, words + (f"; did you mean {near!r}?" if near else ""), near)
    return STEPS[named[0]].model_validate(value)


Step = Annotated[
    ScaleStep | RotateStep | TranslateStep | MatrixStep,
    PlainValidator(
        _step, json_schema_input_type=ScaleStep | RotateStep | TranslateStep | MatrixStep
    ),
]
Transform = Annotated[
    list[Step], Field(default_factory=list, max_length=64, description="steps, in order")
]


MIN_RADIUS = 1e-9  # metres; its fourth power still fits single precision


class SphereShape(Node):
    """A sphere."""

    type: Literal["sphere"] = Field(description="which kind this is")
    name: Name | None = Field(None, description="for messages and reports")
    center: Vec3 = Field(description="metres")
    radius: float = Field(ge=MIN_RADIUS, le=MAX_COORDINATE, description="metres")
    material: Name = Field(description="a key of `materials`")


class MeshShape(Node):
    """A triangle mesh, from a file (PLY, OBJ, GLB) or inline."""

    type: Literal["mesh"] = Field(description="which kind this is")
    name: Name | None = Field(None, description="for messages and reports")
    file: Name | None = Field(None, description="PLY, OBJ or GLB file under the asset root")
    positions: Points | None = Field(None, description="(N, 3) vertices, metres")
    triangles: Triangles | None = Field(None, description="(M, 3) indices into positions")
    normals: Points | None = Field(None, description="(N, 3) shading normals")
    uv: Points2 | None = Field(None, description="(N, 2) texture coordinates")
    uv1: Points2 | None = Field(
        None, description="(N, 2) second set of texture coordinates, for textures with uv_set 1"
    )
    material: Name | None = Field(None, description="a key of `materials`, for the whole mesh")
    materials: dict[str, Name] | None = Field(
        None, description="material or node name in the file -> a key of `materials`"
    )
    transform: Transform

    def problems(self) -> Iterable[Line]:
        yield from self._source_problems()
        if (self.material is None) == (self.materials is None):
            kind = "missing_key" if self.material is None else "exclusive_keys"
            yield (), fault(kind, "a mesh needs either 'material' or 'materials'")
        elif self.materials is not None and self.file is None:
            why = "'materials' names parts of a file; an inline mesh has one 'material'"
            yield ("materials",), fault("exclusive_keys", why)

    def _source_problems(self) -> Iterable[Line]:
        inline = ("positions", "triangles", "normals", "uv", "uv1")
        given = [key for key in inline if getattr(self, key) is not None]
        if self.file is not None:
            for key in given:
                yield (key,), fault("exclusive_keys", f"{key!r} cannot stand beside 'file'")
            return
        if self.positions is None or self.triangles is None:
            yield (), fault("missing_key", "a mesh needs 'file', or 'positions' and 'triangles'")
            return
        count = len(self.positions)
        bad = (self.triangles < 0) | (self.triangles >= count)
        for row, column in [(int(r), int(c)) for r, c in zip(*bad.nonzero(), strict=True)][:5]:
            index = int(self.triangles[row, column])
            yield (
                ("triangles", row, column),
                fault(
                    "index_out_of_range",
                    f"vertex {index} does not exist; positions has {count} (0 to {count - 1})",
                ),
            )
        for key in ("normals", "uv", "uv1"):
            array = getattr(self, key)
            if array is not None and len(array) != count:
                yield (
                    (key,),
                    fault("wrong_length", f"needs one entry per vertex: {count}, got {len(array)}"),
                )


SHAPES = {"sphere": SphereShape, "mesh": MeshShape}
Shape = Annotated[
    SphereShape | MeshShape,
    PlainValidator(
        tagged("type", SHAPES, "shape type"),
        json_schema_input_type=Annotated[SphereShape | MeshShape, Field(discriminator="type")],
    ),
]
