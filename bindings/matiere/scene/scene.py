"""A checked scene: its model, its files, its digest, and the core's scene built from it."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from matiere.errors import AssetChanged, Cancelled, Fault, SceneValidationError, pointer
from matiere.scene import references
from matiere.scene.assets import AssetRoot
from matiere.scene.document import SCALARS
from matiere.scene.materials import MaterialModel
from matiere.scene.model import SceneModel

if TYPE_CHECKING:
    from matiere import _core
    from matiere.scene.flatten import Flattened, Parts


class Scene:
    """A scene that passed every check. Made by `mt.load`; safe to share between threads."""

    def __init__(self, model: SceneModel, assets: AssetRoot) -> None:
        self.model = model
        self._root = assets
        self._lock = threading.Lock()
        self._built: _core.Scene | None = None
        self._notes: tuple[dict[str, Any], ...] = ()
        self._center = (0.0, 0.0, 0.0)
        self._parts: Parts | None = None

    def __repr__(self) -> str:
        film = self.model.film
        return f"Scene({film.width} x {film.height}, {len(self.model.shapes)} shapes)"

    @property
    def asset_root(self) -> str:
        """The folder the scene's files lie in."""
        return str(self._root.root)

    @property
    def assets(self) -> list[tuple[str, str]]:
        """Every file of the scene as (name, SHA-256 in hex), sorted by name, each once."""
        names = {name for _, name, _ in references.files(self._document())}
        return [(name, self.asset_digest(name)) for name in sorted(names)]

    def asset_digest(self, name: str) -> str:
        """Return the SHA-256 (hex) of one of the scene's files."""
        with self._lock:
            return self._root.digest(name)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the whole scene: canonical JSON, defaults filled, files by content."""
        from matiere.scene.digest import scene_digest

        return scene_digest(self)

    def verify_pins(self) -> None:
        """Raise AssetChanged if a pinned file does not have its digest."""
        changed: list[Fault] = []
        for place, name, _ in references.files(self._document()):
            if name not in self._root.pins:
                continue
            try:
                self.asset_digest(name)
            except SceneValidationError as error:
                changed += [Fault(pointer(*place), f.code, f.message) for f in error.faults]
        if changed:
            raise AssetChanged(changed)

    def flatten(self) -> Flattened:
        """Return the core's description of the scene, reading its files; not kept."""
        with self._lock:
            return self._flatten()

    @property
    def notes(self) -> tuple[dict[str, Any], ...]:
        """What was put right while reading the files: `pointer`, `code`, `message`, `count`."""
        return self._notes

    @property
    def center(self) -> tuple[float, float, float]:
        """The point that the core renders as its origin, m; (0, 0, 0) until the scene is built."""
        return self._center

    def _flatten(self) -> Flattened:
        from matiere.scene.flatten import flatten

        flattened = flatten(self.model, self._root)
        self._notes, self._center = flattened.notes, flattened.center
        self._parts = flattened.parts
        return flattened

    def build(
        self,
        threads: int = 0,
        cancel: _core.CancelToken | None = None,
        on_read: Callable[[], None] | None = None,
        like: Scene | None = None,
    ) -> _core.Scene:
        """Return the core's scene (acceleration structure, light tables); kept once built.

        `threads` is the number of threads that build, 0 for one per usable core. `cancel`, raised
        by another thread, stops the building; `on_read` is called when all files have been read,
        which it does not stop. What `like`, a built scene, has in common is shared where the two
        differ in material parameters, camera, film and render settings alone. Raises
        SceneValidationError for what only building can find out, and Cancelled.
        """
        from matiere import _core

        with self._lock:
            if self._built is None and like is not None:
                self._built = self._built_like(like, threads)
            if self._built is None:
                description = self._flatten().description
                if on_read is not None:
                    on_read()
                try:
                    self._built = _core.Scene(description, threads, cancel)
                except _core.SceneError as error:
                    if getattr(error, "code", "") == "cancelled":
                        raise Cancelled("the building of the scene was cancelled") from None
                    code = str(getattr(error, "code", "invalid_scene"))
                    where = str(getattr(error, "pointer", ""))
                    why = str(getattr(error, "message", error))
                    raise SceneValidationError([Fault(where, code, why)]) from None
            return self._built

    def _built_like(self, like: Scene, threads: int) -> _core.Scene | None:
        """Build with the shapes, textures and maps of another scene; None where they differ."""
        from matiere import _core
        from matiere.scene.flatten import alike, flatten_like

        if like._built is None or like._parts is None or not alike(self.model, like.model):
            return None
        names = self._file_names()
        if names != like._file_names():
            return None
        if any(self._root.digest(name) != like._root.known(name) for name in names):
            return None
        flattened = flatten_like(self.model, like._parts, like._center, like._built)
        try:
            built = _core.Scene(flattened.description, threads)
        except _core.SceneError:  # built by itself it says what is wrong, if anything is
            return None
        self._notes, self._center = flattened.notes, flattened.center
        self._parts = flattened.parts
        return built

    def _file_names(self) -> list[str]:
        return sorted({name for _, name, _ in references.files(self._document())})

    def with_render(self, **changes: Any) -> Scene:
        """Return the scene with other render settings, its files shared and nothing built."""
        render = self.model.render.model_copy(update=changes)
        return Scene(self.model.model_copy(update={"render": render}), self._root)

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as plain JSON values, with what was not given left out."""
        made: dict[str, Any] = given(self.model)
        return made

    def to_json(self, indent: int | None = 1) -> str:
        """Return the scene as JSON text that `mt.load` reads back to an equal scene."""
        return json.dumps(self.to_dict(), indent=indent, allow_nan=False) + "\n"

    def _document(self) -> Mapping[str, Any]:
        shapes = self.model.shapes
        lights = self.model.lights
        names: dict[str, Any] = {
            "lights": [{"ies": getattr(light, "ies", None)} for light in lights],
            "shapes": [{"type": s.type, "file": getattr(s, "file", None)} for s in shapes],
            "textures": {key: {"file": t.file} for key, t in self.model.textures.items()},
            "materials": {key: _file_tree(m) for key, m in self.model.materials.items()},
        }
        if self.model.environment is not None:
            names["environment"] = {"file": self.model.environment.file}
        if not isinstance(self.model.background, str):
            names["background"] = {"file": self.model.background.file}
        return names


def _file_tree(material: MaterialModel) -> dict[str, Any]:
    """Return the files of a material as the document has them."""
    tree: dict[str, Any] = {}
    for place, name in material.files().items():
        inner = tree
        for key in place[:-1]:
            inner = inner.setdefault(key, {"type": ""})
        inner[place[-1]] = name
    return tree


def given(value: Any) -> Any:
    """Return a model as plain JSON values: only the keys that were given, arrays as lists."""
    if type(value) in SCALARS:
        return value
    if isinstance(value, BaseModel):
        names = [name for name in type(value).model_fields if name in value.model_fields_set]
        return {name: given(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {key: given(item) for key, item in value.items()}
    return [given(item) for item in value] if isinstance(value, list | tuple) else value
