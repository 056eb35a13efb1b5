"""A rendered film: linear pixels, their error, and where they come from."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import FilmError

if TYPE_CHECKING:
    from matiere import _core
    from matiere.despeckle import Despeckled
    from matiere.scene.scene import Scene

Image = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FilmInfo:
    """Where the samples of a film come from and what their render logged. All plain JSON values."""

    film_key: str
    family_key: str  # the film key but for the seed: equal for films that may be merged
    scene_digest: str
    seeds: tuple[int, ...]
    max_depth: int | None = None
    threshold: float | None = None
    adaptive: bool = False
    light_tracing: bool | str = "auto"
    transparent: bool = False
    materials: tuple[str, ...] = ()  # names by index
    log: tuple[Mapping[str, Any], ...] = ()
    reason: str = ""
    requested: Mapping[str, Any] = field(default_factory=dict)
    threads: int = 0
    build_s: float = 0.0
    versions: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[Mapping[str, Any], ...] = ()
    aovs: tuple[str, ...] = ()  # asked for, in the scene's order
    center: tuple[float, ...] = (0.0, 0.0, 0.0)  # the core's origin in the scene, m

    @classmethod
    def of_scene(cls, scene: Scene) -> FilmInfo:
        """Return the info of an empty film of a scene."""
        from matiere.scene.digest import film_key, fingerprint

        render = scene.model.render
        key = film_key(scene)
        return cls(
            film_key=key,
            family_key=key if render.seed == 0 else film_key(scene.with_render(seed=0)),
            scene_digest=scene.digest,
            seeds=(render.seed,),
            max_depth=render.max_depth,
            threshold=render.threshold,
            adaptive=render.adaptive,
            light_tracing=render.light_tracing,
            transparent=scene.model.background == "transparent",
            materials=tuple(scene.model.materials),
            versions=fingerprint(),
            notes=tuple(scene.notes),
            aovs=tuple(scene.model.film.aovs),
            center=scene.center,
        )


class Film:
    """An image of linear Rec.709 radiance (W/m^2/sr) that knows its own error.

    Every pixel is the mean of `replicates` independently scrambled sample sets, from which the
    error is estimated; docs/error.md explains how. A film does not change once it is made:
    `mt.render(scene, film=old)` and `merge` return new ones.
    """

    def __init__(self, core: _core.Film, info: FilmInfo) -> None:
        """Wrap replicate sums. `mt.render` and `mt.load_film` do this for you."""
        self._core, self.info = core, info

    def __repr__(self) -> str:
        error = self.error["relmse"]
        shown = "unknown" if error is None else f"{error:.3g}"
        return f"Film({self.width} x {self.height}, {self.spp} spp, relMSE {shown})"

    @property
    def width(self) -> int:
        """Pixels per row."""
        return self._core.width

    @property
    def height(self) -> int:
        """Rows; row 0 is the upper one."""
        return self._core.height

    @property
    def spp(self) -> int:
        """Samples per pixel; of an adaptive film their mean, see `sample_counts`."""
        return self._core.spp

    @property
    def adaptive(self) -> bool:
        """True if the noise of the samples decided how many a tile got: docs/adaptive.md."""
        return self._core.plan.adaptive

    @property
    def replicates(self) -> int:
        """Independently scrambled sample sets; sample s belongs to set s mod replicates."""
        return self._core.replicates

    @property
    def transparent(self) -> bool:
        """True if the background was rendered transparent, so that alpha means something."""
        return self.info.transparent

    @cached_property
    def _mean(self) -> Image:
        return _frozen(self._core.mean())

    @property
    def mean(self) -> Image:
        """Mean radiance, float64 (H, W, 3); premultiplied by alpha if `transparent`."""
        return self._mean[..., :3]

    @property
    def alpha(self) -> Image:
        """Coverage, float64 (H, W), 0 to 1."""
        return self._mean[..., 3]

    @cached_property
    def standard_error(self) -> Image:
        """Standard error of `mean`, float64 (H, W, 3), in the same unit; NaN where unknown.

        The variance of a pixel is averaged over 5 x 5 pixels: a single pixel has only
        `replicates - 1` degrees of freedom.
        """
        return _frozen(self._core.standard_error())

    @cached_property
    def error(self) -> dict[str, Any]:
        """The estimated error of the image: relmse, its 95 % interval lower..upper, rmse, ...

        Unknown figures are None. `unknown_share` is the share of pixels whose replicates agree
        exactly, so that they tell nothing about their error. See docs/error.md for every key.
        """
        return self._core.estimate()

    def certificate(self) -> dict[str, Any]:
        """Return how wrong the image may be, with what confidence, and what that leaves out.

        Plain JSON values: `statement` in words, intervals of `image` and `tiles`, standard errors
        of `pixels`, the `target` asked for, the bias `ledger`, and in words what lies `outside`
        of every interval. Unknown figures are None.
        """
        return copy.deepcopy(self._certificate)

    @cached_property
    def _certificate(self) -> dict[str, Any]:
        from matiere.certificate import certificate

        return certificate(self)

    def tiles(self, edge: int | None = None) -> list[dict[str, Any]]:
        """Return the error of every tile of `edge` x `edge` pixels (None: the plan's), row by row.

        A row holds the pixels x0 <= x < x1, y0 <= y < y1, the keys of `error`, and `mean` with
        `mean_standard_error`: the tile's mean R, G, B in radiance.
        """
        return self._core.tiles(self._core.plan.tile_edge if edge is None else edge)

    def interval(self, confidence: float = 0.95) -> tuple[Image, Image]:
        """Return lower and upper end for the true `mean` of every pixel and channel.

        Two float64 (H, W, 3); NaN where nothing is known. From `standard_error` and Student's t;
        a statement about each pixel alone, not about all of them at once.
        """
        from matiere.certificate import pixel_interval

        return pixel_interval(self, confidence)

    @property
    def replicate_means(self) -> Image:
        """Mean radiance of every replicate, float64 (R, H, W, 3)."""
        return self._core.replicate_means()[..., :3]

    @cached_property
    def despeckled(self) -> Despeckled:
        """The mean without specks, for pictures, and how much light that holds back."""
        from matiere.despeckle import despeckle

        return despeckle(self.replicate_means)

    @property
    def sample_counts(self) -> NDArray[np.uint32]:
        """Samples of every pixel, (H, W)."""
        return np.array(self._core.counts)

    @property
    def aovs(self) -> tuple[str, ...]:
        """Layers that the scene asked for beside the light: `film.aovs`, docs/aovs.md."""
        return self.info.aovs

    def aov(self, name: str) -> Image:
        """Return a layer, float64 (H, W, C), or (H, W) for depth, material_id and sample_count.

        `caustic`, `standard_error` and `sample_count` are there in every film, the others if the
        scene's `film.aovs` asked for them. Raises FilmError for any other name.
        """
        from matiere.aovs import layer

        return layer(self, name)

    @cached_property
    def report(self) -> dict[str, Any]:
        """Everything worth knowing about the render, as plain JSON values."""
        from matiere.report import film_report

        return film_report(self)

    @property
    def core(self) -> _core.Film:
        """The core's film: replicate sums and counters."""
        return self._core

    def realised_relmse(self, reference: Film) -> float:
        """Return the relMSE of this film measured against an independent reference.

        Weights (S and m) are the reference's; the reference's own estimated error is taken off.
        Raises FilmError if the two share samples or size differs.
        """
        if set(self.info.seeds) & set(reference.info.seeds):
            raise FilmError("film and reference share a seed: their errors are not independent")
        if (self.width, self.height) != (reference.width, reference.height):
            raise FilmError("film and reference differ in size")
        core = reference.core
        gap = (self.mean - reference.mean) ** 2 - core.mean_variance()
        return float(np.mean(core.error_weights() * gap))

    def merge(self, other: Film) -> Film:
        """Return the film of both films' samples.

        Legal for films of one scene, engine, size and replicate count that were rendered with
        different seeds; any spp. Replicate r of the result holds the samples of both replicates r,
        so the replicates stay independent and the error stays known. A merged film can be merged
        again but not continued. Raises FilmError, naming the reason, for anything else.
        """
        shared = set(self.info.seeds) & set(other.info.seeds)
        if self.info.family_key != other.info.family_key:
            raise FilmError(f"cannot merge: {why_different(self.info, other.info)}")
        if shared:
            seeds = ", ".join(map(str, sorted(shared)))
            raise FilmError(
                f"cannot merge: both films hold samples of seed {seeds}, which would count twice; "
                "render one with another seed, or continue one with mt.render(scene, film=...)"
            )
        core = self._core.copy()
        core.merge(other.core)
        counters = core.counters
        from matiere.chunks import look

        row = look(core, counters["wall_s"])
        info = replace(
            self.info, seeds=self.info.seeds + other.info.seeds, log=(row,), reason="merged",
            requested={}, build_s=self.info.build_s + other.info.build_s,
        )  # fmt: skip
        return Film(core, info)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the film to a file that `mt.load_film` reads; it appears whole or not at all."""
        from matiere.film_file import write_film

        write_film(self, path)


def _frozen(image: Image) -> Image:
    """Make an array read-only: every reader of a film gets the same one."""
    image.flags.writeable = False
    return image


def load_film(path: str | os.PathLike[str]) -> Film:
    """Read a film that `Film.save` wrote. Raises FilmError if it is damaged or from the future."""
    from matiere.film_file import read_film

    return read_film(path)


def why_different(a: FilmInfo, b: FilmInfo) -> str:
    """Return in words why two films do not hold samples of the same image."""
    changed = [
        f"{name} {a.versions.get(name)} and {b.versions.get(name)}"
        for name in sorted({*a.versions, *b.versions})
        if a.versions.get(name) != b.versions.get(name)
    ]
    if changed:
        return "the films were made by different engines (" + "; ".join(changed) + ")"
    if a.adaptive != b.adaptive:
        return "one film was sampled adaptively and the other was not"
    if a.max_depth != b.max_depth:
        return f"max_depth is {a.max_depth} in one film and {b.max_depth} in the other"
    if a.threshold != b.threshold:
        return f"threshold is {a.threshold} in one film and {b.threshold} in the other"
    return (
        "the films show different scenes (or the same scene with other film or render settings): "
        f"digests {a.scene_digest[:12]} and {b.scene_digest[:12]}"
    )
