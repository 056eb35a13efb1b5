"""Which files a submission names, and what is in them: read beside the scene, nowhere else."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any


def local_files(document: Mapping[str, Any], root: Path) -> dict[str, tuple[str, Path]]:
    """Return {name: (SHA-256, path)} of the scene's files that lie below `root`."""
    from matiere.scene import references

    names = {name for _, name, _ in references.files(document)}
    return {name: found for name in sorted(names) if (found := _local(name, root)) is not None}


def files_of_sweep(body: Mapping[str, Any], root: Path) -> dict[str, tuple[str, Path]]:
    """Return the files that a sweep puts into its scenes: by a pointer, or inside values."""
    names: set[str] = set()
    called: list[str] = []  # pointers and axis labels whose values are file names
    sets = body.get("sets") or {}
    for axis in body.get("axes") or ():
        pointers = axis.get("pointer")
        pointers = [pointers] if isinstance(pointers, str) else pointers or []
        values = axis.get("values") or sets.get(axis.get("set")) or []
        values = list(values.values()) if isinstance(values, Mapping) else values
        names |= set(_named_files(values))
        if any(str(at).endswith("/file") for at in pointers):
            names |= {name for name in values if isinstance(name, str)}
            called.append(axis.get("label") or "file")
    settings = [*(body.get("list") or ()), *(o.get("set", {}) for o in body.get("overrides") or ())]
    for values in settings:
        names |= set(_named_files(list(values.values())))
        for to, name in values.items():
            if isinstance(name, str) and (to.endswith("/file") or to in called):
                names.add(name)
    return {name: found for name in sorted(names) if (found := _local(name, root)) is not None}


def _named_files(value: Any) -> Iterator[str]:
    """Yield what stands under a key `file` anywhere in a value."""
    if isinstance(value, Mapping):
        if isinstance(name := value.get("file"), str):
            yield name
        value = list(value.values())
    if isinstance(value, list):
        for inner in value:
            yield from _named_files(inner)


def _local(name: str, root: Path) -> tuple[str, Path] | None:
    """Return digest and path of a file below `root`; None for anything else."""
    try:
        path = (root / name).resolve(strict=True)
        if not path.is_relative_to(root.resolve()) or not path.is_file():
            return None
        return file_digest(path), path
    except (OSError, ValueError):  # a name with a NUL, too long, a loop of links ...
        return None


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file in lower-case hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_scene(
    scene: str | os.PathLike[str] | Mapping[str, Any], root: str | os.PathLike[str] | None
) -> tuple[dict[str, Any], Path]:
    """Return a scene and the folder of its files; raise `SceneValidationError` for no object."""
    if isinstance(scene, Mapping):
        return dict(scene), Path(root or ".")
    from matiere.errors import Fault, SceneValidationError
    from matiere.scene import document

    path = Path(scene)
    plain, faults = document.plain(document.read(path))
    if not faults and not isinstance(plain, dict):
        faults = [Fault("", "wrong_type", "a scene is a JSON object: {...}")]
    if faults:
        raise SceneValidationError(faults)
    return plain, Path(root) if root is not None else path.resolve().parent
