"""The studio light: orientation, resolution independence, colour of its lamps."""

from __future__ import annotations

import time
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt
import pytest


def brightest_direction(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Return the direction of the brightest texel by the issue's conventions."""
    height, width = image.shape[:2]
    row, column = np.unravel_index(int(image.sum(axis=2).argmax()), (height, width))
    phi = ((column + 0.5) / width - 0.5) * 2.0 * np.pi  # centre column: -z, right: +x
    theta = (row + 0.5) / height * np.pi
    return np.array([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)])


def test_sun_stands_where_it_is_said(studio_light: ModuleType) -> None:
    wanted = np.asarray(studio_light.SUN.direction)
    found = brightest_direction(studio_light.studio_light(512, 256))
    angle = np.rad2deg(np.arccos(found @ wanted / np.linalg.norm(wanted)))
    assert angle < studio_light.SUN.radius_deg + 1.0, angle


def irradiance(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Return the flux per channel over the whole sphere."""
    height, width = image.shape[:2]
    sin = np.sin((np.arange(height) + 0.5) / height * np.pi)
    texel = 2.0 * np.pi / width * np.pi / height
    total: npt.NDArray[np.float64] = (image * sin[:, None, None]).sum(axis=(0, 1)) * texel
    return total


@pytest.mark.slow
def test_power_does_not_depend_on_resolution(studio_light: ModuleType) -> None:
    coarse = irradiance(studio_light.studio_light(256, 128))
    fine = irradiance(studio_light.studio_light(1024, 512))
    assert np.abs(coarse / fine - 1.0).max() < 0.01, (coarse, fine)


def test_values_are_finite_and_positive_with_a_high_contrast(studio_light: ModuleType) -> None:
    image = studio_light.studio_light()
    assert image.shape == (256, 512, 3) and image.dtype == np.float32
    assert np.isfinite(image).all() and image.min() > 0.0
    assert image.max() > 100.0 * np.median(image)


@pytest.mark.parametrize(
    ("kelvin", "warmer"), [(2000.0, True), (3000.0, True), (5000.0, True), (9000.0, False)]
)
def test_black_body_is_warm_below_d65(
    studio_light: ModuleType, kelvin: float, warmer: bool
) -> None:
    rgb = studio_light.black_body(kelvin)
    assert (rgb[0] > rgb[2]) == warmer, rgb
    assert abs(float(rgb @ np.array([0.2126, 0.7152, 0.0722])) - 1.0) < 1e-9


def test_black_body_6500_is_near_white(studio_light: ModuleType) -> None:
    assert np.abs(studio_light.black_body(6500.0) - 1.0).max() < 0.05


def test_other_shapes_are_refused(studio_light: ModuleType) -> None:
    with pytest.raises(ValueError, match="2:1"):
        studio_light.studio_light(300, 200)


def test_file_holds_the_floats(studio_light: ModuleType, tmp_path: Path) -> None:
    from matiere import imageio

    image = studio_light.studio_light(64, 32)
    studio_light.write(tmp_path / "studio.exr", image)
    read, integer, _ = imageio.read_color(tmp_path / "studio.exr")
    assert not integer and np.array_equal(read, image)


def test_file_has_the_same_bytes_at_another_time(studio_light: ModuleType, tmp_path: Path) -> None:
    image = studio_light.studio_light(64, 32)
    studio_light.write(tmp_path / "a.exr", image)
    time.sleep(1.1)  # file formats note the second
    studio_light.write(tmp_path / "b.exr", image)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
