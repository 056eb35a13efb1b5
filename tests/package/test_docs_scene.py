"""docs/scene.md: its examples run, every key is in it, its tables are those of the core."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import scene_doc

import matiere as mt

TEXT = scene_doc.PAGE.read_text(encoding="utf-8")


def snippets(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)


def test_material_tables_are_current() -> None:
    assert scene_doc.page(TEXT) == TEXT, "run: python tests/support/scene_doc.py"


def test_every_key_of_the_vocabulary_is_documented() -> None:
    for name, node in mt.schema()["$defs"].items():
        for key in node.get("properties", {}):
            assert re.search(rf"[`\"]{key}[`\"]", TEXT), f"{name}.{key} is not in docs/scene.md"
    for key in mt.schema()["properties"]:
        assert f"| `{key}` |" in TEXT


def test_default_values_are_those_of_the_model() -> None:
    camera = {"type": "pinhole", "origin": [0, 0, 1], "target": [0, 0, 0]}
    model = mt.load({"version": 1, "camera": camera}).model
    assert (model.camera.up, model.camera.vfov_deg) == ((0, 1, 0), 40)
    assert (model.film.width, model.film.height, model.film.filter) == (256, 256, "gaussian")
    assert (model.render.spp_cap, model.render.seed, model.render.max_depth) == (64, 0, None)
    assert re.search(r"^\| `vfov_deg` \|.*\| 40 \|$", TEXT, re.MULTILINE)


@pytest.mark.parametrize("index", range(len(snippets("json"))))
def test_json_examples_render(index: int) -> None:
    scene = json.loads(snippets("json")[index])
    scene["film"] = {"width": 8, "height": 8}
    film = mt.render(mt.load(scene), spp=4, threads=1)
    assert film.mean.mean() > 0.01


@pytest.mark.parametrize("index", range(len(snippets("python"))))
def test_python_examples_run(index: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(snippets("python")[index], "docs/scene.md", "exec"), {})
    assert (tmp_path / "clay.png").stat().st_size > 100


def test_error_examples_are_what_is_said() -> None:
    scene = json.loads(snippets("json")[0])
    scene["camera"]["vfov_deg"] = 190
    scene["materials"]["varnish"]["albdo"] = 1
    scene["shapes"][1] = {"type": "mesh", "file": "ball.glb", "material": "floor"}
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene)
    said = str(caught.value).splitlines()
    shown = re.findall(r"^scene\.json: (.*)$", TEXT, flags=re.MULTILINE)
    assert len(said) == len(shown) == 3
    assert shown[0] == said[0]
    assert shown[2] == said[2]
    assert said[1].startswith(
        "/materials/varnish/albdo: unknown key 'albdo'; did you mean 'albedo'? known here: "
    )
