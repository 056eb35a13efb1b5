"""From scene-linear film to display: exposure and an OpenColorIO view (imported only when used)."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import ColourError
from matiere.imageio import scene_linear
from matiere.scene.checks import choose
from matiere.scene.model import DEFAULT_CONFIG, DEFAULT_DISPLAY, DEFAULT_VIEW

if TYPE_CHECKING:
    from matiere.film import Film

# Names under which configs list the film's own space; the first that the config knows is taken.
_LINEAR_REC709 = ("lin_rec709_srgb", "lin_rec709_scene", "lin_rec709", "Linear Rec.709 (sRGB)",
                  "Utility - Linear - sRGB", "Linear Rec.709", "lin_srgb")  # fmt: skip


@dataclass(frozen=True, slots=True)
class View:
    """A display transform by its full names."""

    config: str = DEFAULT_CONFIG
    display: str = DEFAULT_DISPLAY
    view: str = DEFAULT_VIEW
    exposure: float = 0.0


def develop(
    film: Film | NDArray[Any],
    *,
    config: str | os.PathLike[str] = DEFAULT_CONFIG,
    display: str = DEFAULT_DISPLAY,
    view: str = DEFAULT_VIEW,
    exposure: float = 0.0,
    despeckle: bool = False,
) -> NDArray[np.float32]:
    """Turn linear Rec.709 radiance into display values with an OpenColorIO view.

    `film` is a Film or an array (H, W, 3), or (H, W, 4) with premultiplied alpha. `exposure` is in
    stops: pixels are multiplied by 2^exposure first. `config` names a config built into OpenColorIO
    or a config file. `despeckle` shows a film without the specks that single samples made
    (`film.despeckled`); an array has no replicates to tell them by. Returns float32 of the same
    shape, mostly in [0, 1], alpha not premultiplied.

    Raises ColourError for an unknown config, display or view, with the choices, and ImageError to
    despeckle an array.
    """
    pixels = scene_linear(film, despeckle=despeckle)
    color = pixels[:, :, :3]
    if pixels.shape[2] == 4:
        alpha = pixels[:, :, 3:]
        color = np.divide(color, alpha, out=np.zeros_like(color), where=alpha > 0)
    bright = np.ascontiguousarray(color * np.float32(2.0**exposure))
    bright = np.nan_to_num(bright, nan=0.0, posinf=65504.0, neginf=0.0)
    if bright.size:
        _processor(os.fspath(config), display, view).applyRGB(bright)
    if pixels.shape[2] == 4:
        bright = np.concatenate([bright, np.clip(pixels[:, :, 3:], 0.0, 1.0)], axis=2)
    return np.ascontiguousarray(bright, np.float32)


def check_view(config: str, display: str, view: str, *, builtin_only: bool = False) -> None:
    """Raise ColourError (with the choices, and which name is wrong) for an unknown view.

    `builtin_only` refuses config files: a scene from a stranger names only built-in configs.
    """
    if builtin_only and config not in builtin_configs():
        raise _unknown("config", config, builtin_configs())
    _view_space(_config(config), display, view)


def builtin_configs() -> list[str]:
    """List the configs built into OpenColorIO."""
    import PyOpenColorIO as ocio

    return [str(entry[0]) for entry in ocio.BuiltinConfigRegistry().getBuiltinConfigs()]


def displays(config: str = DEFAULT_CONFIG) -> dict[str, list[str]]:
    """Return display -> its views for a config."""
    loaded = _config(config)
    return {str(d): [str(v) for v in loaded.getViews(d)] for d in loaded.getDisplays()}


def display_space(config: str, display: str, view: str) -> str:
    """Return the Color Interop Forum ID of a view's pixels, "unknown" if the config has none."""
    loaded = _config(config)
    _view_space(loaded, display, view)
    name = loaded.getDisplayViewColorSpaceName(display, view)
    space = loaded.getColorSpace(display if name == "<USE_DISPLAY_NAME>" else name)
    if space is not None and space.getInteropID():
        return str(space.getInteropID())
    return "srgb_rec709_display" if display.startswith("sRGB") else "unknown"


@lru_cache(maxsize=8)
def _config(name: str) -> Any:
    import PyOpenColorIO as ocio

    source = f"ocio://{name}" if name in builtin_configs() else name
    if source == name and not name.startswith("ocio://") and not Path(name).is_file():
        raise _unknown("config", name, builtin_configs())
    try:
        return ocio.Config.CreateFromFile(source)
    except ocio.Exception as error:
        why = str(error).splitlines()[0]
        raise ColourError(f"cannot load the OCIO config {name!r}: {why}") from None


def _view_space(config: Any, display: str, view: str) -> None:
    known = [str(d) for d in config.getDisplays()]
    if display not in known:
        raise _unknown("display", display, known)
    views = [str(v) for v in config.getViews(display)]
    if view not in views:
        raise _unknown("view", view, views, f" of {display!r}")


def _unknown(what: str, name: str, known: list[str], where: str = "") -> ColourError:
    message, _ = choose(f"the {what}", name, known)
    return ColourError(
        message.replace(" is not known", f"{where} is not known"), pointer=f"/{what}"
    )


@lru_cache(maxsize=16)
def _processor(config_name: str, display: str, view: str) -> Any:
    import PyOpenColorIO as ocio

    config = _config(config_name)
    _view_space(config, display, view)
    spaces = (config.getColorSpace(name) for name in _LINEAR_REC709)
    source = next((space.getName() for space in spaces if space is not None), None)
    if source is None:
        raise ColourError(f"the OCIO config {config_name!r} has no linear Rec.709 colour space")
    try:
        forward = ocio.TRANSFORM_DIR_FORWARD
        return config.getProcessor(source, display, view, forward).getDefaultCPUProcessor()
    except ocio.Exception as error:
        why = str(error).splitlines()[0]
        raise ColourError(f"the view {view!r} cannot be used: {why}") from None
