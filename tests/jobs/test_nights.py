"""Nights: folders and pages of signatures, and the comparison of two."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_night_statistics import made, noise

from matiere.errors import MatiereError
from matiere.jobs import night
from matiere.jobs.artifacts import ArtifactFolder
from matiere.jobs.compare_nights import compare_nights
from matiere.jobs.night import FolderWriter, Night, NightError, StoredNight, open_folder
from matiere.jobs.night_options import Options

CELLS = 12


def row(cell: int, **more: Any) -> dict[str, Any]:
    """Return what is known of a cell."""
    return {
        "cell": cell, "label": f"alpha {cell}", "parameters": {"alpha": cell / 10},
        "state": "succeeded", "error": None, "spp": 64, "seconds": 2.0, "relmse": 0.01,
        "relmse_interval": [0.008, 0.012], "stop_reason": "spp", "cached": False,
        "film_key": f"{cell:064}", "job_id": None,
    } | more  # fmt: skip


def pixels(cell: int, seed: int, scale: float = 0.02) -> Any:
    """Return an image of a cell; its noise depends on the seed."""
    return (0.2 + cell / 10) * noise(1000 * seed + cell, scale=scale)


def write(
    folder: Path, seed: int, changed: dict[int, Any] | None = None,
    rows: dict[int, dict[str, Any]] | None = None, **more: Any,
) -> Night:  # fmt: skip
    """Write a night of 12 cells into a folder and open it."""
    writer = FolderWriter(folder)
    for cell in range(CELLS):
        facts = (rows or {}).get(cell, {})
        image = (changed or {}).get(cell, lambda x: x)(pixels(cell, seed))
        data = made(image, seeds=(seed,), engine=more.get("engine", "e1")).to_bytes()
        writer.add(row(cell, **facts), data if facts.get("state") != "failed" else None)
    head = {"name": folder.name, "sweep_id": None, "created": 1.0}
    writer.close(
        head | {"engines": {more.get("engine", "e1"): {"embree": more.get("embree", "4")}}}
    )
    return open_folder(folder)


def test_a_quiet_morning(tmp_path: Path) -> None:
    report = compare_nights(write(tmp_path / "a", 1), write(tmp_path / "b", 2))
    assert report["exit_code"] == 0 and not report["changes"]
    assert report["cells"]["compared"] == CELLS and report["tests"] == CELLS * 17 * 3
    assert report["detectable"]["image_percent"]["median"] > 0
    assert len(report["table"]) == CELLS and "No change beyond noise in 12" in report["statement"]
    assert any("other seeds" in note for note in report["notes"])
    json.dumps(report, allow_nan=False)


def test_a_changed_cell_is_named_with_place_size_and_interval(tmp_path: Path) -> None:
    def brighter(image: Any) -> Any:
        image[:, 8:12, 4:8, 0] *= 1.3
        return image

    report = compare_nights(write(tmp_path / "a", 1), write(tmp_path / "b", 2, {7: brighter}))
    assert report["exit_code"] == 1 and report["cells"]["changed"] == 1
    (change,) = report["changes"]
    assert change["cell"] == 7 and change["label"] == "alpha 7"
    assert change["surest"]["region"] == {"x0": 4, "y0": 8, "x1": 8, "y1": 12}
    assert change["surest"]["channel"] == "R"
    assert change["surest"]["lower_percent"] < 30 < change["surest"]["upper_percent"]
    assert change["tiles"]["significant"].index(True) == 9 and change["tiles_significant"] == 1
    assert [e["channel"] for e in change["image"]] == ["R", "G", "B"]


def test_the_night_of_one_seed_finds_a_tenth_of_a_percent(tmp_path: Path) -> None:
    a = write(tmp_path / "a", 1)
    report = compare_nights(a, write(tmp_path / "b", 1, {3: lambda x: x * 1.001}))
    assert report["cells"] == report["cells"] | {"changed": 1, "identical": 11, "paired": 12}
    assert report["changes"][0]["percent"] == pytest.approx(0.1, rel=1e-3)
    unrelated = compare_nights(a, write(tmp_path / "c", 2, {3: lambda x: x * 1.001}))
    assert unrelated["exit_code"] == 0


def test_new_missing_and_failed_cells_are_told(tmp_path: Path) -> None:
    error = {"code": "out_of_memory", "message": "the child ran out of memory"}
    later = write(
        tmp_path / "b", 1,
        rows={2: {"state": "failed", "error": error}, 5: {"parameters": {"alpha": 99}}},
    )  # fmt: skip
    report = compare_nights(write(tmp_path / "a", 1), later)
    assert report["exit_code"] == 3 and not report["changes"]
    assert report["failed"] == [{"cell": 2, "label": "alpha 2", "state": "failed", "error": error}]
    assert [c["cell"] for c in report["new"]] == [5] == [c["cell"] for c in report["missing"]]
    assert report["cells"]["compared"] == 10


def test_a_change_beside_a_failure_is_still_a_change(tmp_path: Path) -> None:
    later = write(tmp_path / "b", 1, {3: lambda x: 2 * x}, rows={2: {"state": "failed"}})
    assert compare_nights(write(tmp_path / "a", 1), later)["exit_code"] == 1


def test_cells_without_evidence_are_said_not_to_be_comparable(tmp_path: Path) -> None:
    a = write(
        tmp_path / "a", 1, {1: lambda x: x[:1], 2: lambda x: x[:, :8]},
        rows={4: {"state": "failed"}},
    )  # fmt: skip
    report = compare_nights(a, write(tmp_path / "b", 2, {1: lambda x: x[:1]}))
    why = {cell["cell"]: cell["why"] for cell in report["not_comparable"]}
    assert set(why) == {1, 2, 4} and report["exit_code"] == 3
    assert "replicate" in why[1] and "sizes differ" in why[2] and "earlier night" in why[4]


def test_another_engine_is_noted_with_what_differs(tmp_path: Path) -> None:
    later = write(tmp_path / "b", 1, engine="e2", embree="4.4")
    report = compare_nights(write(tmp_path / "a", 1), later)
    assert not report["engines"]["same"] and report["engines"]["differ"] == {"embree": ["4", "4.4"]}
    assert any("embree 4 and 4.4" in note for note in report["notes"])


def test_speed_and_error_drift_is_measured_on_rendered_cells(tmp_path: Path) -> None:
    slower = {i: {"seconds": 3.0, "relmse": 0.011, "cached": i < 2} for i in range(CELLS)}
    report = compare_nights(write(tmp_path / "a", 1), write(tmp_path / "b", 2, rows=slower))
    assert report["speed"]["cells"] == 10 and report["speed"]["median_ratio"] == 1.5
    assert report["error"]["median_ratio"] == pytest.approx(1.1) and report["error"]["cells"] == 12
    assert report["efficiency"]["median_ratio"] == pytest.approx(1 / 1.65)
    assert report["speed"]["lower"] == report["speed"]["upper"] == 1.5


def test_false_discovery_rate_finds_more_than_holm(tmp_path: Path) -> None:
    a = write(tmp_path / "a", 1)
    b = write(tmp_path / "b", 2, {i: lambda x: x * 1.0035 for i in range(CELLS)})
    found = {m: compare_nights(a, b, Options(method=m)) for m in ("holm", "bh", "by")}
    hits = {m: sum(e["p_corrected"] < 0.05 for e in r["table"]) for m, r in found.items()}
    assert hits["holm"] <= hits["by"] <= hits["bh"] and hits["holm"] < hits["bh"]


@pytest.mark.parametrize(
    ("wrong", "pointer"),
    [({"significance": 0.7}, "/significance"), ({"method": "bonferroni"}, "/method"),
     ({"power": 0.1}, "/power"), ({"listed": -1}, "/listed")],
)  # fmt: skip
def test_options_out_of_range_are_refused(wrong: dict[str, Any], pointer: str) -> None:
    with pytest.raises(MatiereError) as error:
        Options(**wrong)
    assert error.value.pointer == pointer


def test_small_films_have_fewer_tiles(tmp_path: Path) -> None:
    cut = {0: lambda x: x[:, :2, :3], 1: lambda x: x[:, :1, :1]}
    report = compare_nights(write(tmp_path / "a", 1, cut), write(tmp_path / "b", 2, cut))
    assert report["tests"] == (10 * 17 + 7 + 2) * 3 and report["tests_unknown"] == 0


# -- files --------------------------------------------------------------------------------------
def test_half_a_night_is_none(tmp_path: Path) -> None:
    with FolderWriter(tmp_path) as writer:
        writer.add(row(0), b"x")
    with pytest.raises(NightError, match="holds no night"):
        open_folder(tmp_path)


def test_only_a_night_is_replaced_by_a_night(tmp_path: Path) -> None:
    assert night.may_replace(tmp_path / "none")
    write(tmp_path / "a", 1)
    assert night.may_replace(tmp_path / "a")
    (tmp_path / "a" / "mine.txt").touch()
    assert not night.may_replace(tmp_path / "a") and not night.may_replace(tmp_path / "a/mine.txt")


def test_a_damaged_or_newer_night_is_refused_in_words(tmp_path: Path) -> None:
    write(tmp_path, 1)
    lines = (tmp_path / night.CELLS).read_text().splitlines()
    (tmp_path / night.CELLS).write_text("\n".join(lines[:-1]))
    with pytest.raises(NightError, match="11 cells, its head says 12"):
        open_folder(tmp_path)
    (tmp_path / night.CELLS).write_text("{")
    with pytest.raises(NightError, match="damaged"):
        open_folder(tmp_path)
    head = json.loads((tmp_path / night.HEAD).read_text())
    (tmp_path / night.HEAD).write_text(json.dumps(head | {"night": 2}))
    with pytest.raises(NightError, match="newer matiere"):
        open_folder(tmp_path)


def test_a_cut_file_of_signatures_makes_cells_not_comparable(tmp_path: Path) -> None:
    a = write(tmp_path / "a", 1)
    write(tmp_path / "b", 1)
    file = tmp_path / "b" / night.SIGNATURES
    file.write_bytes(file.read_bytes()[:-10])
    report = compare_nights(a, open_folder(tmp_path / "b"))
    assert report["cells"]["not_comparable"] == 1 and report["exit_code"] == 3
    assert "cut short" in report["not_comparable"][0]["why"]


def test_pages_of_a_store_hold_the_same_night(tmp_path: Path) -> None:
    there = write(tmp_path / "n", 1)
    store = ArtifactFolder(tmp_path / "artifacts")
    cells = list(night.iterate(there))
    pages = [night.write_page(store, cells[i : i + 5], {"e1": {}})[0] for i in (0, 5, 10)]
    stored = StoredNight({"name": "n"}, store, pages)
    assert compare_nights(there, stored)["cells"]["identical"] == CELLS
    writer = FolderWriter(tmp_path / "again")
    for page in pages:
        writer.add_page(store.read(page))
    again = open_folder(writer.close({"name": "n"}))
    assert [r["cell"] for r in again.rows()] == list(range(CELLS))
    assert again.head["engines"] == {"e1": {}} and "page" not in again.rows()[0]
    signatures = [n.signature(n.rows()[11]) for n in (there, again)]
    assert signatures[0] and signatures[1]
    np.testing.assert_array_equal(signatures[0].means, signatures[1].means)


def test_cells_of_equal_parameters_are_told_apart_by_order(tmp_path: Path) -> None:
    same: dict[int, dict[str, Any]] = {i: {"parameters": {"alpha": 0}} for i in range(CELLS)}
    a, b = write(tmp_path / "a", 1, rows=same), write(tmp_path / "b", 1, rows=same)
    assert compare_nights(a, b)["cells"]["identical"] == CELLS
