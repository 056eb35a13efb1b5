"""Scene JSON v1 as frozen models: the vocabulary of docs/scene.md.

y is up, lengths are metres, angles degrees (`_deg`), colours linear Rec.709; a colour is one number
or [r, g, b]. Every node refuses unknown keys, and nothing here reads a file.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, PlainValidator, WithJsonSchema

from matiere.scene.camera import Camera
from matiere.scene.checks import Line, Name, Node, fault, numbers, shown
from matiere.scene.lights import Background, Environment, Light, Texture
from matiere.scene.materials import Material
from matiere.scene.shapes import Shape

VERSION = 1
MAX_PIXELS = 2**28
MAX_EDGE = 65536
MAX_SPP = 2**24
OPEN_ENDED_SPP = 2**20  # the cap when only `seconds` or `target_error` is given
DEFAULT_SPP = 64
DEFAULT_CONFIG = "studio-config-v4.0.0_aces-v2.0_ocio-v2.5"
DEFAULT_DISPLAY = "sRGB - Display"
DEFAULT_VIEW = "ACES 2.0 - SDR 100 nits (Rec.709)"


def _crop(value: Any) -> tuple[int, ...]:
    result = numbers(value, 4, "[x0, y0, x1, y1]")
    if any(x != int(x) for x in result):
        raise fault("wrong_type", "a crop is given in whole pixels: [x0, y0, x1, y1]")
    return tuple(int(x) for x in result)


Crop = Annotated[
    tuple[int, int, int, int],
    PlainValidator(_crop),
    WithJsonSchema({"type": "array", "items": {"type": "integer"}, "minItems": 4, "maxItems": 4}),
]


def _light_tracing(value: Any) -> bool | Literal["auto"]:
    if value is True or value is False:
        return value
    if value == "auto" and isinstance(value, str):
        return "auto"
    raise fault("wrong_type", f'"auto", true or false, not {shown(value)}')


LightTracing = Annotated[
    bool | Literal["auto"],
    PlainValidator(_light_tracing),
    WithJsonSchema({"enum": ["auto", True, False]}),
]

Aov = Literal[
    "albedo", "normal", "depth", "position", "uv", "material_id", "emission", "direct", "indirect",
    "diffuse", "specular", "transmission", "caustic", "standard_error", "sample_count",
]  # fmt: skip
AOVS: tuple[str, ...] = get_args(Aov)
MADE_AOVS = ("caustic", "standard_error", "sample_count")  # made of the film itself, always at hand


class Film(Node):
    """Size of the image, the filter that makes pixels of samples, and layers beside the light."""

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

    aovs: list[Aov] = Field(
        default_factory=list,
        description="layers beside the light, for EXR and `film.aov(name)`: " + ", ".join(AOVS),
    )

    def problems(self) -> Iterable[Line]:
        for index, name in enumerate(self.aovs):
            if name in self.aovs[:index]:
                yield ("aovs", index), fault("exclusive_keys", f"{name!r} is there already")
        if self.width * self.height > MAX_PIXELS or max(self.width, self.height) > MAX_EDGE:
            yield (
                (),
                fault(
                    "film_too_large",
                    f"a film of {shown(self.width)} x {shown(self.height)} pixels is too large; "
                    f"at most {MAX_PIXELS} pixels (16384 x 16384) and {MAX_EDGE} on an edge fit",
                ),
            )
        elif self.crop is not None:
            x0, y0, x1, y1 = self.crop
            if not (0 <= x0 < x1 <= self.width and 0 <= y0 < y1 <= self.height):
                yield (
                    ("crop",),
                    fault(
                        "out_of_range",
                        f"0 <= x0 < x1 <= {self.width} and 0 <= y0 < y1 <= {self.height} must hold",
                    ),
                )

    @property
    def radius(self) -> float:
        """The filter radius in pixels, the filter's usual one when none is given."""
        usual = {"box": 0.5, "tent": 1.0, "gaussian": 1.5, "blackman_harris": 1.5}
        return usual[self.filter] if self.filter_radius is None else self.filter_radius


class DisplayTarget(Node):
    """How far the delivered 8-bit image may be off, through the view of `output`."""

    code_values: int = Field(1, ge=1, le=254, description="8-bit steps that a pixel may be off")
    pixels_percent: float = Field(
        95.0, gt=0, lt=100, description="share of the pixels that keep to it, percent"
    )


class TargetError(Node):
    """The error at which a render may stop: one of the three."""

    relmse: float | None = Field(
        None, gt=0, description="estimated relative mean squared error of the image"
    )
    rmse_percent: float | None = Field(
        None, gt=0, description="estimated root of the mean squared error, percent of the mean"
    )
    display: DisplayTarget | None = Field(
        None, description="code values of the delivered image, through its view"
    )

    def problems(self) -> Iterable[Line]:
        kinds = ("relmse", "rmse_percent", "display")
        given = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(given) != 1:
            what = "nothing" if not given else " and ".join(given)
            code = "exclusive_keys" if given else "missing_key"
            yield (), fault(code, f"give one of {', '.join(kinds)}, not {what}")


HALVES = (
    "adaptive sampling compares two halves of at least two replicates each: use an even number of "
    "replicates, 4 or more"
)


def halves_well(replicates: int | None) -> bool:
    """Tell whether so many replicates (None: the default) will do for adaptive sampling."""
    return replicates is None or (replicates >= 4 and replicates % 2 == 0)


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
    threshold: float | None = Field(
        None, gt=0, le=1,
        description="paths end where their throughput falls below this, which loses light (the "
        "report says how much); null: never",
    )  # fmt: skip
    seconds: float | None = Field(None, gt=0, description="stop after this wall time, seconds")
    target_error: TargetError | None = Field(None, description="stop at this estimated error")
    replicates: int | None = Field(
        None, ge=1, le=64, description="independently scrambled replicates; null: the default"
    )
    adaptive: bool = Field(
        False,
        description="more samples for the tiles where they lower the error most; spp is then the "
        "mean over the image (needs an even number of at least 4 replicates)",
    )

    light_tracing: LightTracing = Field(
        "auto",
        description="paths from the lights for light that paths from the camera find badly or not "
        "at all: caustics of small lamps; auto: where the scene has them; true: of every lamp",
    )

    def problems(self) -> Iterable[Line]:
        if self.adaptive and not halves_well(self.replicates):
            yield ("replicates",), fault("out_of_range", HALVES)
        if self.light_tracing is True and (self.replicates or 4) < 4:
            why = "the error bar of light tracing needs at least 4 replicates"
            yield ("replicates",), fault("out_of_range", why)

    @property
    def spp_cap(self) -> int:
        """Samples per pixel to stop at when nothing else stops the render earlier."""
        if self.spp is not None:
            return self.spp
        return OPEN_ENDED_SPP if self.seconds or self.target_error else DEFAULT_SPP


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
    despeckle: bool = Field(
        False,
        description="leave light that single samples vouch for out of PNG and JPEG (EXR keeps it); "
        "the report says how much",
    )
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
    camera: Camera = Field(description="where the picture is taken from")
    film: Film = Field(default_factory=Film, description="image size and filter")
    render: Render = Field(default_factory=Render, description="when to stop; seed, depth")
    materials: dict[Name, Material] = Field(
        default_factory=dict, max_length=100_000, description="materials by name"
    )
    shapes: list[Shape] = Field(
        default_factory=list, max_length=1_000_000, description="spheres and meshes"
    )
    lights: list[Light] = Field(
        default_factory=list,
        max_length=1_000_000,
        description="rectangle, point, spot, directional",
    )
    environment: Environment | None = Field(None, description="light from all around; null: none")
    textures: dict[Name, Texture] = Field(
        default_factory=dict, max_length=10_000, description="images by name"
    )
    background: Background = Field(
        "environment",
        description="what the camera sees behind the shapes: the environment, nothing "
        "(transparent: alpha 0), or a map or radiance of its own; the environment gives the light",
    )
    output: Output = Field(default_factory=Output, description="view transform and files")
