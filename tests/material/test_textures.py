"""Textures: lookup, and parameters that change over a surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from matiere import _core

POINT = {"n_g": (0.0, 0.0, 1.0), "n_s": (0.0, 0.0, 1.0)}
WO = (0.6, 0.0, 0.8)
WI = np.array([[0.0, 0.0, 1.0], [0.28, 0.0, 0.96], [-0.6, 0.0, 0.8]], dtype=np.float32)


def image(*rows: list[float]) -> np.ndarray:
    return np.repeat(np.array(rows, dtype=np.float32)[..., None], 3, axis=2)


def materials(kind: str, params: dict[str, Any], textures: Any, wrap: str = "repeat") -> Any:
    return _core.probe.Materials([{"type": kind, "params": params}], textures, wrap)


def value(texture: np.ndarray, u: float, v: float, wrap: str = "repeat") -> np.ndarray:
    """Look a texture up through the emission of a material."""
    m = {"type": "lambert", "params": {}, "emission": ("texture", 0)}
    return _core.probe.Materials([m], [texture], wrap).emission(0, u, v)


CHECKER = image([0.0, 1.0], [1.0, 0.0])  # top row first
RAMP = image([0.0, 1.0, 2.0, 3.0])


def test_texel_centres_are_exact_and_v_grows_upwards() -> None:
    t = image([1.0, 2.0], [3.0, 4.0])
    assert value(t, 0.25, 0.75)[0] == 1 and value(t, 0.75, 0.75)[0] == 2
    assert value(t, 0.25, 0.25)[0] == 3 and value(t, 0.75, 0.25)[0] == 4


def test_lookup_is_bilinear() -> None:
    assert value(CHECKER, 0.5, 0.5)[0] == pytest.approx(0.5)
    assert value(RAMP, 0.5, 0.5)[0] == pytest.approx(1.5)
    assert value(RAMP, 0.3, 0.5)[0] == pytest.approx(0.3 * 4 - 0.5, rel=1e-6)


def test_repeat_wraps_across_the_border_and_clamp_holds_it() -> None:
    assert value(RAMP, 0.0, 0.5)[0] == pytest.approx(1.5)  # between 3 and 0
    assert value(RAMP, 0.0, 0.5, "clamp")[0] == 0
    assert value(RAMP, 1.0, 0.5, "clamp")[0] == 3
    for shift in (-7.0, -1.0, 1.0, 5.0):
        assert value(RAMP, 0.3 + shift, 0.5 + shift)[0] == pytest.approx(
            value(RAMP, 0.3, 0.5)[0], abs=1e-5
        )
    assert value(RAMP, 9.0, 0.5, "clamp")[0] == 3 and value(RAMP, -9.0, 0.5, "clamp")[0] == 0


@pytest.mark.parametrize("uv", [(1e9, -1e9), (np.inf, 0.0), (np.nan, np.nan)])
def test_wild_coordinates_stay_inside_the_image(uv: tuple[float, float]) -> None:
    for wrap in ("repeat", "clamp"):
        assert 0 <= value(CHECKER, *uv, wrap)[0] <= 1


def test_a_textured_colour_is_the_constant_one_at_each_point() -> None:
    rgb = np.array([[[0.1, 0.2, 0.3], [0.9, 0.8, 0.7]]], dtype=np.float32)
    t = materials("lambert", {"albedo": ("texture", 0)}, [rgb])
    for u, albedo in ((0.25, rgb[0, 0]), (0.75, rgb[0, 1])):
        f, _ = t.eval(0, {**POINT, "uv": (u, 0.5)}, WO, WI)
        assert f == pytest.approx(np.outer(WI[:, 2], albedo) / np.pi, rel=1e-5)


@pytest.mark.parametrize(
    ("kind", "params", "name"),
    [
        ("plastic", {"albedo": 1.0}, "alpha"),
        ("plastic", {"albedo": 0.5, "distribution": "beckmann"}, "roughness"),
        ("cook_torrance", {"F0": 0.2, "diffuse": 0.8}, "alpha"),
        ("conductor", {"eta": 0.2, "k": 3.0}, "alpha"),
        ("dielectric", {"eta": 1.5}, "alpha"),
    ],
)
def test_textured_roughness_is_the_constant_one_at_each_point(
    kind: str, params: dict[str, Any], name: str
) -> None:
    values = [0.0, 0.001, 0.03, 0.1, 0.37, 1.0]
    textured = materials(kind, {**params, name: ("texture", 0)}, [image(values)])
    for k, x in enumerate(values):
        at = {**POINT, "uv": ((k + 0.5) / len(values), 0.5)}
        constant = materials(kind, {**params, name: x}, [])
        f, pdf = textured.eval(0, at, WO, WI)
        g, qdf = constant.eval(0, at, WO, WI)
        # 1e-3 of the body's albedo: rows of the table over alpha are interpolated.
        assert f == pytest.approx(g, rel=2e-3, abs=1e-3 / np.pi), (x, f, g)
        assert pdf == pytest.approx(qdf, rel=5e-3, abs=1e-3), (x, pdf, qdf)


def test_a_white_body_stays_white_under_textured_roughness() -> None:
    values = list(np.geomspace(1e-3, 1.0, 12))
    t = materials("plastic", {"albedo": 1.0, "alpha": ("texture", 0)}, [image(values)])
    n = 1 << 14
    i = np.arange(n)
    u = np.stack(
        [(0.5 + i * 0.8191725134) % 1, (0.5 + i * 0.6710436067) % 1, (i + 0.5) / n], axis=1
    )
    u = u.astype(np.float32)
    for k in range(len(values)):
        for degrees in (0.0, 60.0, 85.0):
            theta = np.radians(degrees)
            at = {**POINT, "uv": ((k + 0.5) / len(values), 0.5)}
            wo = (float(np.sin(theta)), 0.0, float(np.cos(theta)))
            _, weight, _, _ = t.sample(0, at, wo, u)
            constant = materials("plastic", {"albedo": 1.0, "alpha": float(values[k])}, [])
            _, exact, _, _ = constant.sample(0, POINT, wo, u)
            # The same samples: their own noise drops out of the difference.
            gap = float(weight.mean() - exact.mean())
            assert abs(gap) < 1e-3, (values[k], degrees, gap)


def error(params: dict[str, Any], textures: Any, kind: str = "lambert") -> Any:
    with pytest.raises(_core.SceneError) as caught:
        materials(kind, params, textures)
    return caught.value


def test_texture_values_must_lie_in_the_parameters_range() -> None:
    e = error({"albedo": ("texture", 0)}, [image([0.0, 1.5])])
    assert e.code == "out_of_range" and e.pointer == "/materials/0/albedo" and "1.5" in e.message


def test_unknown_textures_and_constant_parameters_are_refused() -> None:
    assert error({"albedo": ("texture", 3)}, []).code == "unknown_texture"
    e = error({"eta": ("texture", 0)}, [image([1.5])], "plastic")
    assert e.code == "no_texture" and e.pointer == "/materials/0/eta"
    wide = {"alpha_x": ("texture", 0), "alpha_y": 0.1, "diffuse": 0.5}
    e = error(wide, [image([0.5])], "cook_torrance")
    assert e.pointer == "/materials/0/alpha_x"


def test_broken_images_are_refused() -> None:
    assert error({"albedo": ("texture", 0)}, [image([0.0, np.nan])]).code == "bad_texture"
