"""A film with a light layer as people have it: report, ledger, layers, files, crops, errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import matiere as mt
from matiere import _core

ROOT = Path(__file__).resolve().parents[2]


def document(size: int = 32, **render: Any) -> dict[str, Any]:
    """Glass and gold under a point: camera paths find none of the caustics."""
    scene: dict[str, Any] = json.loads((ROOT / "examples/scenes/caustic.json").read_text())
    scene["film"] = {"width": size, "height": size}
    scene["render"] = {"spp": 32, "seed": 3, **render}
    return scene


def lamp(size: int = 32, **render: Any) -> dict[str, Any]:
    """The same under a lamp that camera paths can find."""
    scene = document(size, **render)
    scene["lights"] = [{"type": "rectangle", "corner": [1.3, 3.5, -1.7], "edge_u": [0.4, 0, 0],
                        "edge_v": [0, 0, 0.4], "radiance": [120, 114, 102]}]  # fmt: skip
    return scene


def row(film: mt.Film, name: str) -> dict[str, Any]:
    return next(r for r in film.certificate()["ledger"] if r["name"] == name)


def mean_of(film: mt.Film) -> tuple[Any, Any]:
    means = film.core.replicate_means()[..., :3].mean((1, 2))
    return means.mean(0), means.std(0, ddof=1) / np.sqrt(len(means))


def test_the_report_says_what_was_decided() -> None:
    on = mt.render(mt.load(document()))
    off = mt.render(mt.load(document(light_tracing=False)))
    few = mt.render(mt.load(document(replicates=2)))
    short = mt.render(mt.load(document(max_depth=1)))
    assert on.report["light_tracing"]["on"] and on.report["light_tracing"]["paths"] == 8 * 32**2
    assert on.report["bytes_per_pixel"] == off.report["bytes_per_pixel"] + 24 * 4
    for film, why in ((off, "request"), (few, "replicates"), (short, "max_depth")):
        told = film.report["light_tracing"]
        assert not told["on"] and told["paths"] == 0 and why in told["why"]
        assert row(film, "hidden_light")["active"]
    assert row(on, "hidden_light")["active"]  # what is seen in mirrors
    assert on.mean.mean() > 1.02 * off.mean.mean()


def test_media_that_scatter_leave_it_out() -> None:
    scene = document()
    scene["materials"]["fog"] = {"type": "null", "sigma_s": 0.1}
    scene["shapes"].append({"type": "sphere", "center": [0, 3, -3], "radius": 0.5,
                            "material": "fog"})  # fmt: skip
    told = mt.render(mt.load(scene), spp=4).report["light_tracing"]
    assert not told["on"] and "scatter" in told["why"]


@pytest.mark.parametrize(
    ("value", "pointer"), [("yes", "/render/light_tracing"), (2, "/render/light_tracing")]
)
def test_a_wrong_choice_is_refused(value: Any, pointer: str) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(document(light_tracing=value))
    assert caught.value.errors[0]["pointer"] == pointer


def test_asked_for_with_too_few_replicates_is_refused() -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(document(light_tracing=True, replicates=2))
    assert caught.value.errors[0]["pointer"] == "/render/replicates"


@pytest.mark.parametrize("adaptive", [False, True])
def test_layers_add_up(adaptive: bool) -> None:
    scene = document(adaptive=adaptive)
    scene["film"]["aovs"] = [
        "emission",
        "direct",
        "indirect",
        "diffuse",
        "specular",
        "transmission",
    ]
    scene["materials"]["floor"] = {"type": "plastic", "albedo": 0.6, "alpha": 0.4}
    film = mt.render(mt.load(scene))
    assert film.aov("caustic").mean() > 0.02 * film.mean.mean()
    whole = film.aov("direct") + film.aov("indirect")
    assert whole == pytest.approx(film.mean, rel=1e-6, abs=1e-7)
    parts = sum(film.aov(n) for n in ("emission", "diffuse", "specular", "transmission"))
    assert parts == pytest.approx(film.mean, rel=1e-6, abs=1e-7)
    again = _core.Film.from_bytes(film.core.to_bytes())
    assert np.array_equal(again.aov("diffuse"), film.core.aov("diffuse"))


@pytest.mark.parametrize("limits", [{"max_depth": 3}, {"threshold": 0.3}], ids=str)
def test_image_and_ledger_make_the_unbiased_image(limits: dict[str, Any]) -> None:
    """Of a lamp that camera paths find, so that nothing is hidden from either."""
    film = mt.render(mt.load(lamp(24, replicates=16, light_tracing=True, **limits)), spp=1024)
    whole = mt.render(mt.load(lamp(24, replicates=16, light_tracing=False, seed=8)), spp=4096)
    assert film.report["light_tracing"]["on"]
    mean, error = mean_of(film)
    true, its = mean_of(whole)
    booked = row(film, next(iter(limits)))
    gap = mean + np.array(booked["radiance"]) - true
    total = np.sqrt(error**2 + its**2 + np.square(booked["radiance_error"]))
    assert np.all(np.abs(gap) < 4 * total), (gap, total)


def test_files_continue_and_merge(tmp_path: Path) -> None:
    scene = mt.load(document())
    whole = mt.render(scene, spp=32)
    mt.render(scene, spp=8).save(tmp_path / "a.film")
    grown = mt.render(scene, film=mt.load_film(tmp_path / "a.film"), spp=32)
    assert np.array_equal(whole.mean, grown.mean)
    other = mt.render(scene, spp=32, seed=9)
    merged = whole.merge(other)
    assert merged.mean == pytest.approx((whole.mean + other.mean) / 2)
    off = mt.render(mt.load(document(light_tracing=False)))
    with pytest.raises(mt.FilmError):
        off.merge(whole)


def test_a_film_without_a_layer_keeps_its_bytes() -> None:
    """Version 4 of the bytes without a layer, 5 with: what others wrote before can be read."""
    off = mt.render(mt.load(document(light_tracing=False)), spp=4).core.to_bytes()
    on = mt.render(mt.load(document()), spp=4).core.to_bytes()
    assert (off[8], on[8]) == (4, 5)


def test_a_crop_has_the_mean_of_the_whole_film() -> None:
    scene = document(64, replicates=16)
    whole = mt.render(mt.load(scene), spp=256)
    scene["film"]["crop"] = [10, 24, 50, 56]
    scene["render"]["seed"] = 4
    crop = mt.render(mt.load(scene), spp=256)
    a = crop.core.replicate_means()[..., :3].mean((1, 2, 3))
    b = whole.core.replicate_means()[..., 24:56, 10:50, :3].mean((1, 2, 3))
    error = np.sqrt(a.var(ddof=1) / len(a) + b.var(ddof=1) / len(b))
    assert abs(a.mean() - b.mean()) < 4 * error < 0.02 * a.mean()


def test_intervals_hold() -> None:
    """Pixels share light paths: intervals of the image that took them as independent would fail."""
    truth = mt.render(mt.load(document(16)), spp=8192, seed=77)
    inside, looks = 0, 20
    for seed in range(looks):
        film = mt.render(mt.load(document(16, seed=seed)), spp=32)
        error = film.report["error"]
        inside += error["lower"] <= film.realised_relmse(truth) <= error["upper"]
    assert inside >= 16, inside  # 95 % of 20, less what chance allows once in 10,000


def test_two_films_of_one_scene_do_not_differ() -> None:
    a = mt.render(mt.load(document(replicates=8)), spp=64)
    b = mt.render(mt.load(document(replicates=8, seed=4)), spp=64)
    c = mt.render(mt.load(document(replicates=8, light_tracing=False)), spp=64)
    assert mt.compare(a, b).report["mean"]["p_value"] > 0.001
    assert mt.compare(a, c).report["mean"]["p_value"] < 0.01
