"""Fixtures of the job tests: engines over the stand-in work module."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # for conftest_jobs and fake_work


@pytest.fixture(autouse=True)
def fake_work_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this process and its children import `fake_work`."""
    monkeypatch.syspath_prepend(str(HERE))
    known = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), *([known] if known else [])]))


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run the test on SQLite and on PostgreSQL: `conftest_jobs.open_engine` opens that."""
    import conftest_jobs

    monkeypatch.setattr(conftest_jobs, "databases", {} if request.param == "postgresql" else None)
    return str(request.param)


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Any]:
    """Return an open engine with two children that render numpy chunks."""
    from conftest_jobs import FAKE, open_engine

    with open_engine(tmp_path / "data", children=2, **FAKE) as opened:
        yield opened
