"""Display values against numbers known from the specifications, and errors that list choices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import matiere as mt
from matiere.develop import builtin_configs, displays

# ACES 2.0, SDR 100 nits, Rec.709 on an sRGB display, for neutral scene-linear values: the transform
# maps 0.18 to about 10 nits, that is (10/100) encoded by sRGB: 0.3492.
GREY = 0.18


def one(*rgb: float, **keys: Any) -> NDArray[np.float32]:
    shown: NDArray[np.float32] = mt.develop(np.array([[rgb]], np.float32), **keys)[0, 0]
    return shown


def srgb(linear: float) -> float:
    return 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055


def test_default_is_aces_2_sdr() -> None:
    assert builtin_configs().count("studio-config-v4.0.0_aces-v2.0_ocio-v2.5") == 1
    assert np.allclose(one(GREY, GREY, GREY), srgb(0.10), atol=2e-3)
    assert np.allclose(one(0, 0, 0), 0, atol=1e-4)
    bright = one(100, 100, 100)
    assert np.allclose(bright, 1, atol=2e-3)


def test_neutral_stays_neutral_and_grows() -> None:
    values = np.geomspace(1e-3, 50, 64, dtype=np.float32)
    image = mt.develop(np.repeat(values[None, :, None], 3, axis=2))
    assert image.shape == (1, 64, 3) and image.dtype == np.float32
    assert np.ptp(image, axis=2).max() < 1e-4
    assert (np.diff(image[0, :, 0]) > 0).all()


def test_un_tone_mapped_is_the_srgb_curve() -> None:
    for value in (0.001, 0.0031308, 0.18, 0.5, 0.9):
        got = one(value, value / 2, value / 4, view="Un-tone-mapped")
        wanted = [srgb(value), srgb(value / 2), srgb(value / 4)]
        assert np.allclose(got, wanted, atol=2e-5), value


def test_exposure_is_in_stops() -> None:
    for stops in (-3.0, 0.5, 2.0):
        scaled = one(*(GREY * 2.0**stops,) * 3)
        assert np.allclose(one(GREY, GREY, GREY, exposure=stops), scaled, atol=1e-6)


def test_red_is_rec709_red() -> None:
    """Guards against reading the film as ACEScg: Rec.709 red shown as it is stays pure."""
    red = one(0.5, 0, 0, view="Un-tone-mapped")
    assert np.allclose(red, [srgb(0.5), 0, 0], atol=2e-3)


def test_alpha_is_divided_out_and_kept() -> None:
    premultiplied = np.array([[[0.09, 0.09, 0.09, 0.5], [0, 0, 0, 0]]], np.float32)
    image = mt.develop(premultiplied)
    assert np.allclose(image[0, 0, :3], one(GREY, GREY, GREY), atol=1e-6)
    assert image[0, :, 3].tolist() == [0.5, 0]
    assert np.isfinite(image).all()


def test_input_is_left_alone_and_odd_values_survive() -> None:
    image = np.array([[[np.nan, np.inf, -np.inf], [1e30, -5, 0]]], np.float32)
    before = image.copy()
    assert np.isfinite(mt.develop(image)).all()
    assert np.array_equal(image, before, equal_nan=True)


@pytest.mark.parametrize("shape", [(4,), (4, 4), (2, 2, 2), (2, 2, 5), (1, 2, 2, 3)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="shape"):
        mt.develop(np.zeros(shape, np.float32))


@pytest.mark.parametrize(
    ("keys", "pointer", "listed"),
    [
        ({"config": "studio"}, "/config", "studio-config-v4.0.0_aces-v2.0_ocio-v2.5"),
        ({"display": "sRGB"}, "/display", "sRGB - Display"),
        ({"view": "ACES"}, "/view", "Un-tone-mapped"),
    ],
)
def test_unknown_names_list_the_choices(keys: dict[str, str], pointer: str, listed: str) -> None:
    with pytest.raises(mt.ColourError) as caught:
        one(1, 1, 1, **keys)
    assert caught.value.pointer == pointer
    assert repr(listed) in caught.value.message


def test_every_builtin_config_with_a_linear_rec709_can_be_used() -> None:
    image = np.full((1, 1, 3), GREY, np.float32)
    for config in builtin_configs():
        for display, views in list(displays(config).items())[:2]:
            for view in views[:2]:
                assert np.isfinite(
                    mt.develop(image, config=config, display=display, view=view)
                ).all()
