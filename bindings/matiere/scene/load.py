"""Load and check a scene: the one door from JSON (or a dict) into matiere."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from matiere.errors import Fault, SceneValidationError, pointer
from matiere.scene import document, references
from matiere.scene.assets import AssetRoot
from matiere.scene.model import SceneModel
from matiere.scene.scene import Scene


def load(
    source: str | os.PathLike[str] | Mapping[str, Any],
    *,
    asset_root: str | os.PathLike[str] | None = None,
    pins: Mapping[str, str] | None = None,
) -> Scene:
    """Load a scene from a JSON file or a dict, and check it completely.

    A dict may hold numpy arrays for positions, normals, uv, triangles and pixels. Files are looked
    up under `asset_root` (default: the scene file's folder; for a dict the current folder) and
    nowhere else. `pins` maps file names to the SHA-256 (hex) they must have.

    Raises SceneValidationError with every fault at once, and AssetChanged for a broken pin.
    """
    if isinstance(source, Mapping):
        raw: Any = source
        root = Path(asset_root or ".")
    else:
        raw = document.read(source)
        root = Path(asset_root) if asset_root is not None else Path(source).resolve().parent
    return check(raw, AssetRoot(root, dict(pins or {})))


def loads(
    text: str | bytes,
    *,
    asset_root: str | os.PathLike[str] = ".",
    pins: Mapping[str, str] | None = None,
) -> Scene:
    """Load a scene from JSON text; otherwise like `load`."""
    return check(document.parse(text), AssetRoot(Path(asset_root), dict(pins or {})))


def check(raw: Any, assets: AssetRoot) -> Scene:
    """Return the checked scene of a parsed document, or raise all its faults at once."""
    plain, found = document.plain(raw)
    if any(fault.code == "too_deep" for fault in found):
        raise SceneValidationError(found)
    if not isinstance(plain, Mapping):
        raise SceneValidationError([Fault("", "wrong_type", "a scene is a JSON object: {...}")])
    model = None
    content = {key: value for key, value in plain.items() if key != "$schema"}  # for editors
    try:
        model = SceneModel.model_validate(content)
    except ValidationError as error:
        found += [_fault(dict(line)) for line in error.errors(include_url=False)]
    found += references.faults(plain, assets)
    if found or model is None:
        raise SceneValidationError(_in_order(found, plain))
    scene = Scene(model, assets)
    scene.verify_pins()
    return scene


def _fault(line: dict[str, Any]) -> Fault:
    suggestion = line.get("ctx", {}).get("suggestion")
    return Fault(pointer(*line["loc"]), line["type"], line["msg"], suggestion)


def _in_order(found: list[Fault], plain: Mapping[str, Any]) -> list[Fault]:
    """Sort faults as their places follow each other in the document; keep one per place."""
    first: dict[str, Fault] = {}
    for fault in found:
        first.setdefault(fault.pointer, fault)
    return sorted(first.values(), key=lambda fault: _position(fault.pointer, plain))


def _position(at: str, plain: Any) -> tuple[int, ...]:
    place: list[int] = []
    for part in at.split("/")[1:]:
        key = part.replace("~1", "/").replace("~0", "~")
        if isinstance(plain, Mapping):
            keys = list(plain)
            place.append(keys.index(key) if key in plain else len(keys))
            plain = plain.get(key)
        else:
            place.append(int(key) if key.isdigit() else 0)
            plain = plain[int(key)] if isinstance(plain, list) and key.isdigit() else None
    return tuple(place)
