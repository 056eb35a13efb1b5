"""Read textures and environment maps, and bring them to linear Rec.709."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import Fault, ImageError, SceneValidationError, pointed
from matiere.imageio import read_color, read_texture, srgb_to_linear
from matiere.scene.assets import AssetRoot
from matiere.scene.lights import Environment, Texture


@dataclass(frozen=True, slots=True)
class Loaded:
    """An image ready for the core: (H, W, 3) float32, linear; and the colour space it was in."""

    pixels: NDArray[np.float32]
    color_space: str


@dataclass(frozen=True, slots=True)
class Texels:
    """A texture ready for the core: (H, W, 1 or 3), as narrow as in its file."""

    pixels: NDArray[Any]  # uint8, uint16, float16 or float32
    color_space: str
    encoded: bool = False  # 8-bit sRGB, decoded by the core


def load_texture(texture: Texture, assets: AssetRoot) -> Texels:
    """Return a texture's texels; raise SceneValidationError (pointers below the texture)."""
    if texture.pixels is not None:
        pixels = texture.pixels
        if texture.channel is not None:
            index = "rgb".index(texture.channel)
            pixels = np.ascontiguousarray(pixels[:, :, index : index + 1])
        return Texels(pixels, "linear")
    assert texture.file is not None
    name = texture.file
    with pointed("/file"):
        path = assets.unchanged(name)
        try:
            read = read_texture(path, texture.channel)
        except ImageError as error:
            raise SceneValidationError([Fault("", "asset_unreadable", error.message)]) from None
        assets.unchanged(name)
    if not read.integer:
        _check_finite(read.pixels, name)
    usual = "sRGB" if read.integer else "linear"
    space = texture.color_space or ("data" if texture.channel == "a" else usual)
    pixels, own = read.pixels, read.chromaticities
    wide = texture.color_space is None and own is not None and pixels.shape[2] == 3
    convert = wide and own is not None and not same_as_rec709(own)
    if space == "sRGB" and (convert or pixels.dtype != np.uint8):
        pixels = srgb_to_linear(_as_float(pixels))
    elif convert:
        pixels = _as_float(pixels)
    if convert and own is not None:
        pixels = convert_to_rec709(pixels, own)
    return Texels(pixels, space, space == "sRGB" and pixels.dtype == np.uint8)


def _as_float(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Return whole numbers as [0, 1], others as they are."""
    if pixels.dtype.kind == "u":
        return (pixels / np.float32(np.iinfo(pixels.dtype).max)).astype(np.float32)
    return pixels.astype(np.float32)


def load_environment(environment: Environment, assets: AssetRoot) -> tuple[Loaded, int]:
    """Return the pixels of a lat-long map, and how many negative values were set to 0."""
    if environment.pixels is not None:
        loaded = Loaded(environment.pixels, "linear")
    else:
        assert environment.file is not None
        loaded = _read(environment.file, environment.color_space, assets)
    negative = loaded.pixels < 0
    count = int(negative.sum())
    if count:  # resampling rings below zero; light cannot
        loaded = Loaded(np.where(negative, np.float32(0), loaded.pixels), loaded.color_space)
    return loaded, count


def _read(name: str, color_space: str | None, assets: AssetRoot) -> Loaded:
    with pointed("/file"):
        path = assets.unchanged(name)
        try:
            read = read_color(path)
        except ImageError as error:
            raise SceneValidationError([Fault("", "asset_unreadable", error.message)]) from None
        assets.unchanged(name)
    _check_finite(read.pixels, name)
    space = color_space or ("sRGB" if read.integer else "linear")
    pixels = srgb_to_linear(read.pixels) if space == "sRGB" else read.pixels
    if color_space is None and read.chromaticities is not None:
        pixels = convert_to_rec709(pixels, read.chromaticities)
    return Loaded(pixels, space)


def _check_finite(pixels: NDArray[Any], name: str) -> None:
    good = np.isfinite(pixels)
    if not good.all():
        y, x = (int(i) for i in np.argwhere(~good.all(axis=2))[0])
        why = f"the image {name!r} holds NaN or infinity, first at pixel x {x}, y {y}"
        raise SceneValidationError([Fault("/file", "not_finite", why)])


# xy of red, green, blue and white (ITU-R BT.709, D65)
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
# Cone responses of the Bradford adaptation (Lam 1985; matrix as in ICC.1:2022, annex E)
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
_SAME = 2e-3  # matrices closer to one than this differ by rounded chromaticities only


def convert_to_rec709(
    pixels: NDArray[np.float32], chromaticities: tuple[float, ...]
) -> NDArray[np.float32]:
    """Convert linear pixels from a file's own primaries; colours outside Rec.709 are clipped at 0.

    The white point is adapted by Bradford's method. Files that only say Rec.709 in other words
    come back unchanged.
    """
    if same_as_rec709(chromaticities):
        return pixels
    matrix = rec709_from(chromaticities)
    return np.maximum(pixels @ matrix.T, 0.0).astype(np.float32)


def same_as_rec709(chromaticities: tuple[float, ...]) -> bool:
    """Tell whether primaries are those of Rec.709, up to rounding."""
    return bool(np.abs(rec709_from(chromaticities) - np.eye(3)).max() < _SAME)


def rec709_from(chromaticities: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the matrix that takes linear RGB of other primaries to linear Rec.709."""
    source, target = (_cone_white(c) for c in (chromaticities, REC709))
    adapt = np.linalg.inv(_BRADFORD) @ np.diag(target / source) @ _BRADFORD
    to_709 = np.linalg.inv(_to_xyz(REC709))
    return np.asarray(to_709 @ adapt @ _to_xyz(chromaticities), np.float64)


def _to_xyz(chromaticities: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the matrix to XYZ in which white has Y = 1 (SMPTE RP 177)."""
    columns = np.stack([_xyz(*chromaticities[i : i + 2]) for i in (0, 2, 4)], axis=1)
    white = _xyz(*chromaticities[6:])
    return np.asarray(columns * np.linalg.solve(columns, white), np.float64)


def _cone_white(chromaticities: tuple[float, ...]) -> NDArray[np.float64]:
    return np.asarray(_BRADFORD @ _xyz(*chromaticities[6:]), np.float64)


def _xyz(x: float, y: float) -> NDArray[np.float64]:
    return np.array([x / y, 1.0, (1.0 - x - y) / y])
