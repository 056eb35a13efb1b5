"""Lights that a measured table spreads: where they shine, how much in all, in cone and turn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render_build import assert_agrees, measure

from matiere import _core

TABLE: dict[str, Any] = {
    "vertical_deg": [0.0, 30.0, 90.0, 180.0],
    "horizontal_deg": [0.0, 90.0, 180.0, 270.0, 360.0],
    "values": np.random.default_rng(4).uniform(0.1, 1, (4, 4))[[0, 1, 2, 3, 0]],
}


def expected(table: dict[str, Any], vertical: Any, horizontal: Any) -> Any:
    """Bilinear lookup in numpy alone."""
    v, h, values = (np.asarray(table[k]) for k in ("vertical_deg", "horizontal_deg", "values"))
    rows = np.array([[np.interp(x, v, row) for row in values] for x in np.ravel(vertical)])
    at = np.ravel(horizontal)
    return np.array([np.interp(x, h, row) for x, row in zip(at, rows, strict=True)])


def seen(away: Any, **light: Any) -> float:
    """Irradiance over pi of a white plate 2 m away that faces the light, in one direction."""
    w = np.asarray(away, float) / np.linalg.norm(away)
    d = _core.RenderDescription()
    d.set_film(4, 4, "box")
    side = np.cross(w, [0.3, 0.5, 0.8])
    side /= np.linalg.norm(side)
    up = np.cross(w, side)
    d.set_camera("pinhole", tuple(1.5 * w), tuple(2 * w), tuple(side), 1e-3)
    plate = 2 * w + 0.1 * np.array([-side - up, side - up, side + up, -side + up])
    d.add_mesh(plate, [[0, 1, 2], [0, 2, 3]], material=d.add_material("lambert", {"albedo": 1.0}))
    d.add_profile_light((0, 0, 0), light.pop("direction", (0, -1, 0)), (8, 8, 8), TABLE, **light)
    return float(measure(_core.Scene(d), spp=4, max_depth=1)[0][0]) * np.pi / 2


def local(vertical: float, horizontal: float) -> np.ndarray:
    """The direction of angles of a lamp that hangs: 0 down, 0 towards +x, 90 towards -z."""
    t, p = np.radians([vertical, horizontal])
    return np.array([np.sin(t) * np.cos(p), -np.cos(t), -np.sin(t) * np.sin(p)])


ANGLES = [(1.0, 200.0), (20.0, 45.0), (60.0, 130.0), (90.0, 359.0), (135.0, 80.0), (179.0, 250.0)]


@pytest.mark.parametrize(("vertical", "horizontal"), ANGLES)
def test_light_follows_the_table(vertical: float, horizontal: float) -> None:
    want = expected(TABLE, vertical, horizontal)[0]
    assert seen(local(vertical, horizontal)) == pytest.approx(want, rel=1e-3)


def test_rotation_turns_the_horizontal_angles() -> None:
    turned = seen(local(60, 130), rotation_deg=50)
    assert turned == pytest.approx(expected(TABLE, 60, 80)[0], rel=1e-3)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0.3, -0.2, 0.9)])
def test_the_axis_turns_by_the_shortest_way(axis: Any) -> None:
    a = np.asarray(axis, float) / np.linalg.norm(axis)
    v, c = np.cross([0, -1, 0], a), -a[1]
    if c < -0.999:
        turn = np.diag([1.0, -1.0, -1.0])
    else:
        k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        turn = np.eye(3) + k + k @ k / (1 + c)
    for angles in ((20.0, 45.0), (60.0, 130.0)):
        want = expected(TABLE, *angles)[0]
        assert seen(turn @ local(*angles), direction=axis) == pytest.approx(want, rel=1e-3)


def test_a_spot_s_cone_cuts_the_table() -> None:
    cone = (30.0, 40.0)
    assert seen(local(20, 45), cone=cone) == pytest.approx(expected(TABLE, 20, 45)[0], rel=1e-3)
    assert seen(local(45, 45), cone=cone) == 0
    t = (np.cos(np.radians(35)) - np.cos(np.radians(40))) / (
        np.cos(np.radians(30)) - np.cos(np.radians(40))
    )
    half = expected(TABLE, 35, 45)[0] * t * t * (3 - 2 * t)
    assert seen(local(35, 45), cone=cone) == pytest.approx(half, rel=1e-3)


def test_all_its_flux_arrives() -> None:
    """A black room around the lamp, the mean irradiance of its walls times their area."""
    d = _core.RenderDescription()
    d.set_film(32, 32, "box")
    d.set_camera("panorama", (0, 0, 0), (0, 0, -1), (0, 1, 0))
    grey = d.add_material("lambert", {"albedo": 0.5})
    d.add_sphere((0, 0, 0), 3, grey)
    d.add_profile_light((0, 0, 0), (0, -1, 0), (2, 2, 2), TABLE)
    film = _core.Film(32, 32, 4)
    _core.render(_core.Scene(d), _core.Settings(0, 1), film, {"spp": 64}, 2)
    image = np.asarray(film.sums).sum(0)[..., 0] / film.spp
    rows = -np.diff(np.cos(np.linspace(0, np.pi, 33)))  # solid angle of a row over its columns
    flux = np.sum(image.mean(1) * rows) * 2 * np.pi * 9 * np.pi / 0.5
    t, p = np.meshgrid((np.arange(360) + 0.5) / 2, np.arange(180) * 2 + 1.0, indexing="ij")
    table = expected(TABLE, t, p).reshape(t.shape)
    want = 2 * np.sum(table.mean(1) * np.sin(np.radians(t[:, 0]))) * np.radians(0.5) * 2 * np.pi
    assert flux == pytest.approx(want, rel=5e-3)


def test_many_luminaires_are_found_by_the_tree() -> None:
    rng = np.random.default_rng(2)
    means = []
    for tree in (True, False):
        d = _core.RenderDescription()
        d.set_film(8, 8, "box")
        d.set_camera("pinhole", (0, 1, 0), (0, 0, 0), (0, 0, 1), 1e-3)
        floor = d.add_material("lambert", {"albedo": 0.5})
        d.add_mesh(
            [[-9, 0, 9], [9, 0, 9], [9, 0, -9], [-9, 0, -9]],
            [[0, 1, 2], [0, 2, 3]],
            material=floor,
        )
        rng = np.random.default_rng(2)
        for _ in range(30):
            x, z = (float(v) for v in rng.uniform(-5, 5, 2))
            d.add_profile_light((x, 2, z), (0.1, -1, 0), (3, 2, 1), TABLE)
        d.light_tree = tree
        means.append(measure(_core.Scene(d), size=8, spp=1024, max_depth=1))
    assert_agrees(means[0][0], means[1][0], np.hypot(means[0][1], means[1][1]))
