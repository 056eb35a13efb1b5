"""Denoised pictures, by Open Image Denoise (an extra: `pip install matiere[denoise]`).

A neural filter guesses what the noise hides. Its picture is smooth and often right, but nobody
knows where it is wrong: the certificate speaks of the raw film alone, which is always kept, and
what is written from here says so.
"""

from __future__ import annotations

from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import ImageError
from matiere.imageio import scene_linear

if TYPE_CHECKING:
    from matiere.film import Film

PACKAGE = "pyoidn"


def denoise(film: Film | NDArray[Any]) -> NDArray[np.float32]:
    """Return the scene-linear picture without its noise: float32 (H, W, 3), or (H, W, 4).

    Takes a film or an array of linear radiance; a fourth channel, alpha, is passed on as it is.
    A film with the layer `albedo`, or with `albedo` and `normal`, keeps the edges of textures and
    shapes better (`film.aovs`, docs/aovs.md). The result has no error bar.

    Raises ImageError where the extra is not installed.
    """
    engine = _engine()
    pixels = scene_linear(film)
    color = np.ascontiguousarray(np.maximum(pixels[:, :, :3], 0.0))
    cleaned = np.asarray(engine.denoise(color, *_guides(film), hdr=True), np.float32)
    return np.concatenate([cleaned, pixels[:, :, 3:]], axis=2)


def _guides(film: Film | NDArray[Any]) -> list[NDArray[np.float32]]:
    """Return what tells the filter where edges are: albedo, or albedo and normals; or nothing."""
    if isinstance(film, np.ndarray) or "albedo" not in film.core.aovs:
        return []
    guides = [np.clip(film.aov("albedo"), 0.0, 1.0)]
    if "normal" in film.core.aovs:
        guides.append(np.clip(film.aov("normal"), -1.0, 1.0))
    return [np.ascontiguousarray(guide, np.float32) for guide in guides]


def beside(path: Path) -> Path:
    """Return where the denoised picture of a file goes: out.png -> out.denoised.png."""
    return path.with_name(f"{path.stem}.denoised{path.suffix}")


def notes() -> dict[str, str]:
    """Return the metadata of a denoised picture; ImageError where the extra is not installed."""
    _engine()
    made = f"{PACKAGE} {metadata.version(PACKAGE)}"
    return {
        "matiere:denoised": f"Open Image Denoise ({made})",
        "matiere:certificate": "none: a denoised picture has no error bar, the raw one has",
    }


def _engine() -> Any:
    try:
        return import_module(PACKAGE)
    except ImportError:
        why = "denoising needs an extra that is not installed: pip install 'matiere[denoise]'"
        raise ImageError(why) from None
