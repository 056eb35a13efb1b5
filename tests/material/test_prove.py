"""`./dev prove materials` on a few parameter sets: the table, and going on where it stopped."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PROVE = Path(__file__).resolve().parents[1] / "prove" / "materials.py"


def prove(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, PROVE, *arguments], capture_output=True, text=True, check=False,
        timeout=300, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip


@pytest.mark.slow
def test_the_table_of_a_sample(tmp_path: Path) -> None:
    asked = ["lambert", "mirror", "plastic", "--sample", "2", "--no-oracle", "--out", str(tmp_path)]
    done = prove(*asked)
    assert done.returncode == 0, done.stdout + done.stderr
    table = (tmp_path / "materials.md").read_text(encoding="utf-8")
    assert [line.split("|")[1].strip() for line in table.splitlines()[2:]] == [
        "lambert", "plastic", "mirror",
    ]  # fmt: skip
    assert "FAIL" not in table and "DISAGREE" not in table
    kept = json.loads((tmp_path / "materials.json").read_text(encoding="utf-8"))
    assert all(row["float"] == row["double"] for row in kept["rows"].values())
    assert " 0 to judge" in prove(*asked).stdout


def test_an_unknown_model_is_refused() -> None:
    done = prove("wood")
    assert done.returncode == 2 and "wood" in done.stderr
