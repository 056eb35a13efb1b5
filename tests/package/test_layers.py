"""The arrows between layers go one way: both tables of the house style, checked on the sources."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# A folder of core includes only itself and folders to its left.
CORE_ORDER = [
    *("base", "sampling", "optics", "texture", "material", "shape", "light", "camera"),
    *("film", "accel", "scene", "integrator", "render"),
]

# A layer of Python imports only itself and layers to its right.
PYTHON_FOLDERS = {"service": "service", "jobs": "jobs", "matiere": "bindings/matiere"}
PYTHON_ORDER = ["service", "jobs", "matiere"]

# Where a library may be imported (paths from the root, as prefixes); "lazy" ones inside functions.
ALLOWED_IMPORTS = {
    "OpenImageIO": ["bindings/matiere/imageio.py"],
    "PyOpenColorIO": ["bindings/matiere/develop.py"],
    "fastapi": ["service/"],
    "starlette": ["service/"],
    "uvicorn": ["service/"],
    "typer": ["service/"],
    "sqlalchemy": ["jobs/store", "jobs/migrations/"],
    "alembic": ["jobs/store", "jobs/migrations/"],
    "pysqlite3": ["jobs/store"],
    "sqlite3": ["jobs/store"],
    "prometheus_client": ["service/metrics.py"],
    "opentelemetry": ["jobs/tracing.py"],
    "ray": ["jobs/cluster/driver.py"],
}
# The public face names the client, which it loads when it is first used.
LAZY_FACE = ("bindings/matiere/__init__.py", "matiere.service.client.")
LAZY_LIBRARIES = {"opentelemetry", "OpenImageIO", "PyOpenColorIO", "trimesh", "matplotlib", "scipy"}


def _python_files(*folders: str) -> list[Path]:
    found = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    assert found, folders
    return sorted(found)


def _imports(tree: ast.AST, module: str) -> Iterator[tuple[str, int, bool]]:
    """Every imported dotted name of a module, its line, and whether it runs at import time."""

    def visit(node: ast.AST, top: bool) -> Iterator[tuple[str, int, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                for alias in child.names:
                    yield alias.name, child.lineno, top
            elif isinstance(child, ast.ImportFrom):
                base = child.module or ""
                if child.level:
                    parent = module.split(".")[: -child.level]
                    base = ".".join([*parent, base] if base else parent)
                for alias in child.names:
                    yield f"{base}.{alias.name}", child.lineno, top
            elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
                yield from visit(child, False)
            else:
                inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
                yield from visit(child, top and not inside)

    yield from visit(tree, True)


def _module_name(path: Path) -> str:
    relative = path.relative_to(ROOT).with_suffix("")
    parts = list(relative.parts)
    parts = parts[1:] if parts[0] == "bindings" else ["matiere", *parts]
    if parts[-1] == "__init__":
        parts[-1] = "__init__"  # kept, so that a relative import of level 1 means the package
    return ".".join(parts)


def _package_imports(*folders: str) -> Iterator[tuple[str, str, int, bool]]:
    for path in _python_files(*folders):
        tree = ast.parse(path.read_text(encoding="utf-8"), filename=str(path))
        for name, line, top in _imports(tree, _module_name(path)):
            yield path.relative_to(ROOT).as_posix(), name, line, top


def _layer_of(name: str) -> str | None:
    for layer in ("service", "jobs"):
        if name == f"matiere.{layer}" or name.startswith(f"matiere.{layer}."):
            return layer
    return "matiere" if name == "matiere" or name.startswith("matiere.") else None


def test_python_layers_import_to_the_right_only() -> None:
    faults = []
    for layer, folder in PYTHON_FOLDERS.items():
        for path, name, line, top in _package_imports(folder):
            target = _layer_of(name)
            if path == LAZY_FACE[0] and name.startswith(LAZY_FACE[1]) and not top:
                continue
            if target and PYTHON_ORDER.index(target) < PYTHON_ORDER.index(layer):
                faults.append(f"{path}:{line}: {layer} imports {name}")
    assert not faults, "\n".join(faults)


def test_nobody_imports_bare_service_or_jobs() -> None:
    """`import jobs` works from the root of the checkout and loads a second copy."""
    faults = [
        f"{path}:{line}: {name}"
        for path, name, line, _ in _package_imports("bindings", "service", "jobs", "tests")
        if name.split(".")[0] in ("service", "jobs", "bindings", "core")
    ]
    assert not faults, "\n".join(faults)


def test_libraries_are_imported_in_their_one_place() -> None:
    faults = []
    for path, name, line, top in _package_imports(*PYTHON_FOLDERS.values()):
        library = name.split(".")[0]
        places = ALLOWED_IMPORTS.get(library)
        if places is not None and not any(path.startswith(place) for place in places):
            faults.append(f"{path}:{line}: {library} belongs to {places}")
        if library in LAZY_LIBRARIES and top:
            faults.append(f"{path}:{line}: {library} must be imported inside a function")
    assert not faults, "\n".join(faults)


def _includes(path: Path) -> Iterator[tuple[int, str, bool]]:
    pattern = re.compile(r'\s*#\s*include\s*(["<])([^">]+)[">]')
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if match := pattern.match(line):
            yield number, match[2], match[1] == "<"


def _core_files() -> list[Path]:
    return sorted([*(ROOT / "core").rglob("*.h"), *(ROOT / "core").rglob("*.cpp")])


def test_core_folders_are_the_known_ones() -> None:
    folders = {path.relative_to(ROOT / "core").parts[0] for path in _core_files()}
    assert folders <= set(CORE_ORDER), folders - set(CORE_ORDER)


def test_core_includes_to_the_left_only() -> None:
    faults = []
    for path in _core_files():
        folder = path.relative_to(ROOT / "core").parts[0]
        for line, name, angled in _includes(path):
            where = f"{path.relative_to(ROOT)}:{line}: includes {name}"
            if angled:
                continue
            target = name.split("/")[0]
            if target not in CORE_ORDER or not (ROOT / "core" / name).is_file():
                faults.append(f"{where}: not a path below core/")
            elif CORE_ORDER.index(target) > CORE_ORDER.index(folder):
                faults.append(f"{where}: {target} is to the right of {folder}")
    assert not faults, "\n".join(faults)


def test_core_includes_only_the_standard_library_and_embree() -> None:
    # No dot: a C++ standard header. sched.h and pmmintrin.h: our threads and the FTZ/DAZ guard.
    standard = re.compile(r"[a-z_0-9]+|[a-z]*intrin\.h|sched\.h|pthread\.h")
    faults = []
    for path in _core_files():
        folder = path.relative_to(ROOT / "core").parts[0]
        for line, name, angled in _includes(path):
            if not angled or standard.fullmatch(name):
                continue
            if not (folder == "accel" and name.startswith("embree")):
                faults.append(f"{path.relative_to(ROOT)}:{line}: {name}")
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    "word",
    ["iostream", r"printf\s*\(", r"std::(cout|cerr)", r"\bgetenv\b", r"\bexit\s*\(", r"\babort\("],
)
def test_core_neither_prints_nor_exits_nor_reads_the_environment(word: str) -> None:
    faults = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in _core_files()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if re.search(word, line.split("//")[0]) and "snprintf" not in line
    ]
    assert not faults, "\n".join(faults)


def test_only_bindings_include_pybind11() -> None:
    for path in _core_files():
        assert "pybind11" not in path.read_text(encoding="utf-8"), path


def _loaded_after(statement: str) -> set[str]:
    program = f"import sys\n{statement}\nprint(*sys.modules)"
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stderr
    return {name.split(".")[0] for name in run.stdout.splitlines()[-1].split()}


HEAVY = ["OpenImageIO", "PyOpenColorIO", "trimesh", "matplotlib", "scipy"]
SERVER = ["fastapi", "uvicorn", "sqlalchemy", "alembic", "pysqlite3", "sqlite3"]


def test_importing_matiere_loads_no_heavy_library() -> None:
    loaded = _loaded_after("import matiere")
    assert not loaded & {*HEAVY, *SERVER, "typer", "rich"}, loaded & {*HEAVY, *SERVER}


@pytest.mark.parametrize("command", ["render", "schema", "info"])
def test_a_command_of_the_base_package_loads_no_server_library(command: str) -> None:
    run = f"""
from matiere.service.cli import main
sys.argv = ["matiere", {command!r}, "--help"]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print()"""
    loaded = _loaded_after(run)
    assert not loaded & {*HEAVY, *SERVER}, loaded & {*HEAVY, *SERVER}


def test_no_acceptance_line_hides_a_library_from_the_others() -> None:
    """Python looks beside the script first: `prove/http.py` would be everybody's `http`."""
    names = {path.stem for path in (ROOT / "tests" / "prove").glob("*.py")}
    assert not names & (sys.stdlib_module_names | set(packages_distributions()))
