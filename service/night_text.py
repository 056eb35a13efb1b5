"""A comparison of nights in lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

Report = Mapping[str, Any]
SHOWN = 20  # cells of a kind that are listed


def lines(report: Report) -> Iterator[str]:
    """Yield the comparison, what matters first."""
    yield report["statement"]
    for change in report["changes"][:SHOWN]:
        yield f"  {change_line(change)}"
    if (left := report["cells"]["changed"] - min(SHOWN, len(report["changes"]))) > 0:
        yield f"  ... and {left} more"
    for kind in ("failed", "missing", "new", "not_comparable"):
        yield from _others(report, kind)
    yield from detectable_lines(report)
    yield from drift_lines(report)
    for note in report["notes"]:
        yield f"note: {note}"


def change_line(change: Report) -> str:
    """Return one changed cell: where, by how much, how sure."""
    surest = change["surest"]
    where = "image" if surest["region"] is None else "pixels {x0}-{x1}, {y0}-{y1}".format(
        **surest["region"])  # fmt: skip
    parts = [f"{name_of(change)}: {effect_words(surest)} in {surest['channel']} of the {where}"]
    if surest["region"] is not None and change["percent"] is not None:
        parts.append(f"whole image {change['percent']:+.3g} %")
    parts.append(f"{change['tiles_significant']} of {len(change['tiles']['boxes'])} tiles")
    parts.append(chance(change["p_corrected"]))
    return ", ".join(parts)


def effect_words(effect: Report) -> str:
    """Return a difference with its interval, in percent where that means something."""
    if effect["percent"] is None:
        return (
            f"{effect['difference']:+.3g} ({effect['lower']:+.3g} to {effect['upper']:+.3g}) "
            "W/m²/sr"
        )
    return (
        f"{effect['percent']:+.3g} % ({effect['lower_percent']:+.3g} to "
        f"{effect['upper_percent']:+.3g} %)"
    )


def chance(p: float) -> str:
    """Return a corrected p-value in words."""
    return f"p {p:.2g}" if p >= 1e-16 else "p below 1e-16"


def name_of(cell: Report) -> str:
    """Return number and label of a cell."""
    return f"cell {cell['cell']} {cell['label']}".rstrip()


def _others(report: Report, kind: str) -> Iterator[str]:
    for cell in report[kind][:SHOWN]:
        why = cell.get("why") or ""
        if error := cell.get("error"):
            why = f"{error['code']}: {error['message']}"
        yield f"  {kind.replace('_', ' ')}: {name_of(cell)}" + (f" ({why})" if why else "")
    if (left := report["cells"][kind] - min(SHOWN, len(report[kind]))) > 0:
        yield f"  ... and {left:,} more {kind.replace('_', ' ')}"


def detectable_lines(report: Report) -> Iterator[str]:
    """Yield the smallest change that this comparison would have found."""
    found = report["detectable"]["image_percent"]
    if found is None:
        return
    words = f"{found['median']:.3g} % of the image in the median cell"
    if report["cells"]["compared"] > 1:
        words += f" ({found['best']:.3g} to {found['worst']:.3g} %)"
    if tile := report["detectable"]["tile_percent"]:
        words += f", {tile['median']:.3g} % in the median tile"
    if report["cells"]["identical"] == report["cells"]["compared"]:
        words += ", were the random numbers unrelated"
    yield (
        f"Smallest detectable change (found with {100 * report['power']:.0f} % probability): "
        f"{words}."
    )
    yield f"{report['tests']:,} tests, {method_words(report)}."


def method_words(report: Report) -> str:
    """Return what the level means."""
    level = f"{100 * report['significance']:g} %"
    if report["method"] == "holm":
        return f"corrected by Holm: if nothing changed, any alarm at all has a chance of {level}"
    name = {"bh": "Benjamini and Hochberg", "by": "Benjamini and Yekutieli"}[report["method"]]
    return f"corrected by {name}: on average at most {level} of the alarms are false"


def drift_lines(report: Report) -> Iterator[str]:
    """Yield speed and error of the later night against the earlier one."""
    for key, words in (
        ("speed", "render seconds"),
        ("error", "relMSE at equal samples"),
        ("efficiency", "efficiency 1 / (relMSE x seconds)"),
    ):
        found = report[key]
        if found["median_ratio"] is None:
            continue
        text = f"{words}: x {found['median_ratio']:.3g} in the median of {found['cells']:,} cells"
        if found["lower"] is not None:
            text += f" (95 %: {found['lower']:.3g} to {found['upper']:.3g})"
        yield text
