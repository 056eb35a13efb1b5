"""Digests: stable, and changed by exactly what changes pixels."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from malformed import good

import matiere as mt

Change = Callable[[dict[str, Any]], object]


def rich(folder: Path) -> dict[str, Any]:
    """Return a scene with one of everything."""
    (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = good()
    scene["camera"] = {
        "type": "thin_lens", "origin": [0, 1, 5], "target": [0, 1, 0], "up": [0, 1, 0],
        "vfov_deg": 35, "aperture_radius": 0.1, "focus_distance": 5,
    }  # fmt: skip
    scene["film"] |= {"filter": "tent", "filter_radius": 1.5, "crop": [0, 0, 8, 8]}
    scene["render"] = {"spp": 4, "seed": 1, "max_depth": 5, "replicates": 4}
    scene["shapes"].append(
        {
            "type": "mesh", "file": "a.obj", "material": "floor",
            "transform": [{"scale": 2}, {"rotate_deg": 30, "axis": [0, 1, 0]}],
        }
    )  # fmt: skip
    scene["lights"] += [
        {"type": "point", "position": [2, 3, 2], "intensity": [5, 6, 7]},
        {"type": "directional", "direction": [0, -1, 0], "irradiance": 2},
        {"type": "spot", "position": [0, 3, 0], "direction": [0, -1, 0], "intensity": 1},
    ]
    scene["textures"] = {"t": {"pixels": [[[0.1, 0.2, 0.3]]]}}
    scene["materials"]["floor"]["albedo"] = {"texture": "t"}
    scene["environment"] = {"pixels": [[[1, 1, 1], [2, 2, 2]]], "rotation_deg": 10}
    scene["output"] = {"exposure": 1}
    return scene


CHANGES_PIXELS: dict[str, Change] = {
    "camera type": lambda s: s.update(
        camera={"type": "pinhole", "origin": [0, 1, 5], "target": [0, 1, 0], "vfov_deg": 35}
    ),
    "origin": lambda s: s["camera"]["origin"].__setitem__(0, 1e-9),
    "target": lambda s: s["camera"]["target"].__setitem__(0, 0.1),
    "up": lambda s: s["camera"].update(up=[0.1, 1, 0]),
    "vfov": lambda s: s["camera"].update(vfov_deg=36),
    "aperture": lambda s: s["camera"].update(aperture_radius=0.2),
    "focus": lambda s: s["camera"].update(focus_distance=6),
    "blades": lambda s: s["camera"].update(blades=6),
    "aperture ratio": lambda s: s["camera"].update(aperture_ratio=0.5),
    "width": lambda s: s["film"].update(width=17),
    "height": lambda s: s["film"].update(height=17),
    "filter": lambda s: s["film"].update(filter="gaussian"),
    "filter radius": lambda s: s["film"].update(filter_radius=1.25),
    "crop": lambda s: s["film"].update(crop=[0, 0, 8, 9]),
    "aovs": lambda s: s["film"].update(aovs=["albedo"]),
    "seed": lambda s: s["render"].update(seed=2),
    "max_depth": lambda s: s["render"].update(max_depth=6),
    "threshold": lambda s: s["render"].update(threshold=0.01),
    "replicates": lambda s: s["render"].update(replicates=8),
    "adaptive": lambda s: s["render"].update(adaptive=True),
    "light_tracing": lambda s: s["render"].update(light_tracing=False),
    "background": lambda s: s.update(background="transparent"),
    "background radiance": lambda s: s.update(background={"radiance": 0.5}),
    "alpha": lambda s: s["materials"]["ball"].update(alpha=0.11),
    "metal": lambda s: s["materials"]["ball"].update(metal="Ag"),
    "distribution": lambda s: s["materials"]["ball"].update(distribution="beckmann"),
    "emission": lambda s: s["materials"]["ball"].update(emission=1),
    "two_sided": lambda s: s["materials"]["ball"].update(two_sided=False),
    "priority": lambda s: s["materials"]["ball"].update(priority=1),
    "sphere": lambda s: s["shapes"][0].update(radius=1.5),
    "positions": lambda s: s["shapes"][1]["positions"][0].__setitem__(0, -8),
    "triangles": lambda s: s["shapes"][1].update(triangles=[[0, 2, 1]]),
    "normals": lambda s: s["shapes"][1].update(normals=[[0, 1, 0]] * 4),
    "uv": lambda s: s["shapes"][1].update(uv=[[0, 0], [1, 0], [1, 1], [0, 1]]),
    "transform": lambda s: s["shapes"][2]["transform"][0].update(scale=2.5),
    "transform order": lambda s: s["shapes"][2]["transform"].reverse(),
    "assignment": lambda s: s["shapes"][0].update(material="floor"),
    "light": lambda s: s["lights"][0].update(radiance=[10, 10, 11]),
    "point light": lambda s: s["lights"][1].update(intensity=1),
    "sun": lambda s: s["lights"][2].update(irradiance=1),
    "portals": lambda s: s["environment"].update(
        portals=[{"corner": [0, 0, 0], "edge_u": [1, 0, 0], "edge_v": [0, 1, 0]}]
    ),
    "spot": lambda s: s["lights"][3].update(outer_deg=31),
    "fewer lights": lambda s: s["lights"].pop(),
    "environment": lambda s: s["environment"]["pixels"][0][0].__setitem__(0, 9),
    "rotation": lambda s: s["environment"].update(rotation_deg=11),
    "environment scale": lambda s: s["environment"].update(scale=2),
    "no environment": lambda s: s.update(environment=None),
    "texture": lambda s: s["textures"]["t"]["pixels"][0][0].__setitem__(0, 0.5),
    "wrap": lambda s: s["textures"]["t"].update(wrap="clamp"),
    "texture filter": lambda s: s["textures"]["t"].update(filter="trilinear"),
    "texture channel": lambda s: s["textures"]["t"].update(channel="g"),
    "uv set": lambda s: s["textures"]["t"].update(uv_set=1),
    "texture transform": lambda s: s["textures"]["t"].update(transform={"rotation_deg": 5}),
    "second uv": lambda s: s["shapes"][1].update(uv1=[[0, 0], [1, 0], [1, 1], [0, 1]]),
}

SAME_FILM: dict[str, Change] = {
    "spp": lambda s: s["render"].update(spp=400),
    "seconds": lambda s: s["render"].update(seconds=5),
    "target_error": lambda s: s["render"].update(target_error={"relmse": 0.01}),
    "exposure": lambda s: s["output"].update(exposure=2),
    "view": lambda s: s["output"].update(view="Un-tone-mapped"),
    "despeckle": lambda s: s["output"].update(despeckle=True),
    "output files": lambda s: s["output"].update(files=["a.png"], bit_depth={"png": 16}),
    "no output": lambda s: s.pop("output"),
    "names of shapes": lambda s: s["shapes"][0].update(name="ball"),
    "default written out": lambda s: s["film"].update(height=16),
    "default up": lambda s: s["camera"].pop("up"),
    "grey as a number": lambda s: s["lights"][0].update(radiance=10),
    "implied default": lambda s: s["materials"]["ball"].update(masking="smith"),
    "order of keys": lambda s: [s.update({k: s.pop(k)}) for k in sorted(s)],
    "whole number as float": lambda s: s["camera"].update(vfov_deg=35.0),
    "array for list": lambda s: s["shapes"][1].update(
        positions=np.asarray(s["shapes"][1]["positions"], np.float32)
    ),
}


def key_of(scene: dict[str, Any], folder: Path) -> str:
    return mt.film_key(mt.load(scene, asset_root=folder))


@pytest.mark.parametrize("name", CHANGES_PIXELS)
def test_what_changes_pixels_changes_the_key(name: str, tmp_path: Path) -> None:
    scene = rich(tmp_path)
    before = key_of(scene, tmp_path), mt.load(scene, asset_root=tmp_path).digest
    CHANGES_PIXELS[name](scene)
    after = key_of(scene, tmp_path), mt.load(scene, asset_root=tmp_path).digest
    assert before[0] != after[0]
    assert before[1] != after[1]


@pytest.mark.parametrize("name", SAME_FILM)
def test_what_changes_no_pixels_keeps_the_key(name: str, tmp_path: Path) -> None:
    scene = rich(tmp_path)
    before = key_of(scene, tmp_path)
    SAME_FILM[name](scene)
    assert key_of(scene, tmp_path) == before


def test_every_field_was_thought_of() -> None:
    """A field added to the vocabulary needs a row in one of the tables above."""
    assert set(mt.SceneModel.model_fields) == {
        "version", "camera", "film", "render", "materials", "shapes", "lights", "environment",
        "textures", "background", "output",
    }  # fmt: skip
    assert set(mt.SceneModel.model_fields["render"].annotation.model_fields) == {  # type: ignore[union-attr]
        "spp", "seed", "max_depth", "seconds", "target_error", "replicates",
        "adaptive", "threshold", "light_tracing",
    }  # fmt: skip


def test_file_content_counts_and_its_name_does_not(tmp_path: Path) -> None:
    scene = rich(tmp_path)
    before = key_of(scene, tmp_path)
    (tmp_path / "b.obj").write_bytes((tmp_path / "a.obj").read_bytes())
    scene["shapes"][2]["file"] = "b.obj"
    assert key_of(scene, tmp_path) == before
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n")
    assert key_of(scene, tmp_path) != before


def test_the_engine_is_part_of_the_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matiere import _core

    scene = rich(tmp_path)
    before = key_of(scene, tmp_path)
    facts = _core.info()
    for fact in ("embree", "isa", "compiler", "flags", "source_hash"):
        changed = {**facts, fact: "other"}
        monkeypatch.setattr(_core, "info", lambda changed=changed: changed)
        assert key_of(scene, tmp_path) != before, fact


def test_key_is_the_same_in_another_process(tmp_path: Path) -> None:
    scene = rich(tmp_path)
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    code = "import matiere as mt, sys; print(mt.film_key(mt.load(sys.argv[1])))"
    command = [sys.executable, "-c", code, str(tmp_path / "scene.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == key_of(scene, tmp_path)


def test_json_round_trip_keeps_the_digest(tmp_path: Path) -> None:
    scene = mt.load(rich(tmp_path), asset_root=tmp_path)
    again = mt.loads(scene.to_json(), asset_root=tmp_path)
    assert again.digest == scene.digest
    assert mt.film_key(again) == mt.film_key(scene)
    assert again.to_json() == scene.to_json()


def test_the_film_key_is_that_of_the_whole_document(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Members kept from scene to scene change nothing, in whatever order scenes come."""
    from matiere.scene import digest

    scenes = []
    for name in ("origin", "target", "origin", "vfov", "aperture"):
        scene = rich(tmp_path)
        CHANGES_PIXELS[name](scene)
        scenes.append(mt.load(scene, asset_root=tmp_path))
    ours = [digest.film_key(scene) for scene in scenes]
    monkeypatch.setattr(digest, "_sha256_by_member", digest._sha256)
    assert ours == [digest.film_key(scene) for scene in scenes]
    assert len(set(ours)) == 4
