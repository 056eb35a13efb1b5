"""What max_depth and threshold cut off: measured, booked, never in the image."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt
from matiere import _core

SPP = 256


def document(**render: Any) -> dict[str, Any]:
    scene = scenes(24)["interior"]
    scene["render"] = {"spp": SPP, **render}
    return scene


def mean_of(film: mt.Film) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean over the image by channel, and its standard error from the replicates."""
    replicates = film.core.replicate_means()[..., :3].mean((1, 2))
    n = len(replicates)
    return replicates.mean(0), replicates.std(0, ddof=1) / np.sqrt(n)


def entry(film: mt.Film, name: str) -> dict[str, Any]:
    return next(row for row in film.certificate()["ledger"] if row["name"] == name)


@pytest.fixture(scope="module")
def whole() -> tuple[np.ndarray, np.ndarray]:
    """The image without limits, from other random numbers."""
    return mean_of(mt.render(mt.load(document(seed=7, replicates=16))))


LIMITS = [
    {"max_depth": 0},
    {"max_depth": 3},
    {"threshold": 0.2},
    {"threshold": 0.5},
    {"max_depth": 3, "adaptive": True, "replicates": 8},
    {"max_depth": 2, "threshold": 0.3},
]


@pytest.mark.parametrize("limits", LIMITS, ids=str)
def test_image_and_ledger_make_the_unbiased_image(limits: dict[str, Any], whole: Any) -> None:
    film = mt.render(mt.load(document(**{"replicates": 16, **limits})))
    mean, error = mean_of(film)
    names = [name for name in ("max_depth", "threshold") if name in limits]
    lost = sum(np.array(entry(film, name)["radiance"]) for name in names)
    variance = sum(np.array(entry(film, name)["radiance_error"]) ** 2 for name in names)
    total_error = np.sqrt(error**2 + variance + whole[1] ** 2)
    assert np.all(np.abs(mean + lost - whole[0]) < 4 * total_error), (mean, lost, whole, variance)
    # The test sees what it is about: without the ledger the image is too dark, far beyond noise. A
    # film of the same numbers without limits tells what was cut with little noise.
    if "adaptive" not in limits:
        free = mt.render(mt.load(document(replicates=16)))
        cut = (free.core.replicate_means() - film.core.replicate_means())[..., :3].mean((1, 2))
        cut_error = np.sqrt(cut.var(0, ddof=1) / len(cut))
        assert np.max(cut.mean(0) / cut_error) > 6
        assert np.all(np.abs(cut.mean(0) - lost) < 4 * np.sqrt(cut_error**2 + variance))
    else:
        assert np.max((whole[0] - mean) / total_error) > 6
    row = entry(film, names[0])
    assert row["relative_bias"] > 5 * row["standard_error"] > 0
    assert row["count"] == pytest.approx(16 * film.core.cut_energy(names[0])["followed"], rel=0.1)


def test_the_standard_error_is_that_of_the_spread() -> None:
    """Over 12 seeds the booked light scatters as its error says, to the noise of 12."""
    films = [mt.render(mt.load(document(max_depth=1, seed=k, spp=32))) for k in range(12)]
    rows = [entry(film, "max_depth") for film in films]
    spread = np.std([row["radiance"][1] for row in rows], ddof=1)
    said = np.mean([row["radiance_error"][1] for row in rows])
    assert 0.5 < spread / said < 1.6, (spread, said)


def test_following_changes_no_pixel() -> None:
    """A limit that cuts nothing gives the bits of none; one that cuts, those of the same paths."""
    plain = mt.render(mt.load(document(spp=16)))
    far = mt.render(mt.load(document(spp=16, max_depth=10000)))
    assert np.array_equal(plain.mean, far.mean)
    assert entry(far, "max_depth")["count"] == 0 and entry(far, "max_depth")["relative_bias"] == 0
    assert not entry(plain, "threshold")["active"]


def test_what_is_booked_survives_files_threads_and_merging() -> None:
    scene = mt.load(document(spp=16, max_depth=2))
    one, two = mt.render(scene, threads=1), mt.render(scene, threads=2)
    assert entry(one, "max_depth") == entry(two, "max_depth")
    again = _core.Film.from_bytes(one.core.to_bytes())
    assert again.cut_energy("max_depth") == one.core.cut_energy("max_depth")
    half = mt.render(mt.load(document(spp=8, max_depth=2)))
    grown = mt.render(scene, film=half, spp=16)
    assert entry(grown, "max_depth") == entry(one, "max_depth")
    other = mt.render(scene, seed=3)
    merged = one.merge(other)
    means = [np.array(entry(film, "max_depth")["radiance"]) for film in (one, other, merged)]
    assert means[2] == pytest.approx((means[0] + means[1]) / 2)


def test_a_threshold_ignores_what_roulette_gave() -> None:
    """Grey walls of albedo 1/2, one bounce per halving: a threshold cuts where depth would."""
    scene = document(spp=64)
    scene["materials"] = {k: {"type": "lambert", "albedo": 0.5} for k in scene["materials"]}
    cut = mt.render(mt.load({**scene, "render": {"spp": 64, "threshold": 2.0**-6 * 1.01}}))
    deep = mt.render(mt.load({**scene, "render": {"spp": 64, "max_depth": 6}}))
    # Depth 6 looks for lights at six surfaces; the sixth halving is cut before the seventh hit,
    # whose own emission the other still sees: the lamp alone.
    assert np.abs(cut.mean - deep.mean).mean() < 0.01 * deep.mean[..., :3].mean()


def test_a_threshold_out_of_range_is_refused() -> None:
    for value in (0, -0.1, 1.5):
        with pytest.raises(mt.SceneValidationError) as caught:
            mt.load(document(threshold=value))
        assert caught.value.errors[0]["pointer"] == "/render/threshold"


def test_opacity_at_the_last_event_is_booked_too() -> None:
    """A half transparent sheet seen at max_depth 0: its own reflection is what is missing."""
    sheet = {"type": "mesh", "positions": [[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]],
             "triangles": [[0, 1, 2], [0, 2, 3]], "material": "veil"}  # fmt: skip
    scene = {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 0, 3], "target": [0, 0, 0], "vfov_deg": 20},
        "film": {"width": 16, "height": 16},
        "render": {"spp": 256, "max_depth": 0},
        "materials": {"veil": {"type": "lambert", "albedo": 0.8, "opacity": 0.5}},
        "shapes": [sheet],
        "lights": [{"type": "point", "position": [0, 0, 3], "intensity": 9}],
        "environment": {"radiance": 1},
    }
    film = mt.render(mt.load(scene))
    scene["render"] = {"spp": 256}
    whole = mt.render(mt.load(scene))
    row = entry(film, "max_depth")
    mean, error = mean_of(film)
    true, its = mean_of(whole)
    gap = mean + np.array(row["radiance"]) - true
    assert np.all(np.abs(gap) < 4 * np.sqrt(error**2 + its**2 + np.square(row["radiance_error"])))
    assert row["relative_bias"] > 0.3
