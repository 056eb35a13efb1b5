"""Lights, the environment and textures of scene JSON v1."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator, WithJsonSchema

from matiere.scene.arrays import Pixels
from matiere.scene.camera import norm
from matiere.scene.checks import (
    Color,
    Direction,
    Float3,
    Line,
    Name,
    Node,
    Vec3,
    choose,
    fault,
    faults,
    numbers,
    shown,
    tagged,
)


def _not_perpendicular(edge_u: Float3, edge_v: Float3) -> Iterable[Line]:
    dot = sum(a * b for a, b in zip(edge_u, edge_v, strict=True))
    if abs(dot) > 1e-6 * norm(edge_u) * norm(edge_v):
        yield ("edge_v",), fault("degenerate", "must be perpendicular to edge_u")


class RectangleLight(Node):
    """A rectangle that emits on the side edge_u x edge_v points to."""

    type: Literal["rectangle"] = Field(description="which kind this is")
    name: Name | None = Field(None, description="for messages and reports")
    corner: Vec3 = Field(description="metres")
    edge_u: Direction = Field(description="first edge from the corner, metres")
    edge_v: Direction = Field(description="second edge from the corner, metres")
    radiance: Color = Field(description="W/m^2/sr")

    def problems(self) -> Iterable[Line]:
        yield from _not_perpendicular(self.edge_u, self.edge_v)


class PointLight(Node):
    """A point that radiates alike in all directions, or as a photometric file says."""

    type: Literal["point"] = Field(description="which kind this is")
    name: Name | None = Field(None, description="for messages and reports")
    position: Vec3 = Field(description="metres")
    intensity: Color = Field(description="W/sr; with ies: in the brightest direction")
    ies: Name | None = Field(
        None, description="photometric file (.ies, type C) that spreads the light over directions"
    )
    direction: Direction = Field(
        (0.0, -1.0, 0.0), description="where the file's vertical angle 0 points"
    )
    rotation_deg: float = Field(
        0.0, description="turn of the file's horizontal angles about direction, degrees"
    )

    def problems(self) -> Iterable[Line]:
        for key in ("direction", "rotation_deg"):
            if self.ies is None and key in self.model_fields_set:
                yield (key,), fault("exclusive_keys", f"{key!r} belongs to 'ies'")


class SpotLight(Node):
    """A point that shines into a cone, fading out smoothly towards its edge."""

    type: Literal["spot"] = Field(description="which kind this is")
    name: Name | None = Field(None, description="for messages and reports")
    position: Vec3 = Field(description="metres")
    direction: Direction = Field(description="axis of the cone, away from the light")
    intensity: Color = Field(
        description="W/sr on the axis; with ies: in the file's brightest direction"
    )
    ies: Name | None = Field(
        None,
        description="photometric file (.ies, type C) that spreads the light inside the cone; its "
        "vertical angle 0 lies on the axis",
    )
    rotation_deg: float = Field(
        0.0, description="turn of the file's horizontal angles about the axis, degrees"
    )
    outer_deg: float = Field(
        30.0,
        gt=0,
        le=180,
        description="angle from the axis beyond which there is no light, degrees",
    )
    inner_deg: float | None = Field(
        None, ge=0,
        description="angle up to which there is all of it, degrees; null: 5/6 of outer_deg",
    )  # fmt: skip

    def problems(self) -> Iterable[Line]:
        if self.inner_deg is not None and self.inner_deg > self.outer_deg:
            yield ("inner_deg",), fault("out_of_range", "must not be greater than outer_deg")
        if self.ies is None and "rotation_deg" in self.model_fields_set:
            yield ("rotation_deg",), fault("exclusive_keys", "'rotation_deg' belongs to 'ies'")

    @property
    def inner(self) -> float:
        """The inner angle in degrees, the usual one when none is given."""
        return self.outer_deg * 5 / 6 if self.inner_deg is None else self.inner_deg


class DirectionalLight(Node):
    """Light from infinitely far away."""

    type: Literal["directional"] = Field(description="which kind this is")
    name: Name | None = Field(None, description="for messages and reports")
    direction: Direction = Field(description="direction in which the light travels")
    irradiance: Color = Field(description="W/m^2 on a surface that faces the light")


LIGHTS = {
    "rectangle": RectangleLight,
    "point": PointLight,
    "spot": SpotLight,
    "directional": DirectionalLight,
}
AnyLight = RectangleLight | PointLight | SpotLight | DirectionalLight
Light = Annotated[
    AnyLight,
    PlainValidator(
        tagged("type", LIGHTS, "light type"),
        json_schema_input_type=Annotated[AnyLight, Field(discriminator="type")],
    ),
]

ColorSpace = Literal["sRGB", "linear", "data"]


class Portal(Node):
    """A window: a rectangle through which the environment shines towards edge_u x edge_v."""

    corner: Vec3 = Field(description="metres")
    edge_u: Direction = Field(description="first edge from the corner, metres")
    edge_v: Direction = Field(description="second edge from the corner, metres")

    def problems(self) -> Iterable[Line]:
        yield from _not_perpendicular(self.edge_u, self.edge_v)


class Environment(Node):
    """Light from all around: a lat-long image (`file` or `pixels`) or one `radiance`.

    The centre column of the image is seen looking along -z, and u grows to the right.
    """

    file: Name | None = Field(None, description="lat-long HDR or EXR image under the asset root")
    pixels: Pixels | None = Field(None, description="(H, W, 3) lat-long image, linear Rec.709")
    radiance: Color | None = Field(None, description="the same radiance everywhere, W/m^2/sr")
    color_space: Literal["sRGB", "linear"] | None = Field(
        None, description="of `file`; null: what the file says, else linear for float pixels"
    )
    rotation_deg: float = Field(
        0.0, description="turn about +y, counter-clockwise seen from above, degrees"
    )
    scale: float = Field(1.0, ge=0, description="factor on the radiance")
    portals: list[Portal] = Field(
        default_factory=list, max_length=256,
        description="windows of a room: light is looked for through them alone",
    )  # fmt: skip

    def problems(self) -> Iterable[Line]:
        given = [k for k in ("file", "pixels", "radiance") if getattr(self, k) is not None]
        if len(given) != 1:
            kind = "exclusive_keys" if given else "missing_key"
            yield (), fault(kind, "an environment needs one of 'file', 'pixels' and 'radiance'")
        if self.color_space is not None and self.file is None:
            yield ("color_space",), fault("exclusive_keys", "'color_space' belongs to 'file'")


def _background(value: Any) -> Any:
    if isinstance(value, Environment):
        return value
    if isinstance(value, Mapping):
        made = Environment.model_validate(value)
        if made.portals:
            why = "a background lights nothing; portals belong to `environment`"
            raise faults([(("portals",), fault("unsupported", why))])
        return made
    words = ("environment", "transparent")
    if isinstance(value, str):
        if value in words:
            return value
        raise fault("unknown_choice", *choose("the background", value, words))
    why = "expected 'environment', 'transparent' or an object like `environment`, got "
    raise fault("wrong_type", why + shown(value))


Background = Annotated[
    Literal["environment", "transparent"] | Environment,
    PlainValidator(
        _background,
        json_schema_input_type=Literal["environment", "transparent"] | Environment,
    ),
]


def _pair(value: Any) -> tuple[float, float]:
    x, y = numbers(value, 2, "[x, y]")
    return (x, y)


Pair = Annotated[
    tuple[float, float],
    PlainValidator(_pair),
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}),
]


class TextureTransform(Node):
    """Where an image lies in the uv plane, with the numbers of glTF's KHR_texture_transform.

    Texture coordinates are scaled, turned and moved, in this order, about the upper left corner of
    the image, with v downwards as in glTF.
    """

    scale: Pair = Field((1.0, 1.0), description="factors of u and v; 2 shows the image twice")
    rotation_deg: float = Field(
        0.0, description="turn of the coordinates, counter-clockwise as glTF counts it, degrees"
    )
    offset: Pair = Field((0.0, 0.0), description="added last, in sizes of the image")

    def problems(self) -> Iterable[Line]:
        if not all(self.scale):
            yield ("scale",), fault("degenerate", "must not be zero: it would flatten the image")

    @property
    def matrix(self) -> tuple[float, float, float, float, float, float]:
        """u' = a u + b v + x, v' = c u + d v + y as (a, b, c, d, x, y), v upwards."""
        cos, sin = (f(math.radians(self.rotation_deg)) for f in (math.cos, math.sin))
        (sx, sy), (x, y) = self.scale, self.offset
        # glTF: u' = sx cos u + sy sin v + x, v' = -sx sin u + sy cos v + y, with v = 1 - ours.
        a, b, c, d = sx * cos, sy * sin, -sx * sin, sy * cos
        return (a, -b, -c, d, b + x, 1.0 - d - y)


class Texture(Node):
    """An image that a material parameter can refer to by `{"texture": name}`."""

    file: Name | None = Field(None, description="image file under the asset root")
    pixels: Pixels | None = Field(None, description="(H, W, 3) or (H, W) image, linear Rec.709")
    color_space: ColorSpace | None = Field(
        None,
        description="of `file`: sRGB (decoded), linear (Rec.709), data (numbers as they are); "
        "null: sRGB for whole-number pixels, linear for float pixels",
    )
    channel: Literal["r", "g", "b", "a"] | None = Field(
        None, description="only this channel of the image, as grey; null: its colour"
    )
    wrap: Literal["repeat", "clamp", "mirror", "black"] = Field(
        "repeat", description="what lies beyond uv in [0, 1]"
    )
    filter: Literal["nearest", "bilinear", "trilinear"] = Field(
        "bilinear",
        description="trilinear: material parameters are averaged over what half a pixel sees",
    )
    uv_set: Literal[0, 1] = Field(
        0, description="texture coordinates of the shape: 0 is `uv`, 1 is `uv1`"
    )
    transform: TextureTransform | None = Field(
        None, description="scale, rotation and offset as in glTF; null: none"
    )

    def problems(self) -> Iterable[Line]:
        if (self.file is None) == (self.pixels is None):
            kind = "missing_key" if self.file is None else "exclusive_keys"
            yield (), fault(kind, "a texture needs either 'file' or 'pixels'")
        if self.color_space is not None and self.file is None:
            yield ("color_space",), fault("exclusive_keys", "'color_space' belongs to 'file'")
        if self.channel == "a":
            if self.pixels is not None:
                yield ("channel",), fault("unknown_choice", "'pixels' have no alpha: use r, g or b")
            if self.color_space == "sRGB":
                why = "alpha is never sRGB: leave it out or use 'data'"
                yield ("color_space",), fault("unknown_choice", why)
