"""Reading a sweep file: a base scene, the axes along which it varies, and how to render it.

The format is described in docs/sweep.md.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import rfc8785
from pydantic import ConfigDict, Field, ValidationError

from matiere.errors import Fault, SceneValidationError, pointer
from matiere.jobs.budget import STOP_KEYS
from matiere.jobs.sweep import SweepPlan, parse_sweep
from matiere.scene import document
from matiere.service.schemas import Label, SweepLanguage


class SweepFile(SweepLanguage):
    """A sweep file, version 1."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    version: Literal[1]
    base: str | dict[str, Any] = Field(
        description="the scene, or the name of its file beside this one"
    )
    render: dict[str, Any] = Field(
        default_factory=dict, description="laid over the base scene's `render` section"
    )
    columns: int | None = Field(None, ge=1, le=1000)
    label: Label = ""
    priority: int | None = Field(None, ge=0, le=100)


@dataclass(frozen=True)
class LoadedSweep:
    """A sweep ready to submit."""

    base: dict[str, Any]
    axes: list[dict[str, Any]]
    mode: str
    columns: int | None
    label: str
    priority: int | None
    root: Path  # folder of the base scene, where its files lie
    plan: SweepPlan
    language: dict[str, Any] = field(default_factory=dict)  # beside axes and mode

    def digest(self, files: dict[str, tuple[str, Path]]) -> str:
        """Return a SHA-256 (hex) over all that decides the images, `files` included."""
        pins = {name: digest for name, (digest, _) in files.items()}
        parts = [self.base, self.axes, self.mode, self.columns, pins]
        if self.language:
            parts.append(self.language)
        return hashlib.sha256(rfc8785.dumps(parts)).hexdigest()


def load_sweep(path: Path) -> LoadedSweep:
    """Read a sweep file and its base scene.

    Raises `SceneValidationError` with pointers into the sweep file; the scenes are checked by the
    service, cell by cell.
    """
    plain = _plain(path, "")
    try:
        sweep = SweepFile.model_validate(plain)
    except ValidationError as error:
        raise SceneValidationError(
            Fault(pointer(*item["loc"]), item["type"], item["msg"])
            for item in error.errors(include_url=False)
        ) from None
    folder = path.resolve().parent
    base: Any = sweep.base
    if isinstance(base, str):
        scene_path = folder / base
        base, folder = _plain(scene_path, "/base"), scene_path.resolve().parent
        if not isinstance(base, dict):
            raise SceneValidationError([Fault("/base", "wrong_type", "a scene is a JSON object")])
    render = base.get("render")
    base = {**base, "render": {**(render if isinstance(render, dict) else {}), **sweep.render}}
    if sweep.budget is not None and (given := [k for k in STOP_KEYS if k in sweep.render]):
        why = "a sweep has a budget or a stop rule, not both; its budget names the target_error"
        raise SceneValidationError([Fault(pointer("render", given[0]), "exclusive_keys", why)])
    language = sweep.language()
    plan = parse_sweep({"mode": sweep.mode, **language}, base)
    return LoadedSweep(
        base=base,
        axes=language.pop("axes", []),
        mode=sweep.mode,
        columns=sweep.columns,
        label=sweep.label or path.stem,
        priority=sweep.priority,
        root=folder,
        plan=plan,
        language=language,
    )


def _plain(path: Path, at: str) -> Any:
    """Return the JSON of a file; every fault is placed at `at` with the file's name before it."""
    try:
        plain, faults = document.plain(document.read(path))
    except SceneValidationError as error:
        plain, faults = None, list(error.faults)
    if faults:
        raise SceneValidationError(
            Fault(at or f.pointer, f.code, f"{path.name}{at and f.pointer}: {f.message}")
            for f in faults
        )
    return plain
