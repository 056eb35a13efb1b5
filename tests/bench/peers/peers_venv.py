"""The environment of the peers: pinned packages in a venv of their own, and an LLVM for Mitsuba."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

MITSUBA, LUXCORE, BLENDER = "mitsuba==3.9.1", "pyluxcore==2.11.2", "bpy==5.0.1"
LLVM_VERSIONS = range(16, 20)  # 14 aborts; 15 cannot select instructions on AVX-512 machines


def say(text: str) -> None:
    """Print a line of progress."""
    print(f"[peers] {text}", file=sys.stderr, flush=True)


def installed(python: Path, module: str) -> bool:
    """Return whether a Python finds a module, without importing it."""
    code = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({module!r}) is None)"
    return subprocess.run([str(python), "-c", code], check=False).returncode == 0


def peers_python(given: Path | None, venv: Path) -> tuple[Path, dict[str, str]]:
    """Return the Python of the peers, made if none is given, and renderer -> why it cannot run."""
    python = given or venv / "bin" / "python"
    if given is None and not (venv / ".stamp").exists():
        maker = shutil.which("python3.11") or sys.executable
        say(f"making {venv} with {maker} (once, about 1.5 GB)")
        subprocess.run([maker, "-m", "venv", "--clear", str(venv)], check=True)
        wanted = [MITSUBA, LUXCORE]
        asked = subprocess.run([str(python), "-V"], check=True, capture_output=True, text=True)
        if asked.stdout.startswith("Python 3.11."):
            wanted.append(BLENDER)
        for package in wanted:  # one by one: a package that is not to be had costs only itself
            command = [str(python), "-m", "pip", "install", "--quiet", package]
            if subprocess.run(command, check=False).returncode != 0:
                say(f"{package} could not be installed")
        (venv / ".stamp").write_text("\n".join(wanted) + "\n", encoding="utf-8")
    modules = {"mitsuba-scalar": "mitsuba", "mitsuba-llvm": "mitsuba"}
    modules |= {"luxcore": "pyluxcore", "cycles": "bpy"}
    missing = {}
    for renderer, module in modules.items():
        if not installed(python, module):
            missing[renderer] = f"no module {module} in {python} (bpy 5.0.1 wants Python 3.11)"
    return python, missing


def find_llvm() -> Path | None:
    """Return an LLVM library Mitsuba's LLVM variants work with, installed if root and apt can."""
    found = newest_llvm()
    if found is None and os.geteuid() == 0 and shutil.which("apt-get"):
        say("installing libllvm19")
        command = ["apt-get", "install", "-y", "--no-install-recommends", "libllvm19"]
        subprocess.run(command, check=False, capture_output=True)
        found = newest_llvm()
    return found


def newest_llvm() -> Path | None:
    """Return the newest fitting LLVM library of this system."""
    best: tuple[int, Path] | None = None
    for folder in ("/usr/lib/x86_64-linux-gnu", "/usr/lib64", "/usr/lib"):
        for path in Path(folder).glob("libLLVM*.so*"):
            found = re.match(r"libLLVM(?:-(\d+)|\.so\.(\d+))", path.name)
            version = int(found[1] or found[2]) if found else 0
            if version in LLVM_VERSIONS and (best is None or version > best[0]):
                best = version, path
    return best[1] if best else None
