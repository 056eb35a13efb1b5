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

    type: Literal["pinhole"] = Field(description="which kind this is")


class ThinLensCamera(_Camera):
    """A camera with depth of field (a lens of `aperture_radius`, focused at `focus_distance`)."""

    type: Literal["thin_lens"] = Field(description="which kind this is")
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
