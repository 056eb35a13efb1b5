"""Layers of a film beside its light: what they are called in arrays and in EXR files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import FilmError
from matiere.scene.checks import choose
from matiere.scene.model import AOVS, MADE_AOVS

if TYPE_CHECKING:
    from matiere.film import Film

SINGLE = ("depth", "material_id", "sample_count")  # (H, W)
# Channel names as compositors know them; colours have R, G and B.
_CHANNELS = {
    "normal": ("X", "Y", "Z"),
    "position": ("X", "Y", "Z"),
    "depth": ("Z",),
    "uv": ("U", "V"),
}
_ALONE = ("material_id", "sample_count")  # one channel, called as the layer


def layer(film: Film, name: str) -> NDArray[np.float64]:
    """Return a layer of a film; FilmError where it has no such layer."""
    if name not in AOVS:
        raise FilmError(choose("the layer", name, AOVS)[0])
    if name == "sample_count":
        return film.sample_counts.astype(np.float64)
    if name == "standard_error":
        return film.standard_error
    if name == "caustic":
        return film.core.light_mean()
    held = film.core.aovs
    if name not in held:
        has = ", ".join([*held, *MADE_AOVS])
        why = f"the film has no layer {name!r}: ask for it in the scene's film.aovs (it has {has})"
        raise FilmError(why, pointer="/film/aovs")
    values = film.core.aov(name)
    if name == "position":  # the core works near its own origin
        values = values + np.asarray(film.info.center)
    if name in ("position", "uv"):  # NaN where nothing was met
        values = np.nan_to_num(values, nan=0.0)
    return values[:, :, 0] if name in SINGLE else values


def exr_layers(film: Film) -> tuple[list[NDArray[np.float32]], list[str]]:
    """Return the layers asked for as (H, W, C) arrays, and the names of their channels.

    `standard_error` is not among them: every EXR of a film has it.
    """
    arrays: list[NDArray[np.float32]] = []
    names: list[str] = []
    for name in film.aovs:
        if name == "standard_error":
            continue
        values: NDArray[Any] = film.aov(name)
        if values.ndim == 2:
            values = values[:, :, None]
        arrays.append(values.astype(np.float32))
        suffixes = _CHANNELS.get(name, ("R", "G", "B"))
        names += [name] if name in _ALONE else [f"{name}.{s}" for s in suffixes]
    return arrays, names
