"""What `matiere sweep` and `matiere fetch` leave in a folder: tables, pages of sheets, a report."""

from __future__ import annotations

import csv
import io
import json
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from fake_engine import FakeEngine
from test_client_and_submit import finish_soon, run

from matiere import imageio
from matiere.jobs import sheet
from matiere.jobs.job import JobState
from matiere.jobs.sweep import parse_sweep
from matiere.service import sweep_output, sweep_page
from matiere.service.client import JobStatus, ServiceError, SweepStatus
from matiere.service.fetch_run import choose
from matiere.service.sweep_baseline import changes
from matiere.service.sweep_check import varying, verdicts
from matiere.service.sweep_output import OutputFolder
from matiere.service.sweep_page import Page, html_of
from matiere.service.sweep_table import ParquetMissing, csv_text, rows_of, write_parquet

GOLD = {"type": "conductor", "metal": "Au"}
AXES = [
    {"label": "material", "values": [GOLD, {"type": "lambert"}], "labels": ["gold", "<chalk>"]},
    {"label": "seconds", "uniform": [0.1, 0.5]},
]
REPORT = {
    "image": {"mean": [0.1, 0.2, 0.3], "luminance": {"mean": 0.2, "min": 0.0, "max": 7.0}},
    "kernel": {"features": ["models", "spheres"]},
}


def died(message: str) -> dict[str, str]:
    """Return the error of a job."""
    return {"code": "signal", "message": message, "pointer": "", "log_tail": ""}


def job(cell: int, state: str = "succeeded", **more: Any) -> JobStatus:
    value = AXES[0]["values"][cell % 2]  # type: ignore[index]
    given: dict[str, Any] = {
        "id": f"job{cell}", "state": state, "label": f"<b>{cell}</b>", "width": 4, "height": 4,
        "spp": 8, "progress": 1, "seconds": 1.5, "relmse": 0.01 * (cell + 1), "cell": cell,
        "relmse_interval": (0.005, 0.02), "parameters": {"material": value, "seconds": 0.1 + cell},
    }  # fmt: skip
    return JobStatus.model_validate(given | more)


def sweep_of(cells: int, columns: int = 2, baseline: int | None = None) -> SweepStatus:
    return SweepStatus(
        id="s", state="succeeded", label="night & day", mode="sobol", axes=AXES, cells=cells,
        counts={"succeeded": cells}, columns=columns, baseline=baseline,
    )  # fmt: skip


def rows_for(jobs: list[JobStatus]) -> list[dict[str, Any]]:
    return rows_of(sweep_of(len(jobs)), jobs, {0: REPORT}, {0: "cells/0.png"}, {0: "warn"})


# -- tables -------------------------------------------------------------------------------------
def test_the_table_tells_parameters_error_image_and_verdict() -> None:
    failed = {"relmse": None, "relmse_interval": None, "error": died("died, twice")}
    rows = rows_for([job(0), job(1, "failed", **failed)])
    read = list(csv.DictReader(io.StringIO(csv_text(rows))))
    first, second = read
    assert (first["material"], first["axis seconds"], first["seconds"]) == ("gold", "0.1", "1.5")
    assert (first["relmse"], first["relmse_low"], first["cached"]) == ("0.01", "0.005", "false")
    assert (first["mean_b"], first["luminance_max"], first["albedo_r"]) == ("0.3", "7.0", "")
    assert (first["stability"], first["features"]) == ("warn", "models spheres")
    assert (second["state"], second["relmse"], second["mean_r"]) == ("failed", "", "")
    assert second["error"] == "died, twice"


def test_parquet_holds_the_same_with_types(tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    rows = rows_for([job(0), job(1, parameters={"material": 7, "seconds": 2})])
    write_parquet(tmp_path / "t.parquet", rows)
    table = pq.read_table(tmp_path / "t.parquet")
    kinds = {field.name: str(field.type) for field in table.schema}
    assert (kinds["cell"], kinds["relmse"], kinds["cached"]) == ("int64", "double", "bool")
    assert (kinds["axis seconds"], kinds["material"], kinds["error"]) == (
        "double", "string", "string")  # fmt: skip
    assert table["axis seconds"].to_pylist() == [0.1, 2.0]
    assert table["material"].to_pylist() == ["gold", "7"]
    assert list(table.column_names) == list(rows[0])


def test_without_pyarrow_parquet_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ParquetMissing, match=r"pip install 'matiere\[parquet\]'"):
        write_parquet(tmp_path / "t.parquet", [])


def test_the_baseline_is_compared_replicate_by_replicate() -> None:
    rng = np.random.default_rng(3)

    def report(values: Any, **more: Any) -> dict[str, Any]:
        return {"image": {"replicate_luminance": list(values)}, "seeds": [1], **more}

    hits = 0
    for _ in range(400):
        shared = rng.normal(1.0, 0.1, 16)
        reports = {0: report(shared), 1: report(shared * 1.02 + rng.normal(0, 0.002, 16))}
        change, low, high = changes(reports, 0)[1]
        assert abs(change - 2.0) < 0.5, "the shared noise of 10 % cancels"
        hits += low < 2.0 < high
    assert 360 <= hits <= 396, hits  # 380 expected; these are 4.6 and 3.7 standard deviations
    unlike = {2: report([1.0, 1.0]), 3: report(shared, seeds=[2]), 4: report(shared, adaptive=True)}
    assert set(changes({**reports, **unlike}, 0)) == {1}
    assert changes(reports, None) == changes(reports, 9) == {}
    same = {0: report(shared), 1: report(shared)}
    assert changes(same, 0)[1] == (0.0, 0.0, 0.0)
    rows = rows_of(sweep_of(2, baseline=0), [job(0), job(1)], reports, {}, {})
    assert rows[0]["versus_baseline"] is None
    text = html_of(Page("x", 2, baseline=0), rows)
    assert "<b>+2" in text.replace("+1.9", "+2") and "vs baseline" in text


# -- the page -----------------------------------------------------------------------------------
class Reader(HTMLParser):
    """Collects links, images and the text of table rows; checks that tags close."""

    VOID = ("meta", "img", "input", "br")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.targets: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.targets += [value for key, value in attrs if key in ("href", "src") and value]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_report_is_one_page_that_needs_no_server() -> None:
    jobs = [job(i) for i in range(3)] + [job(3, "failed", relmse=None, error=died("<died>"))]
    page = Page("night & day", 4, 1, ["contact sheet.png"], "plot.svg",
                files={0: {".png": "cells/a b.png", ".exr": "cells/a b.exr"}})  # fmt: skip
    text = html_of(page, rows_for(jobs))
    read = Reader(text)
    assert read.tags.count("tr") == 5 and read.tags.count("script") == 1
    assert "cells/a%20b.png" in read.targets and "plot.svg" in read.targets
    assert not [t for t in read.targets if ":" in t or t.startswith("/")], "all lies beside it"
    assert "<title>night &amp; day</title>" in text and "&lt;chalk&gt;" in text
    assert "failed: &lt;died&gt;" in text and "<b>" not in text and "<died>" not in text
    assert text.count('class="baseline"') == 1
    assert text.index("0.01") < text.index("<script>"), "readable without script"


def test_a_large_sweep_shows_baseline_failures_and_the_largest_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sweep_page, "MOST_ROWS", 10)
    monkeypatch.setattr(sweep_page, "LARGEST_ERRORS", 8)
    jobs = [job(i, "failed" if i == 4 else "succeeded") for i in range(100)]
    text = html_of(Page("x", 100, baseline=2), rows_for(jobs))
    assert Reader(text).tags.count("tr") == 11 and "<th data-fixed>image</th>" not in text
    assert "10 of 100 cells" in text and 'data-v="99"' in text and 'data-v="2"' in text
    chosen = sweep_page.choose(rows_for(jobs), 2)
    assert [r["cell"] for r in chosen] == [0, 2, 4, *range(93, 100)], "0 has an image"


# -- sheets -------------------------------------------------------------------------------------
def test_pages_hold_whole_rows() -> None:
    split, columns = sheet.pages(1000, 7)
    assert columns == 7 and all(len(page) % 7 == 0 for page in split[:-1])
    assert [i for page in split for i in page] == list(range(1000))
    assert max(map(len, split)) <= sheet.PAGE_CELLS
    assert sheet.pages(100_000, 317)[1] == sheet.PAGE_COLUMNS


def test_a_page_of_a_grid_keeps_the_headers_of_its_rows() -> None:
    axes = [{"label": "a", "values": [1, 2, 3], "labels": ["1", "2", "3"]},
            {"label": "b", "values": [4, 5], "labels": ["4", "5"]}]  # fmt: skip
    request = {"mode": "grid", "axes": axes, "columns": 2, "cells_of_sweep": 6, "first": 2}
    assert sheet._heads(4, request) == (["b 4", "b 5"], ["a 2", "a 3"])
    assert sheet._heads(4, {**request, "cells_of_sweep": 5}) == ([], [])
    assert sheet._heads(4, {**request, "mode": "sobol"}) == ([], [])


def test_larger_sweeps_get_pages_of_what_is_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sheet, "PAGE_CELLS", 4)
    monkeypatch.setattr(sweep_output, "PAGE_CELLS", 4)
    folder = OutputFolder(tmp_path)
    folder.begin("s", "d")
    jobs = [job(i) for i in range(9)]
    pixels = np.full((6, 8, 3), 128, np.uint8)
    for each in jobs[:6]:
        name = tmp_path / folder.names(each)[0]
        imageio.write_stored(name, imageio.Stored(pixels, ("R", "G", "B"), {}), "uint8")
        folder._fetched[str(each.cell)] = each.id
    none: Any = None  # no service is asked
    wrote = folder.finish(none, sweep_of(9), jobs)
    assert wrote[0].name == "index.html" and (tmp_path / "contact-sheet.png").exists()
    assert (tmp_path / "contact-sheet-002.png").exists()
    assert not (tmp_path / "contact-sheet-003.png").exists(), "six images, four to a page"
    assert "pages" in (tmp_path / "index.html").read_text()
    (tmp_path / folder.names(jobs[5])[0]).unlink()
    (tmp_path / folder.names(jobs[4])[0]).unlink()
    folder.finish(none, sweep_of(9), jobs)
    assert not (tmp_path / "contact-sheet-002.png").exists(), "an old page goes"


# -- fetching -----------------------------------------------------------------------------------
@pytest.fixture
def sweep_file(tmp_path: Path) -> Path:
    """Write a sweep file with its scene inside."""
    axes = [{"pointer": "/materials/a/alpha", "values": [0.1, 0.2, 0.3]}]
    scene = {"version": 1, "materials": {"a": {"alpha": 1}}}
    path = tmp_path / "alpha.json"
    path.write_text(json.dumps({"version": 1, "base": scene, "axes": axes, "baseline": 1}))
    return path


def test_fetch_brings_some_cells_of_a_sweep_that_brought_none(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    finish_soon(engine)
    out = sweep_file.parent / "out"
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--fetch", "none", "--url", url)
    assert code == 0, err
    assert list((out / "cells").iterdir()) == []
    asked = ["fetch", out, "--where", "x > 0.15", "--kind", "png", "--cells", "0-1", "--url", url]
    code, said, err = run(capsys, *asked)
    assert code == 0, err
    assert [p.name for p in (out / "cells").iterdir()] == ["0001_0.2.png"]
    assert "cells/0001_0.2.png" in (out / "index.html").read_text()
    assert "1 of 3 cells are here" in err and "index.html" in said
    other = sweep_file.parent / "other"
    sweep_id = next(iter(engine.sweeps))
    code, _, err = run(capsys, "fetch", sweep_id, "-o", other, "--kind", "exr", "--url", url)
    assert code == 0 and len(list((other / "cells").glob("*.exr"))) == 3, err
    job_id = next(iter(engine.jobs))
    code, said, err = run(capsys, "fetch", job_id, "-o", other, "--kind", "png", "--url", url)
    assert code == 0 and (other / f"{job_id}.png").exists(), err


def test_differences_from_the_baseline_are_fetched_and_shown(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    finish_soon(engine)
    out = sweep_file.parent / "out"
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--fetch", "none", "--url", url)
    assert code == 0, err
    code, _, err = run(capsys, "fetch", out, "--kind", "difference", "--url", url)
    assert code == 0, err
    names = ["0000_0.1.difference.png", "0002_0.3.difference.png"]  # cell 1 is the baseline
    assert sorted(p.name for p in (out / "cells").iterdir()) == names
    assert (out / "cells" / names[1]).read_text() == "difference of 2"
    page = (out / "index.html").read_text()
    assert all(f'<img src="cells/{name}"' in page for name in names)
    sweep_id = next(iter(engine.sweeps))
    url_of = f"{url}/v1/sweeps/{sweep_id}/cells/{{}}/difference.png"
    assert httpx.get(url_of.format(0)).headers["content-type"] == "image/png"
    for cell in (1, 3):
        answer = httpx.get(url_of.format(cell))
        assert (answer.status_code, answer.json()["code"]) == (404, "artifact_not_found")
    job_id = next(iter(engine.jobs))
    code, _, err = run(capsys, "fetch", job_id, "--kind", "difference", "--url", url)
    assert code == 2 and "name its sweep" in err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--where", "y > 1"], "no axis is called 'y'"),
        (["--where", "x >"], "value is missing"),
        (["--where", "x > 'a'"], "only numbers have an order"),
        (["--cells", "a"], "no cell and no range"),
        (["--kind", "gif"], "none of png, exr, json, svg"),
    ],
)
def test_what_cannot_be_fetched_is_said(
    capsys: pytest.CaptureFixture[str],
    engine: FakeEngine,
    url: str,
    sweep_file: Path,
    options: list[str],
    words: str,
) -> None:
    finish_soon(engine)
    out = sweep_file.parent / "out"
    run(capsys, "sweep", sweep_file, "-o", out, "--fetch", "none", "--url", url)
    code, _, err = run(capsys, "fetch", out, *options, "--url", url)
    assert code == 2 and words in err.replace("\n", " "), err


def test_cells_are_chosen_by_what_their_values_are_called() -> None:
    from matiere.jobs.condition import parse_condition

    jobs = [job(i) for i in range(6)]
    conditions = [parse_condition("material == 'gold' and seconds < 3 and relmse > 0.01")]
    assert [j.cell for j in choose(sweep_of(6), jobs, conditions, None)] == [2]
    assert [j.cell for j in choose(sweep_of(6), jobs, [], {1, 5, 9})] == [1, 5]


def test_what_a_running_sweep_has_can_be_fetched(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, tmp_path: Path
) -> None:
    axes = [{"pointer": "/x", "values": [1, 2, 3]}]
    sweep = engine.submit_sweep({"version": 1}, axes)
    first = next(iter(engine.jobs))
    engine.finish(first, JobState.SUCCEEDED)
    code, said, err = run(
        capsys, "fetch", sweep.id, "-o", tmp_path, "--where", "state == 'succeeded'",
        "--kind", "json", "--url", url,
    )  # fmt: skip
    assert code == 0 and "1 of 3 cells" in err, err
    assert "contact-sheet" not in said, "its sheet is drawn when all cells have ended"
    assert [p.suffix for p in (tmp_path / "cells").iterdir()] == [".json"]


# -- stability ----------------------------------------------------------------------------------
def test_materials_that_vary_are_checked_once_and_the_worst_counts() -> None:
    base = {"materials": {"ball": {"type": "lambert", "k": 0}, "floor": {"type": "lambert"}}}
    plan = parse_sweep({"axes": [{"pointer": "/materials/ball/k", "values": [1, 2]},
                                 {"pointer": "/render/spp", "values": [1, 2]}]},
                       {**base, "render": {}})  # fmt: skip
    assert varying(plan, 0) == [{"type": "lambert", "k": 1}]
    spp = parse_sweep({"axes": [{"pointer": "/render/spp", "values": [1]}]}, {**base, "render": {}})
    assert len(varying(spp, 0)) == 2
    asked = []

    class Stub:
        def check(self, material: dict[str, Any]) -> str:
            asked.append(material["k"])
            if material["k"] == 2:
                raise ServiceError({"code": "invalid_scene"}, 422)
            return "warn"

    stub: Any = Stub()
    assert verdicts(stub, plan, [job(i) for i in range(4)]) == {0: "warn", 1: "warn"}
    assert asked == [1, 2]
