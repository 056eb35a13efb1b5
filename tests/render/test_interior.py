"""Media inside closed shapes: absorption, nesting by priority, cameras inside."""

from typing import Any

import numpy as np
import pytest
from render_build import BOX, BOX_TRIANGLES, box, render

from matiere import _core


def slab_view(origin: tuple[float, float, float] = (0.01, 0.02, 5)) -> Any:
    d = _core.RenderDescription()
    d.set_film(4, 4, "box")
    d.set_camera("pinhole", origin, (0.01, 0.02, 0), (0, 1, 0), 1e-3)
    d.set_constant_environment((1, 1, 1))
    return d


def glass(d: Any, eta: float, sigma_a: Any, priority: int = 0) -> int:
    return d.add_material("dielectric", {"eta": eta, "sigma_a": sigma_a}, priority=priority)


def test_box_normals_point_outwards() -> None:
    for t in np.array(BOX_TRIANGLES):
        p = BOX[t]
        assert np.dot(np.cross(p[1] - p[0], p[2] - p[0]), p.mean(0)) > 0


@pytest.mark.parametrize("sigma", [0.0, 1e-3, 0.5, 3.0, 1e6])
def test_absorbing_slab_at_normal_incidence(sigma: float) -> None:
    """All internal reflections of a slab of index n and thickness d in a white furnace:
    R + T = F + (1-F)^2 a (1 + F a) / (1 - F^2 a^2), a = exp(-sigma d)."""
    d = slab_view()
    box(d, (3, 3, 0.5), (0, 0, 0), glass(d, 1.5, [sigma, 0.0, 2 * sigma]))
    image, _ = render(_core.Scene(d), spp=4096)
    fresnel = 0.04
    a = np.exp(-np.array([sigma, 0.0, 2 * sigma]))
    expected = fresnel + (1 - fresnel) ** 2 * a * (1 + fresnel * a) / (1 - fresnel**2 * a**2)
    error = image.reshape(-1, 3).std(0, ddof=1) / 4
    assert np.all(np.abs(image.mean((0, 1)) - expected) < 4 * error + 1e-5), (
        image.mean((0, 1)),
        expected,
    )


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_absorption_follows_the_unit_of_length(scale: float) -> None:
    d = _core.RenderDescription()
    d.set_film(4, 4, "box")
    d.set_camera("pinhole", (0.01 * scale, 0, 5 * scale), (0.01 * scale, 0, 0), (0, 1, 0), 1e-3)
    d.set_constant_environment((1, 1, 1))
    box(d, (3 * scale, 3 * scale, scale), (0, 0, 0), glass(d, 1.0, 0.7 / scale))
    image, _ = render(_core.Scene(d), spp=16)
    assert image.mean() == pytest.approx(np.exp(-1.4), rel=1e-5)


def test_equal_index_inside_absorbs_only() -> None:
    """eta 1 is a null interface: an absorbing block of air."""
    d = slab_view()
    box(d, (1, 1, 1), (0, 0, 0), glass(d, 1.0, [0.5, 1.0, 0.0]))
    image, _ = render(_core.Scene(d), spp=16)
    assert image.mean((0, 1)) == pytest.approx(np.exp([-1.0, -2.0, 0.0]), rel=1e-5)


def nested(priority_inner: int) -> tuple[np.ndarray, dict[str, Any]]:
    """Two overlapping blocks of index 1 that absorb differently, seen along z: the outer one spans
    [-1, 1], the other [0, 2]."""
    d = slab_view()
    box(d, (1, 1, 1), (0, 0, 0), glass(d, 1.0, [0.5, 0.0, 0.0], priority=0))
    box(d, (0.9, 0.9, 1), (0, 0, 1), glass(d, 1.0, [0.0, 0.8, 0.0], priority=priority_inner))
    image, report = render(_core.Scene(d), spp=16)
    return image.mean((0, 1)), report


def test_priority_decides_who_owns_an_overlap() -> None:
    mean, report = nested(1)  # the second block owns [0, 2], the first keeps [-1, 0]
    assert mean == pytest.approx(np.exp([-0.5, -1.6, 0.0]), rel=1e-5)
    assert report["log"][-1]["rejected"] == 0
    mean, _ = nested(-1)  # the first block owns [-1, 1], the second keeps [1, 2]
    assert mean == pytest.approx(np.exp([-1.0, -0.8, 0.0]), rel=1e-5)


def test_camera_inside_a_medium() -> None:
    d = slab_view(origin=(0.01, 0.02, 0.0))
    d.set_camera("pinhole", (0.01, 0.02, 0.0), (0.01, 0.02, -1), (0, 1, 0), 1e-3)
    box(d, (1, 1, 1), (0, 0, 0), glass(d, 1.0, 0.5))
    image, _ = render(_core.Scene(d), spp=16)
    assert image.mean() == pytest.approx(np.exp(-0.5), rel=1e-5)


def test_camera_inside_two_media_knows_the_inner_one() -> None:
    d = slab_view()
    d.set_camera("pinhole", (0.01, 0.02, 0.0), (0.01, 0.02, -1), (0, 1, 0), 1e-3)
    box(d, (2, 2, 2), (0, 0, 0), glass(d, 1.0, [0.3, 0.0, 0.0]))
    box(d, (1, 1, 1), (0, 0, 0), glass(d, 1.0, [0.0, 0.7, 0.0]))
    image, _ = render(_core.Scene(d), spp=16)
    assert image.mean((0, 1)) == pytest.approx(np.exp([-0.3, -0.7, 0.0]), rel=1e-5)


def test_shadow_rays_are_absorbed_inside_a_medium() -> None:
    """A diffuse floor and a point light, both inside absorbing air."""
    d = _core.RenderDescription()
    d.set_film(4, 4, "box")
    d.set_camera("pinhole", (0, 0.5, 0), (0, -1, 0), (0, 0, 1), 1e-3)
    box(d, (4, 4, 4), (0, 0, 0), glass(d, 1.0, [0.2, 0.0, 0.0]))
    floor = d.add_material("lambert", {"albedo": 0.5})
    d.add_mesh(
        [[-1, -1, -1], [1, -1, -1], [1, -1, 1], [-1, -1, 1]], [[0, 2, 1], [0, 3, 2]], material=floor
    )
    d.add_point_light((0, 1, 0), (1, 1, 1))
    image, _ = render(_core.Scene(d), spp=16, max_depth=1)
    expected = 0.5 / np.pi / 4 * np.exp([-0.2 * (2 + 1.5), 0, 0])
    assert image.mean((0, 1)) == pytest.approx(expected, rel=1e-5)


def test_shadow_rays_pass_hidden_interfaces() -> None:
    """The walls of a low-priority block inside a high-priority one do not block light."""
    d = _core.RenderDescription()
    d.set_film(4, 4, "box")
    d.set_camera("pinhole", (0, 0.5, 0), (0, -1, 0), (0, 0, 1), 1e-3)
    box(d, (4, 4, 4), (0, 0, 0), glass(d, 1.0, 0.0, priority=2))
    box(d, (0.2, 0.2, 0.2), (0, 0.8, 0), glass(d, 1.5, 9.0, priority=1))
    floor = d.add_material("lambert", {"albedo": 0.5})
    d.add_mesh(
        [[-1, -1, -1], [1, -1, -1], [1, -1, 1], [-1, -1, 1]], [[0, 2, 1], [0, 3, 2]], material=floor
    )
    d.add_point_light((0, 2, 0), (1, 1, 1))
    image, _ = render(_core.Scene(d), spp=16, max_depth=1)
    assert image.mean() == pytest.approx(0.5 / np.pi / 9, rel=1e-5)


def test_unmatched_exits_are_counted() -> None:
    """A single open sheet of glass seen from behind is an exit that was never entered."""
    d = slab_view()
    m = glass(d, 1.5, 0.0)
    d.add_mesh([[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]], [[0, 2, 1], [0, 3, 2]], material=m)
    scene = _core.Scene(d)
    film = _core.Film(4, 4, 4)
    _core.render(scene, _core.Settings(0), film, {"spp": 16}, 1)
    assert film.counters["unmatched_exits"] > 0
