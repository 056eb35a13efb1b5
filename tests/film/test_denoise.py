"""Denoised pictures stand beside the raw ones and claim no error bar."""

import json
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt
from matiere.denoise import beside
from matiere.service.cli import main


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[np.ndarray]]:
    """Stand in for Open Image Denoise: a box filter, which keeps what it was given."""
    seen: list[np.ndarray] = []

    def denoise(color: np.ndarray, *guides: np.ndarray, hdr: bool) -> np.ndarray:
        for image in (color, *guides):
            assert image.dtype == np.float32 and image.flags.c_contiguous
            assert image.shape == color.shape
        assert hdr
        seen.extend((color, *guides))
        return np.full_like(color, color.mean())

    monkeypatch.setitem(sys.modules, "pyoidn", SimpleNamespace(denoise=denoise))
    monkeypatch.setattr(metadata, "version", lambda name: "9.9")
    yield seen


@pytest.fixture
def missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyoidn", None)


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    """Run the command line; return exit code and all that it said."""
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    return int(end.value.code or 0), said.out + said.err


def write_scene(folder: Path) -> Path:
    place = folder / "scene.json"
    place.write_text(json.dumps(scenes(16)["diffuse"]))
    return place


@pytest.mark.parametrize(
    ("aovs", "used"),
    [(["albedo", "normal"], 2), (["albedo"], 1), (["normal"], 0), (["depth"], 0)],
)
def test_layers_of_a_film_go_in_beside_it(
    fake: list[np.ndarray], aovs: list[str], used: int
) -> None:
    document = scenes(16)["diffuse"]
    document["film"] = {**document["film"], "aovs": aovs}
    film = mt.render(mt.load(document), spp=4)
    mt.denoise(film)
    assert len(fake) == 1 + used
    for guide, name in zip(fake[1:], ("albedo", "normal"), strict=False):
        np.testing.assert_array_equal(guide, film.aov(name).astype(np.float32))


def test_a_film_goes_in_as_linear_light_and_alpha_is_kept(fake: list[np.ndarray]) -> None:
    film = mt.render(mt.load(scenes(16)["diffuse"]), spp=4)
    cleaned = mt.denoise(film)
    np.testing.assert_array_equal(fake[0], film.mean.astype(np.float32))
    assert cleaned.shape == (16, 16, 3) and np.ptp(cleaned) == 0
    image = np.random.default_rng(0).random((5, 4, 4), np.float32) - 0.1
    assert np.array_equal(mt.denoise(image)[:, :, 3], image[:, :, 3])
    assert fake[1].min() == 0, "negative samples are no light"


def test_the_raw_picture_is_kept_and_the_other_says_what_it_is(
    fake: list[np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = write_scene(tmp_path), tmp_path / "a.png"
    exr = tmp_path / "a.exr"
    code, said = run(capsys, "render", scene, "-o", out, "-o", exr, "--spp", 4, "--denoise")
    assert code == 0, said
    assert "a.denoised.png" in said and len(fake) == 1
    raw, cleaned = mt.read_image(out), mt.read_image(tmp_path / "a.denoised.png")
    assert "matiere:relmse" in raw.metadata and "matiere:denoised" not in raw.metadata
    assert "Open Image Denoise" in str(cleaned.metadata["matiere:denoised"])
    assert "no error bar" in str(cleaned.metadata["matiere:certificate"])
    assert "matiere:relmse" not in cleaned.metadata
    assert np.ptp(cleaned.pixels[:, :, 0]) == 0 and np.ptp(raw.pixels[:, :, 0]) > 0
    linear = mt.read_image(tmp_path / "a.denoised.exr").pixels
    assert linear.shape[2] == 3, "no standard error beside a picture that has none"


def test_without_the_extra_nothing_is_rendered(
    missing: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path)
    code, said = run(capsys, "render", scene, "-o", tmp_path / "a.png", "--denoise")
    assert code == 2 and "matiere[denoise]" in said
    assert not (tmp_path / "a.png").exists()
    with pytest.raises(mt.ImageError, match="pip install"):
        mt.denoise(np.zeros((4, 4, 3), np.float32))


def test_names() -> None:
    assert beside(Path("out/a.b.png")) == Path("out/a.b.denoised.png")


def test_the_real_one_takes_noise_away() -> None:
    pytest.importorskip("pyoidn", reason="the extra matiere[denoise] is not installed")
    scene = mt.load(scenes(64)["diffuse"])
    noisy, fine = mt.render(scene, spp=8, seed=1), mt.render(scene, spp=1024, seed=2)
    before = np.square(noisy.mean - fine.mean).mean()
    after = np.square(mt.denoise(noisy) - fine.mean).mean()
    assert after < 0.5 * before
