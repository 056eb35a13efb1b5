"""Measured reflection: what the files say, the contract of its sampling, and bad files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import chi_square
import numpy as np
import pytest
from extremes import DEGREES, direction
from measured_files import (
    ALBEDO,
    glossy,
    lambert,
    made,
    merl_bytes,
    merl_table,
    real_files,
    rgl_fields,
    tensor_bytes,
)
from oracle import note

import matiere as mt
from matiere import _core
from matiere.scene.measured import channel_weights, read_merl, read_rgl

ARRAYS = made()
FILES = real_files()
NO_FILES = "RGL's files are not in ../shared/assets/measured/rgl"
real = pytest.mark.parametrize("file", FILES or [None], ids=lambda f: f.stem if f else "none")


def vectors(n: int, seed: int) -> np.ndarray:
    w = np.random.default_rng(seed).normal(size=(n, 3))
    w[:, 2] = np.abs(w[:, 2])
    return w / np.linalg.norm(w, axis=1, keepdims=True)


def probe(arrays: dict[str, Any], precision: str = "float") -> Any:
    return _core.Bsdf("measured", {"file": ("data", arrays)}, precision)


@pytest.mark.parametrize("degrees", DEGREES)
def test_a_lambert_table_is_lambert(degrees: float) -> None:
    b = probe(ARRAYS["merl-lambert"])
    wo, wi = direction(degrees, 0.3), vectors(1000, 1)
    assert np.allclose(b.eval(wo, wi), ALBEDO / np.pi * wi[:, 2:], rtol=1e-5)
    assert b.albedo(wo, n=1 << 14)[0] == pytest.approx(ALBEDO, rel=1e-2)


def angles(wo: np.ndarray, wi: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return Rusinkiewicz's angles by rotation matrices, as the paper has them."""
    h = (wo + wi) / np.linalg.norm(wo + wi, axis=1, keepdims=True)
    theta, phi = np.arccos(np.clip(h[:, 2], -1, 1)), np.arctan2(h[:, 1], h[:, 0])
    c, s = np.cos(-phi), np.sin(-phi)
    x, y = c * wi[:, 0] - s * wi[:, 1], s * wi[:, 0] + c * wi[:, 1]
    c, s = np.cos(-theta), np.sin(-theta)
    x, z = c * x + s * wi[:, 2], -s * x + c * wi[:, 2]
    return theta, np.arccos(np.clip(z, -1, 1)), np.arctan2(y, x)


def test_a_smooth_table_is_its_closed_form() -> None:
    b = probe(ARRAYS["merl-glossy"], "double")
    wo, wi = vectors(4000, 2), vectors(4000, 3)
    h, d, p = angles(wo, wi)
    inside = (d > 0.02) & (d < 1.54)  # between the centres of cells
    expected = np.stack(glossy(h, d, p), 1) * wi[:, 2:]
    assert np.abs(b.eval(wo, wi) - expected)[inside].max() < 1e-3 * expected.max()


def test_cells_below_zero_are_black() -> None:
    table = merl_table(lambert)
    table[:, 45:] = -1.0
    b = probe(read_merl(merl_bytes(table)))
    assert not b.eval((0.9, 0.0, np.sqrt(0.19)), (0.9, 0.0, np.sqrt(0.19))).any()
    assert b.eval((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)).min() > 0


def test_isotropic_tables_turn_with_the_surface() -> None:
    b = probe(ARRAYS["rgl-isotropic"], "double")
    wo, wi = vectors(100, 4), vectors(100, 5)
    c, s = np.cos(1.1), np.sin(1.1)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert np.allclose(b.eval(wo @ turn.T, wi @ turn.T), b.eval(wo, wi), rtol=1e-9)
    assert np.allclose(b.pdf(wo @ turn.T, wi @ turn.T), b.pdf(wo, wi), rtol=1e-9)


@pytest.mark.parametrize(("part", "flip"), [("half", (-1, -1, 1)), ("quarter", (-1, 1, 1))])
def test_parts_of_the_circle_stand_for_the_whole(part: str, flip: Any) -> None:
    b = probe(ARRAYS[f"rgl-{part}-circle"], "double")
    wo, wi = vectors(100, 6), vectors(100, 7)
    assert np.allclose(b.eval(wo * flip, wi * flip), b.eval(wo, wi), rtol=1e-9)
    s, t = (b.sample(w, np.full((100, 3), 0.3)) for w in (wo, wo * flip))
    assert np.allclose(s.wi * flip, t.wi)


def oracle(a: dict[str, Any], wo: np.ndarray, wi: np.ndarray, n: int = 601) -> Any:
    """Evaluate an isotropic RGL table by dense quadrature of its definition."""

    def bilinear(t: np.ndarray, x: Any, y: Any) -> Any:
        x, y = np.asarray(x) * (t.shape[1] - 1), np.asarray(y) * (t.shape[0] - 1)
        i = np.minimum(x.astype(int), t.shape[1] - 2)
        j = np.minimum(y.astype(int), t.shape[0] - 2)
        fx, fy = x - i, y - j
        low = t[j, i] * (1 - fx) + t[j, i + 1] * fx
        return low * (1 - fy) + (t[j + 1, i] * (1 - fx) + t[j + 1, i + 1] * fx) * fy

    h = (wo + wi) / np.linalg.norm(wo + wi)
    theta, phi = np.arccos(wo[2]), np.arctan2(wo[1], wo[0])
    x = np.sqrt(np.arccos(h[2]) * 2 / np.pi)
    y = ((np.arctan2(h[1], h[0]) - phi + np.pi) / (2 * np.pi)) % 1.0
    k = int(np.searchsorted(a["theta_i"], theta, "right")) - 1
    k = min(k, len(a["theta_i"]) - 2)
    part = (theta - a["theta_i"][k]) / (a["theta_i"][k + 1] - a["theta_i"][k])

    def blend(t: np.ndarray, normalize: bool) -> np.ndarray:
        low, high = t[0, k].astype(float), t[0, k + 1].astype(float)
        if normalize:
            low, high = (
                s / np.trapezoid(np.trapezoid(s, dx=1 / (s.shape[1] - 1)), dx=1 / (len(s) - 1))
                for s in (low, high)
            )
        return np.asarray(low * (1 - part) + high * part)

    v = blend(a["vndf"], True)
    cells = np.arange(n)
    mid = (cells + 0.5) / n
    below_y, below_x = (np.clip(at * n - cells, 0, 1) for at in (y, x))  # of each cell
    u_y = below_y @ bilinear(v, *np.meshgrid(mid, mid)).mean(axis=1) / n
    row = bilinear(v, mid, np.full(n, y))
    u_x = below_x @ row / row.sum()
    scale = bilinear(a["ndf"], x, y) / (
        4 * bilinear(a["sigma"], np.sqrt(theta * 2 / np.pi), (phi + np.pi) / (2 * np.pi))
    )
    return [bilinear(blend(a["rgb"][:, :, c], False), u_x, u_y) * scale for c in range(3)]


def test_rgl_is_its_definition() -> None:
    a = ARRAYS["rgl-isotropic"]
    b = probe(ARRAYS["rgl-isotropic"], "double")
    for wo, wi in zip(vectors(6, 8), vectors(6, 9), strict=True):
        error = float(np.abs(b.eval(wo, wi)[0] / oracle(a, wo, wi) - 1).max())
        note(error, 1e-3, "table")
        assert error < 1e-3


@pytest.mark.skipif(not FILES, reason=NO_FILES)
@real
def test_real_files_are_read_and_sampled(file: Path) -> None:
    b = probe(read_rgl(file.read_bytes()))
    level = chi_square.sidak(0.01, len(FILES) * 3)
    for degrees in (0.0, 60.0, 85.0):
        o = chi_square.run(b, np.array(direction(degrees, 0.3)), n=20_000)
        assert o.p_value > level and abs(o.gap) < 1e-2, (file.stem, degrees, o)
    for degrees in DEGREES:
        albedo = b.albedo(direction(degrees, 0.3), n=1 << 12)[0]
        print(file.stem, degrees, albedo)
        assert (albedo >= 0).all() and (albedo < 1.3).all()


@pytest.mark.skipif(not FILES, reason=NO_FILES)
def test_real_colours_look_like_their_names() -> None:
    def albedo(name: str) -> np.ndarray:
        (file,) = (f for f in FILES if f.stem == name)
        b = mt.bsdf({"type": "measured", "file": file.name}, asset_root=file.parent)
        return np.asarray(b.albedo((0, 0, 1))[0])

    white, mint, orange = (albedo(f"{n}_rgb") for n in ("aurora_white", "chm_mint", "chm_orange"))
    assert white.min() > 0.6 and white.max() / white.min() < 1.2
    assert mint[1] > mint[2] > mint[0] and orange[0] > 3 * orange[1] > 3 * orange[2]


def test_grey_spectra_are_grey_and_every_weight_row_is_one() -> None:
    fields = rgl_fields()
    rgb = fields.pop("rgb")
    nodes = np.linspace(360, 1000, 50).astype("f4")
    level = rgb[:, :, :1]
    fields |= {"wavelengths": nodes, "spectra": np.repeat(level, 50, axis=2)}
    read = read_rgl(tensor_bytes(fields))["rgb"]
    assert read.shape == rgb.shape and np.allclose(read, np.repeat(level, 3, axis=2), rtol=1e-5)
    assert np.allclose(channel_weights(nodes.astype(float)).sum(axis=1), 1)
    red = channel_weights(nodes.astype(float)) @ (nodes > 600)
    assert red[0] > 0.8 and abs(red[1]) < 0.2 and abs(red[2]) < 0.1


GOOD = tensor_bytes(rgl_fields())
NAN = {**rgl_fields(), "ndf": np.full((7, 8), np.nan, "f4")}
HUGE = GOOD[:30] + b"\xff" * 40 + GOOD[70:]
LESS = {k: v for k, v in rgl_fields().items() if k != "sigma"}
SHAPE = {**rgl_fields(), "luminance": np.ones((1, 3, 6, 5), "f4")}
BELOW = {**rgl_fields(), "vndf": -np.ones((1, 4, 9, 8), "f4")}
ARC = rgl_fields(4, 1.0)
BAD = {
    "empty": (b"", "fewer than 12 bytes"),
    "text": (b"this is no measurement", "neither"),
    "merl cut short": (merl_bytes(merl_table(lambert))[:-8], "bytes"),
    "rgl cut in the header": (GOOD[:60], "cut short"),
    "rgl cut in the data": (GOOD[:-100], "cut short"),
    "rgl of a later version": (GOOD[:12] + b"\x07" + GOOD[13:], "version 7"),
    "rgl with a million fields": (GOOD[:14] + b"\xff\xff\xff\x7f" + GOOD[18:], "fields"),
    "rgl with absurd numbers": (HUGE, ""),
    "rgl without sigma": (tensor_bytes(LESS), "sigma"),
    "rgl with NaN": (tensor_bytes(NAN), "finite"),
    "rgl with another shape": (tensor_bytes(SHAPE), "shape"),
    "rgl with negative densities": (tensor_bytes(BELOW), "negative"),
    "rgl over an odd arc": (tensor_bytes(ARC), "circle"),
}


def scene(folder: Path, file: str) -> Any:
    return mt.load(
        {
            "version": 1,
            "camera": {"type": "pinhole", "origin": [0, 0, 5], "target": [0, 0, 0]},
            "film": {"width": 8, "height": 8},
            "materials": {
                "m": {"type": "mix", "a": {"type": "measured", "file": file}, "b": {"type": "null"}}
            },
            "shapes": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "m"}],
            "environment": {"radiance": 1},
        },
        asset_root=folder,
    )


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_their_place(name: str, tmp_path: Path) -> None:
    data, words = BAD[name]
    (tmp_path / "x.bsdf").write_bytes(data)
    with pytest.raises(mt.SceneValidationError) as caught:
        scene(tmp_path, "x.bsdf").build(threads=1)
    (fault,) = caught.value.faults
    assert fault.pointer == "/materials/m/a/file" and words in fault.message, fault


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        scene(tmp_path, "nothing.bsdf")
    (fault,) = caught.value.faults
    assert (fault.pointer, fault.code) == ("/materials/m/a/file", "asset_missing")


def test_the_file_is_an_asset_and_part_of_the_film_key(tmp_path: Path) -> None:
    (tmp_path / "x.bsdf").write_bytes(GOOD)
    first = scene(tmp_path, "x.bsdf")
    assert [name for name, _ in first.assets] == ["x.bsdf"]
    key = mt.film_key(first)
    (tmp_path / "x.bsdf").write_bytes(tensor_bytes(rgl_fields(seed=2)))
    assert mt.film_key(scene(tmp_path, "x.bsdf")) != key
