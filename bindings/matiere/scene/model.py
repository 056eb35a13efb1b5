"""Scene JSON v1 as frozen models: the vocabulary of docs/scene.md.

y is up, lengths are metres, angles degrees (`_deg`), colours linear Rec.709; a colour is one number
or [r, g, b]. Every node refuses unknown keys, and nothing here reads a file.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator, WithJsonSchema

from matiere.scene.checks import (
    Color,
    Direction,
    Float3,
    Line,
    Node,
    Pixels,
    Points,
    Points2,
    Triangles,
    Vec3,
    fault,
    number,
    numbers,
    shown,
    tagged,
    vec3,
)
from matiere.scene.materials import Material

VERSION = 1
MAX_PIXELS = 2**28
MAX_EDGE = 65536
MAX_SPP = 2**20
OPEN_ENDED_SPP = MAX_SPP  # the cap when only `seconds` or `target_error` is given
DEFAULT_SPP = 64
DEFAULT_CONFIG = "studio-config-v4.0.0_aces-v2.0_ocio-v2.5"
DEFAULT_DISPLAY = "sRGB - Display"
DEFAULT_VIEW = "ACES 2.0 - SDR 100 nits (Rec.709)"

Name = Annotated[str, Field(min_length=1)]


class _Camera(Node):
    origin: Vec3 = Field(description="position of the camera, metres")
    target: Vec3 = Field(description="point the camera looks at, metres")
    up: Direction = Field((0.0, 1.0, 0.0), description="direction that is up in the image")
    vfov_deg: float = Field(
        40.0, gt=0, lt=180, description="vertical field of view of the whole film, degrees"
    )

    def problems(self) -> Iterable[Line]:
        forward = [b - a for a, b in zip(self.origin, self.target, strict=True)]
        if not any(forward):
            yield ("target",), fault("degenerate", "must differ from the camera's origin")
        elif _parallel(forward, self.up):
            yield ("up",), fault("degenerate", "must not be parallel to the viewing direction")


class PinholeCamera(_Camera):
    """A camera with everything in focus."""

    type: Literal["pinhole"]


class ThinLensCamera(_Camera):
    """A camera with depth of field (a lens of `aperture_radius`, focused at `focus_distance`)."""

    type: Literal["thin_lens"]
    aperture_radius: float = Field(ge=0, description="radius of the lens, metres; 0 is a pinhole")
    focus_distance: float = Field(
        gt=0, description="distance of the plane in focus along the viewing direction, metres"
    )


CAMERAS = {"pinhole": PinholeCamera, "thin_lens": ThinLensCamera}
Camera = Annotated[
    PinholeCamera | ThinLensCamera,
    PlainValidator(
        tagged("type", CAMERAS, "camera type"),
        json_schema_input_type=Annotated[
            PinholeCamera | ThinLensCamera, Field(discriminator="type")
        ],
    ),
]


def _crop(value: Any) -> tuple[int, ...]:
    result = numbers(value, 4, "[x0, y0, x1, y1]")
    if any(x != int(x) for x in result):
        raise fault("wrong_type", "a crop is given in whole pixels: [x0, y0, x1, y1]")
    return tuple(int(x) for x in result)


Crop = Annotated[
    tuple[int, int, int, int],
    PlainValidator(_crop),
    WithJsonSchema(
        {"type": "array", "items": {"type": "integer"}, "minItems": 4, "maxItems": 4}
    ),
]


class Film(Node):
    """Size of the image and the filter that makes pixels of samples."""

    width: int = Field(256, ge=1, description="pixels")
    height: int = Field(256, ge=1, description="pixels")
    filter: Literal["box", "tent", "gaussian", "blackman_harris"] = Field(
        "gaussian", description="pixel filter; all are positive and importance-sampled"
    )
    filter_radius: float | None = Field(
        None, gt=0, le=16,
        description="radius in pixels; null: box 0.5, tent 1, gaussian 1.5, blackman_harris 1.5",
    )  # fmt: skip
    crop: Crop | None = Field(
        None,
        description="render only the pixels x0 <= x < x1, y0 <= y < y1 of [x0, y0, x1, y1]",
    )

    def problems(self) -> Iterable[Line]:
        if self.width * self.height > MAX_PIXELS or max(self.width, self.height) > MAX_EDGE:
            yield (), fault(
                "film_too_large",
                f"a film of {shown(self.width)} x {shown(self.height)} pixels is too large; "
                f"at most {MAX_PIXELS} pixels (16384 x 16384) and {MAX_EDGE} on an edge are possible",
            )
        elif self.crop is not None:
            x0, y0, x1, y1 = self.crop
            if not (0 <= x0 < x1 <= self.width and 0 <= y0 < y1 <= self.height):
                yield ("crop",), fault(
                    "out_of_range",
                    f"must satisfy 0 <= x0 < x1 <= {self.width} and 0 <= y0 < y1 <= {self.height}",
                )

    @property
    def radius(self) -> float:
        """The filter radius in pixels, the filter's usual one when none is given."""
        usual = {"box": 0.5, "tent": 1.0, "gaussian": 1.5, "blackman_harris": 1.5}
        return usual[self.filter] if self.filter_radius is None else self.filter_radius


class TargetError(Node):
    """The error at which a render may stop."""

    relmse: float = Field(gt=0, description="estimated relative mean squared error of the image")


class Render(Node):
    """When to stop, and what else the path tracer needs to know."""

    spp: int | None = Field(
        None, ge=1, le=MAX_SPP,
        description="samples per pixel; null: 64, or up to 2^20 when seconds or target_error is "
        "given",
    )  # fmt: skip
    seed: int = Field(0, ge=0, le=2**53 - 1, description="seed of all random numbers")
    max_depth: int | None = Field(
        None, ge=0, le=10_000,
        description="scattering events per path (0: emission only, 1: direct light); null: no "
        "limit, Russian roulette ends paths",
    )  # fmt: skip
    seconds: float | None = Field(None, gt=0, description="stop after this wall time, seconds")
    target_error: TargetError | None = Field(None, description="stop at this estimated error")
    replicates: int | None = Field(
        None, ge=1, le=64, description="independently scrambled replicates; null: the default"
    )

    @property
    def spp_cap(self) -> int:
        """Samples per pixel to stop at when nothing else stops the render earlier."""
        if self.spp is not None:
            return self.spp
        return OPEN_ENDED_SPP if self.seconds or self.target_error else DEFAULT_SPP


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
        near = next((n for k in value if (n := _near(k))), None)
        raise fault(kind, words + (f"; did you mean {near!r}?" if near else ""), near)
    return STEPS[named[0]].model_validate(value)


def _near(key: str) -> str | None:
    from matiere.scene.checks import closest

    return closest(key, STEPS)


Step = Annotated[
    ScaleStep | RotateStep | TranslateStep | MatrixStep,
    PlainValidator(
        _step, json_schema_input_type=ScaleStep | RotateStep | TranslateStep | MatrixStep
    ),
]
Transform = Annotated[
    list[Step], Field(default_factory=list, max_length=64, description="steps, in order")
]


class SphereShape(Node):
    """A sphere."""

    type: Literal["sphere"]
    name: Name | None = Field(None, description="for messages and reports")
    center: Vec3 = Field(description="metres")
    radius: float = Field(gt=0, description="metres")
    material: Name = Field(description="a key of `materials`")


class MeshShape(Node):
    """A triangle mesh, from a file (PLY, OBJ, GLB) or inline."""

    type: Literal["mesh"]
    name: Name | None = Field(None, description="for messages and reports")
    file: Name | None = Field(None, description="PLY, OBJ or GLB file under the asset root")
    positions: Points | None = Field(None, description="(N, 3) vertices, metres")
    triangles: Triangles | None = Field(None, description="(M, 3) indices into positions")
    normals: Points | None = Field(None, description="(N, 3) shading normals")
    uv: Points2 | None = Field(None, description="(N, 2) texture coordinates")
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
        inline = ("positions", "triangles", "normals", "uv")
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
            yield ("triangles", row, column), fault(
                "index_out_of_range",
                f"vertex {index} does not exist; positions has {count} (0 to {count - 1})",
            )
        for key in ("normals", "uv"):
            array = getattr(self, key)
            if array is not None and len(array) != count:
                yield (key,), fault(
                    "wrong_length", f"needs one entry per vertex: {count}, got {len(array)}"
                )


SHAPES = {"sphere": SphereShape, "mesh": MeshShape}
Shape = Annotated[
    SphereShape | MeshShape,
    PlainValidator(
        tagged("type", SHAPES, "shape type"),
        json_schema_input_type=Annotated[SphereShape | MeshShape, Field(discriminator="type")],
    ),
]


class RectangleLight(Node):
    """A rectangle that emits on the side edge_u x edge_v points to."""

    type: Literal["rectangle"]
    name: Name | None = Field(None, description="for messages and reports")
    corner: Vec3 = Field(description="metres")
    edge_u: Direction = Field(description="first edge from the corner, metres")
    edge_v: Direction = Field(description="second edge from the corner, metres")
    radiance: Color = Field(description="W/m^2/sr")

    def problems(self) -> Iterable[Line]:
        dot = sum(a * b for a, b in zip(self.edge_u, self.edge_v, strict=True))
        lengths = _norm(self.edge_u) * _norm(self.edge_v)
        if abs(dot) > 1e-6 * lengths:
            yield ("edge_v",), fault("degenerate", "must be perpendicular to edge_u")


class PointLight(Node):
    """A point that radiates alike in all directions."""

    type: Literal["point"]
    name: Name | None = Field(None, description="for messages and reports")
    position: Vec3 = Field(description="metres")
    intensity: Color = Field(description="W/sr")


class DirectionalLight(Node):
    """Light from infinitely far away."""

    type: Literal["directional"]
    name: Name | None = Field(None, description="for messages and reports")
    direction: Direction = Field(description="direction in which the light travels")
    irradiance: Color = Field(description="W/m^2 on a surface that faces the light")


LIGHTS = {"rectangle": RectangleLight, "point": PointLight, "directional": DirectionalLight}
Light = Annotated[
    RectangleLight | PointLight | DirectionalLight,
    PlainValidator(
        tagged("type", LIGHTS, "light type"),
        json_schema_input_type=Annotated[
            RectangleLight | PointLight | DirectionalLight, Field(discriminator="type")
        ],
    ),
]

ColorSpace = Literal["sRGB", "linear", "data"]


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

    def problems(self) -> Iterable[Line]:
        given = [k for k in ("file", "pixels", "radiance") if getattr(self, k) is not None]
        if len(given) != 1:
            kind = "exclusive_keys" if given else "missing_key"
            yield (), fault(kind, "an environment needs one of 'file', 'pixels' and 'radiance'")
        if self.color_space is not None and self.file is None:
            yield ("color_space",), fault("exclusive_keys", "'color_space' belongs to 'file'")


class Texture(Node):
    """An image that a material parameter can refer to by `{"texture": name}`."""

    file: Name | None = Field(None, description="image file under the asset root")
    pixels: Pixels | None = Field(None, description="(H, W, 3) or (H, W) image, linear Rec.709")
    color_space: ColorSpace | None = Field(
        None,
        description="of `file`: sRGB (decoded), linear (Rec.709), data (numbers as they are); "
        "null: sRGB for whole-number pixels, linear for float pixels",
    )
    wrap: Literal["repeat", "clamp"] = Field(
        "repeat", description="what lies beyond uv in [0, 1]"
    )

    def problems(self) -> Iterable[Line]:
        if (self.file is None) == (self.pixels is None):
            kind = "missing_key" if self.file is None else "exclusive_keys"
            yield (), fault(kind, "a texture needs either 'file' or 'pixels'")
        if self.color_space is not None and self.file is None:
            yield ("color_space",), fault("exclusive_keys", "'color_space' belongs to 'file'")


class BitDepth(Node):
    """Bits per channel of the files."""

    png: Literal[8, 16] = Field(8, description="8 or 16 bits, whole numbers")
    exr: Literal[16, 32] = Field(32, description="16 (half) or 32 (float) bits")


class Output(Node):
    """How the image is shown and written. None of this changes the film."""

    config: Name = Field(DEFAULT_CONFIG, description="a config built into OpenColorIO")
    display: Name = Field(DEFAULT_DISPLAY, description="display of the config")
    view: Name = Field(DEFAULT_VIEW, description="view transform of the display")
    exposure: float = Field(0.0, ge=-64, le=64, description="stops: the film times 2^exposure")
    files: list[Name] = Field(
        default_factory=list, max_length=16,
        description="files `matiere render` writes without -o: .png, .jpg or .exr, relative to "
        "the scene",
    )  # fmt: skip
    bit_depth: BitDepth = Field(default_factory=BitDepth, description="bits per channel")

    def problems(self) -> Iterable[Line]:
        for index, name in enumerate(self.files):
            if not name.lower().endswith((".png", ".jpg", ".jpeg", ".exr")):
                yield ("files", index), fault("unknown_choice", "must end in .png, .jpg or .exr")
            elif name.startswith(("/", "\\")) or ".." in name.replace("\\", "/").split("/"):
                why = "must be a relative path that does not leave the scene's folder"
                yield ("files", index), fault("asset_outside_root", why)


def _version(value: Any) -> int:
    if isinstance(value, bool) or value != VERSION:
        raise fault("wrong_version", f"must be {VERSION}, the scene version this matiere reads")
    return VERSION


Version = Annotated[int, PlainValidator(_version), WithJsonSchema({"const": VERSION})]


class SceneModel(Node):
    """A whole scene, checked. `mt.load` makes one; nothing after it needs to check again."""

    version: Version = Field(description="the number 1")
    camera: Camera = Field(description="pinhole or thin_lens")
    film: Film = Field(default_factory=Film, description="image size and filter")
    render: Render = Field(default_factory=Render, description="when to stop; seed, depth")
    materials: dict[Name, Material] = Field(
        default_factory=dict, max_length=100_000, description="materials by name"
    )
    shapes: list[Shape] = Field(
        default_factory=list, max_length=1_000_000, description="spheres and meshes"
    )
    lights: list[Light] = Field(
        default_factory=list, max_length=1_000_000, description="rectangle, point, directional"
    )
    environment: Environment | None = Field(None, description="light from all around; null: none")
    textures: dict[Name, Texture] = Field(
        default_factory=dict, max_length=10_000, description="images by name"
    )
    background: Literal["environment", "transparent"] = Field(
        "environment",
        description="what the camera sees behind the shapes; transparent: alpha 0, and the "
        "environment still gives light",
    )
    output: Output = Field(default_factory=Output, description="view transform and files")


def _norm(v: Float3) -> float:
    return float(sum(x * x for x in v)) ** 0.5


def _parallel(a: list[float], b: Float3) -> bool:
    cross = (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
    length = float(sum(x * x for x in a)) ** 0.5
    return _norm(cross) <= 1e-6 * length * _norm(b)
