"""The certificate: what it holds, that unknown is never zero, what it books as bias, its plot."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt
from matiere.plot import certificate_plot

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def film() -> mt.Film:
    return mt.render(mt.load(scenes(24)["interior"]), spp=32)


def entry(film: mt.Film, name: str) -> dict[str, Any]:
    return next(row for row in film.certificate()["ledger"] if row["name"] == name)


def test_it_states_image_tiles_and_pixels(film: mt.Film) -> None:
    found = film.certificate()
    image, tiles = found["image"], found["tiles"]["rows"]
    assert image["any_time_lower"] < image["lower"] < image["relmse"] < image["upper"]
    assert image["upper"] < image["any_time_upper"]
    assert sum((t["x1"] - t["x0"]) * (t["y1"] - t["y0"]) for t in tiles) == 24 * 24
    assert found["pixels"]["degrees_of_freedom"] == 75
    assert f"{image['upper']:.3g}" in found["statement"]
    assert json.loads(json.dumps(found, allow_nan=False)) == film.report["certificate"]


def test_it_is_a_copy(film: mt.Film) -> None:
    film.certificate()["image"]["relmse"] = 0.0
    assert film.certificate()["image"]["relmse"] > 0.0


def test_pixel_intervals_hold_the_truth(film: mt.Film) -> None:
    truth = mt.render(mt.load(scenes(24)["interior"]), spp=4096, seed=77)
    lower, upper = film.interval()
    known = np.isfinite(lower)
    inside = (lower <= truth.mean) & (truth.mean <= upper)
    assert 0.90 < inside[known].mean() < 0.99
    narrow = film.interval(0.5)
    assert ((narrow[1] - narrow[0])[known] < (upper - lower)[known]).all()
    with pytest.raises(ValueError, match="confidence"):
        film.interval(1.0)


def test_without_evidence_nothing_is_zero() -> None:
    document = scenes(8)["diffuse"]
    document |= {"shapes": [], "lights": [], "environment": {"radiance": 1.0}}
    film = mt.render(mt.load(document), spp=16)
    found = film.certificate()
    assert found["known"] is False and "unknown" in found["statement"]
    assert all(value is None for value in found["image"].values())
    assert all(tile["relmse"] is None and tile["upper"] is None for tile in found["tiles"]["rows"])
    assert found["pixels"]["standard_error"] == {"mean": None, "p95": None, "max": None}
    assert np.isnan(film.interval()[0]).all()
    with pytest.raises(ValueError, match="nothing to plot"):
        certificate_plot(film)


def test_the_defaults_cut_nothing(film: mt.Film) -> None:
    for name in ("max_depth", "clamp", "threshold", "stopping"):
        assert entry(film, name)["active"] is False
    assert not any(line.startswith("max_depth") for line in film.certificate()["outside"])


def test_a_depth_limit_is_named_as_biased() -> None:
    film = mt.render(mt.load(scenes(16)["interior"]), spp=16, max_depth=2)
    row = entry(film, "max_depth")
    assert row["active"] and row["biased"] and 0 < row["relative_bias"] < 1
    assert 0 < row["standard_error"] < row["relative_bias"]
    assert 0 < row["share"] <= 1 and row["count"] > 0
    (line,) = [text for text in film.certificate()["outside"] if text.startswith("max_depth")]
    assert "more than 2 scattering events" in line and "% of the mean is missing" in line


def test_dropped_samples_are_booked_with_their_count() -> None:
    """An open interior: exits that were never entered are counted, and so are absorbed sides."""
    document = scenes(16)["glass"]
    document["shapes"][0] |= {"radius": 1.0}
    document["camera"]["origin"] = [0, 1, 0.2]  # inside the ball
    film = mt.render(mt.load(document), spp=16)
    counted = film.core.counters["unmatched_exits"]
    row = entry(film, "unmatched_exits")
    assert row["count"] == counted
    assert row["active"] is (counted > 0)
    assert row["share"] == counted / film.core.counters["samples"]


def test_a_stop_by_target_is_booked() -> None:
    film = mt.render(mt.load(scenes(16)["interior"]), target_error=0.5)
    assert film.report["reason"] == "target_error"
    assert entry(film, "stopping")["active"]
    assert any("below 0.1 % of the mean" in line for line in film.certificate()["outside"])
    state = film.certificate()["target"]
    assert state["reached"] and state["excess"] <= 1.0


def test_a_missed_target_has_a_forecast_on_the_plot(tmp_path: Path) -> None:
    film = mt.render(mt.load(scenes(16)["interior"]), spp=64, target_error=1e-4)
    state = film.certificate()["target"]
    assert not state["reached"] and state["excess"] > 1.0
    page = certificate_plot(film, "box <1>")
    root = ET.fromstring(page.svg())
    words = [t.text or "" for t in root.findall(f"{SVG}text")]
    assert any(w.startswith("target: relMSE 0.0001; expected after") for w in words)
    assert "light band: all looks at once" in words and "box <1>" in words
    bands = [p for p in root.findall(f"{SVG}path") if p.get("fill") == "#0072b2"]
    assert len(bands) == 2
    for name in ("plot.svg", "plot.png"):
        page.save(tmp_path / name)
    pixels = mt.read_image(tmp_path / "plot.png").pixels
    assert pixels.shape == (960, 1520, 3)


def test_an_exr_carries_it(film: mt.Film, tmp_path: Path) -> None:
    mt.write_image(tmp_path / "a.exr", film)
    held = mt.read_image(tmp_path / "a.exr").metadata
    found = film.certificate()
    assert held["matiere:certificate"] == found["statement"]
    assert held["matiere:relmse_any_time_upper"] == pytest.approx(
        found["image"]["any_time_upper"], rel=1e-6
    )
    assert "model:" in held["matiere:outside_certificate"]
