"""Films with a light layer: bits, bytes, and that scenes without need have none."""

from typing import Any

import numpy as np
import pytest
from light_scenes import BALLS, N, ball_on_floor

from matiere import _core


def film_of(scene: Any, spp: int, threads: int, film: Any = None, replicates: int = 4) -> Any:
    film = film or _core.Film(N, N, replicates)
    settings = _core.Settings(5, 8, light_tracing="auto")
    _core.render(scene, settings, film, {"spp": spp}, threads)
    return film


def same_bits(a: Any, b: Any) -> bool:
    return (
        np.array_equal(a.sums, b.sums)
        and np.array_equal(a.light_sums, b.light_sums)
        and a.light_paths == b.light_paths
    )


@pytest.mark.parametrize("adaptive", [False, True])
def test_bits(adaptive: bool) -> None:
    """Any threads; a short film continued, through its bytes; chunks in plan order by hand."""
    scene = _core.Scene(ball_on_floor(*BALLS["glass"]))
    new = lambda: _core.Film(40, 40, 4, adaptive)  # noqa: E731
    one = film_of(scene, 64, 1, new())
    assert one.has_light_layer
    assert same_bits(one, film_of(scene, 64, 3, new()))
    begun = _core.Film.from_bytes(film_of(scene, 16, 2, new()).to_bytes())
    assert same_bits(one, film_of(scene, 64, 2, begun))
    assert _core.Film.from_bytes(one.to_bytes()).to_bytes() == one.to_bytes()

    film = new()
    settings = _core.Settings(5, 8, light_tracing="auto")
    while wanted := film.missing(64):
        parts = [
            _core.ChunkFilm.from_bytes(
                _core.render_chunk(scene, settings, film.plan, index).to_bytes()
            )
            for index in wanted
        ]
        if len(parts) > 1:
            with pytest.raises(_core.SceneError, match="order"):
                film.add(parts[1])
        for part in parts:
            film.add(part)
    assert same_bits(one, film)


def test_damaged_bytes_are_refused() -> None:
    scene = _core.Scene(ball_on_floor(*BALLS["glass"]))
    data = film_of(scene, 8, 1).to_bytes()
    for cut in (data[:-9], data[: len(data) // 2], data + b"\0"):
        with pytest.raises(_core.SceneError):
            _core.Film.from_bytes(cut)


def test_no_need_no_layer() -> None:
    """Bits of a scene without caustics do not know of the layer; a probe camera cannot have one."""
    plain = ball_on_floor("lambert", {"albedo": 0.5})
    scene = _core.Scene(plain)
    films = []
    for light in ("off", "auto"):
        film = _core.Film(N, N, 4)
        _core.render(scene, _core.Settings(5, 8, light_tracing=light), film, {"spp": 16}, 2)
        films.append(film)
    assert not films[1].has_light_layer
    assert films[0].sums.tobytes() == films[1].sums.tobytes()
    assert _core.kernel_of(scene, _core.Settings(light_tracing="auto"))["name"] != "full"
    probe = ball_on_floor(*BALLS["glass"])
    probe.set_camera("material_probe", (0, 3, 5), (0, 0, 0), (0, 1, 0))
    assert not _core.has_light_layer(_core.Scene(probe), _core.Settings(light_tracing="on"))
