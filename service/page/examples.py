"""The shelf of example scenes: those of the repository that need no files of their own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
FOLDERS = (HERE / "scenes", HERE.parents[1] / "examples" / "scenes")  # installed, checked out
MOST_BYTES = 40_000  # a scene that nobody would read in an editor
LINE = 96

ABOUT: Mapping[str, tuple[str, str]] = {
    "first": ("Gold ball", "A rough gold ball on a grey floor under two soft boxes."),
    "rough_metals": ("Rough metals", "Metals beside each other, from polished to rough."),
    "glass_sphere": ("Glass ball", "A clear dielectric with the light it gathers."),
    "cornell": ("Box", "Light that comes by way of coloured walls."),
    "caustic": ("Caustic", "Light of a small lamp gathered by a metal ring."),
}
SWEEP = ("metals-sweep", "Sweep: metals by roughness", "Three metals, four roughnesses: 12 cells.")


@dataclass(frozen=True)
class Example:
    """A scene, or a sweep over one, to begin with."""

    name: str
    title: str
    about: str
    text: str
    picture: str | None  # file of static/


@cache
def shelf() -> dict[str, Example]:
    """Return the examples by name, in order."""
    folder = next((f for f in FOLDERS if f.is_dir()), None)
    found: dict[str, Example] = {}
    for name, (title, about) in ABOUT.items():
        path = folder / f"{name}.json" if folder else None
        if path is not None and path.is_file() and path.stat().st_size <= MOST_BYTES:
            text = path.read_text(encoding="utf-8").rstrip() + "\n"
            found[name] = Example(name, title, about, text, _picture(name))
    if not found:
        found["empty"] = Example("empty", "Empty", "", '{"version": 1}\n', None)
    if "first" in found:
        found[SWEEP[0]] = Example(*SWEEP, _sweep(found["first"].text), _picture(SWEEP[0]))
    return found


def _picture(name: str) -> str | None:
    file = f"examples/{name}.jpg"
    return file if (HERE / "static" / file).is_file() else None


def _sweep(scene: str) -> str:
    base = json.loads(scene) | {"film": {"width": 160, "height": 120}}
    metals = ["Au", "Cu", "Ag"]
    axes = [
        {"pointer": "/materials/ball/metal", "values": metals, "label": "metal"},
        {"pointer": "/materials/ball/alpha", "logspace": [0.02, 0.5, 4], "label": "alpha"},
    ]
    return layout({"base": base, "axes": axes, "stop": {"spp": 16}})


def layout(value: Any, indent: int = 0) -> str:
    """Return JSON as a person would lay it out: short values on one line."""
    flat = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, dict | list) or len(flat) + indent <= LINE:
        return flat + ("" if indent else "\n")
    pad = " " * (indent + 1)
    if isinstance(value, dict):
        items = [
            f"{pad}{json.dumps(key, ensure_ascii=False)}: {layout(item, indent + 1)}"
            for key, item in value.items()
        ]
    else:
        items = [pad + layout(item, indent + 1) for item in value]
    brackets = "{}" if isinstance(value, dict) else "[]"
    text = brackets[0] + "\n" + ",\n".join(items) + "\n" + " " * indent + brackets[1]
    return text + ("" if indent else "\n")
