"""Make the studio light: a float lat-long environment of soft boxes and a small bright sun.

    python examples/make_studio_light.py studio.exr [--width 512]

Conventions of matiere: y up, the centre column looks along -z, u grows to the right seen from
inside, row 0 is straight up.  Radiance in W/m^2/sr, linear Rec.709.  A soft box is a flat rectangle
somewhere in the room, seen from the origin in true perspective, with a soft edge; its colour is a
black body's.  Texels are averages over 4 x 4 points, so a small light keeps its power at any size.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

SUPERSAMPLES = 4


@dataclass(frozen=True)
class SoftBox:
    """A rectangle at `center` facing the origin; sizes in metres, radiance of its middle."""

    center: Vector
    width: float
    height: float
    kelvin: float
    radiance: float
    edge: float = 0.08  # share of the half size over which it fades


@dataclass(frozen=True)
class Sun:
    """A disc of constant radiance with a narrow soft rim."""

    direction: Vector
    radius_deg: float
    kelvin: float
    radiance: float


BOXES = (
    SoftBox((-3.2, 2.6, 2.4), 3.4, 3.0, 5200.0, 7.0),  # key: front left, above
    SoftBox((3.6, 1.3, 1.4), 1.1, 3.6, 7500.0, 5.5),  # strip: right, cool
    SoftBox((0.3, 4.0, -0.6), 4.0, 2.0, 6000.0, 4.5),  # overhead
    SoftBox((-2.6, 1.7, -3.0), 0.9, 2.4, 3400.0, 5.0),  # rim: behind left, warm
    SoftBox((0.5, 2.2, 4.6), 5.2, 3.4, 4600.0, 1.5),  # fill: large and weak, behind the camera
)
SUN = Sun((0.62, 0.70, 0.36), 3.0, 5600.0, 42.0)
SKY = ((0.0, 0.55), (0.45, 0.36), (0.52, 0.20), (1.0, 0.06))  # (v, radiance), bluish grey
SKY_KELVIN = 8000.0
DATED = {"DateTime": "2000:01:01 00:00:00"}  # the same bytes every time: a digest names the file


def black_body(kelvin: float) -> Array:
    """Return the linear Rec.709 colour of a black body, luminance 1.

    CIE xy by the cubic fit of Kim, Cho and others (2002), valid 1667 to 25000 K.
    """
    t = 1e3 / kelvin
    if kelvin < 4000.0:
        x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    else:
        x = -3.0258469 * t**3 + 2.1070379 * t**2 + 0.2226347 * t + 0.240390
    if kelvin < 2222.0:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif kelvin < 4000.0:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    xyz = np.array([x / y, 1.0, (1.0 - x - y) / y])
    to_rec709 = np.array(
        [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    )
    rgb: Array = np.maximum(to_rec709 @ xyz, 0.0)
    return rgb / float(rgb @ np.array([0.2126, 0.7152, 0.0722]))


def directions(width: int, height: int) -> Array:
    """Return unit directions (height, width, 3) of a lat-long grid's texel centres."""
    phi = ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    theta = (np.arange(height) + 0.5) / height * np.pi
    sin = np.sin(theta)[:, None]
    parts = (sin * np.sin(phi), np.cos(theta)[:, None], -sin * np.cos(phi))
    return np.stack(np.broadcast_arrays(*parts), axis=2)


def smooth(x: Array) -> Array:
    """Smoothstep of x clipped to [0, 1]."""
    t = np.clip(x, 0.0, 1.0)
    result: Array = t * t * (3.0 - 2.0 * t)
    return result


def box_coverage(box: SoftBox, toward: Array) -> Array:
    """Return how much of each direction the box fills: 1 inside, 0 outside, soft between."""
    center = np.asarray(box.center)
    distance = float(np.linalg.norm(center))
    normal = center / distance
    right = np.cross([0.0, 1.0, 0.0], normal)
    right /= np.linalg.norm(right)
    up = np.cross(normal, right)
    facing = toward @ normal
    scale = distance / np.maximum(facing, 1e-6)
    x = np.abs(toward @ right) * scale / (0.5 * box.width)
    y = np.abs(toward @ up) * scale / (0.5 * box.height)
    inside = smooth((1.0 - x) / box.edge) * smooth((1.0 - y) / box.edge)
    return np.where(facing > 1e-3, inside, 0.0)


def sun_coverage(sun: Sun, toward: Array) -> Array:
    """Return 1 inside the disc, 0 outside, with a rim of a fifth of the radius."""
    center = np.asarray(sun.direction) / np.linalg.norm(sun.direction)
    chord = np.linalg.norm(toward - center, axis=-1)
    radius = 2.0 * np.sin(0.5 * np.deg2rad(sun.radius_deg))
    return smooth((radius - chord) / (0.2 * radius))


def studio_light(width: int = 512, height: int = 256) -> npt.NDArray[np.float32]:
    """Return the environment as float32 (height, width, 3), linear Rec.709 radiance.

    Raises:
        ValueError: unless width is twice height and height is at least 16.
    """
    if width != 2 * height or height < 16:
        raise ValueError(f"a lat-long image is 2:1 and at least 32 x 16, got {width} x {height}")
    fine = directions(width * SUPERSAMPLES, height * SUPERSAMPLES)
    v = (np.arange(fine.shape[0]) + 0.5) / fine.shape[0]
    sky = np.interp(v, [p[0] for p in SKY], [p[1] for p in SKY])
    light = np.broadcast_to(sky[:, None, None] * black_body(SKY_KELVIN), fine.shape).copy()
    for box in BOXES:
        cover = box_coverage(box, fine)[..., None]
        light = light * (1.0 - cover) + cover * box.radiance * black_body(box.kelvin)
    light += sun_coverage(SUN, fine)[..., None] * SUN.radiance * black_body(SUN.kelvin)
    blocks = light.reshape(height, SUPERSAMPLES, width, SUPERSAMPLES, 3)
    return np.ascontiguousarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


def write(path: Path, image: npt.NDArray[np.float32]) -> None:
    """Write the environment as float EXR (or RGBE if the name ends in .hdr)."""
    from matiere import imageio

    path.parent.mkdir(parents=True, exist_ok=True)
    imageio.write_stored(path, imageio.Stored(image, ("R", "G", "B"), DATED), "float")


def main() -> None:
    """Write the file and say what is in it."""
    parser = argparse.ArgumentParser(description="Make the studio environment (EXR or HDR).")
    parser.add_argument("output", type=Path)
    parser.add_argument("--width", type=int, default=512)
    options = parser.parse_args()
    image = studio_light(options.width, options.width // 2)
    write(options.output, image)
    print(f"{options.output}  {image.shape[1]} x {image.shape[0]}, brightest {image.max():.0f}")


if __name__ == "__main__":
    main()
