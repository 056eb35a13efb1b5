"""Films on disk, continued, merged: the same bits or a reason why not."""

import hashlib
import json
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt


@pytest.fixture(scope="module")
def scene() -> mt.Scene:
    return mt.load(scenes(24)["metal"])


@pytest.fixture(scope="module")
def film(scene: mt.Scene) -> mt.Film:
    return mt.render(scene, spp=16, seed=3)


def assert_same(a: mt.Film, b: mt.Film) -> None:
    assert np.array_equal(a.core.sums, b.core.sums)
    assert np.array_equal(a.sample_counts, b.sample_counts)


def test_a_saved_film_comes_back_whole(film: mt.Film, tmp_path: Path) -> None:
    path = tmp_path / "a.film"
    film.save(path)
    again = mt.load_film(path)
    assert_same(film, again)
    assert again.info == film.info
    assert again.report == film.report
    again.save(tmp_path / "b.film")
    assert (tmp_path / "b.film").read_bytes() == path.read_bytes()


def test_the_container_is_what_the_docs_say(film: mt.Film, tmp_path: Path) -> None:
    path = tmp_path / "a.film"
    film.save(path)
    data = path.read_bytes()
    assert data[:16] == b"\x89matiere film\r\n\x1a"
    assert int.from_bytes(data[16:20], "little") == 1
    length = int.from_bytes(data[20:28], "little")
    header = json.loads(data[28 : 28 + length])
    assert header["layers"] == ["camera"] and header["spp"] == 16 and header["replicates"] == 4
    assert header["info"]["seeds"] == [3]
    assert data[-32:] == hashlib.sha256(data[:-32]).digest()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("seed", range(40))
def test_damaged_files_are_refused_in_words(film: mt.Film, tmp_path: Path, seed: int) -> None:
    path = tmp_path / "a.film"
    film.save(path)
    data = bytearray(path.read_bytes())
    rng = random.Random(seed)
    at = rng.randrange(len(data))
    kind = seed % 3
    if kind == 0:
        data = data[:at]
    elif kind == 1:
        data[at] ^= 1 << rng.randrange(8)
    else:
        data.append(7)
    path.write_bytes(data)
    with pytest.raises(mt.FilmError, match=r"a\.film") as caught:
        mt.load_film(path)
    assert caught.value.code in {"damaged_film", "not_a_film", "newer_film"}


def test_newer_films_say_to_update(film: mt.Film, tmp_path: Path) -> None:
    path = tmp_path / "a.film"
    film.save(path)
    data = bytearray(path.read_bytes()[:-32])
    data[16] = 9
    path.write_bytes(data + hashlib.sha256(data).digest())
    with pytest.raises(mt.FilmError, match=r"newer matiere.*update"):
        mt.load_film(path)


def test_missing_and_foreign_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(mt.FilmError, match="cannot read"):
        mt.load_film(tmp_path / "none.film")
    (tmp_path / "x.film").write_bytes(b"PNG" * 100)
    with pytest.raises(mt.FilmError, match="is not a matiere film"):
        mt.load_film(tmp_path / "x.film")


def test_a_failed_save_leaves_the_old_file(film: mt.Film, tmp_path: Path) -> None:
    with pytest.raises(mt.MatiereError, match="cannot write"):
        film.save(tmp_path / "nowhere" / "a.film")
    assert list(tmp_path.iterdir()) == []


def test_continuing_a_loaded_film_is_one_long_render(
    scene: mt.Scene, film: mt.Film, tmp_path: Path
) -> None:
    film.save(tmp_path / "a.film")
    old = mt.load_film(tmp_path / "a.film")
    before = old.core.to_bytes()
    continued = mt.render(scene, film=old, spp=64, threads=2)  # seed 3 comes from the film
    assert_same(continued, mt.render(scene, spp=64, seed=3, threads=1))
    assert old.core.to_bytes() == before
    assert [row["spp"] for row in continued.info.log] == [4, 8, 16, 32, 48, 64]
    assert continued.report["wall_s"] > old.report["wall_s"]


def test_merging_other_seeds_halves_the_variance(scene: mt.Scene) -> None:
    a, b = (mt.render(scene, spp=32, seed=s) for s in (1, 2))
    both = a.merge(b)
    assert both.spp == 64 and both.info.seeds == (1, 2) and a.spp == 32
    np.testing.assert_allclose(both.mean, (a.mean + b.mean) / 2, rtol=1e-12)
    mean = (a.error["relmse"] + b.error["relmse"]) / 2
    assert both.error["relmse"] == pytest.approx(mean / 2, rel=0.25)
    other_spp = a.merge(mt.render(scene, spp=8, seed=5))
    assert other_spp.spp == 40
    three = both.merge(mt.render(scene, spp=32, seed=7))
    assert three.spp == 96 and three.report["reason"] == "merged"


def edited(change: Callable[[dict[str, object]], None]) -> mt.Scene:
    document = scenes(24)["metal"]
    change(document)
    return mt.load(document)


def test_illegal_merges_name_their_reason(scene: mt.Scene, film: mt.Film) -> None:
    cases = {
        "seed 3, which would count twice": mt.render(scene, spp=4, seed=3),
        "max_depth is None in one film and 2": mt.render(scene, spp=4, seed=1, max_depth=2),
        "different scenes": mt.render(
            edited(lambda d: d["materials"]["ball"].update(alpha=0.3)), spp=4, seed=1
        ),
    }
    for reason, other in cases.items():
        with pytest.raises(mt.FilmError, match=reason):
            film.merge(other)
    both = film.merge(mt.render(scene, spp=16, seed=4))
    with pytest.raises(mt.FilmError, match="seed 3"):
        both.merge(film)
    with pytest.raises(mt.FilmError, match="merged from seeds 3, 4 and cannot be continued"):
        mt.render(scene, film=both, spp=64)


def test_continuing_the_wrong_film_names_the_reason(scene: mt.Scene, film: mt.Film) -> None:
    with pytest.raises(mt.FilmError, match="seed 3, not 5"):
        mt.render(scene, film=film, seed=5)
    with pytest.raises(mt.FilmError, match="max_depth is None in one film and 2"):
        mt.render(scene, film=film, max_depth=2)
    with pytest.raises(mt.FilmError, match="different scenes"):
        mt.render(edited(lambda d: d["film"].update(filter="box")), film=film)


def test_exposure_and_stop_rule_are_no_part_of_a_film(film: mt.Film) -> None:
    changed = edited(lambda d: d.update(output={"exposure": 2}, render={"spp": 32}))
    assert mt.render(changed, film=film).spp == 32


@pytest.mark.parametrize(
    ("keys", "pointer"),
    [
        ({"spp": 0}, "/render/spp"),
        ({"spp": 2**24 + 1}, "/render/spp"),
        ({"spp": 1.5}, "/render/spp"),
        ({"spp": True}, "/render/spp"),
        ({"seconds": -1}, "/render/seconds"),
        ({"seconds": "soon"}, "/render/seconds"),
        ({"target_error": 0}, "/render/target_error/relmse"),
        ({"target_error": {"mse": 1}}, "/render/target_error"),
        ({"seed": -1}, "/render/seed"),
        ({"max_depth": -1}, "/render/max_depth"),
        ({"replicates": 65}, "/render/replicates"),
    ],
)
def test_bad_arguments_are_refused(scene: mt.Scene, keys: dict[str, object], pointer: str) -> None:
    with pytest.raises(mt.RenderError) as caught:
        mt.render(scene, **keys)  # type: ignore[arg-type]
    assert caught.value.pointer == pointer


def test_memory_is_refused_before_any_work(scene: mt.Scene) -> None:
    with pytest.raises(mt.MemoryLimitError, match=r"132 bytes per pixel") as caught:
        mt.render(scene, spp=2**20, memory_limit=10_000)
    assert caught.value.pointer == "/film"
    huge = mt.load({**scenes(24)["metal"], "film": {"width": 16384, "height": 16384}})
    with pytest.raises(mt.MemoryLimitError):
        mt.render(huge, spp=4, replicates=64)


def test_arrays_have_the_documented_shapes(film: mt.Film) -> None:
    assert film.mean.shape == film.standard_error.shape == (24, 24, 3)
    assert film.alpha.shape == film.sample_counts.shape == (24, 24)
    assert (film.alpha == 1).all() and not film.transparent
    assert film.replicate_means.shape == (4, 24, 24, 3)
    np.testing.assert_allclose(film.replicate_means.mean(0), film.mean, rtol=1e-12)


def test_arrays_are_read_only(film: mt.Film) -> None:
    for array in (film.mean, film.alpha, film.standard_error):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 0
    assert film.mean.copy().flags.writeable


def test_a_reference_must_be_independent(scene: mt.Scene, film: mt.Film) -> None:
    with pytest.raises(mt.FilmError, match="share a seed"):
        film.realised_relmse(mt.render(scene, spp=64, seed=3))
    reference = mt.render(scene, spp=1024, seed=77)
    realised = film.realised_relmse(reference)
    assert film.error["lower"] * 0.8 < realised < film.error["upper"] * 1.25
