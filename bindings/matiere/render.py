"""Render a scene: the one pass loop of the core, and what surrounds it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Any

from matiere import chunks, target
from matiere.errors import Cancelled, FilmError, MemoryLimitError, RenderError
from matiere.film import Film, FilmInfo, why_different
from matiere.scene.model import HALVES, halves_well

if TYPE_CHECKING:
    from matiere import _core
    from matiere.scene.scene import Scene

Callback = Callable[[dict[str, Any]], bool | None]
TargetError = float | Mapping[str, Any]

log = logging.getLogger("matiere")


def render(
    scene: Scene,
    *,
    spp: int | None = None,
    seconds: float | None = None,
    target_error: TargetError | None = None,
    seed: int | None = None,
    max_depth: int | EllipsisType | None = ...,
    threads: int = 0,
    film: Film | None = None,
    callback: Callback | None = None,
    memory_limit: int | None = None,
    replicates: int | None = None,
    adaptive: bool | None = None,
    cancel: _core.CancelToken | None = None,
) -> Film:
    """Render a scene to a film, or continue `film` to the bits of one long render.

    Stops at whichever comes first of `spp` (rounded up to a boundary of the chunk plan), `seconds`
    of wall time spent rendering (an overshoot above 10 % happens only if the very first pass is
    longer) and `target_error` (x or {"relmse": x}, {"rmse_percent": x}, or {"display":
    {"code_values": 1, "pixels_percent": 95}} through the scene's view; docs/error.md). If one of
    the three is given here the scene's own stop rule is ignored; with `seconds` or `target_error`
    alone, spp is capped at 2^20. `report["reason"]` names what ended the render.

    `seed`, `max_depth` (None = no limit), `replicates` and `adaptive` default to the film's, else
    the scene's. With `adaptive` tiles get samples by their noise; spp is their mean.
    `threads` = 0 takes every usable core; the pixels do not depend on it. `callback(progress)` is
    called once per pass with `spp`, `spp_limit`, `elapsed_s`, `seconds_left`, `error_spp`, `error`;
    if it returns False the render ends, if it raises, the exception passes through. `memory_limit`
    is in bytes (default: half of the memory that is free).

    Raises RenderError (a bad argument), MemoryLimitError (before any work), FilmError (`film` is
    not of this scene), SceneValidationError (the scene cannot be built), Cancelled (`cancel` was
    raised) and KeyboardInterrupt. `film` itself is never changed.
    """
    from matiere import _core

    asked = _with_settings(scene, film, seed, max_depth, replicates, adaptive)
    stop = _stop_rule(asked, spp, seconds, target_error)
    info = FilmInfo.of_scene(asked)
    if film is not None:
        _check_continues(info, film)
    _check_memory(asked, film, memory_limit)
    start = time.monotonic()
    built = scene.build(threads)
    build_s = time.monotonic() - start
    core = chunks.new_film(chunks.plan(asked.model)) if film is None else film.core.copy()
    settings = chunks.settings(asked.model)
    if _core.has_light_layer(built, settings):
        _check_memory(asked, film, memory_limit, light_layer=True)
    try:
        outcome = _core.render(
            built, settings, core, stop, threads, callback, cancel, _measure(stop, core)
        )
    except _core.SceneError as error:
        raise RenderError(str(error), code=error.code, pointer=error.pointer) from None
    if outcome["reason"] == "cancelled":
        raise Cancelled(f"the render was cancelled at {core.spp} samples per pixel")
    earlier = film.info if film is not None else info
    info = replace(
        info,
        log=(*earlier.log, *outcome["log"]),
        reason=outcome["reason"],
        requested=stop,
        threads=outcome["threads"],
        build_s=earlier.build_s + build_s,
        notes=tuple(scene.notes),
        center=scene.center,
    )
    return Film(core, info)


def film_bytes(scene: Scene, light_layer: bool = False) -> dict[str, int]:
    """Return `bytes_per_pixel` and `bytes` of the film of a scene."""
    from matiere import _core

    of = chunks.plan(scene.model)
    names = chunks.aovs(scene.model)
    each = _core.Film.bytes_per_pixel(of.replicates, of.adaptive, names, light_layer)
    return {"bytes_per_pixel": each, "bytes": each * of.width * of.height}


def _with_settings(
    scene: Scene,
    film: Film | None,
    seed: int | None,
    max_depth: int | EllipsisType | None,
    replicates: int | None,
    adaptive: bool | None,
) -> Scene:
    if film is not None:
        if seed is None:
            seed = film.info.seeds[0]
        if max_depth is ...:
            max_depth = film.info.max_depth
        if replicates is None:
            replicates = film.replicates
        if adaptive is None:
            adaptive = film.adaptive
    changes: dict[str, Any] = {}
    if seed is not None:
        changes["seed"] = _integer("seed", seed, 0, 2**53 - 1)
    if replicates is not None:
        changes["replicates"] = _integer("replicates", replicates, 1, 64)
    if max_depth is not ...:
        changes["max_depth"] = (
            None if max_depth is None else _integer("max_depth", max_depth, 0, 10_000)
        )
    if adaptive is not None:
        changes["adaptive"] = bool(adaptive)
    asked = {**dict(scene.model.render), **changes}
    if asked["adaptive"] and not halves_well(asked["replicates"]):
        raise RenderError(HALVES, code="out_of_range", pointer="/render/replicates")
    same = all(getattr(scene.model.render, key) == value for key, value in changes.items())
    return scene if same else scene.with_render(**changes)


def _integer(name: str, value: Any, low: int, high: int) -> int:
    import operator

    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    if isinstance(value, bool) or not low <= number <= high:
        why = f"{name} must be a whole number from {low} to {high}, not {value!r}"
        raise RenderError(why, code="out_of_range", pointer=f"/render/{name}")
    return number


def _positive(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not 0.0 < number < float("inf"):
        why = f"{name.replace('/', '.')} must be a positive number, not {value!r}"
        raise RenderError(why, code="out_of_range", pointer=f"/render/{name}")
    return number


def _stop_rule(
    scene: Scene, spp: int | None, seconds: float | None, target_error: TargetError | None
) -> dict[str, Any]:
    from matiere import _core

    if spp is None and seconds is None and target_error is None:
        return chunks.stop_rule(scene.model)
    rule: dict[str, Any] = {"spp": None, "seconds": None, "target_error": None}
    if spp is not None:
        rule["spp"] = _integer("spp", spp, 1, _core.MAX_SPP)
    if seconds is not None:
        rule["seconds"] = _positive("seconds", seconds)
    rule["target_error"] = target.of_scene(scene.model, target_error)
    return rule


def _measure(stop: Mapping[str, Any], core: _core.Film) -> Callable[[], float | None] | None:
    """Return what the pass loop asks at every look, if Python measures the target."""
    asked = stop["target_error"]
    if not asked or "display" not in asked:
        return None
    return lambda: target.excess(asked, core)


def _check_continues(wanted: FilmInfo, film: Film) -> None:
    if film.core.merged:
        seeds = ", ".join(map(str, film.info.seeds))
        raise FilmError(
            f"this film was merged from seeds {seeds} and cannot be continued; render a film with "
            "another seed and merge that"
        )
    if film.info.film_key == wanted.film_key:
        return
    if film.info.family_key == wanted.family_key:
        raise FilmError(
            f"the film was rendered with seed {film.info.seeds[0]}, not {wanted.seeds[0]}; render "
            "without film=... and merge the two"
        )
    raise FilmError(
        f"the film cannot be continued with this scene: {why_different(film.info, wanted)}"
    )


def _check_memory(
    scene: Scene, film: Film | None, limit: int | None, light_layer: bool = False
) -> None:
    """Say what the film needs, and refuse before any work if it is too much."""
    need = film_bytes(scene, light_layer)
    width, height = chunks.size(scene.model)
    of = chunks.plan(scene.model)
    total = need["bytes"] * (1 if film is None else 2)  # the old film is kept
    log.info(
        "film %d x %d with %d replicates: %d bytes per pixel, %.1f MiB",
        width, height, of.replicates, need["bytes_per_pixel"], total / 2**20,
    )  # fmt: skip
    if limit is None:
        limit = _free_memory() // 2
    if total > limit:
        raise MemoryLimitError(
            f"the film of {width} x {height} pixels with {of.replicates} replicates needs "
            f"{total / 2**20:.1f} MiB ({need['bytes_per_pixel']} bytes per pixel), the limit is "
            f"{limit / 2**20:.1f} MiB; use a smaller film, a crop, fewer replicates or a higher "
            "memory_limit",
            pointer="/film",
        )


def _free_memory() -> int:
    """Bytes that can be had without swapping."""
    for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
        if line.startswith("MemAvailable:"):
            return int(line.split()[1]) * 1024
    return 2**40
