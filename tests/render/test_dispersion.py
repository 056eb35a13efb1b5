"""Dispersion, nested media and absorption over twelve orders of length, against closed forms."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from render_build import render

from matiere import _core

BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
BOX_TRIANGLES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip


def box(d: Any, half: Any, center: Any, material: int) -> None:
    d.add_mesh(BOX * half + center, BOX_TRIANGLES, material=material)


def view(origin: Any, target: Any) -> Any:
    d = _core.RenderDescription()
    d.set_film(4, 4, "box")
    d.set_camera("pinhole", origin, target, (0, 1, 0), 1e-3)
    return d


def agrees(image: np.ndarray, expected: Any) -> None:
    flat = image.reshape(-1, 3)
    error = flat.std(0, ddof=1) / np.sqrt(len(flat))
    gap = np.abs(flat.mean(0) - np.asarray(expected))
    assert (gap < 4 * error + 1e-5).all(), (flat.mean(0), expected, error)


def fresnel(c: float, eta: float) -> float:
    t = np.sqrt(1 - (1 - c * c) / eta**2)
    return float(((c - eta * t) / (c + eta * t)) ** 2 + ((eta * c - t) / (eta * c + t)) ** 2) / 2


ETAS = np.array([1.50, 1.60, 1.75])


def test_each_channel_refracts_by_its_own_index() -> None:
    """Behind a slab of thickness 4 seen at 45 degrees, each channel meets the screen at a place of
    its own; a screen whose light is a ramp along x says where."""
    n = 4096
    s = np.sqrt(0.5)
    d = view((-6.0, 0.01, 8.0), (0.0, 0.01, 2.0))  # meets the slab's face z = 2 at x = 0
    glass = d.add_material("dielectric", {"eta": list(ETAS)})
    box(d, (50, 50, 2), (0, 0, 0), glass)
    ramp = np.linspace(0, 1, n, dtype=np.float32)[None, :, None].repeat(2, 0).repeat(3, 2)
    texture = d.add_texture(np.ascontiguousarray(ramp), "clamp")
    screen = d.add_material("lambert", {"albedo": 0.0}, emission=("texture", texture))
    corners = [[0, -9, -3], [8, -9, -3], [8, 9, -3], [0, 9, -3]]
    uv = [[0, 0], [1, 0], [1, 1], [0, 1]]
    d.add_mesh(corners, [[0, 1, 2], [0, 2, 3]], material=screen, uv=uv)
    image, _ = render(_core.Scene(d), spp=4096, max_depth=2)
    tan_t = s / np.sqrt(ETAS**2 - 0.5)
    place = (4 * tan_t + 1.0) / 8  # 4 m of glass, 1 m of air at 45 degrees; the ramp is 8 m long
    value = (place * n - 0.5) / (n - 1)
    passed = np.array([(1 - fresnel(s, e)) ** 2 for e in ETAS])
    agrees(image, value * passed)


def test_equal_indices_do_not_disperse() -> None:
    """[n, n, n] and n give the very same samples."""
    images = []
    for eta in (1.5, [1.5, 1.5, 1.5]):
        d = view((0.01, 0.02, 5), (0.01, 0.02, 0))
        d.set_constant_environment((1, 0.5, 0.25))
        box(d, (3, 3, 0.5), (0, 0, 0), d.add_material("dielectric", {"eta": eta, "sigma_a": 0.5}))
        images.append(render(_core.Scene(d), spp=64)[0])
    assert (images[0] == images[1]).all()


@pytest.mark.parametrize("alpha", [0.0, 0.4])
def test_a_dispersive_block_in_a_furnace_disappears(alpha: float) -> None:
    d = view((0.3, 0.2, 5), (0.1, 0.02, 0))
    d.set_constant_environment((1, 1, 1))
    shape = {"eta": list(ETAS), "alpha": alpha, "multiscatter": alpha > 0}
    box(d, (1, 1, 1), (0, 0, 0), d.add_material("dielectric", shape))
    image, _ = render(_core.Scene(d), spp=2048)
    flat = image.reshape(-1, 3)
    error = flat.std(0, ddof=1) / 4
    assert (np.abs(flat.mean(0) - 1) < 4 * error + 2e-3).all(), (flat.mean(0), error)


def stack(layers: list[tuple[float, float]]) -> float:
    """Return R + T of plane layers (index, share left per crossing) in air at normal incidence, all
    internal reflections added incoherently: adding from the back (Stokes 1862)."""
    indices = [1.0, *(n for n, _ in layers), 1.0]
    tints = [1.0, *(t for _, t in layers)]
    F = [((b - a) / (b + a)) ** 2 for a, b in pairwise(indices)]
    # Of what lies behind an interface: (reflectance, transmittance) seen from the front.
    R, T = F[-1], 1 - F[-1]
    for f, tint in zip(reversed(F[:-1]), reversed(tints[1:]), strict=True):
        inner, through = R * tint**2, T * tint
        bounces = 1 / (1 - f * inner)
        R, T = f + (1 - f) ** 2 * inner * bounces, (1 - f) * through * bounces
    return R + T


@pytest.mark.parametrize("sigma", [0.0, 0.3, 2.0])
def test_ice_in_water_in_glass(sigma: float) -> None:
    """Blocks that overlap: glass [-3, 3], water in it [-2, 2], ice in that [-1, 1]; head on."""
    d = view((0.01, 0.02, 9), (0.01, 0.02, 0))
    d.set_constant_environment((1, 1, 1))
    media = ((1.52, 0.05, 3.0), (1.333, 0.2, 2.0), (1.31, sigma, 1.0))
    for priority, (eta, absorbs, half) in enumerate(media):
        m = d.add_material("dielectric", {"eta": eta, "sigma_a": absorbs}, priority=priority)
        box(d, (half + 3, half + 3, half), (0, 0, 0), m)
    image, _ = render(_core.Scene(d), spp=8192)
    glass, water = (1.52, np.exp(-0.05)), (1.333, np.exp(-0.2))
    expected = stack([glass, water, (1.31, np.exp(-2 * sigma)), water, glass])
    agrees(image, [expected] * 3)


@pytest.mark.parametrize("depth", [0.0, 1e-6, 0.7, 30.0])
@pytest.mark.parametrize("exponent", [-6, -3, 0, 3, 6])
def test_absorption_from_a_micrometre_to_a_thousand_kilometres(exponent: int, depth: float) -> None:
    """R + T of a slab of glass whose thickness is 10^exponent metres and optical depth `depth`."""
    scale = 10.0**exponent
    x = 0.01 * scale
    d = view((x, x, 5 * scale), (x, x, 0))
    d.set_constant_environment((1, 1, 1))
    glass = {"eta": 1.5, "transmittance": float(np.exp(-depth)), "at_distance": scale}
    box(d, (3 * scale, 3 * scale, scale / 2), (0, 0, 0), d.add_material("dielectric", glass))
    image, _ = render(_core.Scene(d), spp=1024)
    agrees(image, [stack([(1.5, np.exp(-depth))])] * 3)
