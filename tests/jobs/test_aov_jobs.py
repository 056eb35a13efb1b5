"""Layers of films over the queue: in the EXR of a job, with the bits of `mt.render`."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from conftest_jobs import killed_in_the_middle
from film_scenes import scenes

import matiere as mt
from matiere.imageio import Decoded, read_image, write_image
from matiere.jobs import open_engine
from matiere.scene.model import AOVS

OPTIONS: dict[str, Any] = {"min_free_bytes": 0}
FAR = [5000.0, 0.0, -300.0]


def scene(spp: int, size: int) -> dict[str, Any]:
    """A studio far from the origin, so that the core works around a centre of its own."""
    document = scenes(size)["glass"]
    document["film"]["aovs"] = list(AOVS)
    for key in ("origin", "target"):
        document["camera"][key] = np.add(document["camera"][key], FAR).tolist()
    for shape in document["shapes"]:
        if shape["type"] == "sphere":
            shape["center"] = np.add(shape["center"], FAR).tolist()
        else:
            shape["positions"] = np.add(shape["positions"], FAR).tolist()
    for light in document["lights"]:
        light["corner"] = np.add(light["corner"], FAR).tolist()
    return document | {"render": {"spp": spp, "seed": 5}}


def digest(image: Decoded) -> str:
    return hashlib.sha256(np.ascontiguousarray(image.pixels).tobytes()).hexdigest()


def test_a_job_killed_in_the_middle_has_the_layers_of_mt_render(tmp_path: Path) -> None:
    document = scene(128, 64)
    killed_in_the_middle(tmp_path / "a", document, children=2, **OPTIONS)
    with open_engine(tmp_path / "a", children=2, **OPTIONS) as engine:
        job = engine.wait_job(engine.list_jobs()[0].id, 120)
        assert (job.state, job.spp) == ("succeeded", 128), job.error
        made = read_image(engine.artifact(job.id, "image.exr").path)
    film = mt.render(mt.load(document), threads=2)
    write_image(tmp_path / "direct.exr", film)
    expected = read_image(tmp_path / "direct.exr")
    assert made.channels == expected.channels and "position.X" in made.channels
    assert digest(made) == digest(expected)
    x = made.pixels[:, :, made.channels.index("position.X")]
    assert abs(float(np.median(x[x != 0])) - FAR[0]) < 20
