"""Paths from the lights over the queue: a job killed in the middle has the bits of `mt.render`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest_jobs import killed_in_the_middle

import matiere as mt
from matiere.imageio import read_image, write_image
from matiere.jobs import open_engine

OPTIONS: dict[str, Any] = {"min_free_bytes": 0}
ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("adaptive", [False, True])
def test_a_job_killed_in_the_middle_has_the_light_of_mt_render(
    tmp_path: Path, adaptive: bool
) -> None:
    document: dict[str, Any] = json.loads((ROOT / "examples/scenes/caustic.json").read_text())
    document["film"] = {"width": 64, "height": 64, "aovs": ["diffuse", "caustic"]}
    document["render"] = {"spp": 64, "seed": 5, "adaptive": adaptive}
    killed_in_the_middle(tmp_path / "a", document, children=2, **OPTIONS)
    with open_engine(tmp_path / "a", children=2, **OPTIONS) as engine:
        job = engine.wait_job(engine.list_jobs()[0].id, 120)
        assert job.state == "succeeded", job.error
        made = read_image(engine.artifact(job.id, "image.exr").path)
    film = mt.render(mt.load(document), threads=2)
    assert film.report["light_tracing"]["on"] and film.aov("caustic").max() > 0
    write_image(tmp_path / "direct.exr", film)
    expected = read_image(tmp_path / "direct.exr")
    assert made.channels == expected.channels and "caustic.R" in made.channels
    assert np.array_equal(made.pixels, expected.pixels, equal_nan=True)
