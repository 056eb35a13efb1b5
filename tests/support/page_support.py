"""What the tests of the page look at: small scenes, a job and sweeps of them."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from matiere.jobs.engine import Engine

SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "pinhole", "origin": [0, 0, 4], "target": [0, 0, 0], "vfov_deg": 40},
    "film": {"width": 32, "height": 24},
    "render": {"spp": 4},
    "materials": {"ball": {"type": "conductor", "metal": "Au", "alpha": 0.2}},
    "shapes": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "ball"}],
    "lights": [{"type": "point", "position": [3, 4, 5], "intensity": [200, 200, 200]}],
    "environment": {"radiance": [0.5, 0.55, 0.6]},
}
WAIT_S = 90


@dataclass(frozen=True)
class Site:
    """A served queue and what is in it."""

    engine: Engine
    url: str
    job: str
    sweep: str
    later: str  # the sweep again, brighter


def scene(**changes: Any) -> dict[str, Any]:
    """Return the small scene with some parts replaced."""
    return deepcopy(SCENE) | changes


def fill(engine: Engine, url: str) -> Site:
    """Render a job and two sweeps."""
    job = engine.submit_job(scene(), stop={"spp": 16}, label="gold <ball>")
    axes = [
        {"pointer": "/materials/ball/metal", "values": ["Au", "Cu"], "label": "metal"},
        {"pointer": "/materials/ball/alpha", "values": [0.1, 0.3, 0.6], "label": "alpha"},
    ]
    sweep = engine.submit_sweep(scene(), axes, label="metals")
    brighter = scene(environment={"radiance": [0.6, 0.6, 0.6]})
    later = engine.submit_sweep(brighter, axes, label="metals, brighter")
    engine.wait_job(job.id, WAIT_S)
    for one in (sweep, later):
        assert engine.wait_sweep(one.id, WAIT_S).finished is not None
    assert engine.get_job(job.id).state.value == "succeeded", engine.get_job(job.id)
    return Site(engine, url, job.id, sweep.id, later.id)
