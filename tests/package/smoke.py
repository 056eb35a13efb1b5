"""Use the installed wheel alone, as a person would: run by ./dev test in a clean venv.

The venv holds `matiere` without extras; the checkout is not importable from the empty folder used.
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

SCENE = {
    "version": 1,
    "camera": {
        "type": "pinhole",
        "origin": [0, 1, 5],
        "target": [0, 1, 0],
        "up": [0, 1, 0],
        "vfov_deg": 35,
    },
    "film": {"width": 32, "height": 24},
    "render": {"spp": 16},
    "materials": {"ball": {"type": "conductor", "metal": "Au", "alpha": 0.1}},
    "shapes": [{"type": "sphere", "center": [0, 1, 0], "radius": 1, "material": "ball"}],
    "environment": {"radiance": [1, 1, 1]},
}
SERVER_LIBRARIES = ["fastapi", "uvicorn", "sqlalchemy", "alembic", "pysqlite3"]
MATIERE = str(Path(sys.executable).with_name("matiere"))


def run(*command: str, status: int = 0) -> str:
    """Run a command, check its exit status, return what it printed."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    text = done.stdout + done.stderr
    assert done.returncode == status, f"{command}: exit {done.returncode}\n{text}"
    return text


def check_migrations(package: Path) -> None:
    """Every migration of the checkout is in the wheel, and the script that runs them."""
    source = Path(__file__).resolve().parents[2] / "jobs" / "migrations"
    wanted = {path.relative_to(source) for path in source.rglob("*.py")}
    installed = package / "jobs" / "migrations"
    assert wanted and wanted <= {path.relative_to(installed) for path in installed.rglob("*.py")}


def main() -> None:
    """Render by command line and by Python, and ask for a command of the missing extra."""
    for name in SERVER_LIBRARIES:
        assert importlib.util.find_spec(name) is None, f"the base package pulls in {name}"
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        Path("scene.json").write_text(json.dumps(SCENE), encoding="utf-8")
        run(MATIERE, "render", "scene.json", "-o", "out.png", "--threads", "2")
        assert Path("out.png").read_bytes().startswith(b"\x89PNG")
        program = (
            "import matiere as mt; film = mt.render(mt.load('scene.json'), spp=32);"
            "mt.write_image('out.exr', film); assert film.mean.shape == (24, 32, 3);"
            "assert 0.1 < film.mean.mean() <= 1.0, film.mean.mean(); print(mt.__file__)"
        )
        where = run(sys.executable, "-c", program).strip().splitlines()[-1]
        assert "site-packages" in where, where
        assert Path("out.exr").stat().st_size > 0
        check_migrations(Path(where).parent)
        json.loads(run(MATIERE, "schema"))
        print(run(MATIERE, "info"))
        text = run(MATIERE, "serve", status=1)
        assert "matiere[service]" in text, text


main()
