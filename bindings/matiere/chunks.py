"""Chunks of a film, for those who render one in pieces: plan, settings, chunk bytes, merge, stop.

    plan = mt.chunks.plan(scene.model)
    film = mt.chunks.new_film(plan)
    for index in range(plan.chunk_count(64)):           # anywhere, in any order, more than once
        parts[index] = mt.chunks.render_chunk(scene, index)
    mt.chunks.merge_prefix(film, parts)                  # in plan order: always the same bits

Plan, fold and stop rule are those of the core, the very ones that `mt.render` loops over. The
chunks of an adaptive scene are decided on the way: ask `film.missing(spp)` until it is empty.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from matiere.errors import FilmError, RenderError

if TYPE_CHECKING:
    from matiere import _core
    from matiere.scene.model import SceneModel
    from matiere.scene.scene import Scene

Stop = Mapping[str, Any]


def size(model: SceneModel) -> tuple[int, int]:
    """Return width and height of the stored pixels: the crop, or the whole film."""
    film = model.film
    if film.crop is None:
        return film.width, film.height
    x0, y0, x1, y1 = film.crop
    return x1 - x0, y1 - y0


def plan(model: SceneModel) -> _core.Plan:
    """Return the chunk plan of a scene: a function of film size, replicates and `adaptive`."""
    from matiere import _core

    width, height = size(model)
    replicates = model.render.replicates or _core.DEFAULT_REPLICATES
    return _core.Plan(width, height, replicates, model.render.adaptive)


def settings(model: SceneModel, strategy: str = "mis") -> _core.Settings:
    """Return what decides the value of a sample, beside the scene."""
    from matiere import _core, light_layer

    render = model.render
    depth = -1 if render.max_depth is None else render.max_depth
    return _core.Settings(
        render.seed,
        depth,
        strategy,
        model.background == "transparent",
        threshold=render.threshold or 0.0,
        aovs=aovs(model),
        light_tracing=light_layer.mode(model),
    )


def aovs(model: SceneModel) -> list[str]:
    """Return the layers that the film of a scene stores beside its light."""
    from matiere.scene.model import MADE_AOVS

    return [name for name in model.film.aovs if name not in MADE_AOVS]


def stop_rule(model: SceneModel) -> dict[str, Any]:
    """Return the scene's stop rule: `spp`, `seconds`, `target_error`, each None if not asked for.

    Without any of the three it is 64 samples per pixel.
    """
    from matiere import target

    render = model.render
    rule: dict[str, Any] = {
        "spp": render.spp,
        "seconds": render.seconds,
        "target_error": target.of_scene(model, render.target_error),
    }
    if not any(rule.values()):
        rule["spp"] = render.spp_cap
    return rule


def new_film(of: _core.Plan) -> _core.Film:
    """Return an empty film for a plan; it takes the layers of the first chunk added."""
    from matiere import _core

    return _core.Film(of.width, of.height, of.replicates, of.adaptive)


def open_film(data: bytes | None, of: _core.Plan) -> _core.Film:
    """Return the film that `Film.to_bytes` wrote, or an empty one. Raises FilmError if damaged."""
    from matiere import _core

    if data is None:
        return new_film(of)
    try:
        film = _core.Film.from_bytes(data)
    except _core.SceneError as error:
        raise FilmError(str(error), code=error.code) from None
    mine, wanted = ((p.width, p.height, p.replicates, p.adaptive) for p in (film.plan, of))
    if mine != wanted:
        raise FilmError("the film has another size, replicate count or `adaptive` than its plan")
    return film


def render_chunk(
    scene: Scene, index: int, cancel: _core.CancelToken | None = None, threads: int = 0
) -> bytes | None:
    """Render one chunk on this thread; None if `cancel` was raised. The GIL is released.

    `threads` is for building the scene, the first time. Any two calls for one index give the same
    sums, on any thread of any process with the same engine.
    """
    from matiere import _core

    built = scene.build(threads)
    part = _core.render_chunk(built, settings(scene.model), plan(scene.model), index, cancel)
    return None if part is None else part.to_bytes()


def add(film: _core.Film, data: bytes) -> None:
    """Fold the bytes of the next chunk of a tile into a film.

    Raises FilmError, and leaves the film as it was, if they are damaged or of another chunk.
    """
    from matiere import _core

    try:
        film.add(_core.ChunkFilm.from_bytes(data))
    except _core.SceneError as error:
        raise FilmError(str(error), code=error.code) from None


def merge_prefix(film: _core.Film, parts: Mapping[int, bytes]) -> int:
    """Fold every chunk into `film` that follows it without a gap; return the film's spp.

    Whole sample ranges only, of an adaptive film as far as they are decided: before and after, the
    film is the one that `mt.render` has between two passes.
    """
    of = film.plan
    while True:
        wanted = film.missing(of.round_up(film.spp + 1))
        if not all(index in parts for index in wanted):
            return film.spp
        for index in wanted:
            add(film, parts[index])


def next_step(
    of: _core.Plan, stop: Stop, spp: int, seconds: float, look: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Ask the stop rule what to do at `spp` samples per pixel after `seconds`.

    `look` is the newest row of the error log; for a display target it must have passed through
    `measured`. The answer holds `go_on`, `next_spp`, `reason` (None
    while it goes on), `look` (an estimate is due at this spp) and `seconds_left`.
    """
    from matiere import _core
    from matiere.target import excess_of

    state: dict[str, Any] = {"spp": spp, "elapsed_s": seconds}
    if spp:
        state["s_per_spp"] = seconds / spp
    if look is not None and stop.get("target_error"):
        excess = excess_of(stop["target_error"], look)
        if excess is not None:
            state |= {"excess": excess, "error_spp": look["spp"]}
    try:
        return _core.next_step(of, dict(stop), state)
    except _core.SceneError as error:
        raise RenderError(str(error), code=error.code, pointer=error.pointer) from None


def measured(film: _core.Film, stop: Stop, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of the log with what a display target needs: `display_excess`."""
    from matiere.target import excess

    target = stop.get("target_error")
    if not target or "display" not in target:
        return dict(row)
    return {**row, "display_excess": excess(target, film)}


def look(film: _core.Film, wall_s: float) -> dict[str, Any]:
    """Estimate the error of a film: one row of the log, as `mt.render` writes them."""
    error = film.estimate()
    counters = film.counters
    relmse = error["relmse"]
    return {
        **error,
        "spp": film.spp,
        "wall_s": wall_s,
        "cpu_s": counters["cpu_s"],
        "efficiency": 1.0 / (relmse * wall_s) if relmse and wall_s > 0 else None,
        "rays": counters["rays"] + counters["shadow_rays"],
        "rejected": counters["rejected_total"],
    }
