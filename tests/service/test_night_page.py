"""What `matiere compare` prints and writes about two nights in folders."""

from __future__ import annotations

import csv
import html.parser
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.testing

from matiere.jobs.night import FolderWriter
from matiere.service.cli import make_app
from matiere.signature import Signature, _grouped

RUN = typer.testing.CliRunner()


def write(folder: Path, seed: int, **changed: float) -> Path:
    """Write a night of four cells; `cell2=1.1` makes cell 2 brighter, 0 makes it fail."""
    with FolderWriter(folder) as writer:
        for cell in range(4):
            factor = changed.get(f"cell{cell}", 1.0)
            rng = np.random.default_rng(100 * seed + cell)
            pixels = factor * (1 + 0.05 * rng.standard_normal((4, 16, 16, 3)))
            data = Signature(16, 16, 64, _grouped(pixels), False, f"{seed}{cell}{factor}", (seed,))
            failed = factor == 0.0
            row: dict[str, Any] = {
                "cell": cell, "label": f"<alpha> {cell}", "parameters": {"alpha": cell},
                "state": "failed" if failed else "succeeded",
                "error": {"code": "signal", "message": "crashed & burnt"} if failed else None,
                "spp": 64, "seconds": 1.0 + seed, "relmse": 0.01, "relmse_interval": None,
                "stop_reason": "spp", "cached": False, "film_key": "", "job_id": None,
            }  # fmt: skip
            writer.add(row, None if failed else data.to_bytes())
        return writer.close({"name": f"night {seed}", "sweep_id": None, "created": 1.0})


def run(*arguments: object) -> Any:
    """Run the command in this process."""
    words = [str(a) for a in arguments]
    return RUN.invoke(make_app(words), words)


class Tags(html.parser.HTMLParser):
    """Checks that every opened tag is closed, and gathers what a page would load."""

    VOID = frozenset({"meta", "img"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loads += [v or "" for k, v in attrs if k in ("src", "href")]
        if tag not in self.VOID and tag != "rect":
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        if tag != "rect":
            assert self.open.pop() == tag


def test_a_changed_cell_is_printed_written_and_told_by_the_exit_code(tmp_path: Path) -> None:
    a, b = write(tmp_path / "a", 1), write(tmp_path / "b", 2, cell2=1.1)
    found = run("compare", a, b, "-o", tmp_path / "out")
    assert found.exit_code == 1, found.output
    assert "1 of 4 cells changed" in found.output and "cell 2 <alpha> 2: +9.93 %" in found.output
    assert "Smallest detectable change" in found.output and "render seconds: x 1.5" in found.output
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(page)
    assert not tags.open and not tags.loads and "<script" not in page
    assert "&lt;alpha&gt; 2" in page and "<alpha>" not in page
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["changes"][0]["cell"] == 2
    with (tmp_path / "out" / "cells.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 and float(rows[2]["p_corrected"]) < 0.05


@pytest.mark.parametrize(
    ("changed", "code", "words"),
    [({}, 0, "No change beyond noise in 4 cells"), ({"cell1": 0.0}, 3, "crashed & burnt"),
     ({"cell1": 0.0, "cell3": 2.0}, 1, "1 of 3 cells changed")],
)  # fmt: skip
def test_exit_codes(tmp_path: Path, changed: dict[str, float], code: int, words: str) -> None:
    found = run("compare", write(tmp_path / "a", 1), write(tmp_path / "b", 2, **changed))
    assert found.exit_code == code and words in found.output


def test_what_is_no_night_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from matiere.service.cli import main

    a = write(tmp_path / "a", 1)
    for arguments in (["compare", str(a), "nowhere"],
                      ["compare", str(a), str(a), "--method", "t"]):  # fmt: skip
        with pytest.raises(SystemExit) as left:
            main(arguments)
        assert left.value.code == 2
    assert "neither a night's folder" in capsys.readouterr().err


def test_a_night_inside_a_folder_is_found(tmp_path: Path) -> None:
    write(tmp_path / "out" / "night", 1)
    assert run("compare", tmp_path / "out", tmp_path / "out").exit_code == 0
