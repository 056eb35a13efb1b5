"""Small scenes made call by call, for tests of the transport below the JSON layer."""

from typing import Any

import numpy as np

from matiere import _core

BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
BOX_TRIANGLES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip
FLOOR = ([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]], [[0, 2, 1], [0, 3, 2]])


def box(
    d: Any, half: tuple[float, float, float], center: tuple[float, float, float], m: int
) -> None:
    """Add an axis-aligned box."""
    d.add_mesh(BOX * half + center, BOX_TRIANGLES, material=m)


def look_at_point(
    target: tuple[float, float, float],
    origin: tuple[float, float, float],
    size: int = 4,
    vfov_deg: float = 1e-3,
    up: tuple[float, float, float] = (0, 0, 1),
) -> Any:
    """A description whose whole film sees one point: pixels are repeated measurements of it."""
    d = _core.RenderDescription()
    d.set_film(size, size, "box")
    d.set_camera("pinhole", origin, target, up, vfov_deg)
    return d


def render(
    scene: Any,
    spp: int = 256,
    seed: int = 0,
    max_depth: int = -1,
    strategy: str = "mis",
    threads: int = 2,
    width: int = 4,
    height: int = 4,
    replicates: int = 4,
    guide_caustics: bool = True,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the mean image (H, W, 3) and the report of the loop."""
    film = _core.Film(width, height, replicates)
    settings = _core.Settings(seed, max_depth, strategy, guide_caustics=guide_caustics)
    report = _core.render(scene, settings, film, {"spp": spp}, threads)
    return np.asarray(film.sums).sum(0)[..., :3] / film.spp, report


def measure(scene: Any, size: int = 4, **keys: Any) -> tuple[np.ndarray, np.ndarray]:
    """Mean over all pixels (independent measurements of one point) and its standard error."""
    image, _ = render(scene, width=size, height=size, **keys)
    flat = image.reshape(-1, 3)
    return flat.mean(0), flat.std(0, ddof=1) / np.sqrt(len(flat))


def assert_agrees(mean: np.ndarray, expected: Any, error: np.ndarray) -> None:
    """Fail beyond four standard errors, or 2e-6 where stratification leaves none."""
    gap = np.abs(mean - np.asarray(expected))
    assert np.all(gap <= 4 * error + 2e-6 * np.abs(expected)), (mean, expected, error)
