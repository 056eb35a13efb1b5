"""Image files: round trips, channels, metadata, and nothing half-written."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import matiere as mt
from matiere import imageio
from matiere.imageio import Stored, quantise, read_color, srgb_to_linear, write_stored


class FakeFilm:
    """What write_image needs of a film."""

    aovs: tuple[str, ...] = ()

    def __init__(self, transparent: bool = False) -> None:
        rng = np.random.default_rng(1)
        self.mean = rng.random((5, 7, 3)) * 4
        self.standard_error = self.mean * 0.01
        self.alpha = rng.random((5, 7))
        self.transparent = transparent
        self.spp, self.replicates = 64, 4
        self.report = {
            "scene_digest": "ab" * 32,
            "wall_s": 1.5,
            "reason": "spp",
            "error": {"relmse": 1e-3, "lower": 9e-4, "upper": 1.1e-3},
        }


def test_exr_holds_the_film_to_the_bit(tmp_path: Path) -> None:
    film: Any = FakeFilm()
    mt.write_image(tmp_path / "a.exr", film)
    read = mt.read_image(tmp_path / "a.exr")
    assert read.channels == ("R", "G", "B", *(f"standard_error.{c}" for c in "RGB"))
    assert np.array_equal(read.pixels[:, :, :3], film.mean.astype(np.float32))
    assert np.array_equal(read.pixels[:, :, 3:], film.standard_error.astype(np.float32))
    notes = read.metadata
    assert notes["matiere:scene"] == "ab" * 32
    assert notes["matiere:spp"] == 64
    assert notes["matiere:seconds"] == 1.5
    assert notes["matiere:relmse"] == pytest.approx(1e-3)
    assert "matiere:view" not in notes


def test_half_exr_rounds_to_half(tmp_path: Path) -> None:
    film: Any = FakeFilm()
    mt.write_image(tmp_path / "a.exr", film, bit_depth=16)
    read = mt.read_image(tmp_path / "a.exr")
    assert np.array_equal(read.pixels[:, :, :3], film.mean.astype(np.float16).astype(np.float32))


@pytest.mark.parametrize("bits", [8, 16])
def test_png_is_the_view_rounded_to_nearest(bits: int, tmp_path: Path) -> None:
    film: Any = FakeFilm()
    mt.write_image(tmp_path / "a.png", film, bit_depth=bits)
    read = mt.read_image(tmp_path / "a.png")
    top = (1 << bits) - 1
    stored = np.rint(read.pixels * np.float64(top))
    exact = np.clip(mt.develop(film), 0, 1).astype(np.float64) * top
    assert np.abs(stored - exact).max() <= 0.5
    assert read.metadata["matiere:view"] == "ACES 2.0 - SDR 100 nits (Rec.709)"
    assert read.metadata["matiere:spp"] == "64"


def test_transparent_films_have_alpha(tmp_path: Path) -> None:
    film: Any = FakeFilm(transparent=True)
    for name in ("a.png", "a.exr"):
        mt.write_image(tmp_path / name, film)
        read = mt.read_image(tmp_path / name)
        assert read.channels[:4] == ("R", "G", "B", "A")
        assert np.abs(read.pixels[:, :, 3] - film.alpha).max() <= 0.5 / 255
    shown = mt.develop(film)
    assert np.abs(mt.read_image(tmp_path / "a.png").pixels - np.clip(shown, 0, 1)).max() < 0.002
    mt.write_image(tmp_path / "a.jpg", film)
    assert mt.read_image(tmp_path / "a.jpg").channels == ("R", "G", "B")


def test_arrays_are_written_as_they_are(tmp_path: Path) -> None:
    ramp = np.linspace(0, 1, 256, dtype=np.float32)
    image = np.repeat(ramp[None, :, None], 3, axis=2)
    mt.write_image(tmp_path / "a.png", image)
    read = mt.read_image(tmp_path / "a.png").pixels
    assert np.array_equal(np.rint(read[0, :, 0] * 255), np.arange(256))
    mt.write_image(tmp_path / "b.png", image, view="Un-tone-mapped")
    shown = mt.read_image(tmp_path / "b.png").pixels
    assert np.abs(shown - mt.develop(image, view="Un-tone-mapped")).max() <= 0.5 / 255 + 1e-6


def png_chunks(path: Path) -> dict[bytes, bytes]:
    data, at, found = path.read_bytes(), 8, {}
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        found[data[at + 4 : at + 8]] = data[at + 8 : at + 8 + size]
        at += 12 + size
    return found


def test_files_say_which_display_they_are_for(tmp_path: Path) -> None:
    """CICP code points of ITU-T H.273: primaries 12 are P3 D65, 9 Rec.2020; transfer 13 is sRGB."""
    film: Any = FakeFilm()
    mt.write_image(tmp_path / "a.png", film)
    assert b"sRGB" in png_chunks(tmp_path / "a.png")
    p3 = {"display": "Display P3 - Display", "view": "ACES 2.0 - SDR 100 nits (P3 D65)"}
    mt.write_image(tmp_path / "a.png", film, **p3)
    chunks = png_chunks(tmp_path / "a.png")
    assert b"sRGB" not in chunks and chunks[b"cICP"] == bytes([12, 13, 0, 1])
    pq = {"display": "Rec.2100-PQ - Display", "view": "ACES 2.0 - HDR 1000 nits (Rec.2020)"}
    mt.write_image(tmp_path / "a.png", film, bit_depth=16, **pq)
    chunks = png_chunks(tmp_path / "a.png")
    assert b"sRGB" not in chunks and chunks[b"cICP"] == bytes([9, 16, 0, 1])
    mt.write_image(tmp_path / "a.exr", film)
    assert mt.read_image(tmp_path / "a.exr").metadata["oiio:ColorSpace"] == "lin_rec709_scene"
    mt.write_image(tmp_path / "a.exr", film, **p3)
    shown = mt.read_image(tmp_path / "a.exr").metadata
    assert shown["oiio:ColorSpace"] == "srgb_p3d65_display"
    old = {"config": "cg-config-v1.0.0_aces-v1.3_ocio-v2.1", "view": "ACES 1.0 - SDR Video"}
    mt.write_image(tmp_path / "a.png", film, display="Rec.1886 Rec.709 - Display", **old)
    assert b"sRGB" not in png_chunks(tmp_path / "a.png")


def test_jpeg_is_close_to_the_view(tmp_path: Path) -> None:
    y, x = np.mgrid[0:64, 0:64] / 64
    image = np.stack([x, y, 1 - x], axis=2).astype(np.float32)
    mt.write_image(tmp_path / "a.jpg", image)
    read = mt.read_image(tmp_path / "a.jpg").pixels
    assert np.abs(read - image).mean() < 0.01


def test_rounding_is_to_nearest() -> None:
    values = np.array([0, 0.49 / 255, 0.51 / 255, 1, 2, -1, np.nan, np.inf])
    assert quantise(values, 8).tolist() == [0, 0, 1, 255, 255, 0, 0, 255]
    exact = np.arange(65536) / 65535
    assert np.array_equal(quantise(exact, 16), np.arange(65536))


def test_srgb_decoding_matches_the_standard() -> None:
    x = np.array([0, 0.04045, 0.5, 1.0])
    wanted = [0, 0.04045 / 12.92, ((0.5 + 0.055) / 1.055) ** 2.4, 1]
    assert np.allclose(srgb_to_linear(x), wanted, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "kind"), [("a.png", "uint8"), ("a.png", "uint16"), ("a.tif", "uint16")]
)
def test_whole_number_formats_scale_to_one(name: str, kind: str, tmp_path: Path) -> None:
    top = np.iinfo(kind).max
    pixels = np.array([[[0, top // 3, top]]], kind)
    write_stored(tmp_path / name, Stored(pixels, "RGB", {}), kind)
    read = read_color(tmp_path / name)
    assert read.integer
    assert np.allclose(read.pixels[0, 0], pixels[0, 0] / top, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "kind"), [("a.exr", "half"), ("a.exr", "float"), ("a.hdr", "float")]
)
def test_float_formats_keep_bright_values(name: str, kind: str, tmp_path: Path) -> None:
    pixels = np.array([[[0.5, 2, 1024]]], np.float32)
    write_stored(tmp_path / name, Stored(pixels, "RGB", {}), kind)
    read = read_color(tmp_path / name)
    assert not read.integer
    assert np.allclose(
        read.pixels[0, 0], [0.5, 2, 1024], rtol=0.01, atol=4.1
    )  # RGBE shares an exponent


def test_grey_and_alpha_are_understood(tmp_path: Path) -> None:
    grey = np.full((1, 1, 1), 0.25, np.float32)
    write_stored(tmp_path / "a.exr", Stored(grey, "Y", {}), "float")
    assert read_color(tmp_path / "a.exr").pixels.tolist() == [[[0.25] * 3]]
    rgba = np.array([[[255, 128, 0, 51]]], np.uint8)
    write_stored(tmp_path / "b.png", Stored(rgba, "RGBA", {}), "uint8")
    read = read_color(tmp_path / "b.png").pixels[0, 0]
    assert np.allclose(read, [1, 128 / 255, 0], rtol=1e-6)  # not darkened by alpha


def test_channels_are_found_by_name(tmp_path: Path) -> None:
    pixels = np.array([[[0.1, 0.2, 0.3, 0.4]]], np.float32)
    write_stored(tmp_path / "a.exr", Stored(pixels, ("A", "B", "G", "R"), {}), "float")
    assert np.allclose(read_color(tmp_path / "a.exr").pixels[0, 0], [0.4, 0.3, 0.2])


@pytest.mark.parametrize(
    ("name", "keys", "words"),
    [
        ("a.bmp", {}, "use .png, .jpg or .exr"),
        ("a", {}, "without ending"),
        ("a.png", {"bit_depth": 12}, "8 or 16"),
        ("a.exr", {"bit_depth": 8}, "16 or 32"),
        ("missing/a.png", {}, "No such file"),
    ],
)
def test_bad_requests_are_refused(
    name: str, keys: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(mt.ImageError, match=words):
        mt.write_image(tmp_path / name, np.zeros((2, 2, 3), np.float32), **keys)
    assert list(tmp_path.iterdir()) == []


def test_a_failing_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = np.zeros((4, 4, 3), np.float32)
    mt.write_image(tmp_path / "a.png", image)
    before = (tmp_path / "a.png").read_bytes()

    def full(_: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(imageio, "_sync", full)
    with pytest.raises(mt.ImageError, match="No space left"):
        mt.write_image(tmp_path / "a.png", image + 1)
    assert (tmp_path / "a.png").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


FULL_DISK = """
import resource, sys
import numpy as np
import matiere as mt
image = np.random.default_rng(0).random((256, 256, 3)).astype(np.float32)
mt.write_image("warm.png", image[:4, :4])
mt.write_image(sys.argv[1], image[:4, :4])
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    mt.write_image(sys.argv[1], image)
except mt.ImageError as error:
    print(error)
"""


@pytest.mark.parametrize("name", ["a.png", "a.exr", "a.jpg"])
def test_a_write_that_fails_half_way_changes_nothing(name: str, tmp_path: Path) -> None:
    """A file size limit, which cuts writes short just as a full disk does."""
    command = [sys.executable, "-c", FULL_DISK, name]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    if name == "a.jpg":  # libjpeg ends the process, before any file was touched
        assert done.returncode == 1
    else:
        assert done.stdout.startswith("cannot encode as"), done
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([name, "warm.png"])
    assert mt.read_image(tmp_path / name).pixels.shape[:2] == (4, 4)


def test_files_get_the_usual_permissions(tmp_path: Path) -> None:
    mt.write_image(tmp_path / "a.png", np.zeros((2, 2, 3), np.float32))
    (tmp_path / "plain").touch()
    assert (tmp_path / "a.png").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_huge_images_are_refused_by_their_header(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mt.write_image(tmp_path / "a.png", np.zeros((64, 64, 3), np.float32))
    monkeypatch.setattr(imageio, "MAX_READ_VALUES", 1000)
    with pytest.raises(mt.ImageError, match="64 x 64"):
        mt.read_image(tmp_path / "a.png")
