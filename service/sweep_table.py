"""The table of a sweep: one row per cell, as CSV and, if asked for, Parquet.

Columns: cell, label, one per axis, how the cell ended, its error with interval, what its image
holds, and the names of its files. What only the report of a cell knows (`mean_r` ... `features`)
is empty for cells whose report is not in the folder.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matiere.errors import MatiereError
from matiere.service.client import JobStatus, SweepStatus
from matiere.service.sweep_baseline import changes

FIRST = ("cell", "label")
ENDED = ("state", "spp", "seconds", "relmse", "relmse_low", "relmse_high", "stop_reason", "cached")
IMAGE = (
    *("mean_r", "mean_g", "mean_b", "luminance_mean", "luminance_min", "luminance_max"),
    *("albedo_r", "albedo_g", "albedo_b"),
)
BASELINE = ("versus_baseline", "versus_baseline_low", "versus_baseline_high")
LAST = ("stability", "features", "image", "job", "error")
FIXED = {*FIRST, *ENDED, *IMAGE, *BASELINE, *LAST}

Row = dict[str, Any]


class ParquetMissing(MatiereError):
    """A Parquet table was asked for and pyarrow is not installed."""

    default_code = "parquet_missing"


def check_parquet() -> None:
    """Raise ParquetMissing, with what to do, before hours of rendering rather than after."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise ParquetMissing(
            "a Parquet table needs pyarrow: pip install 'matiere[parquet]'"
            " (table.csv holds the same and needs nothing)"
        ) from None


def column_of(label: str) -> str:
    """Return the column of an axis; one that is called as a column of ours gets a longer name."""
    return f"axis {label}" if label in FIXED else label


def texts_of(sweep: SweepStatus) -> dict[tuple[str, str], str]:
    """Return what values of axes are called: (axis label, JSON of the value) -> text."""
    return {
        (axis["label"], key_of(value)): text
        for axis in sweep.axes
        for value, text in zip(axis.get("values", ()), axis.get("labels", ()), strict=True)
    }


def key_of(value: object) -> str:
    """Return JSON by which equal values are found again."""
    return json.dumps(value, sort_keys=True)


def plain_of(texts: Mapping[tuple[str, str], str], label: str, value: object) -> object:
    """Return a parameter for the table: numbers and names as they are, the rest by their label."""
    if value is None or isinstance(value, str | bool | int | float):
        return value
    return texts.get((label, key_of(value)), key_of(value))


def rows_of(
    sweep: SweepStatus,
    jobs: Sequence[JobStatus],
    reports: Mapping[int, Mapping[str, Any]],
    images: Mapping[int, str],
    stability: Mapping[int, str],
) -> list[Row]:
    """Return one row per cell; `reports`, `images` (file names) and `stability` go by cell."""
    texts = texts_of(sweep)
    labels = list(dict.fromkeys(label for job in jobs for label in job.parameters))
    changed = changes(reports, sweep.baseline)
    rows = []
    for job in jobs:
        low, high = job.relmse_interval or (None, None)
        cell = -1 if job.cell is None else job.cell
        report = reports.get(cell, {})
        row: Row = {"cell": job.cell, "label": job.label}
        row |= {
            column_of(label): plain_of(texts, label, job.parameters.get(label)) for label in labels
        }
        row |= {
            "state": job.state, "spp": job.spp, "seconds": round(job.seconds, 3),
            "relmse": job.relmse, "relmse_low": low, "relmse_high": high,
            "stop_reason": job.stop_reason, "cached": job.cached,
        }  # fmt: skip
        row |= dict(zip(IMAGE, _image(report.get("image") or {}), strict=True))
        row |= dict(zip(BASELINE, changed.get(cell, (None,) * 3), strict=True))
        row |= {
            "stability": stability.get(cell),
            "features": " ".join(report.get("kernel", {}).get("features", ())) or None,
            "image": images.get(cell),
            "job": job.id,
            "error": job.error["message"] if job.error else None,
        }
        rows.append(row)
    return rows


def _image(found: Mapping[str, Any]) -> list[float | None]:
    light = found.get("luminance") or {}
    return [
        *(found.get("mean") or (None,) * 3),
        *(light.get(key) for key in ("mean", "min", "max")),
        *(found.get("albedo") or (None,) * 3),
    ]


def csv_text(rows: Sequence[Row]) -> str:
    """Return the table as CSV; nothing where nothing is known."""
    file = io.StringIO(newline="")
    table = csv.DictWriter(file, list(rows[0]) if rows else [*FIRST, *ENDED], lineterminator="\n")
    table.writeheader()
    for row in rows:
        table.writerow({key: _csv(value) for key, value in row.items()})
    return file.getvalue()


def _csv(value: object) -> object:
    return json.dumps(value) if isinstance(value, bool) else value


def write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Write the table as Parquet. Raises ParquetMissing."""
    check_parquet()
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = list(rows[0]) if rows else []
    columns = {}
    for name in names:
        values = [row[name] for row in rows]
        kind = _arrow_type(pa, name, values)
        if kind == pa.string():
            values = [v if v is None or isinstance(v, str) else key_of(v) for v in values]
        columns[name] = pa.array(values, kind)
    pq.write_table(pa.table(columns), path)


def _arrow_type(pa: Any, name: str, values: Sequence[object]) -> Any:
    """Return the narrowest type for a column; ours are the same whatever they hold."""
    if name in ("cell", "spp"):
        return pa.int64()
    if name == "cached":
        return pa.bool_()
    if name in (*IMAGE, *BASELINE, "seconds", "relmse", "relmse_low", "relmse_high"):
        return pa.float64()
    kinds = {type(value) for value in values if value is not None}
    if name in FIXED or not kinds:
        return pa.string()
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int} and all(abs(v) < 2**63 for v in values if isinstance(v, int)):
        return pa.int64()
    return pa.float64() if kinds <= {int, float} else pa.string()
