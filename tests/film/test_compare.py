"""Comparing films: planted differences are found, noise is not, pairing is measured."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt
from matiere.compare import holm
from matiere.errors import FilmError

SIZE = 24


def film(seed: int = 0, spp: int = 16, name: str = "diffuse", **changes: Any) -> mt.Film:
    document = scenes(SIZE)[name]
    document["materials"]["ball"] |= changes
    return mt.render(mt.load(document), spp=spp, seed=seed)


@pytest.fixture(scope="module")
def base() -> mt.Film:
    return film()


def test_a_difference_of_one_percent_is_found(base: mt.Film) -> None:
    """Albedo 0.7 to 0.707: the ball differs, tiles of sky do not, and the sign is that of b - a."""
    found = mt.compare(base, film(albedo=0.707))
    mean = found.report["mean"]
    assert mean["significant"] and mean["difference"] > 0 and mean["p_value"] < 1e-6
    assert mean["lower_percent"] < mean["difference_percent"] < mean["upper_percent"]
    assert 0.05 < mean["difference_percent"] < 1.0
    assert found.report["paired"] and found.report["variance_ratio"] > 100
    significant = [t for t in found.report["tiles"] if t["significant"]]
    assert significant and all(t["difference"] > 0 for t in significant)
    back = mt.compare(film(albedo=0.707), base).report["mean"]
    assert back["difference"] == pytest.approx(-mean["difference"])


def test_without_pairing_it_is_lost_in_noise(base: mt.Film) -> None:
    found = mt.compare(base, film(seed=5, albedo=0.707))
    assert not found.report["paired"]
    assert found.report["variance_ratio"] == pytest.approx(1.0, abs=0.25)
    assert not found.report["mean"]["p_value"] < 1e-4
    assert any("different seeds" in note for note in found.report["notes"])


def test_the_interval_of_the_difference_holds_the_truth() -> None:
    """A lamp 10 % brighter, other seeds: the true difference is a tenth of the true mean."""
    document = scenes(16)["interior"]
    long = mt.render(mt.load(document), spp=4096, seed=999)
    truth = 0.1 * float((long.mean @ [0.2126, 0.7152, 0.0722]).mean())
    scene = mt.load(document)
    films = [mt.render(scene, spp=8, seed=seed) for seed in range(20)]
    document["lights"][0]["radiance"] = [1.1 * x for x in document["lights"][0]["radiance"]]
    scene, inside = mt.load(document), 0
    for seed, a in enumerate(films):
        b = mt.render(scene, spp=8, seed=seed + 100)
        mean = mt.compare(a, b).report["mean"]
        inside += mean["lower"] <= truth <= mean["upper"]
    assert inside >= 16, inside  # P < 0.3 % at 95 %


def test_equal_materials_differ_no_more_often_than_chance() -> None:
    """40 pairs of seeds: at 5 % no more than 6 images and 6 sets of tiles (P < 1.4 %)."""
    images = sets = 0
    scene = mt.load(scenes(16)["metal"])
    films = [mt.render(scene, seed=k, spp=8) for k in range(80)]
    for a, b in zip(films[::2], films[1::2], strict=True):
        report = mt.compare(a, b).report
        images += bool(report["mean"]["significant"])
        sets += report["tiles_significant"] > 0
    assert images <= 6 and sets <= 6, (images, sets)


def test_pixels_have_the_error_of_their_difference() -> None:
    """z of the per-pixel difference over its standard error has a standard deviation near 1."""
    films = [film(seed=k, spp=16) for k in range(8)]
    z = []
    for a, b in zip(films[::2], films[1::2], strict=True):
        found = mt.compare(a, b)
        z.append((found.difference / found.standard_error)[np.isfinite(found.standard_error)])
    assert np.std(np.concatenate(z)) == pytest.approx(1.0, abs=0.15)


def test_a_film_equals_itself(base: mt.Film) -> None:
    report = mt.compare(base, base).report
    assert report["identical"] and "equal" in report["statement"]
    assert report["variance_ratio"] is None and report["mean"]["standard_error"] is None
    assert report["tiles_significant"] == 0


def test_a_gap_alike_in_all_replicates_is_unknown_not_certain() -> None:
    films = []
    for radiance in (1.0, 1.5):
        document = scenes(8)["diffuse"]
        document |= {"shapes": [], "lights": [], "environment": {"radiance": radiance}}
        films.append(mt.render(mt.load(document), spp=16))
    found = mt.compare(*films)
    mean = found.report["mean"]
    assert mean["difference"] == pytest.approx(0.5, rel=1e-6)
    assert mean["p_value"] is None and mean["standard_error"] is None
    assert found.report["tiles_unknown"] == len(found.report["tiles"])
    assert np.isnan(found.standard_error).all()


def test_films_that_do_not_match_are_refused(base: mt.Film) -> None:
    small = mt.render(mt.load(scenes(16)["diffuse"]), spp=4)
    with pytest.raises(FilmError, match=r"24 x 24 and\s+16 x 16"):
        mt.compare(base, small)
    scene = mt.load(scenes(SIZE)["diffuse"])
    with pytest.raises(FilmError, match="4 and 8 replicates"):
        mt.compare(base, mt.render(scene, spp=8, replicates=8))
    with pytest.raises(FilmError, match="at least two replicates"):
        mt.compare(base, mt.render(scene, spp=8, replicates=1))


def test_holm_by_hand() -> None:
    assert holm([0.01, None, 0.04, 0.03]) == pytest.approx([0.03, None, 0.06, 0.06])
    assert holm([0.9, 0.8]) == pytest.approx([1.0, 1.0])


def test_files_hold_difference_error_and_report(base: mt.Film, tmp_path: Path) -> None:
    found = mt.compare(base, film(albedo=0.6))
    picture, data, report = found.save(tmp_path / "out")
    shown = mt.read_image(picture).pixels
    assert shown.shape[0] > 400 and shown.shape[2] == 3
    values = mt.read_image(data).pixels
    np.testing.assert_allclose(values[..., :3], found.difference, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(values[..., 3:], found.standard_error, rtol=1e-6)
    assert json.loads(report.read_text()) == json.loads(json.dumps(found.report))
