"""Every kernel gives the very pixels of the full one on scenes that need no more."""

from typing import Any

import numpy as np
import pytest
from render_build import FLOOR

from matiere import _core

SIZE, SPP, DEPTH = 24, 32, 12
NAMES = [kernel["name"] for kernel in _core.kernels()]
UV = np.array([[0, 0], [6, 0], [6, 6], [0, 6]], float)
QUAD = np.array([[-1, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]], float)


def studio(floor: int | None = None) -> tuple[Any, int]:
    """A floor, a lamp, a smooth-shaded quad and a ball of lambert."""
    d = _core.RenderDescription()
    d.set_film(SIZE, SIZE)
    d.set_camera("pinhole", (0.3, 1.6, 5), (0, 0.9, 0), (0, 1, 0), 40)
    grey = d.add_material("lambert", {"albedo": (0.6, 0.5, 0.4)})
    thin = d.add_material("lambert", {"albedo": 0.8}, two_sided=False)
    d.add_mesh(*FLOOR, material=grey, uv=np.array(FLOOR[0])[:, [0, 2]] / 3)
    bent = np.array([[-0.5, 0, 1], [0.5, 0, 1], [0.5, 0.4, 1], [-0.5, 0.4, 1]])
    d.add_mesh(QUAD - (0, 0, 2), [[0, 1, 2], [0, 2, 3]], normals=bent, material=thin, uv=UV[:4])
    d.add_sphere((-1.2, 0.7, 0), 0.7, grey)
    d.add_rectangle_light((-1, 4, -1), (2, 0, 0), (0, 0, 2), (9, 9, 8))
    return d, grey


def every_light(d: Any) -> None:
    d.set_environment(np.random.default_rng(1).random((8, 16, 3), np.float32), 30)
    d.add_point_light((2, 2, 2), (3, 3, 3))
    d.add_directional_light((0.2, -1, 0.1), (0.5, 0.5, 0.4))
    lamp = d.add_material("lambert", {"albedo": 0.1}, emission=2.0)
    d.add_mesh(QUAD * 0.3 + (2, 0.5, 1), [[0, 2, 1], [0, 3, 2]], material=lamp)
    d.add_sphere((-2, 2, 0), 0.2, lamp)


def diffuse() -> Any:
    return studio()[0]


def opaque() -> Any:
    """Rough and sharp metal (with a caustic guide), plastic, coats, and every kind of light."""
    d = studio()[0]
    every_light(d)
    gold = d.add_material("cook_torrance", {"alpha": 0.02, "F0": 0.9})
    d.add_sphere((0.4, 0.5, 0.8), 0.5, gold)
    d.add_sphere((1.4, 0.5, 0), 0.5, d.add_material("plastic", {"alpha": 0.1, "albedo": 0.5}))
    d.add_sphere((0.2, 0.4, 1.8), 0.3, d.add_material("mirror", {}))
    d.add_sphere((1.2, 0.3, 1.5), 0.3, d.add_material("oren_nayar", {"roughness": 0.5}))
    return d


def textured() -> Any:
    """Textures in parameters and emission, normal and bump maps, an anisotropic lobe."""
    d = opaque()
    noise = np.random.default_rng(2).random((8, 8, 3), np.float32)
    map_ = d.add_texture(noise, "repeat")
    emission = d.add_texture(noise * 3, "repeat")
    painted = d.add_material(
        "lambert",
        {"albedo": ("texture", map_)},
        maps={"normal_map": map_, "bump_map": map_, "bump_height": 0.05},
    )
    brushed = d.add_material("ward", {"alpha_x": 0.1, "alpha_y": 0.4, "specular": 0.5})
    glowing = d.add_material("lambert", {}, emission=("texture", emission))
    for at, material in ((-2.0, painted), (0.0, brushed), (2.0, glowing)):
        d.add_mesh(QUAD * 0.6 + (at, 0, -1), [[0, 1, 2], [0, 2, 3]], uv=UV, material=material)
    return d


def clear() -> Any:
    """Dispersive and absorbing glass in glass, and a leaf with holes."""
    d = textured()
    glass = d.add_material("dielectric", {"eta": (1.50, 1.52, 1.54)})
    inner = d.add_material("dielectric", {"eta": 1.3, "sigma_a": (1, 2, 3)}, priority=1)
    leaf = d.add_material("lambert", {"albedo": 0.5}, opacity=0.4)
    d.add_sphere((0, 0.9, 2), 0.5, glass)
    d.add_sphere((0, 0.9, 2), 0.3, inner)
    d.add_mesh(QUAD + np.array([0, 0, 1.0]), [[0, 1, 2], [0, 2, 3]], uv=UV, material=leaf)
    return d


def full() -> Any:
    """Fog around everything, which glass and leaf stand in, and milk."""
    d = clear()
    fog = {"sigma_s": (0.02, 0.03, 0.05), "sigma_a": 0.01, "g": 0.6}
    d.add_sphere((0, 1, 1), 9, d.add_material("null", fog, priority=-1))
    milk = {"eta": 1.33, "alpha": 0.1, "scattering_albedo": (0.99, 0.9, 0.8), "mean_free_path": 0.1}
    d.add_sphere((-0.9, 0.4, 1.9), 0.3, d.add_material("dielectric", milk))
    return d


SCENES = {
    "diffuse": diffuse,
    "opaque": opaque,
    "textured": textured,
    "clear": clear,
    "full": full,
}


@pytest.fixture(scope="module")
def built() -> dict[str, Any]:
    return {name: _core.Scene(make()) for name, make in SCENES.items()}


def settings(kernel: str, **keys: Any) -> Any:
    return _core.Settings(5, DEPTH, kernel=kernel, **keys)


def film(scene: Any, settings: Any, spp: int = SPP) -> Any:
    film = _core.Film(SIZE, SIZE, 4)
    _core.render(scene, settings, film, {"spp": spp}, 2)
    return film


def counted(film: Any) -> dict[str, Any]:
    return {k: v for k, v in film.counters.items() if k not in ("cpu_s", "wall_s")}


def test_every_kernel_has_a_scene() -> None:
    assert list(SCENES) == NAMES
    for smaller, larger in zip(_core.kernels(), _core.kernels()[1:], strict=False):
        assert set(smaller["features"]) < set(larger["features"])


@pytest.mark.parametrize("name", NAMES)
def test_the_smallest_kernel_that_covers_a_scene_is_chosen(
    built: dict[str, Any], name: str
) -> None:
    assert _core.kernel_of(built[name], settings(""))["name"] == name


@pytest.mark.parametrize(
    ("scene", "kernel"),
    [(s, k) for i, s in enumerate(NAMES) for k in NAMES[i:] if k != "full" or s == "full"],
)
@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_pixels_and_counts_are_those_of_the_full_kernel(
    built: dict[str, Any], scene: str, kernel: str, strategy: str
) -> None:
    spp = SPP if strategy == "mis" else 8
    ours = film(built[scene], settings(kernel, strategy=strategy), spp)
    theirs = film(built[scene], settings("full", strategy=strategy), spp)
    chosen = film(built[scene], settings("", strategy=strategy), spp)
    assert np.asarray(theirs.sums).any()
    for other in (ours, chosen):
        assert np.asarray(other.sums).tobytes() == np.asarray(theirs.sums).tobytes()
        assert counted(other) == counted(theirs)


@pytest.mark.parametrize("scene", NAMES)
def test_the_recording_kernel_gives_the_same_values(built: dict[str, Any], scene: str) -> None:
    """One sample in each replicate of a small film, against the sums of the chosen kernel."""
    chosen = settings("")
    sums = np.asarray(film(built[scene], chosen, 4).sums)[:, ::3, ::3]
    for r, y, x in np.ndindex(sums.shape[:3]):
        path = _core.replay(built[scene], chosen, 3 * x, 3 * y, r, 0)
        assert (*path["value"], path["alpha"]) == tuple(sums[r, y, x]), (x, y, r)


def test_a_kernel_that_lacks_something_is_refused(built: dict[str, Any]) -> None:
    for name in NAMES[1:]:
        smaller = NAMES[NAMES.index(name) - 1]
        with pytest.raises(_core.SceneError, match="lacks"):
            film(built[name], settings(smaller), 4)
    with pytest.raises(ValueError, match="no kernel"):
        settings("fast")


def test_without_the_guide_less_is_needed(built: dict[str, Any]) -> None:
    scene = built["opaque"]
    assert "caustic_guide" in _core.kernel_of(scene, settings(""))["found"]
    guided = film(scene, settings(""), 8)
    plain = film(scene, settings("", guide_caustics=False), 8)
    assert np.asarray(guided.sums).tobytes() != np.asarray(plain.sums).tobytes()


ONE_MORE = {
    "a second lamp": lambda d: d.add_rectangle_light((2, 4, 0), (1, 0, 0), (0, 0, 1), (1, 1, 1)),
    "environment": lambda d: d.set_constant_environment((1, 1, 1)),
    "point light": lambda d: d.add_point_light((0, 3, 0), (1, 1, 1)),
    "another model": lambda d: d.add_sphere((0, 0.5, 0), 0.5, d.add_material("oren_nayar", {})),
    "a texture": lambda d: d.add_sphere(
        (0, 0.5, 0),
        0.5,
        d.add_material(
            "lambert",
            {"albedo": ("texture", d.add_texture(np.ones((1, 1, 3), np.float32)))},
        ),
    ),
    "opacity": lambda d: d.add_sphere((0, 0.5, 0), 0.5, d.add_material("lambert", {}, opacity=0.5)),
    "emission": lambda d: d.add_sphere(
        (0, 0.5, 0), 0.5, d.add_material("lambert", {}, emission=1.0)
    ),
    "fog": lambda d: d.add_sphere((0, 0.5, 0), 0.5, d.add_material("null", {"sigma_s": 1.0})),
    "glass": lambda d: d.add_sphere((0, 0.5, 0), 0.5, d.add_material("dielectric", {"eta": 1.5})),
}


@pytest.mark.parametrize("what", ONE_MORE)
def test_one_thing_more_takes_a_scene_out_of_the_diffuse_kernel(what: str) -> None:
    d = diffuse()
    ONE_MORE[what](d)
    assert _core.kernel_of(_core.Scene(d), settings(""))["name"] != "diffuse"


def test_texture_coordinates_that_nothing_reads_are_dropped() -> None:
    grid = np.stack(np.meshgrid(np.arange(50.0), np.arange(50.0)), -1).reshape(-1, 2)
    positions = np.insert(grid, 1, 0.0, axis=1)
    triangles = [[0, 1, 50]]
    size = {}
    for material in ("lambert", "ward"):
        d = studio()[0]
        m = d.add_material(
            material, {} if material == "lambert" else {"alpha_x": 0.1, "alpha_y": 0.4}
        )
        d.add_mesh(positions, triangles, uv=grid, material=m)
        size[material] = _core.Scene(d).stats()["bytes"]
    assert size["ward"] - size["lambert"] >= 2500 * 8
