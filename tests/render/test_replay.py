"""Outliers are the brightest samples, however a film came about; a replay gives them to the bit."""

import json
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt
from matiere import _core
from matiere.errors import RenderError

KEPT = 16


def scene(size: int = 8, name: str = "glass", **render: Any) -> mt.Scene:
    return mt.load(scenes(size)[name] | {"render": {"spp": 8, **render}})


def luminance(value: Any) -> np.float32:
    r, g, b = np.asarray(value, np.float32)
    return np.float32(0.2126) * r + np.float32(0.7152) * g + np.float32(0.0722) * b


def identity(row: dict[str, Any]) -> tuple[Any, ...]:
    return (*row["pixel"], row["replicate"], row["sample"], row["seed"], *row["value"])


def identities(film: Any) -> list[tuple[Any, ...]]:
    core = getattr(film, "core", film)
    return [identity(row) for row in core.provenance["outliers"]]


def test_outliers_are_the_brightest_of_all_samples() -> None:
    small = scene(4, "interior")
    film = mt.render(small, spp=8)
    every = [
        dict(mt.replay(small, pixel=(x, y), replicate=r, sample=s).path)
        for y in range(4)
        for x in range(4)
        for r in range(4)
        for s in range(2)
    ]
    sums = np.zeros((4, 4, 4, 3))
    for path in every:
        x, y = path["pixel"]
        sums[path["replicate"], y, x] += path["value"]
    assert np.array_equal(sums, np.asarray(film.core.sums)[..., :3])
    every.sort(key=lambda p: (-luminance(p["value"]), p["pixel"][1], p["pixel"][0],
                              p["replicate"], p["sample"]))  # fmt: skip
    assert identities(film) == [identity(path) for path in every[:KEPT]]


@pytest.mark.parametrize("name", ["diffuse", "metal", "glass"])
def test_a_replay_gives_the_recorded_bits(name: str) -> None:
    made = scene(12, name, seed=3)
    film = mt.render(made, spp=32)
    rows = film.report["outliers"]
    assert len(rows) == KEPT and rows[0]["luminance"] >= rows[-1]["luminance"] > 0
    for row in rows:
        again = mt.replay(
            made, pixel=tuple(row["pixel"]), replicate=row["replicate"], sample=row["sample"]
        )
        assert np.float32(again.value).tobytes() == np.float32(row["value"]).tobytes()


def test_contributions_add_up_to_the_value() -> None:
    made = scene(12, "metal")
    for row in mt.render(made, spp=16).report["outliers"]:
        path = mt.replay(made, **{k: row[k] for k in ("pixel", "replicate", "sample")}).path
        met = [m for v in path["vertices"] for m in v["lights"]] + list(path["background"])
        total = np.sum([m["contribution"] for m in met], axis=0)
        assert total == pytest.approx(path["value"], rel=1e-5)


def test_outliers_do_not_depend_on_threads_chunks_or_restarts() -> None:
    made = scene(40)
    one = mt.render(made, spp=8, threads=1)
    expected = identities(one)
    assert identities(mt.render(made, spp=8, threads=2)) == expected
    assert identities(mt.render(made, film=mt.render(made, spp=4), spp=8)) == expected
    plan = mt.chunks.plan(made.model)
    count = plan.chunk_count(8)
    parts = {i: mt.chunks.render_chunk(made, i) for i in reversed(range(count))}
    film = mt.chunks.new_film(plan)
    mt.chunks.merge_prefix(film, parts)
    assert identities(film) == expected
    assert identities(_core.Film.from_bytes(film.to_bytes())) == expected


def test_merged_films_keep_the_brightest_of_both(tmp_path: Path) -> None:
    films = [mt.render(scene(8, seed=seed), spp=8) for seed in (1, 2)]
    both = films[0].merge(films[1])
    rows = [row for film in films for row in film.report["outliers"]]
    rows.sort(key=lambda r: (-r["luminance"], r["pixel"][1], r["pixel"][0], r["replicate"],
                             r["sample"], r["seed"]))  # fmt: skip
    assert identities(both) == [identity(row) for row in rows[:KEPT]]
    assert {row["seed"] for row in both.report["outliers"]} == {1, 2}
    both.save(tmp_path / "both.film")
    assert identities(mt.load_film(tmp_path / "both.film")) == identities(both)


def crc64(data: bytes) -> int:
    crc = 2**64 - 1
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xC96C5795D7870F42 if crc & 1 else 0)
    return crc ^ (2**64 - 1)


@pytest.mark.parametrize("older", [1, 2, 3])
def test_bytes_of_older_versions_are_still_read(older: int) -> None:
    """1 lacks the provenance, which stood after counters and rejections; 2 the cuts; 3 layers."""
    film = mt.render(scene(4, "interior"), spp=4).core
    data = film.to_bytes()
    version, rows = struct.unpack_from("<I", data, 8)[0], 8 + 4 + 16 + 4 + 16 + 6 * 8
    assert version >= 4
    begin = rows + 8 + 48 * struct.unpack_from("<Q", data, rows)[0]
    cuts = begin + 12 + 40 * len(film.provenance["outliers"])
    layers = cuts + 2 * 64 * film.plan.strips
    kept = {1: begin, 2: cuts, 3: layers}[older]
    old = data[:8] + struct.pack("<I", older) + data[12:kept] + data[layers + 4 : -8]
    read = _core.Film.from_bytes(old + struct.pack("<Q", crc64(old)))
    assert np.array_equal(read.sums, film.sums)
    assert read.cut_energy("max_depth")["paths"] == 0 and read.aovs == []
    if older == 1:
        assert read.provenance == {"kernels": [], "found": [], "left_out": [], "outliers": []}


def test_the_report_names_kernel_and_what_it_left_out() -> None:
    kernel = mt.render(scene(4, "interior"), spp=4).report["kernel"]
    assert kernel["name"] == "diffuse"
    assert kernel["features"] == ["area_lights", "spheres"]
    assert {"interiors", "textures", "models"} <= set(kernel["left_out"])
    kernel = mt.render(scene(4, "glass"), spp=4).report["kernel"]
    assert kernel["name"] == "clear" and kernel["left_out"] == ["scattering"]
    assert {"interiors", "environment", "delta_lobes"} <= set(kernel["features"])


def test_words_name_materials_lights_and_the_end() -> None:
    made = scene(12)
    row = mt.render(made, spp=32).report["outliers"][0]
    text = mt.replay(made, **{k: row[k] for k in ("pixel", "replicate", "sample")}).text
    assert f"pixel ({row['pixel'][0]}, {row['pixel'][1]})" in text
    assert "'ball' (dielectric)" in text or "'floor' (lambert)" in text
    assert "The path " in text and "MIS weight" in text


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({"pixel": (8, 0)}, "pixel x"),
        ({"pixel": (0, -1)}, "pixel y"),
        ({"pixel": (0, 0), "replicate": 4}, "replicate"),
        ({"pixel": (0, 0), "sample": -1}, "sample"),
        ({"pixel": (0, 0), "seed": 0.5}, "seed"),
    ],
)
def test_numbers_outside_the_film_are_refused(wrong: dict[str, Any], what: str) -> None:
    with pytest.raises(RenderError, match=what):
        mt.replay(scene(8), **wrong)


def test_the_command_replays_the_worst_of_a_film(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(scenes(8)["metal"] | {"render": {"spp": 8}}))
    film = mt.render(mt.load(path))
    film.save(tmp_path / "a.film")
    (tmp_path / "a.json").write_text(json.dumps(film.report))

    def run(*arguments: str, code: int = 0) -> str:
        command = [sys.executable, "-m", "matiere.service", "replay", str(path), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == code, done.stderr
        return done.stdout if code == 0 else done.stderr

    worst = run("--worst", "2", "--film", str(tmp_path / "a.film"), "--json")
    assert [identity(row) for row in json.loads(worst)] == identities(film)[:2]
    assert run("--worst", "2", "--report", str(tmp_path / "a.json"), "--json") == worst
    assert run("--pixel", "3,4", "--sample", "1").startswith("pixel (3, 4), replicate 0, sample 1")
    assert "--pixel" in run(code=2)
    assert "replicate must be" in run("--pixel", "1,1", "--replicate", "9", code=2)
