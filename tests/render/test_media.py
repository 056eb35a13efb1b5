"""Media that scatter inside closed shapes, against closed forms and white furnaces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from media_oracle import h_function, plane_albedo, single_scattering
from render_build import assert_agrees, box, measure, render

from matiere import _core

NULL: dict[str, Any] = {"type": "null"}
GLASS: dict[str, Any] = {"type": "dielectric", "eta": 1.5}
ROUGH: dict[str, Any] = {"type": "dielectric", "eta": 1.4, "alpha": 0.3, "multiscatter": True}


def add(d: Any, material: dict[str, Any], medium: dict[str, Any], **more: Any) -> int:
    params = {k: v for k, v in material.items() if k != "type"} | medium
    return int(d.add_material(material["type"], params, **more))


def view(
    origin: tuple[float, float, float] = (0.01, 0.02, 5.0),
    target: tuple[float, float, float] = (0.01, 0.02, 0.0),
    size: int = 8,
) -> Any:
    d = _core.RenderDescription()
    d.set_film(size, size, "box")
    d.set_camera("pinhole", origin, target, (0, 1, 0), 1e-3)
    return d


def furnace(material: dict[str, Any], medium: dict[str, Any], spp: int = 64) -> tuple[Any, Any]:
    """Mean over a ball seen in a white environment, its error, and what was counted."""
    d = view(size=16)
    d.set_camera("pinhole", (0, 0, 4), (0, 0, 0), (0, 1, 0), 30)
    d.add_sphere((0, 0, 0), 1, add(d, material, medium))
    d.set_constant_environment((1, 1, 1))
    film = _core.Film(16, 16, 4)
    _core.render(_core.Scene(d), _core.Settings(1), film, {"spp": spp}, 2)
    image = np.asarray(film.sums).sum(0)[..., :3] / film.spp
    flat = image.mean(2).reshape(-1)
    return (flat.mean(), flat.std(ddof=1) / np.sqrt(flat.size)), film.counters


@pytest.mark.parametrize("boundary", [NULL, GLASS, ROUGH], ids=["null", "smooth", "rough"])
@pytest.mark.parametrize("sigma", [1e-6, 0.5, 20.0])
@pytest.mark.parametrize("g", [-0.99, 0.0, 0.99])
def test_a_white_medium_keeps_all_light(boundary: Any, sigma: float, g: float) -> None:
    (mean, error), counters = furnace(boundary, {"sigma_s": sigma, "g": g})
    assert abs(mean - 1) <= 3 * error + 1e-5, (mean, error)
    assert error < 0.02
    assert counters["depth_guard"] == counters["unmatched_exits"] == 0


@pytest.mark.parametrize("boundary", [NULL, GLASS], ids=["null", "smooth"])
def test_a_dense_white_medium_ends_and_keeps_all_light(boundary: Any) -> None:
    """A millionth of the radius between events: the mean walk would have 4/3 million of them.
    Roulette ends walks in a hundredth of that and loses no light."""
    (mean, error), counters = furnace(boundary, {"sigma_s": 1e6}, spp=8)
    assert abs(mean - 1) <= 3 * error, (mean, error)
    assert error < 0.15
    assert counters["depth_guard"] == counters["unmatched_exits"] == 0
    assert counters["rays"] < 13000 * counters["samples"]


@pytest.mark.parametrize("albedo", [0.999, 1.0])
def test_a_thick_medium_keeps_what_is_not_absorbed(albedo: float) -> None:
    """Walks of hundreds of events, for which roulette grows sterner: against H at albedo 0.999."""
    d = view()
    medium = {"scattering_albedo": albedo, "mean_free_path": 1.0}
    box(d, (2e3, 1e3, 2e3), (0, -1e3, 0), add(d, NULL, medium))
    d.set_camera("pinhole", (0.01, 4e3, 0.01), (0.01, 0, 0.01), (0, 0, 1), 1e-3)
    d.set_constant_environment((1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=64)
    assert_agrees(mean, np.full(3, plane_albedo(albedo, 1.0)), error)
    assert np.all(error < 0.01)


def test_lanes_that_differ_keep_all_light_each() -> None:
    d = view()
    d.add_sphere((0, 0, 0), 1, add(d, NULL, {"sigma_s": [0.1, 3.0, 40.0], "g": 0.4}))
    d.set_constant_environment((1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=256)
    assert_agrees(mean, np.ones(3), error)
    assert np.all(error < 0.03)


def test_without_scattering_the_law_is_beer_lamberts() -> None:
    """The same bits as a dielectric of index 1, which never could scatter."""
    images = []
    for boundary in (NULL, {"type": "dielectric", "eta": 1.0}):
        d = view()
        box(d, (1, 1, 1), (0, 0, 0), add(d, boundary, {"sigma_a": [0.5, 1.0, 0.0]}))
        d.set_constant_environment((1, 1, 1))
        scene = _core.Scene(d)
        assert _core.kernel_of(scene, _core.Settings())["name"] == "clear"
        images.append(render(scene, spp=16, width=8, height=8)[0])
        assert images[-1].mean((0, 1)) == pytest.approx(np.exp([-1.0, -2.0, 0.0]), rel=1e-5)
    assert np.abs(images[0] - images[1]).max() < 1e-6


def test_scattering_goes_to_absorption_in_the_limit() -> None:
    d = view()
    box(d, (1, 1, 1), (0, 0, 0), add(d, NULL, {"sigma_a": [0.5, 1.0, 0.0], "sigma_s": 1e-7}))
    d.set_constant_environment((1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=1024)
    assert_agrees(mean, np.exp([-1.0, -2.0, 0.0]), error + 1e-6)


def test_both_ways_to_state_a_medium_agree() -> None:
    probe = _core.probe.Materials(
        [
            {
                "type": "dielectric",
                "params": {"sigma_a": [1, 0, 3], "sigma_s": [3, 4, 1], "g": 0.2},
            },
            {
                "type": "null",
                "params": {
                    "scattering_albedo": [0.75, 1.0, 0.25],
                    "mean_free_path": 0.25,
                    "g": 0.2,
                },
            },
        ]
    )
    ours, theirs = probe.record(0), probe.record(1)
    for key in ("sigma_a", "sigma_s", "sigma_t", "g"):
        assert ours[key] == pytest.approx(theirs[key], rel=1e-6), key
    assert ours["scatters"] and theirs["scatters"]


# --- closed forms -----------------------------------------------------------------------------


@pytest.mark.parametrize("g", [-0.99, 0.0, 0.6])
@pytest.mark.parametrize("strategy", ["mis", "light"])
def test_one_event_in_a_slab(g: float, strategy: str) -> None:
    """One scattering event of directional light in a slab of fog, seen at 30 degrees."""
    depth, sigma_s, sigma_a = 0.8, np.array([0.4, 1.0, 2.0]), np.array([0.3, 0.1, 0.0])
    light = np.array([0.48, -0.6, -0.64])  # travels down; the slab lies in y
    eye = np.array([0.5, np.sqrt(0.75), 0.0])
    d = view(tuple(3 * eye), (0, 0, 0))
    medium = {"sigma_s": list(sigma_s), "sigma_a": list(sigma_a), "g": g}
    box(d, (400, depth / 2, 400), (0, -depth / 2, 0), add(d, NULL, medium))
    d.add_directional_light(tuple(light), (2, 2, 2))
    mean, error = measure(_core.Scene(d), size=8, spp=256, max_depth=1, strategy=strategy)
    cosine = float(light @ eye)
    expected = single_scattering(
        2.0, sigma_s, sigma_a + sigma_s, g, cosine, -light[1], eye[1], depth
    )
    assert_agrees(mean, expected, error)
    assert np.all(error < 0.05 * mean)


@pytest.mark.parametrize("albedo", [0.3, 0.9, 0.99])
@pytest.mark.parametrize("degrees", [0.0, 60.0, 80.0])
def test_albedo_of_a_deep_medium(albedo: float, degrees: float) -> None:
    """White environment over isotropic scattering without bottom: 1 - sqrt(1 - a) H(mu)."""
    a = np.radians(degrees)
    eye = np.array([np.sin(a), np.cos(a), 0.01])
    d = view(tuple(2e4 * eye / np.linalg.norm(eye)), (0, 0, 0))
    medium = {"scattering_albedo": albedo, "mean_free_path": 1.0}
    box(d, (1e4, 5e3, 1e4), (0, -5e3, 0), add(d, NULL, medium))
    d.set_constant_environment((1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=256)
    expected = plane_albedo(albedo, float(np.cos(a)))
    assert_agrees(mean, np.full(3, expected), error)
    assert np.all(error < 0.01)


@pytest.mark.parametrize("albedo", [0.5, 0.95])
def test_reflectance_of_a_deep_medium(albedo: float) -> None:
    """Radiance under a directional light: a E / 4 pi mu0 / (mu + mu0) H(mu) H(mu0)."""
    light = np.array([0.0, -0.5, -np.sqrt(0.75)])
    eye = np.array([0.6, 0.8, 0.0])
    d = view(tuple(2e4 * eye), (0, 0, 0))
    medium = {"scattering_albedo": albedo, "mean_free_path": 1.0}
    box(d, (1e4, 5e3, 1e4), (0, -5e3, 0), add(d, NULL, medium))
    d.add_directional_light(tuple(light), (1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=512)
    h = h_function(albedo)
    expected = albedo / (4 * np.pi) * 0.5 / (0.5 + 0.8) * h(0.5) * h(0.8)
    assert_agrees(mean, np.full(3, expected), error)
    assert np.all(error < 0.02 * mean)


# --- looking for lights, nesting, cameras -----------------------------------------------------


def fog(boundary: dict[str, Any], medium: dict[str, Any]) -> Any:
    """A ball of fog in front of a floor under a lamp, itself around a small mirror and a wall."""
    d = view((0, 0.3, 4), (0, 0, 0))
    d.add_sphere((0, 0, 0), 1, add(d, boundary, medium))
    d.add_sphere((0.3, -0.2, 0.2), 0.3, d.add_material("lambert", {"albedo": 0.7}))
    grey = d.add_material("lambert", {"albedo": 0.4})
    d.add_mesh(
        [[-4, -1.2, -4], [4, -1.2, -4], [4, -1.2, 4], [-4, -1.2, 4]],
        [[0, 2, 1], [0, 3, 2]],
        material=grey,
    )
    d.add_rectangle_light((-1, 2, -1), (2, 0, 0), (0, 0, 2), (4, 4, 4))
    d.set_constant_environment((0.2, 0.3, 0.4))
    return d


def test_strategies_agree_in_fog() -> None:
    d = fog(NULL, {"sigma_s": [1.0, 2.0, 4.0], "sigma_a": 0.2, "g": 0.5})
    scene = _core.Scene(d)
    mis, error = measure(scene, size=8, spp=1024, strategy="mis")
    assert np.all(error < 0.03 * mis)
    for strategy in ("light", "bsdf"):
        other, its = measure(scene, size=8, spp=1024, strategy=strategy)
        assert_agrees(mis, other, np.hypot(error, its))


def test_looking_for_lights_pays_inside_fog() -> None:
    """A small lamp: without it, phase sampling alone is many times as noisy."""
    d = fog(NULL, {"sigma_s": 2.0})
    d.add_rectangle_light((-0.05, 1.5, -0.05), (0.1, 0, 0), (0, 0, 0.1), (400, 400, 400))
    scene = _core.Scene(d)
    mis, error = measure(scene, size=8, spp=256, strategy="mis")
    plain, its = measure(scene, size=8, spp=256, strategy="bsdf")
    assert_agrees(mis, plain, np.hypot(error, its))
    assert np.all(its > 3 * error)


def test_a_camera_inside_a_medium() -> None:
    """Deep inside a closed white medium without light but the environment: still white."""
    d = view((0.01, 0.02, 0.03), (0.01, 0.02, -1))
    d.add_sphere((0, 0, 0), 1, add(d, NULL, {"sigma_s": 3.0}))
    d.set_constant_environment((1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=64)
    assert_agrees(mean, np.ones(3), error + 1e-6)


@pytest.mark.parametrize("priority", [1, -1])
def test_priority_decides_which_medium_fills_an_overlap(priority: int) -> None:
    """Fog over [-1, 1], an absorber over [0, 2]; seen without scattered light (max_depth 0)."""
    d = view()
    box(d, (1, 1, 1), (0, 0, 0), add(d, NULL, {"sigma_s": [0.5, 0.0, 0.0]}))
    inner = add(d, NULL, {"sigma_a": [0.0, 0.8, 0.0]}, priority=priority)
    box(d, (0.9, 0.9, 1), (0, 0, 1), inner)
    d.set_constant_environment((1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=1024, max_depth=0)
    ways = (1.0, 2.0) if priority > 0 else (2.0, 1.0)
    assert_agrees(mean, np.exp([-0.5 * ways[0], -0.8 * ways[1], 0.0]), error)


@pytest.mark.parametrize("inside", [False, True], ids=["around", "inside"])
def test_fog_takes_the_index_of_what_surrounds_it(inside: bool) -> None:
    """A slab of glass, with thin fog around it or in it: the reflectance stays that of glass."""
    thin = {"sigma_s": 1e-9}
    d = view()
    box(d, (3, 3, 0.5), (0, 0, 0), add(d, GLASS, {"sigma_a": [0.7, 0.0, 5.0]}))
    half = (2, 2, 0.3) if inside else (4, 4, 2)
    box(d, half, (0, 0, 0), add(d, NULL, thin, priority=0 if inside else -1))
    d.set_constant_environment((1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=1024)
    a = np.exp(-np.array([0.7, 0.0, 5.0]) * (0.4 if inside else 1.0))
    fresnel = 0.04
    expected = fresnel + (1 - fresnel) ** 2 * a * (1 + fresnel * a) / (1 - fresnel**2 * a**2)
    assert_agrees(mean, expected, error + 1e-6)


def test_glass_that_disperses_may_scatter() -> None:
    d = view()
    cloudy = {"type": "dielectric", "eta": [1.5, 1.55, 1.62]}
    d.add_sphere((0, 0, 0), 1, add(d, cloudy, {"sigma_s": [2.0, 1.0, 0.5]}))
    d.set_constant_environment((1, 1, 1))
    mean, error = measure(_core.Scene(d), size=8, spp=512)
    assert_agrees(mean, np.ones(3), error)


def test_an_open_shape_is_counted_and_darkens_nothing() -> None:
    d = view()
    square = [[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]]
    d.add_mesh(square, [[0, 1, 2], [0, 2, 3]], material=add(d, NULL, {"sigma_s": 1.0}))
    d.set_constant_environment((1, 1, 1))
    film = _core.Film(4, 4, 4)
    _core.render(_core.Scene(d), _core.Settings(0), film, {"spp": 16}, 1)
    assert film.counters["unmatched_exits"] == 4 * 4 * 16
    assert np.asarray(film.sums)[..., :3].mean() == 4


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_media_follow_the_unit_of_length(scale: float) -> None:
    """The same picture of the same set-up in other units: grey furnace of a ball."""
    means = []
    for s in (1.0, scale):
        d = view((0, 0, 5 * s), (0, 0, 0))
        d.add_sphere((0, 0, 0), s, add(d, GLASS, {"sigma_s": 4 / s, "sigma_a": 0.1 / s, "g": 0.3}))
        d.set_constant_environment((1, 1, 1))
        means.append(measure(_core.Scene(d), size=8, spp=128))
    (a, a_error), (b, b_error) = means
    assert_agrees(a, b, np.hypot(a_error, b_error) + 1e-6)
    assert np.all(a < 0.95)


def test_depth_limits_count_events_inside() -> None:
    """At max_depth 0 only what is not scattered arrives; each more adds light."""
    d = view()
    d.add_sphere((0, 0, 0), 1, add(d, NULL, {"sigma_s": 1.5}))
    d.set_constant_environment((1, 1, 1))
    scene = _core.Scene(d)
    means = [measure(scene, size=8, spp=256, max_depth=n)[0].mean() for n in (0, 1, 3, -1)]
    assert means[0] == pytest.approx(np.exp(-3.0), rel=0.05)
    assert means == sorted(means) and means[-1] == pytest.approx(1, abs=0.01)
