"""A scene's files: found below the asset root, never outside it, and what was hashed is used."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from malformed import good

import matiere as mt
from matiere.imageio import Stored, write_stored
from matiere.scene.assets import AssetRoot

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return an asset root with a mesh, beside a file that must stay out of reach."""
    (tmp_path / "secret.obj").write_text(TRIANGLE)
    root = tmp_path / "root"
    (root / "sub").mkdir(parents=True)
    (root / "sub" / "a.obj").write_text(TRIANGLE)
    return root


def with_mesh(name: str) -> dict[str, Any]:
    scene = good()
    scene["shapes"] = [{"type": "mesh", "file": name, "material": "floor"}]
    return scene


def refused(name: str, root: Path) -> str:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(with_mesh(name), asset_root=root)
    (error,) = caught.value.errors
    assert error["pointer"] == "/shapes/0/file"
    return error["code"]


def test_files_below_the_root_are_found(folder: Path) -> None:
    scene = mt.load(with_mesh("sub/a.obj"), asset_root=folder)
    assert scene.assets == [("sub/a.obj", hashlib.sha256(TRIANGLE.encode()).hexdigest())]
    (folder / "inside.obj").symlink_to(folder / "sub" / "a.obj")
    mt.load(with_mesh("inside.obj"), asset_root=folder)
    mt.load(with_mesh("./sub//a.obj"), asset_root=folder)


@pytest.mark.parametrize(
    "name",
    [
        "../secret.obj",
        "sub/../../secret.obj",
        "sub/../sub/a.obj",
        "..",
        "/etc/passwd",
        "//etc/passwd",
        "..\\secret.obj",
        "C:/secret.obj",
        "file:///etc/passwd",
        "https://example.org/a.obj",
        "a\0.obj",
    ],
)
def test_names_that_lead_out_are_refused(name: str, folder: Path) -> None:
    assert refused(name, folder) == "asset_outside_root"


def test_links_that_lead_out_are_refused(folder: Path) -> None:
    (folder / "link.obj").symlink_to("../secret.obj")
    (folder / "absolute.obj").symlink_to(folder.parent / "secret.obj")
    (folder / "chain.obj").symlink_to("link.obj")
    (folder / "up").symlink_to("..")
    for name in ("link.obj", "absolute.obj", "chain.obj", "up/secret.obj"):
        assert refused(name, folder) == "asset_outside_root", name


def test_the_root_itself_may_be_a_link(folder: Path) -> None:
    (folder.parent / "alias").symlink_to(folder)
    mt.load(with_mesh("sub/a.obj"), asset_root=folder.parent / "alias")


def test_a_root_is_no_prefix_of_its_neighbour(folder: Path) -> None:
    neighbour = folder.parent / "root2"
    neighbour.mkdir()
    (neighbour / "a.obj").write_text(TRIANGLE)
    (folder / "near.obj").symlink_to(neighbour / "a.obj")
    assert refused("near.obj", folder) == "asset_outside_root"


def test_what_is_no_file_is_refused(folder: Path) -> None:
    os.mkfifo(folder / "pipe.obj")
    (folder / "loop.obj").symlink_to("loop.obj")
    (folder / "folder.obj").mkdir()
    assert refused("pipe.obj", folder) == "asset_unreadable"
    assert refused("loop.obj", folder) == "asset_unreadable"
    assert refused("folder.obj", folder) == "asset_unreadable"
    assert refused("sub/a.obj/b.obj", folder) == "asset_missing"
    assert refused("x" * 5000 + ".obj", folder) == "asset_unreadable"


def test_other_formats_are_refused(folder: Path) -> None:
    (folder / "a.fbx").write_text("x")
    assert refused("a.fbx", folder) == "asset_format"


def test_the_scene_file_gives_the_root(folder: Path, tmp_path: Path) -> None:
    import json

    path = folder / "scene.json"
    path.write_text(json.dumps(with_mesh("sub/a.obj")))
    assert mt.load(path).asset_root == str(folder.resolve())
    path.write_text(json.dumps(with_mesh("secret.obj")))
    mt.load(path, asset_root=tmp_path)
    with pytest.raises(mt.SceneValidationError):
        mt.load(path)


def test_pins_are_checked_at_load(folder: Path) -> None:
    digest = hashlib.sha256(TRIANGLE.encode()).hexdigest()
    mt.load(with_mesh("sub/a.obj"), asset_root=folder, pins={"sub/a.obj": digest})
    with pytest.raises(mt.AssetChanged) as caught:
        mt.load(with_mesh("sub/a.obj"), asset_root=folder, pins={"sub/a.obj": "0" * 64})
    assert caught.value.code == "asset_changed"
    assert caught.value.errors[0]["pointer"] == "/shapes/0/file"
    assert caught.value.errors[0]["code"] == "asset_changed"


def test_a_mesh_changed_after_loading_is_noticed(folder: Path, recorded: None) -> None:
    scene = mt.load(with_mesh("sub/a.obj"), asset_root=folder)
    assert scene.assets
    (folder / "sub" / "a.obj").write_text(TRIANGLE.replace("1 0 0", "2 0 0"))
    with pytest.raises(mt.AssetChanged):
        scene.flatten()


def test_an_image_changed_after_loading_is_noticed(tmp_path: Path, recorded: None) -> None:
    def write(value: float) -> None:
        pixels = np.full((2, 4, 3), value, np.float32)
        write_stored(tmp_path / "sky.exr", Stored(pixels, "RGB", {}), "float")

    write(1.0)
    scene = good()
    scene["environment"] = {"file": "sky.exr"}
    loaded = mt.load(scene, asset_root=tmp_path)
    loaded.flatten()
    write(2.0)
    with pytest.raises(mt.AssetChanged) as caught:
        loaded.flatten()
    assert caught.value.errors[0]["pointer"] == "/environment/file"


def test_a_file_is_hashed_once_while_it_stays_the_same(folder: Path) -> None:
    root = AssetRoot(folder)
    first = root.digest("sub/a.obj")
    reads = []
    original = AssetRoot._hash
    try:
        AssetRoot._hash = lambda self, *a: reads.append(a) or original(self, *a)  # type: ignore[method-assign,func-returns-value]
        assert root.digest("sub/a.obj") == first
        assert reads == []
    finally:
        AssetRoot._hash = original  # type: ignore[method-assign]
