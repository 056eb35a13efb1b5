"""The light layer of a film in words: whether paths from the lights took part, why, what is left.

The core decides (core/scene/light_layer.h); docs/caustics.md explains.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matiere.film import Film
    from matiere.scene.model import SceneModel

LEAST_REPLICATES = 4  # below, nothing tells the error of pixels that share their light paths


def mode(model: SceneModel) -> str:
    """Return what the core is asked for: off, auto or on."""
    from matiere import _core

    asked = model.render.light_tracing
    replicates = model.render.replicates or _core.DEFAULT_REPLICATES
    if asked is False or replicates < LEAST_REPLICATES:
        return "off"
    return "on" if asked is True else "auto"


def hidden(film: Film) -> bool:
    """Tell whether some light cannot be met by any path from the camera."""
    found = film.core.provenance["found"]
    return "point_lights" in found and "delta_lobes" in found


def facts(film: Film) -> dict[str, Any]:
    """Return `on`, what was asked for, why in words, and the paths traced so far."""
    core = film.core
    half = core.light_paths
    replicates = film.replicates // 2 if film.adaptive else film.replicates
    return {
        "on": core.has_light_layer,
        "asked": film.info.light_tracing,
        "why": _why(film),
        "paths": replicates * sum(half),
    }


def _why(film: Film) -> str:
    asked = film.info.light_tracing
    if film.core.has_light_layer:
        if asked is True:
            return "asked for: every lamp sends paths through mirrors and glass"
        return "mirrors, glass or smooth coats throw light of small lamps onto other surfaces"
    if asked is False:
        return "left out on request"
    if film.replicates < LEAST_REPLICATES:
        return f"left out: its error bar needs at least {LEAST_REPLICATES} replicates"
    if "scattering" in film.core.provenance["found"]:
        return "left out: no path from a lamp is followed through media that scatter"
    if film.info.max_depth in (0, 1):
        return "left out: its paths have at least two scattering events, more than max_depth"
    return "not needed, or the camera is one that no path from a lamp can reach"


def missing(film: Film) -> str:
    """Say in a sentence which light the film has no way to find; empty if there is none."""
    if not hidden(film):
        return ""
    lamps = "light of point, spot and directional lamps by way of smooth mirrors or glass"
    if film.core.has_light_layer:
        return (
            f"{lamps} is found on every surface that the camera sees directly; what it sees of "
            "that light in another smooth mirror or through smooth glass is missing"
        )
    return f"{lamps} onto other surfaces is missing: {_why(film)}"
