"""A pytest plugin for `./dev prove materials`: the worst error of each model against its oracle.

    MATIERE_ORACLE_LOG=out.json python -m pytest -p oracle_log tests/material/test_oracle.py

A comparison belongs to the model that the test made last.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import oracle

from matiere import _core

worst: dict[str, dict[str, float]] = {}
_made: list[str] = ["none"]
_real = _core.Bsdf


def _spy(type: str, *rest: Any, **more: Any) -> Any:
    _made[:] = [type]
    return _real(type, *rest, **more)


def _take(error: float, allowed: float) -> None:
    known = worst.setdefault(_made[0], {"error": 0.0, "share": 0.0, "checks": 0})
    known["checks"] += 1
    known["error"] = max(known["error"], error)
    known["share"] = max(known["share"], error / allowed)


def pytest_configure() -> None:
    """Listen."""
    _core.Bsdf = _spy
    oracle.listeners.append(_take)


def pytest_sessionfinish() -> None:
    """Write what was heard."""
    path = Path(os.environ["MATIERE_ORACLE_LOG"])
    path.write_text(json.dumps(worst, indent=1) + "\n", encoding="utf-8")
