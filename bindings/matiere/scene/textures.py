"""Read textures and environment maps, and bring them to linear Rec.709."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matiere.errors import Fault, ImageError, SceneValidationError, pointed
from matiere.imageio import read_color, srgb_to_linear
from matiere.scene.assets import AssetRoot
from matiere.scene.lights import Environment, Texture


@dataclass(frozen=True, slots=True)
class Loaded:
    """An image ready for the core: (H, W, 3) float32, linear; and the colour space it was in."""

    pixels: NDArray[np.float32]
    color_space: str


def load_texture(texture: Texture, assets: AssetRoot) -> Loaded:
    """Return a texture's pixels; raise SceneValidationError (pointers below the texture)."""
    if texture.pixels is not None:
        return Loaded(texture.pixels, "linear")
    assert texture.file is not None
    return _read(texture.file, texture.color_space, assets)


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
            pixels, integer = read_color(path)
        except ImageError as error:
            raise SceneValidationError([Fault("", "asset_unreadable", error.message)]) from None
        assets.unchanged(name)
    if not np.isfinite(pixels).all():
        y, x = (int(i) for i in np.argwhere(~np.isfinite(pixels).all(axis=2))[0])
        why = f"the image {name!r} holds NaN or infinity, first at pixel x {x}, y {y}"
        raise SceneValidationError([Fault("/file", "not_finite", why)])
    space = color_space or ("sRGB" if integer else "linear")
    return Loaded(srgb_to_linear(pixels) if space == "sRGB" else pixels, space)
