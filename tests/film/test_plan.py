"""The chunk plan: every sample of every pixel exactly once, and a short render is a prefix."""

import numpy as np
import pytest

from matiere import _core

SIZES = [(1, 1), (16, 16), (17, 5), (100, 37), (192, 192), (256, 256), (640, 360), (1920, 1080)]
REPLICATES = [1, 2, 3, 4, 8, 64]


@pytest.mark.parametrize("replicates", REPLICATES)
def test_boundaries_double_to_8r_then_step_by_4r(replicates: int) -> None:
    plan = _core.Plan(32, 32, replicates)
    found = [plan.boundary(k) // replicates for k in range(10)]
    assert found == [0, 1, 2, 4, 8, 12, 16, 20, 24, 28]
    assert all(plan.boundary(k) % replicates == 0 for k in range(10))


@pytest.mark.parametrize("replicates", REPLICATES)
def test_round_up_is_the_smallest_boundary(replicates: int) -> None:
    plan = _core.Plan(8, 8, replicates)
    boundaries = [plan.boundary(k) for k in range(400)]
    for spp in range(1, 1200):
        if spp > boundaries[-1]:
            break
        expected = next(b for b in boundaries if b >= spp)
        assert plan.round_up(spp) == expected, spp
        assert plan.boundary(plan.ranges(spp)) == expected


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_chunks_hold_every_sample_once(width: int, height: int) -> None:
    plan = _core.Plan(width, height, 4)
    spp = plan.round_up(40)
    seen = np.zeros((height, width), np.int64)
    ends: dict[tuple[int, int], int] = {}
    for index in range(plan.chunk_count(spp)):
        c = plan.chunk(index)
        assert c["index"] == index
        assert 0 <= c["x0"] < c["x1"] <= width and 0 <= c["y0"] < c["y1"] <= height
        assert ends.get((c["x0"], c["y0"]), 0) == c["s0"] < c["s1"]  # without gap or overlap
        ends[c["x0"], c["y0"]] = c["s1"]
        seen[c["y0"] : c["y1"], c["x0"] : c["x1"]] += c["s1"] - c["s0"]
    assert (seen == spp).all()


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_tiles_depend_on_the_size_alone(width: int, height: int) -> None:
    plans = [_core.Plan(width, height, r) for r in REPLICATES]
    assert len({(p.tiles, p.tile_edge) for p in plans}) == 1
    assert plans[0].tile_edge in (16, 32, 64, 128)


def test_a_short_render_is_a_prefix_of_a_long_one() -> None:
    plan = _core.Plan(100, 60, 4)
    short, long = ([plan.chunk(i) for i in range(plan.chunk_count(spp))] for spp in (16, 200))
    assert long[: len(short)] == short


@pytest.mark.parametrize("replicates", REPLICATES)
def test_looks_are_the_first_boundaries_after_half_octaves(replicates: int) -> None:
    plan = _core.Plan(8, 8, replicates)
    boundaries = [plan.boundary(k) for k in range(1, 300)]
    marks = [replicates * 2 ** (k / 2) for k in range(17)]
    expected = {next((b for b in boundaries if b >= m * (1 - 1e-9)), None) for m in marks}
    last = max(b for b in expected if b)
    found = {b for b in boundaries if b <= last and plan.is_look(b)}
    assert found == expected - {None}
    assert not plan.is_look(replicates + 1) or replicates == 1


@pytest.mark.parametrize(
    ("arguments", "pointer"),
    [
        ((0, 1, 4), "/film"),
        ((1, 65537, 4), "/film"),
        ((1, 1, 0), "/render/replicates"),
        ((1, 1, 65), "/render/replicates"),
    ],
)
def test_unusable_plans_are_refused(arguments: tuple[int, int, int], pointer: str) -> None:
    with pytest.raises(_core.SceneError) as caught:
        _core.Plan(*arguments)
    assert caught.value.pointer == pointer


def test_too_many_samples_are_refused() -> None:
    plan = _core.Plan(8, 8, 4)
    assert plan.round_up(_core.MAX_SPP) == _core.MAX_SPP
    with pytest.raises(_core.SceneError):
        plan.round_up(_core.MAX_SPP + 1)
