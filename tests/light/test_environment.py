"""Environment maps: orientation, density, sampling."""

import numpy as np
import pytest

from matiere import _core


def sun_map(width: int = 32, height: int = 16) -> np.ndarray:
    rng = np.random.default_rng(1)
    pixels = rng.uniform(0, 1, (height, width, 3)) ** 4
    pixels[3, 20] = 3000
    pixels[height - 2 :] = 0
    return pixels.astype(np.float32)


def broad_map(width: int = 32, height: int = 16) -> np.ndarray:
    """Light from everywhere, uneven."""
    pixels = np.random.default_rng(1).uniform(0, 1, (height, width, 3)) ** 4
    pixels[height // 5, width // 3] = 30
    return pixels.astype(np.float32)


def sphere_grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Midpoint directions and solid angles over the sphere."""
    cos = 1 - (np.arange(n) + 0.5) * 2 / n
    phi = (np.arange(2 * n) + 0.5) * np.pi / n
    c, p = (a.ravel() for a in np.meshgrid(cos, phi, indexing="ij"))
    s = np.sqrt(1 - c * c)
    return np.stack([s * np.cos(p), c, s * np.sin(p)], 1), np.full(c.size, 4 * np.pi / c.size)


def bits(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 2**32, (n, 4), dtype=np.uint64).astype(np.uint32)


def test_centre_looks_along_minus_z_and_u_grows_to_the_right() -> None:
    pixels = np.zeros((8, 16, 3), np.float32)
    pixels[:, 8:, 0] = 1  # right half red
    pixels[0, :, 1] = 1  # top row green
    environment = _core.EnvironmentLight(pixels)
    radiance, _ = environment.eval([[0.7, 0, -0.7], [-0.7, 0, -0.7], [0, 1, 0], [0.7, 0, 0.7]])
    assert radiance[0, 0] == 1  # right of the centre, seen from inside
    assert radiance[1, 0] == 0
    assert radiance[2, 1] == 1
    assert radiance[3, 0] == 1


def test_rotation_turns_the_map_about_y_right_handed() -> None:
    pixels = np.zeros((8, 64, 3), np.float32)
    pixels[:, 30:34] = 1  # around -z
    environment = _core.EnvironmentLight(pixels, 90.0)
    # Turning -z by +90 degrees about +y gives -x.
    radiance, _ = environment.eval([[-1, 0, 0], [0, 0, -1], [1, 0, 0]])
    assert radiance[0, 0] == 1
    assert radiance[1, 0] == 0
    assert radiance[2, 0] == 0


NORMALS = [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.36, -0.48, 0.8), (-0.8, 0.0, 0.6)]


@pytest.mark.parametrize("normal", NORMALS, ids=str)
@pytest.mark.parametrize(
    ("rotation", "width", "height"), [(0, 32, 16), (77, 32, 16), (77, 200, 90)]
)
def test_density_integrates_to_one(
    rotation: float, width: int, height: int, normal: tuple[float, float, float]
) -> None:
    environment = _core.EnvironmentLight(broad_map(width, height), rotation)
    theta = (np.arange(height) + 0.5) * np.pi / height  # the density is constant in each pixel
    phi = (np.arange(width) + 0.5) * 2 * np.pi / width
    t, p = (a.ravel() for a in np.meshgrid(theta, phi, indexing="ij"))
    p = p + np.radians(rotation)
    directions = np.stack([np.sin(t) * np.cos(p), np.cos(t), -np.sin(t) * np.sin(p)], 1)
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    solid_angle = np.repeat((edges[:-1] - edges[1:]) * 2 * np.pi / width, width)
    _, pdf = environment.eval(directions, normal)
    assert np.sum(pdf.astype(float) * solid_angle) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("normal", NORMALS, ids=str)
def test_sample_reports_the_density_of_its_direction(normal: tuple[float, float, float]) -> None:
    environment = _core.EnvironmentLight(broad_map(), 30.0)
    wi, radiance, pdf = environment.sample(bits(20000), normal)
    again, pdf_again = environment.eval(wi, normal)
    # On a cell border rounding may fall to the neighbour: at most a few in ten thousand.
    same = np.isclose(pdf, pdf_again, rtol=1e-4)
    assert np.mean(same) > 0.998, np.mean(same)
    assert np.allclose(radiance, again, rtol=1e-3, atol=1e-4)
    assert np.abs(np.linalg.norm(wi, axis=1) - 1).max() < 3e-7


def test_estimate_over_the_sampled_part_is_unbiased() -> None:
    environment = _core.EnvironmentLight(sun_map())
    directions, weight = sphere_grid(2048)
    radiance, pdf = environment.eval(directions)
    total = np.sum(radiance[pdf > 0, 1].astype(float) * weight[pdf > 0])
    _, value, pdf = environment.sample(bits(400000))
    ratio = value[:, 1] / pdf
    error = ratio.std() / np.sqrt(ratio.size)
    assert ratio.mean() == pytest.approx(total, abs=4 * error + 2e-3 * total)
    assert error / total < 2e-3  # importance sampling: a nearly constant ratio


@pytest.mark.parametrize("normal", NORMALS[1:], ids=str)
@pytest.mark.parametrize("size", [(32, 16), (200, 90)])
def test_a_surface_looks_for_all_the_light_above_it_and_for_little_else(
    normal: tuple[float, float, float], size: tuple[int, int]
) -> None:
    """The mean of L cos over density is the irradiance, with less noise than without a normal."""
    environment = _core.EnvironmentLight(broad_map(*size), 30.0)
    directions, weight = sphere_grid(2048)
    cosine = np.maximum(directions @ normal, 0)
    radiance, pdf = environment.eval(directions, normal)
    _, plain = environment.eval(directions)
    lit = cosine > 1e-3
    assert np.array_equal(pdf[lit] > 0, plain[lit] > 0), "nothing above the horizon is forgotten"
    hidden = directions @ normal < -np.sin(np.radians(40))
    assert np.all(pdf[hidden] == 0)
    total = np.sum((radiance[:, 1] * cosine * weight)[pdf > 0], dtype=float)
    errors = []
    for n in (normal, (0, 0, 0)):
        wi, value, density = environment.sample(bits(200000), n)
        ratio = value[:, 1] * np.maximum(wi @ normal, 0) / density
        errors.append(ratio.std() / np.sqrt(ratio.size))
        assert ratio.mean() == pytest.approx(total, abs=4 * errors[-1] + 2e-3 * total)
    assert errors[0] < errors[1]


def test_a_surface_below_all_light_looks_for_none() -> None:
    pixels = np.zeros((16, 32, 3), np.float32)
    pixels[:2] = 1
    environment = _core.EnvironmentLight(pixels)
    wi, _, pdf = environment.sample(bits(10), (0, -1, 0))
    assert np.all(wi == 0) and np.all(pdf == 0)


def test_what_exceeds_the_mean_is_sampled() -> None:
    """Bilinear lookup bleeds into black neighbours: the density must follow."""
    pixels = np.zeros((8, 8, 3), np.float32)
    pixels[4, 4] = 1
    environment = _core.EnvironmentLight(pixels)
    directions, weight = sphere_grid(256)
    radiance, pdf = environment.eval(directions)
    mean = np.sum(radiance[:, 0] * weight) / (4 * np.pi)
    assert 0 < mean < 0.05
    assert np.all(pdf[radiance[:, 0] > 0.3] > 0)


@pytest.mark.parametrize("size", [(1, 1), (32, 16)])
def test_an_even_map_leaves_sampling_to_the_materials(size: tuple[int, int]) -> None:
    environment = _core.EnvironmentLight(np.full((size[1], size[0], 3), 0.7, np.float32))
    radiance, pdf = environment.eval(sphere_grid(16)[0])
    assert radiance == pytest.approx(0.7, rel=1e-6)
    assert np.all(pdf == 0)
    wi, _, _ = environment.sample(bits(3))
    assert np.all(wi == 0)


def test_black_map_gives_nothing() -> None:
    environment = _core.EnvironmentLight(np.zeros((4, 8, 3), np.float32))
    wi, _, pdf = environment.sample(bits(10))
    assert np.all(wi == 0)
    assert np.all(pdf == 0)
