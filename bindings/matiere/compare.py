"""Two films of the same size: how they differ, and what of that is more than noise.

Films rendered with one seed share their random numbers, so most of their noise is the same and
leaves the difference ("common random numbers"; Kahn & Marshall 1953): a change of a material by one
percent shows long before either image is converged. Everything is judged by the replicates of the
difference, d_r = b_r - a_r, which are independent whatever the films share. docs/error.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import FilmError
from matiere.film import Film, why_different

if TYPE_CHECKING:
    from pathlib import Path

Image = NDArray[np.float64]
VERSION = 1
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # linear Rec.709
SIGNIFICANCE = 0.05  # of the image, and of all tiles together
MAX_TILES = 256
RADIUS = 2  # pixels a standard error is averaged over, as in a film


@dataclass(frozen=True, slots=True)
class Comparison:
    """What `compare` found; `b - a` throughout.

    `difference` is float64 (H, W, 3) in W/m^2/sr; `standard_error` is its own, of the same shape,
    averaged over 5 x 5 pixels and NaN where the replicates tell nothing; `report` holds the
    figures of image and tiles as plain JSON values.
    """

    difference: Image
    standard_error: Image
    report: dict[str, Any]

    def picture(self) -> NDArray[np.float32]:
        """Draw the signed difference of luminance with a colour bar and the tiles that differ."""
        from matiere.compare_picture import draw

        return draw(self)

    def save(self, folder: str | Path) -> list[Path]:
        """Write difference.png, difference.exr (with standard_error.R/G/B) and report.json."""
        from matiere.compare_picture import save

        return save(self, folder)


def compare(a: Film, b: Film) -> Comparison:
    """Compare two films of the same size and replicates; render both with one seed and spp.

    The report says by how much the image's mean differs (`mean`: luminance, relative to film a,
    with 95 % interval and p-value), which tiles differ (Holm's correction: 5 % for all tiles
    together) and `variance_ratio`: how many times the variance of the difference would be larger
    with unrelated seeds. Unknown figures are None.

    Raises FilmError, naming the reason, for films that do not match.
    """
    _check(a, b)
    d = b.replicate_means - a.replicate_means
    difference, variance = _moments(d)
    light, light_variance = _moments((d @ LUMINANCE)[..., None])
    # Pixels that share light paths are not independent: then only replicates tell the error.
    shared = d @ LUMINANCE if a.core.has_light_layer or b.core.has_light_layer else None
    alone = a.core.mean_variance() + b.core.mean_variance()
    total = float(variance.sum())
    tiles = _tiles(a, light[..., 0], light_variance[..., 0], shared)
    paired = a.info.seeds == b.info.seeds
    report = {
        "compare_version": VERSION,
        "a": _facts(a),
        "b": _facts(b),
        "paired": paired,
        "identical": bool(not d.any()),
        "variance_ratio": float(alone.sum()) / total if total > 0.0 else None,
        "mean": _mean(a, light[..., 0], light_variance[..., 0], shared),
        "significance": SIGNIFICANCE,
        "tiles": tiles,
        "tiles_significant": sum(bool(tile["significant"]) for tile in tiles),
        "tiles_unknown": sum(tile["p_value"] is None for tile in tiles),
        "notes": _notes(a, b),
    }
    report["statement"] = statement(report)
    return Comparison(difference, _pooled(variance), report)


def _check(a: Film, b: Film) -> None:
    for film, name in ((a, "a"), (b, "b")):
        if film.replicates < 2 or film.spp == 0:
            raise FilmError(
                f"film {name} has {film.replicates} replicates and {film.spp} samples per pixel: "
                "at least two replicates with samples are needed to tell a difference from noise"
            )
    if (a.width, a.height) != (b.width, b.height):
        raise FilmError(
            f"films of different size cannot be compared: {a.width} x {a.height} and "
            f"{b.width} x {b.height} pixels"
        )
    if a.replicates != b.replicates:
        raise FilmError(
            f"the films have {a.replicates} and {b.replicates} replicates; render both with the "
            "same number"
        )
    if a.transparent != b.transparent:
        raise FilmError("one film has a transparent background and the other has not")


def _notes(a: Film, b: Film) -> list[str]:
    found = []
    if a.info.seeds != b.info.seeds:
        found.append(
            "the films have different seeds, so nothing of their noise cancels: render both with "
            "one seed to see smaller differences"
        )
    if not np.array_equal(a.sample_counts, b.sample_counts):
        found.append("the films differ in samples per pixel; only the samples they share cancel")
    limits = [(i.versions, i.max_depth, i.threshold) for i in (a.info, b.info)]
    if limits[0] != limits[1]:
        found.append(why_different(a.info, b.info))
    return found


def _facts(film: Film) -> dict[str, Any]:
    return {
        "scene_digest": film.info.scene_digest,
        "seeds": list(film.info.seeds),
        "spp": film.spp,
        "mean_luminance": float((film.mean @ LUMINANCE).mean()),
    }


def _moments(replicates: Image) -> tuple[Image, Image]:
    """Mean over replicates and its variance."""
    count = len(replicates)
    return replicates.mean(0), replicates.var(0, ddof=1) / count


def _pooled(variance: Image) -> Image:
    """Root of the variance averaged over 5 x 5 pixels; NaN where it is zero."""
    total, count = np.zeros_like(variance), np.zeros(variance.shape[:2])
    height, width = variance.shape[:2]
    for dy in range(-RADIUS, RADIUS + 1):
        for dx in range(-RADIUS, RADIUS + 1):
            to = (slice(max(0, -dy), max(0, min(height, height - dy))),
                  slice(max(0, -dx), max(0, min(width, width - dx))))  # fmt: skip
            at = (slice(max(0, dy), max(0, min(height, height + dy))),
                  slice(max(0, dx), max(0, min(width, width + dx))))  # fmt: skip
            total[to] += variance[at]
            count[to] += 1
    error = np.sqrt(total / count[..., None])
    return np.where(error > 0.0, error, np.nan)


def _freedom(variance: Image, replicates: int) -> float:
    """Degrees of freedom of a sum of pixel variances: few where a few pixels carry it.

    (sum V)^2 / sum V^2 counts pixels, too few by (R + 1) / (R - 1) because V is noisy itself; each
    has R - 1 degrees of freedom.
    """
    squares = float((variance**2).sum())
    return (replicates + 1) * float(variance.sum()) ** 2 / squares if squares > 0.0 else 0.0


def _judge(
    light: Image, variance: Image, replicates: int, shared: Image | None = None
) -> dict[str, Any]:
    """Mean of a region, its standard error, 95 % interval and two-sided p-value.

    `shared`: the region of every replicate, where its pixels hang together.
    """
    from matiere import _core

    mean, error = float(light.mean()), float(np.sqrt(variance.sum())) / light.size
    if shared is not None:
        error = float(np.sqrt(shared.mean((1, 2)).var(ddof=1) / replicates))
    if error == 0.0:
        known = None if mean else 1.0  # exactly equal, or differing by one amount everywhere
        return {"difference": mean, "standard_error": None, "lower": None, "upper": None,
                "p_value": known}  # fmt: skip
    dof = float(replicates - 1)
    if shared is None:
        dof = max(_freedom(variance, replicates), dof)
    t = float(_core.student_quantile(0.025, dof))
    p = 2.0 * float(_core.student_tail(abs(mean) / error, dof))
    return {"difference": mean, "standard_error": error, "lower": mean - t * error,
            "upper": mean + t * error, "p_value": p}  # fmt: skip


def _mean(a: Film, light: Image, variance: Image, shared: Image | None) -> dict[str, Any]:
    """Judge the whole image, also in percent of film a's mean luminance."""
    found = _judge(light, variance, a.replicates, shared)
    base = float((a.mean @ LUMINANCE).mean())
    for key in ("difference", "lower", "upper"):
        value = found[key]
        percent = 100.0 * value / base if value is not None and base > 0.0 else None
        found[f"{key}_percent"] = percent
    p = found["p_value"]
    found["significant"] = None if p is None else p < SIGNIFICANCE
    return found


def _tiles(a: Film, light: Image, variance: Image, shared: Image | None) -> list[dict[str, Any]]:
    edge = int(a.core.plan.tile_edge)
    while -(-a.width // edge) * -(-a.height // edge) > MAX_TILES:
        edge *= 2
    rows = []
    for y0 in range(0, a.height, edge):
        for x0 in range(0, a.width, edge):
            part = np.s_[y0 : y0 + edge, x0 : x0 + edge]
            place = {"x0": x0, "y0": y0, "x1": min(x0 + edge, a.width),
                     "y1": min(y0 + edge, a.height)}  # fmt: skip
            of_part = None if shared is None else shared[:, *part]
            rows.append(place | _judge(light[part], variance[part], a.replicates, of_part))
    for row, p in zip(rows, holm([row["p_value"] for row in rows]), strict=True):
        row["p_corrected"] = p
        row["significant"] = None if p is None else p < SIGNIFICANCE
    return rows


def holm(p_values: list[float | None]) -> list[float | None]:
    """Correct p-values for their number (Holm 1979), valid however they depend on each other."""
    known = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    corrected: list[float | None] = [None] * len(p_values)
    least = 0.0
    for rank, (p, index) in enumerate(known):
        least = max(least, min(1.0, p * (len(known) - rank)))
        corrected[index] = least
    return corrected


def statement(report: dict[str, Any]) -> str:
    """Return the comparison in words."""
    if report["identical"]:
        return "The films are equal to the last bit."
    mean, tiles = report["mean"], report["tiles"]
    if mean["p_value"] is None:
        text = f"b differs from a by {mean['difference']:+.3g}, alike in every replicate."
    else:
        percent = mean["difference_percent"]
        amount = f"{mean['difference']:+.3g} W/m²/sr"
        if percent is not None:
            amount = (
                f"{percent:+.3g} % (95 %: {mean['lower_percent']:+.3g} to "
                f"{mean['upper_percent']:+.3g} %)"
            )
        verdict = "more than noise" if mean["significant"] else "noise can do that"
        p = mean["p_value"]
        chance = f"p {p:.2g}" if p >= 1e-16 else "p below 1e-16"
        text = f"The mean luminance of b differs from a's by {amount}: {verdict} ({chance})."
    text += f" {report['tiles_significant']} of {len(tiles)} tiles differ."
    ratio = report["variance_ratio"]
    if report["paired"] and ratio is not None:
        text += f" The common random numbers made the variance {ratio:.3g} times smaller."
    return text
