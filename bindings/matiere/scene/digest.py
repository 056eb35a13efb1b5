"""Digests of scenes: what was asked for, and the key of the film it leads to.

Both are the SHA-256 of RFC 8785 canonical JSON in which defaults are filled in and files and arrays
are replaced by the SHA-256 of their content. The film key leaves out everything that does not
change the samples of a film, and adds what does: the engine that makes them.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

import numpy as np

from matiere.scene.document import SCALARS
from matiere.scene.materials import FileName, MaterialModel, TextureRef

if TYPE_CHECKING:
    from matiere.scene.checks import Node
    from matiere.scene.scene import Scene

_TEXTS: dict[str, tuple[Any, bytes]] = {}  # by member: its newest value and canonical form
# Stop rules and presentation: a longer, shorter or differently shown render is of the same film.
_STOP_RULE = ("spp", "seconds", "target_error")
# What of `_core.info()` tells one engine's samples from another's.
_ENGINE = ("embree", "isa", "compiler", "flags", "source_hash")


def scene_digest(scene: Scene) -> str:
    """Return the SHA-256 (hex) of a whole scene, output and stop rule included."""
    return _sha256(canonical(scene))


def film_key(scene: Scene) -> str:
    """Return the SHA-256 (hex) that two renders share when their films are the same samples.

    Left out: output, spp, seconds, target_error (a longer render continues a shorter one) and
    threads. Included: everything else with defaults filled in, file contents, and the engine.
    """
    from matiere import _core

    document = canonical(scene)
    del document["output"]
    for key in _STOP_RULE:
        del document["render"][key]
    document["film"]["filter_radius"] = scene.model.film.radius
    document["render"]["replicates"] = scene.model.render.replicates or _core.DEFAULT_REPLICATES
    document["engine"] = fingerprint()
    return _sha256_by_member(document)


def fingerprint() -> dict[str, Any]:
    """Return what identifies the engine: matiere, Embree, instruction set, compiler, plan."""
    from matiere import __version__, _core

    known = _core.info()
    plan = _core.Plan(1, 1, 1).version
    return {"matiere": __version__, "plan": plan, **{k: str(known[k]) for k in _ENGINE}}


def canonical(scene: Scene) -> dict[str, Any]:
    """Return the scene as plain values, defaults filled in, files and arrays by their SHA-256."""
    document: dict[str, Any] = _plain(scene.model, scene)
    for kind in ("shapes", "lights"):  # names are for people
        for item in document[kind]:
            item.pop("name", None)
    return document


def _plain(value: Any, scene: Scene) -> Any:
    if type(value) in SCALARS:  # the tests below are slow
        return value
    from pydantic import BaseModel

    if isinstance(value, TextureRef):
        return {"texture": value.texture}
    if isinstance(value, MaterialModel):
        return {key: _plain(item, scene) for key, item in value.filled().items()}
    if isinstance(value, FileName):
        return {"sha256": scene.asset_digest(value), "format": value.rsplit(".", 1)[-1].lower()}
    if isinstance(value, BaseModel):
        return _node(value, scene)
    if isinstance(value, np.ndarray):
        return {"sha256": _array_digest(value), "shape": list(value.shape)}
    if isinstance(value, dict):
        return {key: _plain(item, scene) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, scene) for item in value]
    return value


def _node(node: Node | Any, scene: Scene) -> dict[str, Any]:
    result = {}
    for name in type(node).model_fields:
        value = getattr(node, name)
        is_file = name in ("file", "ies") and isinstance(value, str)
        if is_file:
            suffix = value.rsplit(".", 1)[-1].lower()
            result[name] = {"sha256": scene.asset_digest(value), "format": suffix}
        else:
            result[name] = _plain(value, scene)
    return result


def _array_digest(array: np.ndarray[Any, Any]) -> str:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return hashlib.sha256(np.ascontiguousarray(little).tobytes()).hexdigest()


def _sha256_by_member(document: dict[str, Any]) -> str:
    """Return the same as `_sha256`, with the text of members that are as they were last time.

    The canonical form of an object is that of its members in order; the cells of a sweep differ in
    few of them.
    """
    import rfc8785

    texts = []
    for name in sorted(document):
        value, known = document[name], _TEXTS.get(name)
        if known is None or known[0] != value:
            known = value, rfc8785.dumps({name: value})[1:-1]
            _TEXTS[name] = known
        texts.append(known[1])
    return hashlib.sha256(b"{" + b",".join(texts) + b"}").hexdigest()


def _sha256(document: dict[str, Any]) -> str:
    import rfc8785

    return hashlib.sha256(rfc8785.dumps(document)).hexdigest()
