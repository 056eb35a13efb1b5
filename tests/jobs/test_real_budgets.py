"""Budgets over the real renderer: cells of very different difficulty, one error for all."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest
from test_real import OPTIONS, SCENE

import matiere as mt
from matiere.imageio import read_image, write_image
from matiere.jobs import open_engine

AXES = [
    {
        "pointer": "/materials/ball",
        "values": [
            {"type": "lambert", "albedo": [0.2, 0.3, 0.4]},
            {"type": "conductor", "metal": "Au", "alpha": 0.1},
            {"type": "dielectric", "eta": 1.5},
        ],
        "labels": ["clay", "gold", "glass"],
        "label": "material",
    }
]


def small(scene: dict[str, Any]) -> dict[str, Any]:
    """Return the scene on a film of few pixels, under a small lamp beside the sky."""
    lamp = {"type": "sphere", "center": [2, 4, 2], "radius": 0.2, "material": "lamp"}
    materials = {"type": "lambert", "albedo": 0.0, "emission": [60, 60, 60]}
    return scene | {
        "film": {"width": 24, "height": 20},
        "materials": scene["materials"] | {"lamp": materials},
        "shapes": [*scene["shapes"], lamp],
        "render": {"seed": 3},
    }


def pixels(path: str | Path) -> str:
    """Return a digest of an image's pixels."""
    return hashlib.sha256(read_image(path).pixels.tobytes()).hexdigest()


@pytest.mark.parametrize(("seconds", "target"), [(120.0, 3e-3), (0.4, 1e-6)])
def test_finished_cells_keep_the_target_and_every_cell_its_bits(
    tmp_path: Path, seconds: float, target: float
) -> None:
    budget = {"seconds": seconds, "target_error": {"relmse": target}}
    base = small(SCENE)
    with open_engine(tmp_path / "data", children=2, **OPTIONS) as engine:
        sweep = engine.wait_sweep(engine.submit_sweep(base, AXES, budget=budget).id, 240)
        jobs = engine.list_jobs(sweep_id=sweep.id)
        print(sweep.budget, [(j.label, str(j.state), j.spp, j.relmse_interval) for j in jobs])
        assert sweep.budget is not None
        assert sweep.budget.spent_s <= 1.2 * seconds  # clocks of a machine with other work
        assert len({job.spp for job in jobs}) > 1
        if seconds > 100:
            assert sweep.counts["succeeded"] == 3
        else:
            assert sweep.counts["unfinished"] == 3
        for job in jobs:
            done = job.state == "succeeded"
            assert done == (job.stop_reason == "target_error") and job.relmse_interval
            assert not done or job.relmse_interval[1] <= target
            scene = base | {"materials": base["materials"] | {"ball": job.parameters["material"]}}
            alone = tmp_path / f"{job.cell}.exr"
            write_image(alone, mt.render(mt.load(scene), spp=job.spp, threads=2))
            assert pixels(engine.artifact(job.id, "image.exr").path) == pixels(alone)
