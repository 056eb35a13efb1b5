"""`import matiere` is quick, and each command imports only what it uses."""

from __future__ import annotations

import json
import subprocess
import sys

HEAVY = ("numpy", "pydantic", "trimesh", "OpenImageIO", "PyOpenColorIO", "matiere._core")
SERVICE = ("fastapi", "uvicorn", "sqlalchemy", "alembic", "pysqlite3", "httpx", "matplotlib")

SCENE = {
    "version": 1,
    "camera": {"type": "pinhole", "origin": [0, 0, 5], "target": [0, 0, 0]},
    "film": {"width": 4, "height": 4},
    "materials": {"grey": {"type": "lambert"}},
    "shapes": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "grey"}],
    "environment": {"radiance": 1},
}


def loaded_after(code: str) -> set[str]:
    """Return the names of the modules that a fresh interpreter has loaded after `code`."""
    tail = "\nimport sys, json; print('\\n' + json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code + tail], capture_output=True, text=True, timeout=120, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_import_alone_loads_nothing_heavy() -> None:
    loaded = loaded_after("import matiere")
    assert not loaded.intersection(HEAVY + SERVICE)


def test_the_client_needs_no_server_and_no_renderer() -> None:
    loaded = loaded_after("import matiere as mt\nmt.Client('http://127.0.0.1:9').close()")
    server = ("fastapi", "uvicorn", "sqlalchemy", "matplotlib", "matiere.jobs", "matiere._core")
    assert "httpx" in loaded and not loaded.intersection(server)


def test_a_client_without_httpx_says_what_to_install() -> None:
    code = (
        "import sys, matiere as mt\nsys.modules['httpx'] = None\n"
        "try: mt.Client\n"
        "except ModuleNotFoundError as error: assert 'matiere[client]' in str(error), error\n"
        "else: raise AssertionError"
    )
    loaded_after(code)


def test_render_help_loads_neither_service_nor_images() -> None:
    code = (
        "from matiere.service.cli import main\n"
        "try: main(['render', '--help'])\nexcept SystemExit: pass"
    )
    loaded = loaded_after(code)
    unwanted = (*SERVICE, "OpenImageIO", "PyOpenColorIO", "trimesh", "matiere._core", "numpy")
    assert not loaded.intersection(unwanted)


def test_loading_a_scene_without_files_needs_no_file_library() -> None:
    loaded = loaded_after(
        f"import json, matiere as mt\nmt.load(json.loads('''{json.dumps(SCENE)}'''))"
    )
    assert not loaded.intersection(("trimesh", "OpenImageIO", "PyOpenColorIO", *SERVICE))


def test_rendering_a_scene_without_files_needs_no_file_library() -> None:
    code = (
        f"import json, matiere as mt\nscene = mt.load(json.loads('''{json.dumps(SCENE)}'''))\n"
        "mt.render(scene, spp=4, threads=1)"
    )
    loaded = loaded_after(code)
    assert not loaded.intersection(("trimesh", "OpenImageIO", "PyOpenColorIO", *SERVICE))


WRITE = (
    "import json, os, tempfile, matiere as mt\n"
    f"scene = mt.load(json.loads('''{json.dumps(SCENE)}'''))\n"
    "film = mt.render(scene, spp=4, threads=1)\n"
    "place = os.path.join(tempfile.mkdtemp(), 'a')\n"
)


def test_writing_a_film_as_exr_needs_no_colour_management() -> None:
    loaded = loaded_after(WRITE + "mt.write_image(place + '.exr', film)")
    assert "OpenImageIO" in loaded and "PyOpenColorIO" not in loaded


def test_a_view_is_what_colour_management_is_for() -> None:
    assert "PyOpenColorIO" in loaded_after(WRITE + "mt.write_image(place + '.png', film)")


PEAK = (
    "\nprint(int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]))"
    "\nimport OpenImageIO, PyOpenColorIO"
    "\nprint(int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]))"
)


def test_the_memory_of_a_render_is_without_the_file_libraries() -> None:
    """Loading them afterwards raises the peak: until then the process did without."""
    code = (
        f"import json, matiere as mt\nscene = mt.load(json.loads('''{json.dumps(SCENE)}'''))\n"
        "mt.render(scene, spp=4, threads=1)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code + PEAK], capture_output=True, text=True, timeout=120, check=True
    )
    without, with_them = (int(line) * 1024 for line in done.stdout.split())
    assert with_them - without > 16 * 2**20, (without, with_them)
    assert without < 128 * 2**20, without


def test_writing_an_array_needs_no_colour_management() -> None:
    code = (
        "import numpy as np, tempfile, os, matiere as mt\n"
        "folder = tempfile.mkdtemp()\n"
        "mt.write_image(os.path.join(folder, 'a.png'), np.zeros((2, 2, 3), np.float32))"
    )
    loaded = loaded_after(code)
    assert "OpenImageIO" in loaded
    assert "PyOpenColorIO" not in loaded
