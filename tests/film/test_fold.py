"""Chunks fold into the same bits, whoever made them; damaged ones are refused."""

import random

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt
from matiere import _core, chunks


def synthetic(spp: int, threads: int = 1, replicates: int = 4, size: int = 40) -> _core.Film:
    film = _core.Film(size, size - 7, replicates)
    _core.render_synthetic(film, "lognormal", {"spp": spp}, 2.0, 5, threads)
    return film


def same_bits(a: _core.Film, b: _core.Film) -> bool:
    return np.array_equal(a.sums.view(np.uint64), b.sums.view(np.uint64)) and np.array_equal(
        a.counts, b.counts
    )


@pytest.fixture(scope="module")
def scene() -> mt.Scene:
    return mt.load(scenes(32)["glass"])


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_threads_do_not_change_bits(threads: int) -> None:
    assert same_bits(synthetic(64), synthetic(64, threads))


def test_threads_do_not_change_bits_of_a_scene(scene: mt.Scene) -> None:
    one, two = (mt.render(scene, spp=16, threads=n).core for n in (1, 2))
    assert same_bits(one, two)


@pytest.mark.parametrize("replicates", [1, 2, 4, 8])
def test_continuing_is_one_long_run(replicates: int) -> None:
    film = _core.Film(40, 33, replicates)
    for spp in (1, 3 * replicates, 40, 41, 200):
        _core.render_synthetic(film, "lognormal", {"spp": spp}, 2.0, 5, 2)
    assert same_bits(film, synthetic(200, 1, replicates))


def test_chunks_in_any_order_make_the_film_of_the_pass_loop(scene: mt.Scene) -> None:
    asked = scene.with_render(spp=16)
    plan = chunks.plan(asked.model)
    indices = list(range(plan.chunk_count(16)))
    random.Random(3).shuffle(indices)
    parts = {i: chunks.render_chunk(asked, i, threads=1) for i in indices}
    film = chunks.new_film(plan)
    assert chunks.merge_prefix(film, parts) == 16
    assert same_bits(film, mt.render(scene, spp=16).core)


def test_merging_stops_at_a_gap(scene: mt.Scene) -> None:
    plan = chunks.plan(scene.model)
    parts = {i: chunks.render_chunk(scene, i, threads=1) for i in range(2 * plan.tiles)}
    del parts[plan.tiles + 1]
    film = chunks.new_film(plan)
    assert chunks.merge_prefix(film, parts) == plan.boundary(1)
    assert (np.asarray(film.counts) == plan.boundary(1)).all()


def test_a_chunk_out_of_order_or_twice_is_refused_and_changes_nothing(scene: mt.Scene) -> None:
    plan = chunks.plan(scene.model)
    film = chunks.new_film(plan)
    first, later = (chunks.render_chunk(scene, i, threads=1) for i in (0, plan.tiles))
    with pytest.raises(mt.FilmError, match=f"chunk {plan.tiles} was given where chunk 0 is next"):
        chunks.add(film, later)
    assert not film.sums.any()
    chunks.add(film, first)
    before = film.to_bytes()
    with pytest.raises(mt.FilmError) as caught:
        chunks.add(film, first)
    assert caught.value.code == "chunk_out_of_order"
    assert film.to_bytes() == before


def test_a_chunk_of_another_film_is_refused(scene: mt.Scene) -> None:
    film = _core.Film(32, 32, 8)
    with pytest.raises(mt.FilmError, match="4 replicates, this one is 32 x 32 with 8"):
        chunks.add(film, chunks.render_chunk(scene, 0, threads=1))


def test_crop_pixels_are_those_of_the_whole_film(scene: mt.Scene) -> None:
    """But for light paths, whose number is that of the samples of the film, crop or whole."""
    document = scenes(32)["glass"]
    document["film"]["crop"] = [5, 9, 27, 20]
    crop = mt.render(mt.load(document).with_render(light_tracing=False), spp=8)
    whole = mt.render(scene.with_render(light_tracing=False), spp=8)
    np.testing.assert_array_equal(crop.mean, whole.mean[9:20, 5:27])


def test_bytes_round_trip_exactly() -> None:
    film = synthetic(16)
    again = _core.Film.from_bytes(film.to_bytes())
    assert same_bits(film, again)
    assert again.to_bytes() == film.to_bytes()
    assert again.counters == film.counters


def damage(data: bytes, rng: random.Random) -> bytes:
    kind = rng.randrange(3)
    at = rng.randrange(len(data))
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data + bytes([rng.randrange(256)])
    return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]


@pytest.mark.parametrize("seed", range(60))
def test_damaged_bytes_are_refused(seed: int, scene: mt.Scene) -> None:
    rng = random.Random(seed)
    film = synthetic(4, size=20)
    with pytest.raises(_core.SceneError):
        _core.Film.from_bytes(damage(film.to_bytes(), rng))


def test_damaged_chunks_are_refused(scene: mt.Scene) -> None:
    data = chunks.render_chunk(scene, 0, threads=1)
    assert data is not None
    rng = random.Random(1)
    for _ in range(60):
        with pytest.raises(mt.FilmError):
            chunks.add(chunks.new_film(chunks.plan(scene.model)), damage(data, rng))


def test_counters_are_summed_over_chunks() -> None:
    film = synthetic(64, 2)
    counters = film.counters
    assert counters["samples"] == 64 * 40 * 33 == counters["rays"]
    assert counters["rejected"] == [] and counters["rejected_total"] == 0


def test_views_are_read_only_and_keep_their_film_alive() -> None:
    sums = synthetic(4).sums
    assert sums.shape == (4, 33, 40, 4)
    with pytest.raises(ValueError, match="read-only"):
        sums[0, 0, 0, 0] = 1.0
    assert np.isfinite(sums).all() and sums.any()
