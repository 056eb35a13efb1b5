"""Layers of a film beside its light: what they hold, and that they cost the light nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import matiere as mt
from matiere import _core
from matiere.imageio import read_image
from matiere.scene.model import AOVS, MADE_AOVS

STORED = [name for name in AOVS if name not in MADE_AOVS]
LIGHT = ["emission", "direct", "indirect", "diffuse", "specular", "transmission"]


def rich(aovs: list[str], **more: Any) -> dict[str, Any]:
    """Every kind of lobe: coats over textures, glass, layers, a mix with holes, a lamp in view."""
    quad = [[-3, 0, -3], [3, 0, -3], [3, 0, 3], [-3, 0, 3]]
    materials = {
        "floor": {"type": "plastic", "albedo": {"texture": "t"}, "alpha": 0.2},
        "glass": {"type": "dielectric", "eta": 1.5},
        "frost": {"type": "dielectric", "eta": 1.4, "alpha": 0.3, "multiscatter": True},
        "paint": {
            "type": "layered", "eta": 1.5, "alpha": 0.1,
            "base": {"type": "lambert", "albedo": [0.7, 0.2, 0.1]},
        },
        "leaf": {
            "type": "mix", "opacity": 0.7,
            "a": {"type": "oren_nayar", "albedo": 0.4},
            "b": {"type": "conductor", "metal": "Au", "alpha": 0.2},
        },
        "old": {"type": "schlick", "layers": [{"C": 0.4, "r": 0.6, "p": 1}]},
        "lamp": {"type": "lambert", "albedo": 0, "emission": [6, 5, 4]},
    }  # fmt: skip
    balls = [("glass", -1.2, 0.6), ("frost", 0, 1.2), ("paint", 1.2, 0.5), ("leaf", 0, -0.6),
             ("old", -1.1, -1), ("lamp", 1.2, -1.2)]  # fmt: skip
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 3, 5], "target": [0, 0.3, 0], "vfov_deg": 42},
        "film": {"width": 24, "height": 20, "aovs": aovs},
        "render": {"seed": 3, "max_depth": 8},
        "textures": {"t": {"pixels": [[0.2, 0.8], [0.6, 0.1]], "transform": {"scale": [4, 4]}}},
        "materials": materials,
        "shapes": [
            {"type": "mesh", "material": "floor", "positions": quad,
             "triangles": [[0, 2, 1], [0, 3, 2]], "uv": [[0, 0], [1, 0], [1, 1], [0, 1]]},
            *({"type": "sphere", "material": m, "center": [x, 0.5, z], "radius": 0.5}
              for m, x, z in balls),
        ],
        "lights": [{"type": "point", "position": [1, 4, 2], "intensity": 20}],
        "environment": {"radiance": [0.3, 0.4, 0.5]},
        **more,
    }  # fmt: skip


@pytest.fixture(scope="module")
def film() -> mt.Film:
    return mt.render(mt.load(rich(list(AOVS))), spp=64, threads=2)


def test_the_light_has_the_same_bits_with_layers(film: mt.Film) -> None:
    plain = mt.render(mt.load(rich([])), spp=64, threads=2)
    assert np.asarray(plain.core.sums).tobytes() == np.asarray(film.core.sums).tobytes()
    assert plain.core.aovs == [] and film.core.aovs == STORED
    cut = plain.core.cut_energy("max_depth")
    assert cut["followed"] > 0 and cut == film.core.cut_energy("max_depth")
    assert mt.film_key(mt.load(rich([]))) != mt.film_key(mt.load(rich(["uv"])))


def test_direct_and_indirect_are_the_picture(film: mt.Film) -> None:
    total = film.aov("direct") + film.aov("indirect")
    assert total == pytest.approx(film.mean, rel=1e-6, abs=1e-7)
    assert film.aov("indirect").mean() > 0.01 and film.aov("direct").mean() > 0.05


def test_lobes_and_what_is_seen_directly_are_the_picture(film: mt.Film) -> None:
    parts = [film.aov(name) for name in ("emission", "diffuse", "specular", "transmission")]
    assert sum(parts) == pytest.approx(film.mean, rel=1e-6, abs=1e-7)
    for part in parts:
        assert part.min() >= 0 and part.mean() > 1e-3


@pytest.mark.parametrize(
    ("material", "present"),
    [
        ({"type": "lambert", "albedo": 0.5}, {"diffuse"}),
        ({"type": "conductor", "metal": "Ag", "alpha": 0.3}, {"specular"}),
        ({"type": "mirror"}, {"specular"}),
        ({"type": "dielectric", "eta": 1.5}, {"specular", "transmission"}),
        ({"type": "plastic", "albedo": 0.5}, {"diffuse", "specular"}),
        ({"type": "cook_torrance", "F0": 0.1, "diffuse": 0.5}, {"diffuse", "specular"}),
        ({"type": "ward", "diffuse": 0.4, "specular": 0.2}, {"diffuse", "specular"}),
        ({"type": "blinn_phong", "diffuse": 0.4, "specular": 0.2}, {"diffuse", "specular"}),
        ({"type": "ashikhmin_shirley"}, {"diffuse", "specular"}),
    ],
)
def test_every_model_has_the_lobes_it_should(material: dict[str, Any], present: set[str]) -> None:
    document = rich(["diffuse", "specular", "transmission"])
    document["materials"] = {"m": material}
    document["shapes"] = [{"type": "sphere", "material": "m", "center": [0, 0.3, 0], "radius": 1.5}]
    got = mt.render(mt.load(document), spp=16, threads=2)
    lit = {n for n in ("diffuse", "specular", "transmission") if got.aov(n).max() > 1e-4}
    assert lit == present


def test_a_camera_in_a_medium_sees_it_by_transmission() -> None:
    document = rich(list(STORED))
    fog = {"type": "null", "sigma_s": 0.4}
    document["materials"] = {"fog": fog, "floor": {"type": "lambert"}}
    ball = {"type": "sphere", "material": "fog", "center": [0, 0, 0], "radius": 40}
    document["shapes"] = [
        ball,
        {"type": "sphere", "material": "floor", "center": [0, 0, 0], "radius": 1},
    ]
    got = mt.render(mt.load(document), spp=16, threads=2)
    assert got.aov("transmission").mean() > 0.01
    parts = [got.aov(name) for name in ("emission", "diffuse", "specular", "transmission")]
    assert sum(parts) == pytest.approx(got.mean, rel=1e-6, abs=1e-7)


def test_the_diffuse_part_of_a_coat_is_its_body() -> None:
    """A black body leaves the specular part as it was, bit by bit of the mean."""

    def specular(albedo: float) -> np.ndarray:
        document = rich(["diffuse", "specular"])
        document["render"]["max_depth"] = 1
        document["materials"] = {"m": {"type": "plastic", "albedo": albedo, "alpha": 0.4}}
        document["shapes"] = [
            {"type": "sphere", "material": "m", "center": [0, 0.3, 0], "radius": 1.5}
        ]
        document["environment"] = None
        return mt.render(mt.load(document), spp=16, threads=2).aov("specular")

    assert specular(0.8) == pytest.approx(specular(0.0), rel=1e-4, abs=1e-6)


def probe(**surface: Any) -> dict[str, Any]:
    """A square of 2 m, 3 m before an orthographic camera, far from the origin."""
    at = np.array([1e4, 50.0, -2e4])
    quad = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    return {
        "version": 1,
        "camera": {"type": "orthographic", "origin": np.add(at, [0, 0, 3]).tolist(),
                   "target": at.tolist(), "height": 4},
        "film": {"width": 8, "height": 8, "filter": "box", "aovs": STORED},
        "materials": {"far": {"type": "lambert"},
                      "m": {"type": "lambert", "albedo": [0.2, 0.4, 0.6], **surface}},
        "shapes": [{"type": "mesh", "material": "m", "positions": (np.array(quad) + at).tolist(),
                    "triangles": [[0, 1, 2], [0, 2, 3]], "uv": [[0, 0], [1, 0], [1, 1], [0, 1]]}],
        "environment": {"radiance": 1},
    }  # fmt: skip


def test_what_the_camera_meets_first() -> None:
    got = mt.render(mt.load(probe()), spp=16, threads=2)
    inside = (slice(3, 5), slice(3, 5))
    assert got.aov("albedo")[inside] == pytest.approx(np.broadcast_to([0.2, 0.4, 0.6], (2, 2, 3)))
    assert got.aov("normal")[inside] == pytest.approx(np.broadcast_to([0.0, 0, 1], (2, 2, 3)))
    assert got.aov("depth")[inside] == pytest.approx(3.0, rel=1e-5)
    assert (got.aov("material_id")[inside] == 1).all()
    place = got.aov("position")
    # The middle of pixel (3, 3) lies a quarter of a metre left of and above the centre.
    assert place[3, 3] == pytest.approx([1e4 - 0.25, 50.25, -2e4], abs=0.03)
    assert got.aov("uv")[3, 3] == pytest.approx([0.375, 0.625], abs=0.02)
    outside = (0, 0)
    assert got.aov("depth")[outside] == np.inf and got.aov("material_id")[outside] == -1
    for name in ("albedo", "normal", "position", "uv"):
        assert (got.aov(name)[outside] == 0).all()
    assert got.aov("emission")[outside] == pytest.approx([1, 1, 1])
    assert got.info.materials[1] == "m"


def test_a_surface_that_is_passed_is_not_met() -> None:
    got = mt.render(mt.load(probe(opacity=0.0)), spp=16, threads=2)
    assert (got.aov("material_id") == -1).all() and np.isinf(got.aov("depth")).all()
    half = mt.render(mt.load(probe(opacity=0.5)), spp=256, threads=2)
    middle = half.aov("albedo")[3:5, 3:5].mean(axis=(0, 1))
    assert middle == pytest.approx([0.1, 0.2, 0.3], rel=0.2)
    assert half.aov("depth")[3, 3] == pytest.approx(3.0, rel=1e-5)  # of those that met it


def test_depth_of_a_pinhole_is_along_the_ray() -> None:
    document = probe()
    document["camera"] = {**document["camera"], "type": "pinhole", "vfov_deg": 40}
    del document["camera"]["height"]
    got = mt.render(mt.load(document), spp=16, threads=2)
    x = (np.arange(8) + 0.5 - 4) / 4 * np.tan(np.radians(20))
    expected = 3 * np.sqrt(1 + x[3] ** 2 + x[None, :] ** 2)[0]
    assert got.aov("depth")[3, 2:6] == pytest.approx(expected[2:6], rel=0.01)


def parts(document: dict[str, Any]) -> list[bytes]:
    scene = mt.load(document)
    of = mt.chunks.plan(scene.model)
    made = [mt.chunks.render_chunk(scene, i) for i in range(of.chunk_count(16))]
    return [part for part in made if part is not None]


@pytest.mark.parametrize("adaptive", [False, True])
def test_layers_have_the_same_bits_however_they_are_made(adaptive: bool, tmp_path: Path) -> None:
    document = rich(list(STORED), render={"seed": 3, "max_depth": 4, "adaptive": adaptive})
    scene = mt.load(document)
    whole = mt.render(scene, spp=64, threads=2)
    first = mt.render(scene, spp=16, threads=1)
    first.save(tmp_path / "a.film")
    again = mt.render(scene, spp=64, threads=2, film=mt.load_film(tmp_path / "a.film"))
    for name in STORED:
        assert again.aov(name).tobytes() == whole.aov(name).tobytes(), name
    assert again.core.to_bytes()[-8:] != b"" and again.aovs == tuple(STORED)
    total = whole.aov("direct") + whole.aov("indirect")
    assert total == pytest.approx(whole.mean, rel=1e-6, abs=1e-7)


def test_chunks_carry_layers_into_an_empty_film() -> None:
    document = rich(["albedo", "direct"])
    scene = mt.load(document)
    core = mt.chunks.new_film(mt.chunks.plan(scene.model))
    for data in parts(document):
        mt.chunks.add(core, data)
    whole = mt.render(scene, spp=16, threads=2)
    assert core.aovs == ["albedo", "direct"]
    assert core.aov("direct").tobytes() == whole.core.aov("direct").tobytes()
    with pytest.raises(mt.FilmError, match="other layers"):
        mt.chunks.add(core, _next_of_plain(core))


def _next_of_plain(core: Any) -> bytes:
    scene = mt.load(rich([]))
    index = core.next_chunk(0)
    data = mt.chunks.render_chunk(scene, index)
    assert data is not None
    return data


def test_merged_films_merge_their_layers() -> None:
    scene = mt.load(rich(list(STORED)))
    a, b = (mt.render(scene, spp=16, seed=s, threads=2) for s in (1, 2))
    both = a.merge(b)
    assert both.aov("direct") == pytest.approx((a.aov("direct") + b.aov("direct")) / 2)
    assert np.array_equal(both.aov("material_id"), a.aov("material_id"))


@pytest.mark.parametrize("depth", [16, 32])
def test_exr_holds_the_layers_as_floats(film: mt.Film, tmp_path: Path, depth: int) -> None:
    mt.write_image(tmp_path / "a.exr", film, bit_depth=depth)
    read = read_image(tmp_path / "a.exr")
    wanted = "albedo.R normal.X position.Z depth.Z uv.V emission.G transmission.B"
    for channel in (*wanted.split(), "material_id", "sample_count", "standard_error.R"):
        assert channel in read.channels, channel
    at = read.channels.index("position.X")
    assert np.array_equal(read.pixels[:, :, at], film.aov("position")[:, :, 0].astype(np.float32))
    at = read.channels.index("material_id")
    assert np.array_equal(read.pixels[:, :, at], film.aov("material_id"))


def test_what_was_not_asked_for_is_refused_in_words(film: mt.Film) -> None:
    plain = mt.render(mt.load(rich([])), spp=4, threads=2)
    assert plain.aov("sample_count").min() == 4
    assert plain.aov("standard_error").shape == (20, 24, 3)
    with pytest.raises(mt.FilmError, match=r"film\.aovs"):
        plain.aov("normal")
    with pytest.raises(mt.FilmError, match="normal"):
        film.aov("normals")


@pytest.mark.parametrize(
    ("aovs", "at"),
    [(["normals"], "/film/aovs/0"), (["uv", "uv"], "/film/aovs/1"), ("uv", "/film/aovs")],
)
def test_faults_have_their_place(aovs: Any, at: str) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(rich(aovs))
    assert at in [f.pointer for f in caught.value.faults]


def test_layers_are_counted_into_the_memory_of_a_film() -> None:
    per_pixel = _core.Film.bytes_per_pixel
    assert per_pixel(4, False, ["albedo"]) == per_pixel(4) + 8 * 4
    assert per_pixel(4, True, ["depth", "uv"]) == per_pixel(4, True) + 2 * 8 * 4
    scene = mt.load(rich(["albedo"]))
    with pytest.raises(mt.MemoryLimitError):
        mt.render(scene, spp=4, memory_limit=per_pixel(4) * 24 * 20)
