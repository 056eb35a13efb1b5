"""Cameras: where the pixels of every kind look, against geometry worked out by hand."""

from typing import Any

import numpy as np
import pytest

import matiere as mt

WHITE = {"type": "lambert", "albedo": 0.5}


def picture(
    camera: dict[str, Any], width: int, height: int, spp: int = 16, **scene: Any
) -> mt.Film:
    document = {
        "version": 1,
        "camera": camera,
        "film": {"width": width, "height": height, "filter": "box"},
        "render": {"spp": spp, "max_depth": scene.pop("max_depth", 0)},
        **scene,
    }
    return mt.render(mt.load(document))


def sky(size: int = 256) -> np.ndarray:
    """A lat-long map whose colour is the direction: (1 + d) / 2."""
    theta = np.pi * (np.arange(size // 2) + 0.5) / (size // 2)
    phi = 2 * np.pi * ((np.arange(size) + 0.5) / size - 0.5)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    d = np.stack([np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)], axis=2)
    return ((1 + d) / 2).astype(np.float32)


def test_a_panorama_towards_minus_z_is_the_environment_map() -> None:
    camera = {"type": "panorama", "origin": [3, -2, 5], "target": [3, -2, 4]}
    film = picture(camera, 64, 32, spp=64, environment={"pixels": sky()})
    expected = sky(64)
    assert np.abs(film.mean - expected).max() < 0.01


def test_a_panorama_turns_with_its_target() -> None:
    camera = {"type": "panorama", "origin": [0, 0, 0], "target": [1, 0, 0]}
    film = picture(camera, 64, 32, spp=64, environment={"pixels": sky()})
    assert np.abs(np.roll(film.mean, 16, axis=1) - sky(64)).max() < 0.01


def test_an_orthographic_camera_keeps_sizes_at_any_distance() -> None:
    """A sphere of radius 0.5 covers pi/4 of 4 square metres wherever it stands."""
    for z in (0.0, -50.0):
        film = picture(
            {"type": "orthographic", "origin": [0, 0, 5], "target": [0, 0, 0], "height": 2},
            64, 64, spp=64,
            materials={"glow": {"type": "lambert", "albedo": 0, "emission": 1}},
            shapes=[{"type": "sphere", "center": [0, 0, z], "radius": 0.5, "material": "glow"}],
        )  # fmt: skip
        assert film.mean[..., 0].mean() * 4 == pytest.approx(np.pi / 4, rel=2e-3)
        assert film.mean[32, 32, 0] == 1 and film.mean[32, 14, 0] == 0


def bokeh(**lens: Any) -> np.ndarray:
    """The picture of a tiny lamp far out of focus: the shape of the aperture."""
    camera = {
        "type": "thin_lens", "origin": [0, 0, 4], "target": [0, 0, 0], "vfov_deg": 12,
        "aperture_radius": 0.25, "focus_distance": 2, **lens,
    }  # fmt: skip
    film = picture(
        camera, 48, 48, spp=1024,
        materials={"glow": {"type": "lambert", "albedo": 0, "emission": 1}},
        shapes=[{"type": "sphere", "center": [0, 0, 0], "radius": 0.02, "material": "glow"}],
    )  # fmt: skip
    return film.mean[..., 0]


# A lamp at distance 4 seen by a lens focused at 2: the circle of confusion has the radius
# 0.25 * (4 - 2) / 4 on a film plane at distance 2, the film there being 4 tan 6 deg high.
RADIUS = 0.125 / (4 * np.tan(np.radians(6)) / 48)

LAMP = (0.02 / 4 / 0.0625) ** 2 / 4  # what the lamp's own size adds to the spread


def moments(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:48, :48] - 23.5
    weights = image / image.sum()
    mean = np.array([(weights * x).sum(), -(weights * y).sum()])
    spread = np.array([(weights * x * x).sum(), (weights * y * y).sum()]) / RADIUS**2
    return mean, spread - LAMP


def test_a_round_aperture_blurs_to_a_disk() -> None:
    mean, spread = moments(bokeh())
    assert np.abs(mean).max() < 0.1
    assert spread == pytest.approx([0.25, 0.25], rel=0.05)


def test_a_wide_aperture_stretches_the_blur() -> None:
    _, spread = moments(bokeh(aperture_ratio=0.5))
    assert spread == pytest.approx([0.25 / 4, 0.25], rel=0.06)


@pytest.mark.parametrize(("blades", "turn"), [(3, 90.0), (6, 0.0), (6, 30.0)])
def test_blades_cut_a_polygon(blades: int, turn: float) -> None:
    """Against the same lamp's blur by points spread evenly over the polygon."""
    angles = np.radians(turn) + 2 * np.pi * np.arange(blades) / blades
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    u = (np.arange(400) + 0.5) / 400
    a, b = np.meshgrid(np.sqrt(u), u)
    points = np.concatenate([
        (a * (1 - b)).reshape(-1, 1) * corners[k]
        + (a * b).reshape(-1, 1) * corners[(k + 1) % blades]
        for k in range(blades)
    ])  # fmt: skip
    image = bokeh(blades=blades, blade_rotation_deg=turn)
    _, spread = moments(image)
    assert spread == pytest.approx((points**2).mean(axis=0), rel=0.06)
    y, x = np.mgrid[:48, :48] - 23.5
    lit = image > 0
    # A defocused point lamp behind the plane of focus is seen the right way up through the lens.
    reach = np.hypot(x, y)[lit].max() / RADIUS
    assert reach == pytest.approx(1, abs=0.12)
    skew = (image * (-y) ** 3).sum() / image.sum() / RADIUS**3
    assert abs(skew) == pytest.approx(abs((points[:, 1] ** 3).mean()), abs=0.02)


def test_a_material_probe_shows_the_brdf() -> None:
    """A probe of a flat lambert sample under one lamp is albedo / pi all over the disk."""
    incidence = np.radians(40)
    light = {
        "type": "directional",
        "direction": [np.sin(incidence), -np.cos(incidence), 0],
        "irradiance": 1 / np.cos(incidence),
    }
    floor = [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]]
    shape = {
        "type": "mesh", "positions": floor, "triangles": [[0, 2, 1], [0, 3, 2]], "material": "m",
    }  # fmt: skip
    rough = {"type": "conductor", "metal": "Au", "alpha": 0.4}
    found = {}
    for name, material in {"lambert": WHITE, "rough": rough}.items():
        film = picture(
            {"type": "material_probe"}, 65, 65, spp=4, max_depth=1,
            materials={"m": material}, shapes=[shape], lights=[light],
        )  # fmt: skip
        found[name] = film.mean
    y, x = (np.mgrid[:65, :65] - 32.0) / 32.5
    r2 = x**2 + y**2
    inside = r2 < 0.93
    assert found["lambert"][inside] == pytest.approx(0.5 / np.pi, rel=1e-5)
    assert np.all(found["lambert"][r2 > 1.07] == 0)
    # In the sample's frame of the probe API (z up), pixels against eval / cos theta_i.
    s = np.sqrt(2 - r2[inside])
    wo = np.stack([x[inside] * s, y[inside] * s, 1 - r2[inside]], axis=1).astype(np.float32)
    wi = np.tile([-np.sin(incidence), 0, np.cos(incidence)], (len(wo), 1)).astype(np.float32)
    expected = mt.bsdf(rough).eval(wo, wi) / np.cos(incidence)
    assert found["rough"][inside] == pytest.approx(expected, rel=0.05, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"type": "thin_lens", "aperture_radius": 1, "focus_distance": 1, "blades": 2}, "/blades"),
        ({"type": "orthographic", "height": 0}, "/height"),
        ({"type": "orthographic", "vfov_deg": 30}, "/vfov_deg"),
        ({"type": "fisheye"}, "/type"),
        ({"type": "material_probe", "normal": [0, 0, 0]}, "/normal"),
        ({"type": "material_probe", "normal": [0, 0, 2]}, "/up"),
    ],
)
def test_bad_cameras_are_named(change: dict[str, Any], pointer: str) -> None:
    placed = (
        {} if change["type"] == "material_probe" else {"origin": [0, 0, 4], "target": [0, 0, 0]}
    )
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load({"version": 1, "camera": {**placed, **change}})
    assert [fault.pointer for fault in caught.value.faults] == ["/camera" + pointer]
