"""The soak of ./dev prove soak, one minute long."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

PROVE = Path(__file__).resolve().parents[1] / "prove"


@pytest.fixture
def soak(monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    """Load the acceptance line."""
    monkeypatch.syspath_prepend(str(PROVE))
    spec = importlib.util.spec_from_file_location("prove_soak", PROVE / "soak.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "prove_soak", module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("leak", [0.0, 5000.0])
def test_the_fit_finds_a_leak_and_invents_none(soak, leak: float) -> None:  # type: ignore[no-untyped-def]
    """A life of its own height each, noise of a megabyte, a leak of 5 kB/s or none."""
    noise = np.random.default_rng(7)
    points = [
        (life, float(at), 1e8 * (1 + life) + leak * at + 1e6 * noise.standard_normal())
        for life in range(6)
        for at in range(300)
    ]
    found = soak.slope(points, warm_s=30.0)
    print(found)
    assert found["low"] <= leak <= found["high"]
    assert (found["low"] > 0) == bool(leak)


@pytest.mark.slow
def test_a_minute_leaves_nothing_behind(soak, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Memory is judged by the half hour alone: a minute is warm-up."""
    result = soak.measure(60.0, 3, tmp_path / "data")
    print(result)
    good = soak.verdict(result)
    assert result["lives"] == soak.lives_of(60.0) + 1 and result["done"]["job"] > 10
    assert good["artifacts"] and good["store"] and good["descriptors"], result
