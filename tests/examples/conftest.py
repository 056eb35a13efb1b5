"""Make the example scripts importable and find the shared assets."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
ASSETS = ROOT.parent / "shared" / "assets"


def load_example(relative: str) -> ModuleType:
    """Import one script of examples/ by path."""
    path = ROOT / "examples" / relative
    sys.path.insert(0, str(path.parent))
    try:
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[path.stem] = module
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))
    return module


@pytest.fixture(scope="session")
def example() -> Callable[[str], ModuleType]:
    """Return the function that imports an example by its path below examples/."""
    return load_example


@pytest.fixture(scope="session")
def assets() -> Path:
    """Return ../shared/assets, or skip where it is not there."""
    if not (ASSETS / "SOURCES.md").is_file():
        pytest.skip(f"no shared assets at {ASSETS}")
    return ASSETS


@pytest.fixture(scope="session")
def shader_ball() -> ModuleType:
    """Return examples/make_shader_ball.py."""
    return load_example("make_shader_ball.py")


@pytest.fixture(scope="session")
def studio_light() -> ModuleType:
    """Return examples/make_studio_light.py."""
    return load_example("make_studio_light.py")


@pytest.fixture(scope="session")
def fit_metals() -> ModuleType:
    """Return examples/metals/fit_metals.py."""
    return load_example("metals/fit_metals.py")
