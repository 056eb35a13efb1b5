"""Two nights: which cells changed by more than noise, and what else is different.

    report = compare_nights(open_folder("2026-11-22"), open_folder("2026-11-23"))
    print(report["statement"])

Every cell that both nights have is tested in 17 regions and 3 channels (`night_statistics`); the
p-values of all cells are corrected together, so that a morning without change raises any alarm at
all in at most 5 % of cases (Holm), or that at most 5 % of the alarms are false on average (`bh`,
`by`). The report is plain JSON values; docs/nightly.md explains every key.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import MatiereError
from matiere.jobs import night_statistics as statistics
from matiere.jobs.artifacts import DamagedFile
from matiere.jobs.drift import drift
from matiere.jobs.job import RENDERED, JsonDict
from matiere.jobs.night import Night
from matiere.jobs.night_options import CHANGED, INCOMPLETE, NO_CHANGE, Options
from matiere.jobs.night_statistics import CellTests, Figures

if TYPE_CHECKING:
    from matiere.signature import Signature

VERSION = 1
CHANNELS = "RGB"
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # linear Rec.709
BLOCK = 500  # cells that are tested together
MAX_TABLE = 5000  # cells up to which the report holds a row for each


@dataclass
class _Tested:
    """A cell that could be compared: small things only, there may be 100,000."""

    a: JsonDict
    b: JsonDict
    p: Figures
    identical: bool
    paired: bool
    shared: bool
    percent: float  # of the image's luminance
    relative: NDArray[np.float32]  # standard error / mean of the luminance of every region
    dof: NDArray[np.float32]


def compare_nights(a: Night, b: Night, options: Options | None = None) -> JsonDict:
    """Compare night b with the earlier night a and return the report."""
    options = options or Options()
    rows_a, rows_b = a.keys(), b.keys()
    engines: tuple[set[str], set[str]] = (set(), set())
    both = [(rows_a[key], row) for key, row in rows_b.items() if key in rows_a]
    tested, unlike = list[_Tested](), list[JsonDict]()
    for first in range(0, len(both), BLOCK):
        _test(a, b, both[first : first + BLOCK], engines, (tested, unlike))
    new = [_name(row) for key, row in rows_b.items() if key not in rows_a]
    missing = [_name(row) for key, row in rows_a.items() if key not in rows_b]
    failed = [_failure(row) for row in rows_b.values() if row["state"] not in RENDERED]
    p = np.full((len(tested), max((len(t.p) for t in tested), default=1), 3), np.nan)
    for place, t in zip(p, tested, strict=True):
        place[: len(t.p)] = t.p  # small films have fewer tiles
    p_corrected = statistics.corrected(p, options.method)
    significant = p_corrected < options.significance
    changes = _changes(a, b, tested, p_corrected, significant, options)
    tests = int(np.isfinite(p).sum())
    detectable = _detectable(tested, tests, options)
    report: JsonDict = {
        "night_comparison_version": VERSION,
        "a": _about(a), "b": _about(b),
        **asdict(options),
        "tests": tests, "tests_unknown": sum(int(np.isnan(t.p).sum()) for t in tested),
        "cells": {
            "compared": len(tested),
            "identical": sum(t.identical for t in tested),
            "paired": sum(t.paired for t in tested),
            "changed": int(significant.any((1, 2)).sum()),
            "new": len(new), "missing": len(missing), "failed": len(failed),
            "not_comparable": len(unlike),
        },
        "changes": changes,
        "new": new[: options.listed], "missing": missing[: options.listed],
        "failed": failed[: options.listed], "not_comparable": unlike[: options.listed],
        "detectable": detectable[0],
        **drift([(t.a, t.b) for t in tested]),
        "engines": _engines(a, b, engines),
        "table": _table(tested, p_corrected, detectable[1]) if len(tested) <= MAX_TABLE else None,
    }  # fmt: skip
    report["notes"] = _notes(report, tested)
    report["exit_code"] = _exit_code(report["cells"])
    report["statement"] = statement(report)
    return report


def _test(
    a: Night, b: Night, rows: Sequence[tuple[JsonDict, JsonDict]],
    engines: tuple[set[str], set[str]], results: tuple[list[_Tested], list[JsonDict]],
) -> None:  # fmt: skip
    """Test a block of cells; those that cannot be go to the second list, with the reason."""
    good, pairs = list[tuple[JsonDict, JsonDict]](), list[statistics.Pair]()
    for one, two in rows:
        if two["state"] not in RENDERED:
            continue  # its failure says enough
        found = _signatures(a, b, one, two)
        if isinstance(found, str):
            results[1].append(_name(two) | {"why": found})
            continue
        engines[0].add(found[0].engine)
        engines[1].add(found[1].engine)
        good.append((one, two))
        pairs.append(found)
    for (one, two), tests in zip(good, statistics.compare_many(pairs), strict=True):
        results[0].append(_tested(one, two, tests))


def _signatures(a: Night, b: Night, one: JsonDict, two: JsonDict) -> statistics.Pair | str:
    """Return both signatures of a cell, or why it cannot be compared."""
    if one["state"] not in RENDERED:
        return f"it {one['state']} in the earlier night"
    try:
        before, after = a.signature(one), b.signature(two)
    except (DamagedFile, MatiereError) as fault:
        return str(fault)
    if before is None or after is None:
        which = "earlier" if before is None else "later"
        return f"the {which} night has no signature of it: it was rendered by an older matiere"
    return statistics.why_not(before, after) or (before, after)


def _tested(one: JsonDict, two: JsonDict, tests: CellTests) -> _Tested:
    same = tests.identical or not tests.error[0].any()
    error, dof = (tests.alone, tests.alone_dof) if same else (tests.error, tests.dof)
    base = tests.base @ LUMINANCE
    spread = error @ LUMINANCE  # channels share their noise: an upper bound
    relative = np.divide(spread, base, out=np.full_like(base, np.nan), where=base > 0.0)
    return _Tested(
        one, two, tests.p, tests.identical, tests.paired, tests.shared, _percent(tests),
        relative.astype(np.float32), dof[:, 1].astype(np.float32),
    )  # fmt: skip


def _percent(tests: CellTests) -> float:
    """Return the change of the image's luminance in percent; NaN of a black image."""
    base = float(tests.base[0] @ LUMINANCE)
    return 100.0 * float(tests.difference[0] @ LUMINANCE) / base if base > 0.0 else math.nan


# -- what changed -------------------------------------------------------------------------------
def _changes(
    a: Night, b: Night, tested: Sequence[_Tested], p: Figures, significant: Any, options: Options
) -> list[JsonDict]:
    """Describe the cells that changed, the surest first."""
    hit = [int(i) for i in np.flatnonzero(significant.any((1, 2)))]
    # Intervals of what was selected for being large miss too often, unless they are widened for it
    # (Benjamini & Yekutieli 2005): 5 % of those listed here miss, on average.
    tests = max(int(np.isfinite(p).sum()), 1)
    tail = options.significance * max(int(significant.sum()), 1) / tests / 2.0
    if not len(hit):
        return []
    raw = np.array([np.nanmin(tested[i].p) for i in hit])
    spread = significant[hit].sum((1, 2))
    order = [hit[i] for i in np.lexsort((-spread, raw))][: options.listed]
    found = []
    for index in order:
        t = tested[index]
        before, after = a.signature(t.a), b.signature(t.b)
        assert before is not None and after is not None
        cell = statistics.compare_cells(before, after)
        size = len(t.p)
        found.append(_change(t, cell, before, p[index][:size], significant[index][:size], tail))
    return found


def _change(t: _Tested, cell: CellTests, film: Signature, p: Figures, hit: Any, tail: float) -> Any:
    """Describe one changed cell: p (corrected) and hit are of its regions and channels."""
    half = statistics.interval_half(cell.error, cell.dof, tail)
    with np.errstate(divide="ignore", invalid="ignore"):  # an exact change has no error
        score = np.where(hit, abs(cell.difference) / cell.error, -1.0)
    region, channel = np.unravel_index(np.argmax(score), score.shape)

    def effect(region: int, channel: int) -> JsonDict:
        d, base, h = (float(x[region, channel]) for x in (cell.difference, cell.base, half))
        scale = 100.0 / base if base > 0.0 else None
        ends = {"": d, "lower_": d - h, "upper_": d + h}
        percent = {f"{k}percent": None if scale is None else scale * x for k, x in ends.items()}
        return {
            "channel": CHANNELS[channel],
            "difference": d, "lower": d - h, "upper": d + h, **percent,
            "p_value": _known(cell.p[region, channel]),
            "p_corrected": _known(p[region, channel]), "significant": bool(hit[region, channel]),
        }  # fmt: skip

    light, base = cell.difference @ LUMINANCE, cell.base @ LUMINANCE
    percent = [100.0 * float(d / m) if m > 0.0 else None for d, m in zip(light, base, strict=True)]
    boxes = film.boxes()
    corners = ("x0", "y0", "x1", "y1")
    where = dict(zip(corners, boxes[region - 1], strict=True)) if region else None
    return _name(t.b) | {
        "parameters": t.b["parameters"],
        "job_a": t.a.get("job_id"), "job_b": t.b.get("job_id"),
        "width": film.width, "height": film.height,
        "paired": cell.paired,
        "p_corrected": float(np.nanmin(p)),
        "percent": percent[0],
        "image": [effect(0, c) for c in range(3)],
        "surest": {"region": where, **effect(int(region), int(channel))},
        "tiles": {
            "rows": film.grid[0], "columns": film.grid[1], "boxes": [list(box) for box in boxes],
            "difference": [float(x) for x in light[1:]], "percent": percent[1:],
            "significant": [bool(x) for x in hit[1:].any(1)],
        },
        "tiles_significant": int(hit[1:].any(1).sum()),
    }  # fmt: skip


def _detectable(
    tested: Sequence[_Tested], tests: int, options: Options
) -> tuple[JsonDict, list[float | None]]:
    """Return the smallest detectable changes of the night, in percent, and of every cell's image.

    At the level that the surest of all tests must pass.
    """
    level = options.significance / max(tests, 1)
    if not tested:
        return {"level": level, "image_percent": None, "tile_percent": None, "unknown": 0}, []
    shape = len(tested), max(len(t.relative) for t in tested)
    relative, dof = np.full(shape, np.nan), np.full(shape, np.nan)
    for number, t in enumerate(tested):
        relative[number, : len(t.relative)] = t.relative
        dof[number, : len(t.dof)] = t.dof
    table = 100.0 * statistics.detectable(relative, dof, level, options.power)
    image = table[:, 0]
    return {
        "level": level,
        "image_percent": _spread(image), "tile_percent": _spread(table[:, 1:].ravel()),
        "unknown": int(np.isnan(image).sum()),
    }, [_known(x) for x in image]  # fmt: skip


def _spread(values: Figures) -> JsonDict | None:
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    best, median, worst = np.quantile(known, [0.0, 0.5, 1.0])
    return {"best": float(best), "median": float(median), "worst": float(worst)}


def _table(tested: Sequence[_Tested], p: Figures, detectable: Sequence[float | None]) -> Any:
    return [
        _name(t.b) | {
            "percent": _known(t.percent), "identical": t.identical,
            "p_corrected": _known(np.nanmin(row)) if np.isfinite(row).any() else None,
            "detectable_percent": most,
            "spp": t.b["spp"], "seconds": t.b["seconds"], "relmse": t.b["relmse"],
        }
        for t, row, most in zip(tested, p, detectable, strict=True)
    ]  # fmt: skip


# -- what else ----------------------------------------------------------------------------------
def _about(night: Night) -> JsonDict:
    rows = night.rows()
    spp = sorted({int(row["spp"]) for row in rows if row["state"] in RENDERED})
    return {
        "name": night.name, "sweep_id": night.head.get("sweep_id"), "cells": len(rows),
        "created": night.head.get("created"),
        "succeeded": sum(row["state"] in RENDERED for row in rows),
        "spp": [spp[0], spp[-1]] if spp else None,
    }  # fmt: skip


def _engines(a: Night, b: Night, used: tuple[set[str], set[str]]) -> JsonDict:
    """Tell which engines rendered, and in what they differ where that is known."""
    known = {**a.head.get("engines", {}), **b.head.get("engines", {})}
    one, two = (known.get(next(iter(s)), {}) if len(s) == 1 else {} for s in used)
    differ = {
        name: [one.get(name), two.get(name)]
        for name in sorted({*one, *two})
        if one.get(name) != two.get(name)
    }
    return {
        "a": sorted(used[0]),
        "b": sorted(used[1]),
        "same": used[0] == used[1],
        "differ": differ,
    }


def _notes(report: Mapping[str, Any], tested: Sequence[_Tested]) -> list[str]:
    found, cells, engines = list[str](), report["cells"], report["engines"]
    if not engines["same"] and cells["compared"]:
        what = "; ".join(f"{k} {v[0]} and {v[1]}" for k, v in engines["differ"].items())
        found.append(
            "the nights were rendered by different engines" + (f" ({what})" if what else "")
        )
    if max(len(engines["a"]), len(engines["b"])) > 1:
        found.append("a night holds films of more than one engine")
    if cells["compared"] - cells["paired"] > 0:
        found.append(
            f"{_cells(cells['compared'] - cells['paired'])} other seeds or replicates than before: "
            "nothing of the noise cancels, smaller changes stay hidden"
        )
    unequal = sum(t.a["spp"] != t.b["spp"] for t in tested)
    if unequal:
        found.append(f"{_cells(unequal)} other samples per pixel than before")
    shared = sum(t.shared for t in tested)
    if shared:
        found.append(
            f"{_cells(shared)} light traced from the lamps: pixels share their noise; as "
            "the few replicates must show a change, only large ones are found; more 'replicates' "
            "in the scene's render section help"
        )
    if cells["new"] and cells["missing"] and not cells["compared"]:
        found.append("the nights have no cell in common: were axes renamed or values changed?")
    if report["tests_unknown"]:
        found.append(f"{report['tests_unknown']} tests tell nothing")
    return found


def _cells(count: int) -> str:
    return "1 cell has" if count == 1 else f"{count:,} cells have"


def _exit_code(cells: Mapping[str, int]) -> int:
    if cells["changed"]:
        return CHANGED
    gaps = cells["failed"] + cells["missing"] + cells["not_comparable"]
    return INCOMPLETE if gaps or not cells["compared"] else NO_CHANGE


def statement(report: Mapping[str, Any]) -> str:
    """Return the comparison in one or two sentences."""
    cells, words = report["cells"], list[str]()
    if not cells["compared"]:
        words.append("No cell could be compared.")
    elif cells["changed"]:
        words.append(
            f"{cells['changed']} of {cells['compared']:,} cells changed by more than noise."
        )
    elif cells["identical"] == cells["compared"]:
        words.append(f"All {cells['compared']:,} cells are equal to the last bit.")
    else:
        words.append(f"No change beyond noise in {cells['compared']:,} cells.")
    others = [
        f"{cells[key]:,} {word}"
        for key, word in (("failed", "failed"), ("missing", "missing"), ("new", "new"),
                          ("not_comparable", "not comparable"))
        if cells[key]
    ]  # fmt: skip
    if others:
        words.append(f"Cells beside these: {', '.join(others)}.")
    return " ".join(words)


def _name(row: Mapping[str, Any]) -> JsonDict:
    return {"cell": row["cell"], "label": row["label"]}


def _failure(row: Mapping[str, Any]) -> JsonDict:
    return _name(row) | {"state": row["state"], "error": row.get("error")}


def _known(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None
