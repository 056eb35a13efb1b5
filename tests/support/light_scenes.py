"""Scenes with a light layer, made call by call, and the statistics that judge it."""

import warnings
from typing import Any

import numpy as np
from render_build import FLOOR
from scipy import stats

from matiere import _core

N, R = 16, 16
CHANCE = 1e-3  # of a test to fail by chance
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def replicates(
    d: Any, spp: int, light: str = "auto", depth: int = 2, seed: int = 1, guide: bool = True
) -> Any:
    film = _core.Film(N, N, R)
    settings = _core.Settings(seed, depth, guide_caustics=guide, light_tracing=light)
    scene = d if isinstance(d, _core.Scene) else _core.Scene(d)
    _core.render(scene, settings, film, {"spp": spp}, 2)
    assert film.has_light_layer == (light != "off")
    return np.array(film.replicate_means()[..., :3])


def tiles(images: Any) -> Any:
    """The image's mean and those of 16 tiles, luminance, of every replicate."""
    light = images @ LUMINANCE
    t = light.reshape(len(images), 4, N // 4, 4, N // 4).mean((2, 4)).reshape(len(images), -1)
    return np.concatenate([light.mean((1, 2))[:, None], t], 1)


def worst_p(images: Any, expected: Any) -> float:
    """The least p of image and tiles against known means, Sidak-corrected; 1e-6 off is exact."""
    ours, wanted = tiles(images), tiles(expected[None])[0]
    error = ours.std(0, ddof=1) / np.sqrt(len(ours))
    t = np.abs(ours.mean(0) - wanted) / np.maximum(error, 1e-6 * wanted)
    p = 2 * stats.t.sf(t, len(ours) - 1)
    return float(1 - (1 - p.min()) ** p.size)


def welch(a: Any, b: Any) -> float:
    """The least p of image and tiles of two roads, Sidak-corrected."""
    ours, theirs = tiles(a), tiles(b)
    same = np.abs(ours.mean(0) - theirs.mean(0)) <= 1e-5 * theirs.mean(0)  # constant tiles
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of their variance
        p = stats.ttest_ind(ours, theirs, equal_var=False).pvalue
    p = np.where(same, 1.0, p)
    return float(1 - (1 - p.min()) ** p.size)


def by_both_roads(scene: Any, spp: int = 1024, depth: int = 12) -> None:
    """Assert that images with the layer of every lamp and without it have the same means in all
    tiles, and that 5 % more would be found."""
    ours = replicates(scene, spp, "on", depth)
    theirs = replicates(scene, 4 * spp, "off", depth, seed=2)
    assert welch(ours, theirs) > CHANCE
    assert welch(ours, 1.05 * theirs) < CHANCE


def ball_on_floor(
    material: str, params: dict[str, Any], lens: str = "pinhole", lamp: float = 0.4
) -> Any:
    """A ball under a square lamp and a dim sky. Camera paths find it if it is not too small."""
    d = _core.RenderDescription()
    d.set_film(N, N)
    more = {"aperture_radius": 0.1, "focus_distance": 5.0} if lens == "thin_lens" else {}
    more |= {"height": 4.0} if lens == "orthographic" else {}
    fov = {} if lens in ("orthographic", "panorama") else {"vfov_deg": 40}
    d.set_camera(lens, (0, 3, 5), (0.2, 0.3, 0), (0, 1, 0), **fov, **more)
    d.add_mesh(*FLOOR, material=d.add_material("plastic", {"albedo": 0.6, "alpha": 0.2}))
    d.add_sphere((0, 0.8, 0), 0.8, d.add_material(material, params))
    radiance = [5.4 / lamp**2, 5.0 / lamp**2, 4.0 / lamp**2]
    d.add_rectangle_light((1.4, 2.6, 0.2), (lamp, 0, 0), (0, 0, lamp), radiance)
    d.set_constant_environment((0.02, 0.02, 0.025))
    return d


BALLS: dict[str, tuple[str, dict[str, Any]]] = {
    "glass": ("dielectric", {"eta": 1.5}),
    "tinted dispersive glass": ("dielectric", {"eta": (1.4, 1.5, 1.7), "sigma_a": (0.2, 0.6, 1)}),
    "nearly smooth glass": ("dielectric", {"eta": 1.5, "alpha": 0.08}),
    "smooth metal": ("mirror", {"F0": 0.9}),
    "rough metal": ("conductor", {"eta": 0.4, "k": 3.0, "alpha": 0.1}),
    "coated body": ("plastic", {"albedo": 0.5, "alpha": 0.0}),
    "coat over metal": (
        "layered", {"base": {"type": "mirror", "F0": 0.7}, "eta": 1.5, "method": "walk"}),
}  # fmt: skip
