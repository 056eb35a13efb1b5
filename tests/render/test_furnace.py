"""White furnace: environment 1, nothing absorbs, so every pixel must be 1."""

from typing import Any

import numpy as np
import pytest
from render_build import render

from matiere import _core

LOSSLESS: dict[str, dict[str, Any]] = {
    "lambert": {"type": "lambert", "albedo": 1.0},
    "mirror": {"type": "mirror", "F0": 1.0},
    "smooth conductor": {"type": "conductor", "eta": 1e-4, "k": 1e3, "alpha": 0.0},
    "smooth plastic": {"type": "plastic", "eta": 1.5, "alpha": 0.0, "albedo": 1.0},
    "rough plastic": {"type": "plastic", "eta": 1.5, "alpha": 0.3, "albedo": 1.0},
    "smooth dielectric": {"type": "dielectric", "eta": 1.5},
    "diamond": {"type": "dielectric", "eta": 2.4},
    "air in glass": {"type": "dielectric", "eta": 1 / 1.5},
}
# Reflectance that is not 1 by a known amount: |F - 1| of the conductor above.
ALLOWED_LOSS = {"smooth conductor": 5e-7}


def furnace(material: dict[str, Any], shape: str) -> np.ndarray:
    d = _core.RenderDescription()
    d.set_film(16, 16)
    d.set_camera("pinhole", (0, 0, 4), (0, 0, 0), (0, 1, 0), 40)
    params = {k: v for k, v in material.items() if k != "type"}
    m = d.add_material(material["type"], params)
    if shape == "sphere":
        d.add_sphere((0, 0, 0), 1, m)
    else:
        n = 24  # a sphere of triangles with smooth normals
        theta, phi = np.meshgrid(
            np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij"
        )
        p = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
        index = np.arange(p.shape[0] * p.shape[1]).reshape(p.shape[:2])
        a, b, c, e = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
        triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, c, b), (a, e, c))])
        d.add_mesh(p.reshape(-1, 3), triangles, material=m)
    d.set_constant_environment((1, 1, 1))
    film = _core.Film(16, 16, 4)
    report = _core.render(_core.Scene(d), _core.Settings(1), film, {"spp": 256}, 2)
    assert report["log"][-1]["rejected"] == 0
    return np.asarray(film.sums)[..., :3] / (film.spp / 4)


def mean_and_error(replicates: np.ndarray) -> tuple[float, float]:
    """Pixels and replicates are independent: their variances add up."""
    r, height, width, _ = replicates.shape
    variance = replicates.mean(-1).var(0, ddof=1).sum() / r
    return float(replicates.mean()), float(np.sqrt(variance) / (height * width))


@pytest.mark.parametrize("shape", ["sphere", "mesh"])
@pytest.mark.parametrize("name", LOSSLESS)
def test_furnace_is_white(name: str, shape: str) -> None:
    replicates = furnace(LOSSLESS[name], shape)
    mean, error = mean_and_error(replicates)
    bound = max(3 * error, 2e-5) + ALLOWED_LOSS.get(name, 0)
    assert abs(mean - 1) <= bound, (mean, error)
    # No pixel may hide behind another: each within the noise of the pixels that have any.
    noise2 = replicates.var(0, ddof=1) / len(replicates)
    noise = np.sqrt(noise2[noise2 > 0].mean()) if np.any(noise2 > 0) else 0.0
    gap = np.abs(replicates.mean(0) - 1).max()
    assert gap <= 6 * noise + 2e-5 + ALLOWED_LOSS.get(name, 0), (gap, noise)


def test_grey_furnace_darkens_by_the_albedo() -> None:
    """A convex grey sphere reflects its albedo; the test above can fail."""
    replicates = furnace({"type": "lambert", "albedo": 0.99}, "sphere")
    mean, error = mean_and_error(replicates[:, 5:11, 5:11])
    assert abs(mean - 0.99) <= 3 * error + 1e-6
    assert 3 * error < 0.005


def test_closed_white_box_keeps_its_energy() -> None:
    """A camera in a closed emissive enclosure sees emission / (1 - albedo)."""
    d = _core.RenderDescription()
    d.set_film(8, 8)
    d.set_camera("pinhole", (0, 0, 0), (0, 0, -1), (0, 1, 0), 60)
    m = d.add_material("lambert", {"albedo": 0.75}, emission=0.25)
    d.add_sphere((0, 0, 0), 3, m)
    image, report = render(_core.Scene(d), spp=256, width=8, height=8)
    error = image.std() / np.sqrt(image.size / 3)
    assert abs(image.mean() - 1) < 4 * error + 1e-4, (image.mean(), error)
    assert report["log"][-1]["rejected"] == 0
