"""Texels in their own format, mip levels, wrap modes, filters and transforms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from matiere import _core

Texture = _core.probe.Texture
RANDOM = np.random.default_rng(3)


def srgb(code: np.ndarray) -> np.ndarray:
    x = code / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize(
    ("stored", "linear"),
    [
        (np.arange(256, dtype=np.uint8), lambda x: x / 255),
        (np.array([0, 1, 255, 65535], np.uint16), lambda x: x / 65535),
        (np.array([0, 1e-7, 0.1, 3.5, 65504], np.float16), lambda x: x.astype(float)),
        (np.array([-1, 0, 1e-30, 1e30], np.float32), lambda x: x.astype(float)),
    ],
)
@pytest.mark.parametrize("channels", [1, 3])
def test_every_format_is_read_as_it_is(stored: Any, linear: Any, channels: int) -> None:
    image = np.stack([np.roll(stored, c) for c in range(channels)], axis=-1)[None]
    texture = Texture(image)
    assert texture.bytes == image.nbytes
    assert texture.level(0) == pytest.approx(
        np.broadcast_to(linear(image), (1, len(stored), 3)), rel=2e-7
    )


def test_srgb_codes_are_decoded() -> None:
    codes = np.arange(256, dtype=np.uint8)[None]
    assert Texture(codes, srgb=True).level(0)[0, :, 0] == pytest.approx(srgb(codes[0]), rel=1e-7)
    with pytest.raises(ValueError, match="uint8"):
        Texture(codes.astype(np.uint16), srgb=True)


@pytest.mark.parametrize("size", [(1, 1), (8, 8), (7, 5), (1, 9), (33, 2), (100, 3)])
@pytest.mark.parametrize("kind", ["u1", "u2", "f2", "f4"])
def test_every_mip_level_has_the_mean_of_the_image(size: tuple[int, int], kind: str) -> None:
    values = RANDOM.random((*size, 3))
    image = values if kind[0] == "f" else values * np.iinfo(kind).max
    texture = Texture(image.astype(kind), filter="trilinear", srgb=kind == "u1")
    assert texture.level(texture.levels - 1).shape == (1, 1, 3)
    for i in range(texture.levels):
        mean = texture.level(i).astype(float).mean(axis=(0, 1))
        assert mean == pytest.approx(texture.mean.astype(float), rel=2**-10)


def test_a_level_of_an_odd_size_averages_areas() -> None:
    texture = Texture(np.array([[1, 0, 0, 0, 2]], np.float32), filter="trilinear")
    assert texture.level(1)[0, :, 0] == pytest.approx([1 / 2.5, 2 / 2.5])


def test_black_and_white_average_to_grey_light() -> None:
    """In sRGB codes the mean would be 0.214 or 0.503 (rounded to 8 bits)."""
    checker = (np.indices((16, 16)).sum(0) % 2 * 255).astype(np.uint8)
    texture = Texture(checker, filter="trilinear", srgb=True)
    for i in range(1, texture.levels):
        assert texture.level(i) == pytest.approx(0.5, rel=1e-6)
    assert texture.bytes == 256 + 2 * (64 + 16 + 4 + 1)


def test_levels_are_blended_by_the_area() -> None:
    image = RANDOM.random((16, 16)).astype(np.float32)
    fine, soft = Texture(image), Texture(image, filter="trilinear")
    texel = 1 / 256
    for u, v in RANDOM.random((20, 2)):
        here = fine.lookup(u, v)[0]
        for area in (0.0, texel / 4, texel):
            assert soft.lookup(u, v, area)[0] == here
        for level in (1, 2, 3):
            coarse = Texture(soft.level(level)).lookup(u, v)[0]
            assert soft.lookup(u, v, texel * 4**level)[0] == pytest.approx(coarse, rel=1e-5)
        between = soft.lookup(u, v, texel * 4**1.25)[0]
        one, two = (soft.lookup(u, v, texel * 4**k)[0] for k in (1, 2))
        assert between == pytest.approx(0.75 * one + 0.25 * two, rel=1e-5)
        assert soft.lookup(u, v, 1e9)[0] == pytest.approx(image.mean(), rel=1e-5)
        assert fine.lookup(u, v, 1e9)[0] == here


ROW = np.array([[1, 2, 3, 4]], np.float32)


@pytest.mark.parametrize(
    ("wrap", "expected"),
    [
        ("repeat", [1, 2, 3, 4, 1, 2, 3, 4, 1, 2, 3, 4]),
        ("clamp", [1, 1, 1, 1, 1, 2, 3, 4, 4, 4, 4, 4]),
        ("mirror", [4, 3, 2, 1, 1, 2, 3, 4, 4, 3, 2, 1]),
        ("black", [0, 0, 0, 0, 1, 2, 3, 4, 0, 0, 0, 0]),
    ],
)
@pytest.mark.parametrize("filter_", ["nearest", "bilinear", "trilinear"])
def test_wrap_modes(wrap: str, expected: list[float], filter_: str) -> None:
    texture = Texture(ROW, wrap, filter_)
    centres = (np.arange(-4, 8) + 0.5) / 4
    assert [texture.lookup(u, 0.5)[0] for u in centres] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("wrap", "expected"), [("repeat", 2.5), ("clamp", 1), ("mirror", 1), ("black", 0.5)]
)
def test_the_border_is_blended_with_what_lies_beyond(wrap: str, expected: float) -> None:
    assert Texture(ROW, wrap).lookup(0.0, 0.5)[0] == expected


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror", "black"])
def test_wild_coordinates_stay_inside_the_image(wrap: str) -> None:
    for filter_ in ("nearest", "bilinear", "trilinear"):
        texture = Texture(ROW, wrap, filter_)
        for uv in ((1e30, -1e30), (np.inf, 0.5), (np.nan, np.nan), (-1e9, 7.7)):
            for area in (0.0, 0.1, np.inf, np.nan):
                assert 0 <= texture.lookup(*uv, area)[0] <= 4


def test_nearest_has_no_values_in_between() -> None:
    texture = Texture(ROW, filter="nearest")
    assert {float(texture.lookup(u, 0.5)[0]) for u in np.linspace(0, 0.999, 97)} == {1, 2, 3, 4}


def test_a_transform_moves_turns_and_scales() -> None:
    image = RANDOM.random((8, 8)).astype(np.float32)
    plain = Texture(image)
    a, b, c, d, x, y = 1.5, -0.4, 0.3, 2.0, 0.1, -0.7
    moved = Texture(image, transform=(a, b, c, d, x, y), filter="trilinear")
    for u, v in RANDOM.random((10, 2)):
        wanted = plain.lookup(a * u + b * v + x, c * u + d * v + y)[0]
        assert moved.lookup(u, v)[0] == pytest.approx(wanted, abs=1e-5)
        # A texel is smaller on the surface by the determinant.
        texel = 1 / 64 / (a * d - b * c)
        assert moved.lookup(u, v, texel)[0] == pytest.approx(wanted, abs=1e-5)
        assert moved.lookup(u, v, 4 * texel)[0] == pytest.approx(
            Texture(moved.level(1)).lookup(a * u + b * v + x, c * u + d * v + y)[0], abs=1e-4
        )


def test_a_flat_transform_is_refused() -> None:
    with pytest.raises(_core.SceneError, match="flattens"):
        Texture(ROW, transform=(1, 2, 2, 4, 0, 0))
