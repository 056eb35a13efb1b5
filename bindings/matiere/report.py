"""The report of a render: error against run time, what was counted, what it was made with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matiere.film import Film

VERSION = 1
MOST_REPLICATE_PIXELS = 2**22  # of 32 bytes
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # linear Rec.709
# What ended a render, in words.
REASONS = {
    "spp": "the samples per pixel asked for were reached",
    "cap": "the cap of 2^20 samples per pixel was reached",
    "seconds": "the time asked for was used up (the next pass would have overshot)",
    "target_error": "the any-time interval of the error came to lie within what was asked for",
    "callback": "the callback asked to stop",
    "merged": "films of several seeds were merged",
}
# Counters that warn of a scene or a numeric problem, in words.
WARNINGS = {
    "depth_guard": "paths were cut after 10,000 scattering events on surfaces or 16 million inside "
    "media",
    "interior_overflow": "entries found more than 8 nested media",
    "unmatched_exits": "exits from a medium that was never entered, or none from one that scatters "
    "(open or inside-out meshes)",
}


def film_report(film: Film) -> dict[str, Any]:
    """Return the report of a film as plain JSON values; unknown figures are None."""
    info, counters = film.info, film.core.counters
    wall_s, samples = counters["wall_s"], counters["samples"]
    if not wall_s and info.log:  # chunks rendered by jobs know no wall clock of their own
        wall_s = info.log[-1]["wall_s"]
    rays = counters["rays"] + counters["shadow_rays"]
    made = film.core.provenance
    from matiere import light_layer

    return {
        "report_version": VERSION,
        "scene_digest": info.scene_digest,
        "film_key": info.film_key,
        "width": film.width,
        "height": film.height,
        "spp": film.spp,
        "requested": dict(info.requested),
        "spp_note": spp_note(film),
        "adaptive": film.adaptive,
        "samples_per_pixel": [int(film.sample_counts.min()), int(film.sample_counts.max())],
        "replicates": film.replicates,
        "seeds": list(info.seeds),
        "max_depth": info.max_depth,
        "threshold": info.threshold,
        "reason": info.reason,
        "reason_text": REASONS.get(info.reason, ""),
        "wall_s": wall_s,
        "cpu_s": counters["cpu_s"],
        "build_s": info.build_s,
        "threads": info.threads,
        "error": {**film.error, "standard_error": standard_error_summary(film)},
        "certificate": film.certificate(),
        "image": image_statistics(film),
        "log": [dict(row) for row in info.log],
        "samples": samples,
        "rays": rays,
        "samples_per_s": samples / wall_s if wall_s else None,
        "rays_per_s": rays / wall_s if wall_s else None,
        "kernel": {
            "name": " + ".join(made["kernels"]) or None,
            "features": made["found"],
            "left_out": made["left_out"],
        },
        "outliers": made["outliers"],
        "counters": {key: counters[key] for key in ("rays", "shadow_rays", *WARNINGS)},
        "rejected": rejections(counters, info.materials),
        "rejected_total": counters["rejected_total"],
        "warnings": warnings(film),
        "light_tracing": light_layer.facts(film),
        "bytes_per_pixel": film.core.bytes_per_pixel(
            film.replicates, film.adaptive, film.core.aovs, film.core.has_light_layer
        ),
        "versions": dict(info.versions),
        "notes": [dict(note) for note in info.notes],
    }


def picture_report(film: Film, despeckle: bool) -> dict[str, Any]:
    """Return what the delivered picture leaves out: shares of pixels and of light held back."""
    if not despeckle:
        return {"despeckle": False}
    found = film.despeckled
    return {"despeckle": True, "pixels_changed": found.pixels, "energy_held_back": found.energy}


def image_statistics(film: Film) -> dict[str, Any]:
    """Return means of the linear image: `mean` R, G, B, `luminance`, `albedo` if it is there.

    `replicate_luminance`: the mean luminance of every replicate alone, None of a film so large that
    its replicates would need more than 128 MB at once.
    """
    replicates = None
    if film.replicates * film.width * film.height <= MOST_REPLICATE_PIXELS:
        replicates = (film.replicate_means @ LUMINANCE).mean(axis=(1, 2)).tolist()
    light = film.mean @ LUMINANCE
    albedo = film.aov("albedo").mean(axis=(0, 1)).tolist() if "albedo" in film.aovs else None
    return {
        "mean": film.mean.mean(axis=(0, 1)).tolist(),
        "luminance": {
            "mean": float(light.mean()), "min": float(light.min()), "max": float(light.max())
        },
        "albedo": albedo,
        "replicate_luminance": replicates,
    }  # fmt: skip


def standard_error_summary(film: Film) -> dict[str, float | None]:
    """Return mean, 95th percentile and maximum of the pixels' standard errors (radiance units)."""
    values = film.standard_error
    known = values[np.isfinite(values)]
    if not known.size:
        return {"mean": None, "p95": None, "max": None}
    return {
        "mean": float(known.mean()),
        "p95": float(np.quantile(known, 0.95)),
        "max": float(np.max(known)),
    }


def rejections(counters: Mapping[str, Any], names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return rejected samples by material and cause; material None is a whole path."""
    return [{**row, "material": _name(row["material"], names)} for row in counters["rejected"]]


def _name(index: int | None, names: tuple[str, ...]) -> str | None:
    if index is None:
        return None
    return names[index] if index < len(names) else f"material {index}"


def spp_note(film: Film) -> str:
    """Say in words how spp came out of what was asked for; empty if they are the same."""
    asked = film.info.requested.get("spp")
    if asked is None or asked == film.spp or film.info.reason != "spp":
        return ""
    if film.spp == film.core.plan.round_up(asked):
        return f"{asked} samples per pixel were asked for, rounded up to {film.spp}, whole passes"
    return f"{asked} samples per pixel were asked for, the film already had {film.spp}"


REJECTION_WORDS = {
    "side_mismatch": (
        "sampled directions went below the real surface under a smoothed normal and were absorbed: "
        "a finer mesh has fewer"
    ),
    "negative_radiance": "samples had a negative channel and were kept",
}


def _rejection_warnings(counters: Mapping[str, Any]) -> list[str]:
    totals: dict[str, int] = {}
    for row in counters["rejected"]:
        totals[row["cause"]] = totals.get(row["cause"], 0) + row["count"]
    default = "values that are not finite were counted as zero"
    return [
        f"{count} {REJECTION_WORDS.get(cause, f'{default} ({cause})')}"
        for cause, count in totals.items()
    ]


def warnings(film: Film) -> list[str]:
    """Return what the reader should know before trusting the image, in sentences."""
    counters, error = film.core.counters, film.error
    found = [f"{counters[key]} {text}" for key, text in WARNINGS.items() if counters[key]]
    found += _rejection_warnings(counters)
    if not error["known"]:
        found.append("the error is unknown: the replicates agree in every pixel, or there is one")
    elif error["unknown_share"] > 0:
        share = 100 * error["unknown_share"]
        found.append(
            f"{share:.3g} % of the pixels are without evidence (all replicates equal): "
            "exact, or hiding a path too rare to have been found"
        )
    seconds = film.info.requested.get("seconds")
    if seconds is not None and film.info.log and len(film.info.log) == 1:
        wall = film.info.log[-1]["wall_s"]
        if wall > 1.1 * seconds:
            found.append(f"one pass took {wall:.3g} s, longer than the {seconds:.3g} s asked for")
    return found


def report_text(report: Mapping[str, Any]) -> str:
    """Return a report as plain text: one line of facts, the table of looks, the warnings."""
    head = (
        f"{report['width']} x {report['height']}, {report['spp']} spp in {report['wall_s']:.2f} s "
        f"({report['cpu_s']:.2f} s of CPU, {report['threads']} threads), "
        f"stopped by {report['reason']}: {report['reason_text']}"
    )
    lines = [head, "", _error_line(report["error"]), "", *_table(report["log"])]
    extra = [report["spp_note"], *report["warnings"]]
    lines += ["", *(f"note: {line}" for line in extra if line)] if any(extra) else []
    lines += ["", "not in the interval:", *(f"- {x}" for x in report["certificate"]["outside"])]
    return "\n".join(lines).rstrip() + "\n"


def _error_line(error: Mapping[str, Any]) -> str:
    if not error["known"]:
        return "relMSE unknown"
    se = error["standard_error"]
    return (
        f"relMSE {number_text(error['relmse'])} (95 %: {number_text(error['lower'])} to "
        f"{number_text(error['upper'])}), RMSE {number_text(error['rmse'])}, standard error mean "
        f"{number_text(se['mean'])}, p95 {number_text(se['p95'])}, max {number_text(se['max'])}, "
        f"m {number_text(error['log_average'])}, unknown {100 * error['unknown_share']:.3g} %"
    )


_COLUMNS = (
    ("spp", "spp"), ("wall s", "wall_s"), ("CPU s", "cpu_s"), ("relMSE", "relmse"),
    ("lower", "lower"), ("upper", "upper"), ("1/(relMSE s)", "efficiency"), ("rays", "rays"),
    ("rejected", "rejected"),
)  # fmt: skip


def _table(log: list[Mapping[str, Any]]) -> list[str]:
    rows = [[title for title, _ in _COLUMNS]]
    rows += [[number_text(row[key]) for _, key in _COLUMNS] for row in log]
    widths = [max(len(row[i]) for row in rows) for i in range(len(_COLUMNS))]
    return ["  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]


def number_text(value: Any) -> str:
    """Return a figure to three digits, or "unknown"."""
    if value is None:
        return "unknown"
    return str(value) if isinstance(value, int) else f"{value:.3g}"
