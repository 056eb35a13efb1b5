"""Commands that only talk to a service load neither the server nor the database nor the core."""

from __future__ import annotations

import subprocess
import sys

import pytest

SERVER = {"fastapi", "starlette", "uvicorn", "sqlalchemy", "alembic", "pysqlite3", "sqlite3"}
PIXELS = {"OpenImageIO", "PyOpenColorIO", "trimesh", "matiere._core", "matplotlib"}


def loaded_after(code: str) -> set[str]:
    """Return the modules that a fresh interpreter has loaded after `code`."""
    tail = "\nimport sys; print('\\n' + ' '.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code + tail], capture_output=True, text=True, timeout=120, check=True
    )
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize("module", ["client", "sweep_run", "find", "console", "sweep_output"])
def test_client_side_modules_are_light(module: str) -> None:
    loaded = loaded_after(f"import matiere.service.{module}")
    assert not loaded & (SERVER | PIXELS)


@pytest.mark.parametrize("command", ["serve", "submit", "sweep", "config"])
def test_help_loads_only_the_command_line(command: str) -> None:
    loaded = loaded_after(
        "from matiere.service.cli import main\n"
        f"try: main(['{command}', '--help'])\nexcept SystemExit: pass"
    )
    assert not loaded & (SERVER | PIXELS | {"httpx", "numpy"})


def test_the_application_loads_no_image_library() -> None:
    assert not loaded_after("import matiere.service.app") & PIXELS
