"""The command line: render, schema, info, and the way it words mistakes."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from malformed import good

import matiere as mt

COMMAND = [sys.executable, "-m", "matiere.service"]


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments], cwd=cwd, capture_output=True, text=True, timeout=120
    )


def write_scene(folder: Path, **changes: Any) -> Path:
    scene = good()
    for key, value in changes.items():
        scene[key] = value
    path = folder / "scene.json"
    path.write_text(json.dumps(scene))
    return path


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_render_writes_everything_asked_for(tmp_path: Path) -> None:
    write_scene(tmp_path)
    done = run(
        "render", "scene.json", "-o", "a.png", "-o", "a.exr", "--report", "report.json",
        "--film", "a.mfilm", "--spp", "16", "--threads", "1", "--seed", "5", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert names(tmp_path) == ["a.exr", "a.mfilm", "a.png", "report.json", "scene.json"]
    lines = done.stdout.splitlines()
    assert re.fullmatch(
        r"16 spp in [\d.]+ s; the samples per pixel asked for were reached", lines[0]
    )
    number = r"[\d.e-]+"
    bar = (
        rf"relMSE ({number}), 95 % interval \[({number}), ({number})\]; RMSE {number}; m {number}; "
    )
    match = re.match(bar + r"unknown: [\d.]+ % of pixels$", lines[1])
    assert match and float(match[2]) < float(match[1]) < float(match[3])
    assert lines[2:] == [f"wrote {name}" for name in ("a.png", "a.exr", "a.mfilm", "report.json")]
    assert re.search(r"film 16 x 16, \d+ bytes per pixel, 0\.\d MiB", done.stderr)
    report = json.loads((tmp_path / "report.json").read_text())
    assert (report["spp"], report["seeds"], report["reason"]) == (16, [5], "spp")
    film = mt.load_film(tmp_path / "a.mfilm")
    exr = mt.read_image(tmp_path / "a.exr")
    assert np.array_equal(exr.pixels[:, :, :3], film.mean.astype(np.float32))
    assert exr.metadata["matiere:scene"] == report["scene_digest"]
    shown = np.clip(mt.develop(film), 0, 1)
    assert np.abs(mt.read_image(tmp_path / "a.png").pixels - shown).max() <= 0.5 / 255 + 1e-6


def test_despeckle_changes_the_picture_and_says_what_it_cost(tmp_path: Path) -> None:
    write_scene(tmp_path)
    done = run(
        "render", "scene.json", "-o", "a.png", "-o", "a.exr", "--report", "report.json",
        "--film", "a.mfilm", "--spp", "8", "--despeckle", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "of the light as specks" in done.stdout
    film = mt.load_film(tmp_path / "a.mfilm")
    picture = json.loads((tmp_path / "report.json").read_text())["picture"]
    assert picture["energy_held_back"] == film.despeckled.energy
    png = mt.read_image(tmp_path / "a.png")
    shown = np.clip(mt.develop(film, despeckle=True), 0, 1)
    assert np.abs(png.pixels - shown).max() <= 0.5 / 255 + 1e-6
    assert float(png.metadata["matiere:held_back"]) == pytest.approx(film.despeckled.energy)
    exr = mt.read_image(tmp_path / "a.exr")
    assert np.array_equal(exr.pixels[:, :, :3], film.mean.astype(np.float32))


def test_resumed_render_has_the_bits_of_one_long_one(tmp_path: Path) -> None:
    write_scene(tmp_path)
    run("render", "scene.json", "--film", "a.mfilm", "--spp", "8", cwd=tmp_path)
    done = run(
        "render", "scene.json", "--resume", "a.mfilm", "-o", "a.exr", "--spp", "32", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    run("render", "scene.json", "-o", "b.exr", "--spp", "32", cwd=tmp_path)
    a, b = (mt.read_image(tmp_path / name).pixels for name in ("a.exr", "b.exr"))
    assert np.array_equal(a, b, equal_nan=True)


def test_scene_may_name_its_files_view_and_depth(tmp_path: Path) -> None:
    output = {"files": ["x.png", "x.exr"], "bit_depth": {"png": 16, "exr": 16}, "exposure": 1}
    write_scene(tmp_path, output=output)
    (tmp_path / "elsewhere").mkdir()
    done = run("render", "../scene.json", "--quiet", cwd=tmp_path / "elsewhere")
    assert done.returncode == 0, done.stderr
    assert done.stdout == done.stderr == ""
    assert names(tmp_path) == ["elsewhere", "scene.json", "x.exr", "x.png"]
    assert mt.read_image(tmp_path / "x.png").metadata["matiere:exposure"] == "1.0"
    half = mt.read_image(tmp_path / "x.exr").pixels
    assert np.array_equal(half, half.astype(np.float16).astype(np.float32), equal_nan=True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "say where to write: -o out.png"),
        (["-o", "a.bmp"], "use .png, .jpg or .exr"),
        (["-o", "no/a.png"], "does not exist; make it first"),
        (["-o", "a.png", "--view", "ACES"], "'Un-tone-mapped'"),
        (["-o", "a.png", "--seconds", "-1"], "/render/seconds: "),
        (["-o", "a.png", "--resume", "no.mfilm"], "no.mfilm"),
        (["-o", "a.png", "--spp", "100000000"], "/render/spp: "),
    ],
)
def test_bad_requests_fail_before_the_render(
    arguments: list[str], words: str, tmp_path: Path
) -> None:
    write_scene(tmp_path)
    done = run("render", "scene.json", *arguments, cwd=tmp_path)
    assert done.returncode == 2, done
    assert words in done.stderr.splitlines()[-1], done.stderr
    assert "Traceback" not in done.stderr
    assert names(tmp_path) == ["scene.json"]


def test_rounded_samples_and_warnings_are_told(tmp_path: Path) -> None:
    write_scene(tmp_path, lights=[], environment=None)
    done = run("render", "scene.json", "-o", "a.png", "--spp", "10", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "note: the scene has no light" in done.stderr
    assert "warning: the error is unknown" in done.stderr
    assert "rounded up to 16" in done.stdout
    assert "error unknown (no evidence in 100 % of pixels)" in done.stdout


def test_film_beyond_the_memory_is_refused(tmp_path: Path) -> None:
    write_scene(tmp_path, film={"width": 16384, "height": 16384})
    done = run("render", "scene.json", "-o", "a.png", "--memory-limit", "2", cwd=tmp_path)
    assert done.returncode == 2
    film, refusal = done.stderr.splitlines()
    assert film.startswith("film 16384 x 16384, ") and "bytes per pixel" in film
    assert refusal.startswith("scene.json: /film: ") and "MiB" in refusal
    assert names(tmp_path) == ["scene.json"]


def test_missing_scene_is_named(tmp_path: Path) -> None:
    done = run("render", "no.json", "-o", "a.png", cwd=tmp_path)
    assert done.returncode == 2
    assert "no.json" in done.stderr and "No such file" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def start_long_render(folder: Path, **kwargs: Any) -> subprocess.Popen[bytes]:
    write_scene(folder)
    arguments = ["render", "scene.json", "-o", "a.png", "--seconds", "60"]
    return subprocess.Popen([*COMMAND, *arguments], cwd=folder, **kwargs)


def test_interrupt_leaves_nothing_behind(tmp_path: Path) -> None:
    process = start_long_render(tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stderr is not None
    assert b"bytes per pixel" in process.stderr.readline()
    assert b"spp" in process.stderr.readline()  # progress: the render runs
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)  # the render itself would take 60 s
    assert process.returncode == 130
    assert errors.decode().splitlines()[-1] == "interrupted; nothing was written"
    assert names(tmp_path) == ["scene.json"]


def test_terminal_shows_a_bar_with_spp_error_and_time_left(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "120"}
    process = start_long_render(tmp_path, stdout=subprocess.DEVNULL, stderr=theirs, env=environment)
    os.close(theirs)
    seen = b""
    deadline = time.monotonic() + 60
    while b"s left" not in seen or b"relMSE 0" not in seen:
        assert time.monotonic() < deadline, seen[-500:]
        seen += os.read(ours, 4096)
    process.send_signal(signal.SIGINT)
    while process.poll() is None:
        try:
            os.read(ours, 4096)
        except OSError:
            break
    assert process.wait(timeout=30) == 130
    os.close(ours)
    assert b" spp, " in seen


def test_schema_and_info(tmp_path: Path) -> None:
    done = run("schema", cwd=tmp_path)
    assert json.loads(done.stdout) == mt.schema()
    facts = json.loads(run("info", "--json", cwd=tmp_path).stdout)
    assert facts["matiere"] == mt.__version__
    assert facts["embree"].startswith(("3.", "4."))
    assert facts["threads"] >= 1 and facts["isa"]
    assert "lambert" in run("info", cwd=tmp_path).stdout


def test_help_lists_every_command_and_mistakes_are_guessed(tmp_path: Path) -> None:
    text = run("--help", cwd=tmp_path).stdout
    for command in ("render", "sweep", "serve", "submit", "schema", "info", "config"):
        assert command in text
    done = run("rendr", cwd=tmp_path)
    assert done.returncode == 2
    assert "render" in done.stderr
    assert run("--version", cwd=tmp_path).stdout == f"matiere {mt.__version__}\n"


GLASS = '{"type": "dielectric", "alpha": 0.2}'


def test_check_prints_a_table_and_draws(tmp_path: Path) -> None:
    done = run("check", GLASS, "--plot", "plots", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("pass: ") and "chi_square" in done.stdout
    assert names(tmp_path / "plots") == ["albedo.png", "albedo.svg", "polar.png", "polar.svg"]


@pytest.mark.slow
def test_check_reads_files_and_scenes(tmp_path: Path) -> None:
    (tmp_path / "glass.json").write_text(GLASS)
    scene = write_scene(tmp_path)
    document = json.loads(scene.read_text())
    name = next(iter(document["materials"]))
    document["materials"] = {name: {"type": "mirror"}, "other": {"type": "lambert", "albedo": 9}}
    scene.write_text(json.dumps(document))
    done = run("check", "scene.json", "--material", name, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["material"] == {"type": "mirror"} and report["version"] == 1
    assert run("check", "glass.json", cwd=tmp_path).stdout.startswith("pass")
    several = run("check", "scene.json", cwd=tmp_path)
    assert several.returncode == 2 and "--material" in several.stderr and "other" in several.stderr
    wrong = run("check", "scene.json", "--material", "other", cwd=tmp_path)
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("scene.json: /materials/other/albedo: must be at most 1")
    assert run("check", "none.json", cwd=tmp_path).returncode == 2


def test_check_fails_with_code_one(monkeypatch: pytest.MonkeyPatch) -> None:
    import fake_bsdf
    import typer

    from matiere.service.commands.check import check
    from matiere.stability import report

    bad = report.check_bsdf(fake_bsdf.GainsEnergy(), fake_bsdf.GainsEnergy(), report.Promises())
    monkeypatch.setattr(mt, "check", lambda *_args, **_more: bad)
    with pytest.raises(typer.Exit) as end:
        check(GLASS, name=None, as_json=False, plot=None, seed=1)
    assert end.value.exit_code == 1
