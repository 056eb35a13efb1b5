"""The queue over the real renderer: the bits of `mt.render`, whoever is killed meanwhile."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest_jobs import killed_in_the_middle, report_of, wait_until

import matiere as mt
from matiere.errors import SceneValidationError
from matiere.imageio import read_image, write_image
from matiere.jobs import open_engine
from matiere.jobs.errors import JobNotFound

SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "pinhole", "origin": [0, 1, 5], "target": [0, 1, 0], "vfov_deg": 35},
    "film": {"width": 48, "height": 40},
    "render": {"spp": 32, "seed": 3},
    "materials": {
        "ball": {"type": "conductor", "metal": "Au", "alpha": 0.1},
        "floor": {"type": "lambert", "albedo": [0.5, 0.5, 0.5]},
    },
    "shapes": [
        {"type": "sphere", "center": [0, 1, 0], "radius": 1, "material": "ball"},
        {
            "type": "mesh",
            "positions": [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]],
            "triangles": [[0, 2, 1], [0, 3, 2]],
            "material": "floor",
        },
    ],
    "environment": {"radiance": [0.5, 0.6, 0.7]},
}
AXES = [
    {"pointer": "/materials/ball/alpha", "values": [0.05, 0.2, 0.5]},
    {"pointer": "/materials/ball/metal", "values": ["Au", "Cu"]},
]
OPTIONS: dict[str, Any] = {"min_free_bytes": 0}


def pixels(engine: Any, job_id: str) -> str:
    """Return the SHA-256 of the EXR's pixels: colour and standard error."""
    image = read_image(engine.artifact(job_id, "image.exr").path)
    assert image.channels[:3] == ("R", "G", "B")
    assert np.isfinite(image.pixels[..., :3]).all()
    return hashlib.sha256(np.ascontiguousarray(image.pixels).tobytes()).hexdigest()


def cells(engine: Any, sweep_id: str) -> list[str]:
    """Return the pixel hashes of a finished sweep; fail unless every film has all its samples."""
    found = []
    for job in engine.list_jobs(sweep_id=sweep_id):
        assert (job.state, job.spp) == ("succeeded", 32), job.error
        report = report_of(engine, job.id)
        assert report["samples"] == 48 * 40 * 32
        found.append(pixels(engine, job.id))
    return found


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Pixel hashes of the sweep with one process and one thread."""
    with open_engine(tmp_path_factory.mktemp("quiet"), children=1, **OPTIONS) as engine:
        sweep = engine.wait_sweep(engine.submit_sweep(SCENE, AXES).id, 120)
        return cells(engine, sweep.id)


def test_a_job_has_the_pixels_of_mt_render(quiet: list[str], tmp_path: Path) -> None:
    scene = json.loads(json.dumps(SCENE))
    scene["materials"]["ball"]["alpha"] = 0.05
    film = mt.render(mt.load(scene), threads=2)
    write_image(tmp_path / "direct.exr", film)
    image = read_image(tmp_path / "direct.exr")
    assert hashlib.sha256(image.pixels.tobytes()).hexdigest() == quiet[0]


@pytest.mark.parametrize(
    ("children", "threads"), [pytest.param(1, 2, marks=pytest.mark.slow), (2, 1)]
)
def test_one_hash_for_processes_and_threads(
    quiet: list[str], tmp_path: Path, children: int, threads: int
) -> None:
    options = OPTIONS | {"children": children, "threads_per_child": threads}
    with open_engine(tmp_path, **options) as engine:
        sweep = engine.wait_sweep(engine.submit_sweep(SCENE, AXES).id, 120)
        assert cells(engine, sweep.id) == quiet
        assert read_image(engine.sweep_artifact(sweep.id).path).pixels.shape[2] == 3


def test_a_render_killed_in_the_middle_resumes_with_the_same_bits(tmp_path: Path) -> None:
    scene = SCENE | {"film": {"width": 128, "height": 96}, "render": {"spp": 192, "seed": 5}}
    killed_in_the_middle(tmp_path / "a", scene, children=2, **OPTIONS)
    with open_engine(tmp_path / "a", children=2, **OPTIONS) as engine:
        job = engine.wait_job(engine.list_jobs()[0].id, 120)
        rendered = engine.status()["counters"]["chunks_rendered"]
        print(f"{engine.resumed}; chunks rendered after the restart: {rendered}")
        assert (job.state, job.spp) == ("succeeded", 192)
        assert rendered == engine.resumed["chunks_missing"] > 0
        assert report_of(engine, job.id)["samples"] == 128 * 96 * 192
        killed = pixels(engine, job.id)
    film = mt.render(mt.load(scene), threads=2)
    write_image(tmp_path / "direct.exr", film)
    assert (
        hashlib.sha256(read_image(tmp_path / "direct.exr").pixels.tobytes()).hexdigest() == killed
    )


@pytest.mark.slow
def test_killed_children_change_nothing(quiet: list[str], tmp_path: Path) -> None:
    with open_engine(tmp_path, children=2, **OPTIONS) as engine:
        sweep = engine.submit_sweep(SCENE, AXES)
        for _ in range(3):
            time.sleep(0.5)
            children = [c["pid"] for c in engine.status()["children"][:2] if c["pid"]]
            if children and engine.get_sweep(sweep.id).finished is None:
                os.kill(children[0], signal.SIGKILL)
        engine.wait_sweep(sweep.id, 120)
        assert cells(engine, sweep.id) == quiet


def test_cancel_reaches_the_renderer_within_100_ms(tmp_path: Path) -> None:
    scene = SCENE | {"film": {"width": 512, "height": 512}, "render": {"spp": 65536}}
    with open_engine(tmp_path, children=1, **OPTIONS) as engine:
        job = engine.submit_job(scene)
        wait_until(lambda: engine.get_job(job.id).progress > 0, 60)
        times = []
        for _ in range(3):
            wait_until(lambda: engine.status()["children"][0]["claims"], 60)
            start = time.monotonic()
            engine.cancel_job(job.id)
            while engine.status()["children"][0]["claims"]:
                time.sleep(0.002)
            times.append(time.monotonic() - start)
            job = engine.submit_job(scene)
        print("cancelled after", [f"{1000 * t:.0f} ms" for t in times])
        assert engine.status()["counters"].get("children_lost", 0) == 0
        assert sorted(times)[1] < 1.0, "the median cancel needed a signal"


def test_the_report_holds_error_against_time(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=2, **OPTIONS) as engine:
        stop = {"target_error": {"relmse": 0.01}}
        job = engine.wait_job(engine.submit_job(SCENE, stop=stop, label="gold").id, 120)
        assert job.stop_reason == "target_error"
        assert job.relmse_interval is not None and job.relmse_interval[1] <= 0.01
        report = report_of(engine, job.id)
        assert report["job"]["label"] == "gold"
        assert report["requested"]["target_error"] == {"relmse": 0.01}
        rows = report["log"]
        assert [r["spp"] for r in rows] == sorted({r["spp"] for r in rows})
        assert rows[-1]["spp"] == job.spp
        assert all(a["wall_s"] < b["wall_s"] for a, b in itertools.pairwise(rows))
        direct = mt.render(mt.load(SCENE), target_error=0.01)
        assert direct.spp == job.spp, "the same stop rule as mt.render"
        plot = Path(engine.artifact(job.id, "error.svg").path).read_text()
        assert plot.lstrip().startswith(("<svg", "<?xml"))


def test_a_job_may_aim_at_the_picture_people_get(tmp_path: Path) -> None:
    """The view is the job's own: a darker picture of the same film is done earlier."""
    goal = {"display": {"code_values": 3, "pixels_percent": 90}}
    dark_scene = SCENE | {"output": {"exposure": -4.0}}
    with open_engine(tmp_path, children=2, **OPTIONS) as engine:
        ids = [
            engine.submit_job(scene, stop={"target_error": goal}).id
            for scene in (SCENE, dark_scene)
        ]
        plain, dark = (engine.wait_job(i, 120) for i in ids)
        assert (plain.stop_reason, dark.stop_reason) == ("target_error", "target_error")
        assert dark.film_key == plain.film_key and dark.spp < plain.spp
        for scene, job in ((SCENE, plain), (dark_scene, dark)):
            direct = mt.render(mt.load(scene), target_error=goal)
            assert direct.spp == job.spp, "the same stop rule as mt.render"
            state = report_of(engine, job.id)["certificate"]["target"]
            assert state["reached"] and state["display"]["lower_percent"] >= 90
            stored = read_image(engine.artifact(job.id, "image.exr").path).pixels[..., :3]
            assert np.array_equal(stored, direct.mean.astype(np.float32))


def test_output_settings_develop_the_same_film_again(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=1, **OPTIONS) as engine:
        first = engine.wait_job(engine.submit_job(SCENE).id, 60)
        rendered = engine.status()["counters"]["chunks_rendered"]
        output = {"exposure": 2.0, "despeckle": True, "bit_depth": {"png": 16, "exr": 16}}
        second = engine.wait_job(engine.submit_job(SCENE | {"output": output}).id, 60)
        assert (second.cached, second.film_key) == (True, first.film_key)
        assert engine.status()["counters"]["chunks_rendered"] == rendered, "nothing was rendered"
        dark, bright = (
            read_image(engine.artifact(job.id, "image.png").path).pixels.mean()
            for job in (first, second)
        )
        assert bright > dark
        plain, spotless = (
            json.loads(Path(engine.artifact(job.id, "report.json").path).read_text())["picture"]
            for job in (first, second)
        )
        assert plain == {"despeckle": False} and spotless["despeckle"] is True
        assert 0 <= spotless["energy_held_back"] < 1 and 0 <= spotless["pixels_changed"] < 1


def test_uploaded_assets_are_pinned_and_used(tmp_path: Path) -> None:
    write_image(tmp_path / "sky.exr", np.full((4, 8, 3), 0.5, np.float32))
    data = (tmp_path / "sky.exr").read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    scene = SCENE | {"environment": {"file": "maps/sky.exr"}}
    with open_engine(tmp_path / "data", children=1, **OPTIONS) as engine:
        with pytest.raises(SceneValidationError) as caught:
            engine.submit_job(scene)
        assert caught.value.faults[0].pointer == "/environment/file"
        engine.put_asset(digest, [data])
        job = engine.submit_job(scene, assets={"maps/sky.exr": digest})
        job = engine.wait_job(job.id, 60)
        assert job.state == "succeeded", job.error
        assert report_of(engine, job.id)["assets"] == {"maps/sky.exr": digest}
        with pytest.raises(SceneValidationError) as caught:
            bad = scene | {"environment": {"file": "../../etc/passwd"}}
            engine.submit_job(bad, assets={"../../etc/passwd": digest})
        assert caught.value.faults[0].code == "asset_outside_root"


def test_a_file_that_cannot_be_read_is_refused_with_its_pointer(tmp_path: Path) -> None:
    (tmp_path / "data" / "assets").mkdir(parents=True)
    (tmp_path / "data" / "assets" / "bad.ply").write_bytes(b"not a mesh")
    (tmp_path / "data" / "assets" / "bad.hdr").write_bytes(b"#?RADIANCE\nnot an image")
    mesh = {"type": "mesh", "file": "bad.ply", "material": "ball"}
    bad = SCENE | {"shapes": [mesh], "environment": {"file": "bad.hdr"}}
    with open_engine(tmp_path / "data", children=1, **OPTIONS) as engine:
        with pytest.raises(SceneValidationError) as caught:
            engine.submit_job(bad)
        pointers = {fault.pointer for fault in caught.value.faults}
        assert pointers == {"/shapes/0/file", "/environment/file"}
        assert engine.list_jobs() == []
        assert engine.status()["counters"].get("children_lost", 0) == 0


def test_a_film_of_unknown_error_still_gets_all_its_files(tmp_path: Path) -> None:
    scene = SCENE | {"render": {"spp": 4, "replicates": 1}}
    with open_engine(tmp_path, children=1, **OPTIONS) as engine:
        job = engine.wait_job(engine.submit_job(scene).id, 60)
        assert (job.state, job.relmse, job.relmse_interval) == ("succeeded", None, None), job.error
        assert report_of(engine, job.id)["error"]["known"] is False
        assert "no look" in Path(engine.artifact(job.id, "error.svg").path).read_text()
        sweep = engine.submit_sweep(scene, AXES[:1])
        assert engine.wait_sweep(sweep.id, 60).artifacts == ("contact-sheet.png",)


def test_a_sweep_with_a_baseline_has_difference_images(tmp_path: Path) -> None:
    base = SCENE | {"film": {"width": 24, "height": 20}}
    with open_engine(tmp_path, children=2, **OPTIONS) as engine:
        sweep = engine.wait_sweep(engine.submit_sweep(base, AXES, baseline=1).id, 120)
        made = engine.cell_difference(sweep.id, 3)
        (tmp_path / "cell.png").write_bytes(made.data)
        shown = read_image(tmp_path / "cell.png").pixels[..., :3]
        assert shown.shape[1] >= 480 and shown.std() > 0.01
        films = [
            mt.render(mt.load(base | {"materials": base["materials"] | {"ball": ball}}), threads=2)
            for ball in (
                {"type": "conductor", "metal": metal, "alpha": alpha}
                for alpha, metal in ((0.05, "Cu"), (0.2, "Cu"))
            )
        ]
        mt.compare(*films).save(tmp_path / "alone")
        alone = read_image(tmp_path / "alone" / "difference.png").pixels[..., :3]
        assert np.array_equal(shown, alone)
        for cell in (1, 6, -1):
            with pytest.raises(JobNotFound):
                engine.cell_difference(sweep.id, cell)
        other = engine.wait_sweep(engine.submit_sweep(base, AXES).id, 120)
        with pytest.raises(JobNotFound, match="no baseline"):
            engine.cell_difference(other.id, 3)
