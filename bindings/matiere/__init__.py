"""matiere: render materials with a path tracer, and know the error of every image.

    import matiere as mt
    scene = mt.load("scene.json")
    film = mt.render(scene, spp=64)
    mt.write_image("out.png", film)

Names are loaded when first used, so `import matiere` is quick.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# public name -> module that defines it
_HOMES = {
    "AssetChanged": "errors",
    "Bsdf": "probe",
    "BsdfSample": "probe",
    "Cancelled": "errors",
    "Client": "service.client",
    "ColourError": "errors",
    "Comparison": "compare",
    "Film": "film",
    "FilmError": "errors",
    "ImageError": "errors",
    "JobStatus": "service.client",
    "Lobe": "probe",
    "MatiereError": "errors",
    "MemoryLimitError": "errors",
    "ProbeError": "errors",
    "RenderError": "errors",
    "Replay": "replay",
    "Scene": "scene.scene",
    "SceneModel": "scene.model",
    "SceneValidationError": "errors",
    "ServiceError": "service.client",
    "ServiceEvent": "service.client",
    "Signature": "signature",
    "SweepStatus": "service.client",
    "Unreachable": "service.client",
    "bsdf": "probe",
    "check": "stability",
    "compare": "compare",
    "denoise": "denoise",
    "develop": "develop",
    "film_key": "scene.digest",
    "info": "materials",
    "load": "scene.load",
    "load_film": "film",
    "loads": "scene.load",
    "materials": "materials",
    "metals": "materials",
    "read_image": "imageio",
    "render": "render",
    "replay": "replay",
    "schema": "scene.schema",
    "signature": "signature",
    "write_image": "imageio",
}
_MODULES = ("chunks", "errors")

__all__ = [
    "AssetChanged",
    "Bsdf",
    "BsdfSample",
    "Cancelled",
    "Client",
    "ColourError",
    "Comparison",
    "Film",
    "FilmError",
    "ImageError",
    "JobStatus",
    "Lobe",
    "MatiereError",
    "MemoryLimitError",
    "ProbeError",
    "RenderError",
    "Replay",
    "Scene",
    "SceneModel",
    "SceneValidationError",
    "ServiceError",
    "ServiceEvent",
    "Signature",
    "SweepStatus",
    "Unreachable",
    "__version__",
    "bsdf",
    "check",
    "chunks",
    "compare",
    "denoise",
    "develop",
    "errors",
    "film_key",
    "info",
    "load",
    "load_film",
    "loads",
    "materials",
    "metals",
    "read_image",
    "render",
    "replay",
    "schema",
    "signature",
    "write_image",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        try:
            value = getattr(import_module(f"matiere.{_HOMES[name]}"), name)
        except ModuleNotFoundError as error:
            if error.name != "httpx":
                raise
            text = f"matiere.{name} needs httpx: pip install 'matiere[client]'"
            raise ModuleNotFoundError(text, name=error.name) from None
    elif name in _MODULES:
        value = import_module(f"matiere.{name}")
    else:
        raise AttributeError(f"module 'matiere' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """The package, which keeps `matiere.render` the function when matiere/render.py is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package

if TYPE_CHECKING:
    from matiere import chunks, errors
    from matiere.compare import Comparison, compare
    from matiere.denoise import denoise
    from matiere.develop import develop
    from matiere.errors import (
        AssetChanged,
        Cancelled,
        ColourError,
        FilmError,
        ImageError,
        MatiereError,
        MemoryLimitError,
        ProbeError,
        RenderError,
        SceneValidationError,
    )
    from matiere.film import Film, load_film
    from matiere.imageio import read_image, write_image
    from matiere.materials import info, materials, metals
    from matiere.probe import Bsdf, BsdfSample, Lobe, bsdf
    from matiere.render import render
    from matiere.replay import Replay, replay
    from matiere.scene.digest import film_key
    from matiere.scene.load import load, loads
    from matiere.scene.model import SceneModel
    from matiere.scene.scene import Scene
    from matiere.scene.schema import schema
    from matiere.service.client import (
        Client,
        JobStatus,
        ServiceError,
        ServiceEvent,
        SweepStatus,
        Unreachable,
    )
    from matiere.signature import Signature, signature
    from matiere.stability import check
