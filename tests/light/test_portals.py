"""Windows: the environment looked for through them, with the mean of a room without."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render_build import assert_agrees, measure

from matiere import _core

CORNERS = np.array([[x, y, z] for x in (-2, 2) for y in (0, 3) for z in (-2, 2)], float)
WALLS = [  # of the box, inwards; all but the one at x = 2
    [0, 1, 3], [0, 3, 2], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
    [1, 5, 7], [1, 7, 3],
]  # fmt: skip
WINDOW = ((2, 1, -0.6), (0, 0, 1.2), (0, 1, 0))  # edge_u x edge_v points to -x


def room(sky: str, *, portals: bool, inwards: bool = True) -> Any:
    """A room with one window in its wall at x = 2; the whole film sees one point of the floor."""
    d = _core.RenderDescription()
    d.set_film(8, 8, "box")
    d.set_camera("pinhole", (-1, 1, 0.3), (-0.5, 0, 0.2), (0, 1, 0), 1e-3)
    grey = d.add_material("lambert", {"albedo": 0.6})
    d.add_mesh(CORNERS, WALLS, material=grey)
    y, z = [0, 1, 2, 3], [-2, -0.6, 0.6, 2]
    grid = np.array([[2.0, a, b] for a in y for b in z])
    holes = [
        [4 * i + k, 4 * i + k + 1, 4 * i + k + 5, 4 * i + k + 4]
        for i in range(3)
        for k in range(3)
        if (i, k) != (1, 1)
    ]
    d.add_mesh(grid, [t for a, b, c, e in holes for t in ([a, b, c], [a, c, e])], material=grey)
    if sky == "even":
        d.set_constant_environment((2, 3, 4))
    else:
        pixels = np.full((16, 32, 3), 1.0, np.float32)
        pixels[:8] = (1, 2, 3)
        pixels[6, 24:26] = 200.0  # a sun, towards +x
        d.set_environment(pixels)
    if portals:
        corner, u, v = WINDOW
        d.add_portal(corner, *((u, v) if inwards else (v, u)))
    return d


def test_the_window_s_front_is_the_room() -> None:
    _, u, v = WINDOW
    assert np.cross(u, v)[0] < 0


@pytest.mark.parametrize("sky", ["even", "uneven"])
def test_portals_change_no_mean_and_lower_the_noise(sky: str) -> None:
    plain, its = measure(_core.Scene(room(sky, portals=False)), size=8, spp=2048, max_depth=3)
    ours, error = measure(_core.Scene(room(sky, portals=True)), size=8, spp=512, max_depth=3)
    assert_agrees(ours, plain, np.hypot(error, its))
    gain = (its**2 * 2048) / (error**2 * 512)  # variance at equal samples
    assert np.all(gain > (10 if sky == "even" else 2)), gain


@pytest.mark.parametrize("sky", ["even", "uneven"])
@pytest.mark.parametrize("strategy", ["light", "bsdf"])
def test_strategies_agree(sky: str, strategy: str) -> None:
    scene = _core.Scene(room(sky, portals=True))
    mis, error = measure(scene, size=8, spp=512, max_depth=2)
    other, its = measure(scene, size=8, spp=2048, max_depth=2, strategy=strategy)
    assert_agrees(mis, other, np.hypot(error, its))


def test_two_portals_that_overlap_and_one_that_faces_away() -> None:
    d = room("uneven", portals=True)
    d.add_portal((2.1, 0.5, -1.0), (0, 0, 2), (0, 2, 0))
    d.add_portal((2, 1, -0.6), (0, 1, 0), (0, 0, 1.2))
    ours, error = measure(_core.Scene(d), size=8, spp=1024, max_depth=2)
    plain, its = measure(_core.Scene(room("uneven", portals=False)), size=8, spp=4096, max_depth=2)
    assert_agrees(ours, plain, np.hypot(error, its))


def test_a_portal_that_is_wrong_costs_noise_but_no_light() -> None:
    """It faces away from the room, or covers a part of the window: the mean stays."""
    plain, its = measure(_core.Scene(room("even", portals=False)), size=8, spp=4096, max_depth=2)
    away = _core.Scene(room("even", portals=True, inwards=False))
    d = room("even", portals=False)
    d.add_portal((2, 1, -0.6), (0, 0, 0.5), (0, 1, 0))
    for scene in (away, _core.Scene(d)):
        ours, error = measure(scene, size=8, spp=4096, max_depth=2)
        assert_agrees(ours, plain, np.hypot(error, its))


def test_a_portal_without_area_is_refused() -> None:
    d = room("even", portals=False)
    d.add_portal((0, 0, 0), (1, 0, 0), (2, 0, 0), pointer="/environment/portals/0")
    with pytest.raises(_core.SceneError, match="no area"):
        _core.Scene(d)
