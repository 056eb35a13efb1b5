"""Shared fixtures of all tests."""

import signal
from pathlib import Path

import pytest

# A shell that starts the tests in the background ignores SIGINT for them and their children: the
# tests of Ctrl-C would wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def root() -> Path:
    """Return the folder of the checkout."""
    return ROOT


@pytest.fixture(scope="session")
def shared_assets() -> Path:
    """Return ../shared/assets, or skip: those files are not part of the project."""
    folder = ROOT.parent / "shared" / "assets"
    if not folder.is_dir():
        pytest.skip(f"needs the sample assets in {folder}")
    return folder
