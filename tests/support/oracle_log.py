"""A pytest plugin for `./dev prove materials`: the worst error of each model against its oracle.

    MATIERE_ORACLE_LOG=out.json python -m pytest -p oracle_log tests/material/test_oracle.py

A comparison belongs to the part that it names, or to the model that the test made last.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import oracle

from matiere import _core

worst: dict[str, dict[str, Any]] = {}
_made: list[str] = ["none"]
_real = _core.Bsdf


def _spy(type: str, *rest: Any, **more: Any) -> Any:
    _made[:] = [type]
    return _real(type, *rest, **more)


def _take(error: float, allowed: float, part: str) -> None:
    name = f"{_made[0]}, tables" if part == "table" else part or _made[0]
    known = worst.setdefault(name, {"error": 0.0, "share": 0.0, "checks": 0, "case": ""})
    known["checks"] += 1
    known["error"] = max(known["error"], error)
    if error / allowed > known["share"]:
        known["share"] = error / allowed
        known["case"] = os.environ["PYTEST_CURRENT_TEST"].split("::")[-1].removesuffix(" (call)")


def _curious(error: float) -> bool:
    return error / oracle.ALWAYS > worst.get(_made[0], {"share": 0.0})["share"]


def pytest_configure() -> None:
    """Listen."""
    _core.Bsdf = _spy
    oracle.listeners.append(_take)
    oracle.curious = _curious


def pytest_sessionfinish() -> None:
    """Write what was heard."""
    path = Path(os.environ["MATIERE_ORACLE_LOG"])
    path.write_text(json.dumps(worst, indent=1) + "\n", encoding="utf-8")
