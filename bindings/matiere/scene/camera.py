"""Cameras of scene JSON v1."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, PlainValidator

from matiere.scene.checks import Direction, Float3, Line, Node, Vec3, fault, tagged


class _Camera(Node):
    origin: Vec3 = Field(description="position of the camera, metres")
    target: Vec3 = Field(description="point the camera looks at, metres")
    up: Direction = Field((0.0, 1.0, 0.0), description="direction that is up in the image")

    def problems(self) -> Iterable[Line]:
        forward = [b - a for a, b in zip(self.origin, self.target, strict=True)]
        if not any(forward):
            yield ("target",), fault("degenerate", "must differ from the camera's origin")
        elif _parallel(forward, self.up):
            yield ("up",), fault("degenerate", "must not be parallel to the viewing direction")

    @property
    def placement(self) -> tuple[Float3, Float3, Float3]:
        """Origin, target and up."""
        return self.origin, self.target, self.up

    def settings(self) -> dict[str, float | int]:
        """What else the core takes of this type, by name."""
        return self.model_dump(exclude={"type", "origin", "target", "up"})


class _Perspective(_Camera):
    vfov_deg: float = Field(
        40.0, gt=0, lt=180, description="vertical field of view of the whole film, degrees"
    )


class PinholeCamera(_Perspective):
    """A camera with everything in focus."""

    type: Literal["pinhole"] = Field(description="which kind this is")


class ThinLensCamera(_Perspective):
    """A camera with depth of field (a lens of `aperture_radius`, focused at `focus_distance`)."""

    type: Literal["thin_lens"] = Field(description="which kind this is")
    aperture_radius: float = Field(ge=0, description="radius of the lens, metres; 0 is a pinhole")
    focus_distance: float = Field(
        gt=0, description="distance of the plane in focus along the viewing direction, metres"
    )
    blades: int = Field(
        0, ge=0, le=64, description="corners of the aperture, on the circle; 0: a round one"
    )
    blade_rotation_deg: float = Field(
        0.0, description="turn of the aperture's first corner from the right, counter-clockwise"
    )
    aperture_ratio: float = Field(
        1.0, gt=0, le=100,
        description="width of the aperture over its height, the width being stretched; 0.5 is that "
        "of a 2x anamorphic lens",
    )  # fmt: skip

    def problems(self) -> Iterable[Line]:
        yield from super().problems()
        if self.blades in (1, 2):
            yield ("blades",), fault("out_of_range", "must be 0 (round) or from 3 to 64")


class OrthographicCamera(_Camera):
    """Parallel rays: no perspective. What lies behind `origin` is not seen."""

    type: Literal["orthographic"] = Field(description="which kind this is")
    height: float = Field(2.0, gt=0, description="height of the whole film in the scene, metres")


class PanoramaCamera(_Camera):
    """All directions around `origin` by longitude and latitude; the target is in the middle."""

    type: Literal["panorama"] = Field(description="which kind this is")


class MaterialProbeCamera(Node):
    """All directions above one point of a surface: a picture of its reflected light over them.

    The film shows the hemisphere around `normal` as an equal-area disk (Lambert 1772): a pixel at
    radius r from the middle (1 at the rim) looks at `target` from cos theta = 1 - r^2. With one
    directional light of irradiance 1 / cos theta_i on a flat sample, pixels show the BRDF.
    """

    type: Literal["material_probe"] = Field(description="which kind this is")
    target: Vec3 = Field((0.0, 0.0, 0.0), description="point on the sample, metres")
    normal: Direction = Field((0.0, 1.0, 0.0), description="middle of the hemisphere")
    up: Direction = Field((0.0, 0.0, -1.0), description="direction that is up in the image")
    distance: float = Field(1.0, gt=0, description="from which the point is looked at, metres")

    def problems(self) -> Iterable[Line]:
        if _parallel(list(self.normal), self.up):
            yield ("up",), fault("degenerate", "must not be parallel to the normal")

    @property
    def placement(self) -> tuple[Float3, Float3, Float3]:
        """Origin, target and up."""
        length = norm(self.normal)
        x, y, z = (
            t + self.distance * n / length for t, n in zip(self.target, self.normal, strict=True)
        )
        return (x, y, z), self.target, self.up

    def settings(self) -> dict[str, float | int]:
        """What else the core takes of this type, by name."""
        return {}


CAMERAS = {
    "pinhole": PinholeCamera,
    "thin_lens": ThinLensCamera,
    "orthographic": OrthographicCamera,
    "panorama": PanoramaCamera,
    "material_probe": MaterialProbeCamera,
}
AnyCamera = (
    PinholeCamera | ThinLensCamera | OrthographicCamera | PanoramaCamera | MaterialProbeCamera
)
Camera = Annotated[
    AnyCamera,
    PlainValidator(
        tagged("type", CAMERAS, "camera type"),
        json_schema_input_type=Annotated[AnyCamera, Field(discriminator="type")],
    ),
]


def norm(v: Float3) -> float:
    """Return the length of a vector."""
    return math.sqrt(sum(x * x for x in v))


def _parallel(a: list[float], b: Float3) -> bool:
    cross = (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
    length = math.sqrt(sum(x * x for x in a))
    return norm(cross) <= 1e-6 * length * norm(b)
