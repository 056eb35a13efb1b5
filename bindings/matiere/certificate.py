"""The certificate of a film: how wrong it may be, with what confidence, and what that leaves out.

Image, tiles and pixels have intervals from the replicates; each is unknown (None, NaN) where the
replicates tell nothing, never zero. docs/error.md derives them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matiere import ledger, target
from matiere.report import number_text, standard_error_summary

if TYPE_CHECKING:
    from matiere.film import Film

VERSION = 1
MAX_TILES = 256  # rows of the table in a report
_IMAGE = (
    "relmse", "lower", "upper", "any_time_lower", "any_time_upper", "rmse", "rmse_percent",
    "rmse_percent_lower", "rmse_percent_upper", "rmse_percent_any_time_lower",
    "rmse_percent_any_time_upper", "effective_pixels",
)  # fmt: skip
_TILE = ("x0", "y0", "x1", "y1", "relmse", "lower", "upper", "unknown_share", "mean",
         "mean_standard_error")  # fmt: skip


def certificate(film: Film) -> dict[str, Any]:
    """Return the certificate of a film as plain JSON values; unknown figures are None."""
    from matiere import _core

    error, rows = film.error, ledger.ledger(film)
    edge = tile_edge(film)
    return {
        "certificate_version": VERSION,
        "statement": statement(film),
        "known": error["known"],
        "confidence": _core.CONFIDENCE,
        "look": error["look"],
        "look_confidence": error["look_confidence"],
        "image": {key: error[key] for key in _IMAGE},
        "target": target_state(film),
        "pixels": {
            "standard_error": standard_error_summary(film),
            "unknown_share": error["unknown_share"],
            "degrees_of_freedom": pixel_freedom(film),
        },
        "tiles": {
            "edge": edge,
            "rows": [{key: tile[key] for key in _TILE} for tile in film.tiles(edge)],
        },
        "ledger": rows,
        "outside": outside(film, rows),
    }


def tile_edge(film: Film) -> int:
    """Return the plan's tile edge, doubled until the table is short enough for a report."""
    edge = int(film.core.plan.tile_edge)
    while -(-film.width // edge) * -(-film.height // edge) > MAX_TILES:
        edge *= 2
    return edge


def pixel_freedom(film: Film) -> int:
    """Degrees of freedom of a pixel's standard error: 25 pixels of `replicates` means."""
    return 25 * (film.replicates - 1)


def pixel_interval(
    film: Film, confidence: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lower and upper end for the true radiance of every pixel; NaN where unknown."""
    from matiere import _core

    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence must lie between 0 and 1, not {confidence!r}")
    t = float(_core.student_quantile(0.5 * (1.0 - confidence), max(pixel_freedom(film), 1)))
    away = t * film.standard_error
    return film.mean - away, film.mean + away


def target_state(film: Film) -> dict[str, Any] | None:
    """Return the target asked for, whether it was reached, and the samples it still needs."""
    goal = film.info.requested.get("target_error")
    if not goal:
        return None
    excess = target.excess(goal, film.core)
    state: dict[str, Any] = {
        "asked": goal,
        "text": target.in_words(goal),
        "reached": excess is not None and excess <= 1.0,
        "excess": excess,
    }
    if "display" in goal:
        from matiere.display_error import display_error

        state["display"] = display_error(film.core, goal["display"])
    return state


def statement(film: Film) -> str:
    """Return the certificate in a sentence."""
    error = film.error
    if not error["known"]:
        return (
            "The error is unknown: the replicates agree in every pixel, or there is only one. "
            "That is no proof that the image is exact."
        )
    lower, upper = number_text(error["lower"]), number_text(error["upper"])
    text = (
        f"With 95 % confidence the relMSE of this image lies between {lower} and {upper} "
        f"(RMSE about {number_text(error['rmse_percent'])} % of the mean); "
        f"between {number_text(error['any_time_lower'])} and "
        f"{number_text(error['any_time_upper'])} counting every look at this run."
    )
    if error["unknown_share"] > 0:
        text += f" {100 * error['unknown_share']:.3g} % of the pixels are without evidence."
    return text


def outside(film: Film, rows: list[dict[str, Any]]) -> list[str]:
    """Return in sentences what the intervals do not cover."""
    found = ledger.outside(rows)
    if film.error["unknown_share"] > 0:
        found.append(
            "unknown: pixels whose replicates all agree are exact, or hide light along paths too "
            "rare to have been found"
        )
    found.append(
        "model: the scene itself is taken as given; materials, lights and geometry are not judged"
    )
    return found
