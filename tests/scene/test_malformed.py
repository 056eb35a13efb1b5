"""Every malformed scene gives one error with pointer and code, through Python and the CLI."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from malformed import CASES, Case, good

import matiere as mt


def test_good_scene_loads(tmp_path: Path) -> None:
    assert mt.load(good(), asset_root=tmp_path).model.film.width == 16


def test_editors_may_name_the_schema_and_begin_with_a_mark(tmp_path: Path) -> None:
    text = json.dumps({"$schema": "scene.schema.json", **good()})
    assert mt.loads(b"\xef\xbb\xbf" + text.encode()).digest == mt.load(good()).digest


def test_there_are_twenty() -> None:
    assert len({case.name for case in CASES}) == len(CASES) >= 20


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_python_refuses(case: Case, tmp_path: Path) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.loads(case.text, asset_root=tmp_path)
    (error,) = caught.value.errors
    assert (error["pointer"], error["code"]) == (case.pointer, case.code), error
    assert error.get("suggestion") == case.suggestion or case.suggestion is None
    assert len(error["message"]) > 15
    assert list(tmp_path.iterdir()) == []


def run_cli(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "matiere.service", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=120)


# Every case costs a process, so the command line gets a few of each kind; the table is the same.
@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=[] if i % 5 == 0 else [pytest.mark.slow]) for i, c in enumerate(CASES)],
    ids=lambda case: case.name,
)
def test_command_line_refuses(case: Case, tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_text(case.text)
    done = run_cli("render", "scene.json", "-o", "out.png", cwd=tmp_path)
    place = f"scene.json: {case.pointer}: " if case.pointer else "scene.json: "
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(place), done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback" not in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["scene.json"]


def test_all_errors_come_at_once(tmp_path: Path) -> None:
    scene = good()
    scene["camera"]["vfov_deg"] = 190
    scene["film"]["widht"] = 3
    scene["materials"]["ball"] |= {"alpha": "rough", "eta": 2}
    scene["shapes"][0]["material"] = "gold"
    scene["shapes"][1]["positions"][2][1] = float("nan")
    scene["lights"][0]["radiance"] = [1, -1, float("inf")]
    scene["textures"]["wood"] = {"file": "wood.png"}
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene, asset_root=tmp_path)
    found = [(e["pointer"], e["code"]) for e in caught.value.errors]
    assert found == [
        ("/camera/vfov_deg", "out_of_range"),
        ("/film/widht", "unknown_key"),
        ("/materials/ball/alpha", "wrong_type"),
        ("/materials/ball/eta", "exclusive_keys"),
        ("/shapes/0/material", "unknown_material"),
        ("/shapes/1/positions/2/1", "not_finite"),
        ("/lights/0/radiance/1", "out_of_range"),
        ("/lights/0/radiance/2", "not_finite"),
        ("/textures/wood/file", "asset_missing"),
    ]


@pytest.mark.parametrize("count", [10, 2000])
@pytest.mark.parametrize(
    ("bad", "place", "code"),
    [
        ("x", "positions/7/1", "wrong_type"),
        (float("nan"), "positions/7/1", "not_finite"),
        (None, "positions/7/1", "wrong_type"),
        (10**400, "positions/7/1", "not_finite"),
        ([1], "positions/7/1", "wrong_type"),
        (1.5, "triangles/7/1", "wrong_type"),
        (-1, "triangles/7/1", "index_out_of_range"),
    ],
)
def test_bad_elements_of_short_and_long_arrays_have_pointers(
    count: int, bad: object, place: str, code: str
) -> None:
    scene = good()
    mesh = scene["shapes"][1]
    mesh["positions"] = [[i, i % 7, i % 3] for i in range(count)]
    mesh["triangles"] = [[i, i + 1, i + 2] for i in range(count - 2)]
    mesh[place.split("/", maxsplit=1)[0]][7][1] = bad
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene)
    (error,) = caught.value.errors
    assert (error["pointer"], error["code"]) == (f"/shapes/1/{place}", code)


def test_pointers_are_escaped(tmp_path: Path) -> None:
    scene = good()
    scene["materials"]["a/b~c"] = {"type": "lambert", "albedo": 2}
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene, asset_root=tmp_path)
    assert caught.value.errors[0]["pointer"] == "/materials/a~1b~0c/albedo"


def test_text_that_is_no_utf8_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_bytes(b'{"version": "\xff"}')
    with pytest.raises(mt.SceneValidationError, match="UTF-8"):
        mt.load(tmp_path / "scene.json")


def test_numbers_of_many_digits_are_refused(tmp_path: Path) -> None:
    text = json.dumps(good()).replace('"vfov_deg": 35', '"vfov_deg": ' + "9" * 400)
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.loads(text, asset_root=tmp_path)
    assert caught.value.errors[0]["code"] == "not_finite"
    with pytest.raises(mt.SceneValidationError, match="too many digits"):
        mt.loads(text.replace("9" * 400, "9" * 5000), asset_root=tmp_path)


def test_extreme_nesting_is_refused(tmp_path: Path) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.loads("[" * 200_000, asset_root=tmp_path)
    assert caught.value.errors[0]["code"] in ("too_deep", "invalid_json")
