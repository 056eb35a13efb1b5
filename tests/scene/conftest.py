"""Helpers of the scene tests."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from matiere import _core

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)


class Recorder:
    """Stands in for `_core.RenderDescription` and keeps what flatten says to it."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any, **named: Any) -> int:
            self.calls.append((name, arguments, named))
            return len(self.of(name)) - 1

        return call

    def of(self, name: str) -> list[tuple[Any, ...]]:
        """Return the positional arguments of every call of one method."""
        return [arguments for called, arguments, _ in self.calls if called == name]

    def calls_of(self, name: str) -> list[tuple[tuple[Any, ...], dict[str, Any]]]:
        """Return positional and keyword arguments of every call of one method."""
        return [(arguments, keys) for called, arguments, keys in self.calls if called == name]


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let flatten talk to a Recorder; the real class takes the same calls (test_stub)."""
    monkeypatch.setattr(_core, "RenderDescription", Recorder)
