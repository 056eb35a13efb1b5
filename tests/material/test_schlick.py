"""Schlick's model of 1994: its parts, its list of layers, its energy, and 50 digits."""

from __future__ import annotations

from typing import Any

import facet_quadrature
import numpy as np
import oracle
import oracle_models
import pytest
from extremes import direction
from mpmath import mpf, pi, sqrt
from oracle_check import check_model, directions, f32, judge_table
from pydantic import ValidationError

import matiere as mt
from matiere import _core
from matiere.scene.materials import check_material

DEGREES = [0, 30, 60, 75, 85, 89]


def layer(C: Any = 1.0, r: float = 0.1, p: float = 1.0) -> dict[str, Any]:
    return {"C": C, "r": r, "p": p}


def schlick(*layers: dict[str, Any], precision: str = "double", variant: str = "ggx") -> Any:
    return _core.Bsdf("schlick", {"layers": list(layers), "variant": variant}, precision)


def at(degrees: list[float], azimuth: float = 0.3) -> np.ndarray:
    return np.array([direction(d, azimuth) for d in degrees])


def test_r_zero_is_a_mirror_and_r_one_diffuse() -> None:
    wo, wi = at([0, 40, 80]), at([70, 20, 50], 1.0)
    mirror = schlick(layer(0.3, 0.0))
    s = mirror.sample(wo, [[0.4, 0.4, 0.4]])
    c = wo[:, 2]
    assert mirror.lobes == 4 | 8 and (s.lobe == 4 | 8).all()
    assert s.weight[:, 0] == pytest.approx(0.3 + 0.7 * (1 - c) ** 5)
    diffuse = schlick(layer(1.0, 1.0))
    assert diffuse.eval(wo, wi)[:, 0] == pytest.approx(wi[:, 2] / np.pi)
    assert diffuse.pdf(wo, wi) == pytest.approx(wi[:, 2] / np.pi)


@pytest.mark.parametrize("r", [0.01, 0.1, 0.3, 0.5])
def test_the_glossy_part_is_ggx(r: float) -> None:
    wo, wi = at([10, 40, 70]), at([20, 45, 60], 2.8)
    ggx = _core.Bsdf("cook_torrance", {"F0": 1.0, "alpha": r**0.5}, "double")
    got = schlick(layer(1.0, r)).eval(wo, wi)[:, 0]
    assert got == pytest.approx(4 * r * (1 - r) * ggx.eval(wo, wi)[:, 0], rel=1e-6)


def test_isotropy_is_elliptic_ggx_along_the_tangent() -> None:
    wo, wi = at([10, 40, 70], 0.2), at([20, 45, 60], 2.8)
    r, p = 0.3, 0.4
    widths = {"alpha_x": (r * p) ** 0.5, "alpha_y": (r / p) ** 0.5}
    ggx = _core.Bsdf("cook_torrance", {"F0": 1.0, **widths}, "double")
    got = schlick(layer(1.0, r, p)).eval(wo, wi)[:, 0]
    assert got == pytest.approx(4 * r * (1 - r) * ggx.eval(wo, wi)[:, 0], rel=1e-6)


def test_the_published_form_has_the_published_albedo() -> None:
    # Specification, section 2: albedo of the bounded form by quadrature, and the largest weights.
    u = np.random.default_rng(2).random((400_000, 3))
    for r, p, degrees, expected, most in ((0.3, 0.2, 50, 0.514, 2.9), (0.1, 0.5, 70, 0.7647, 6.7)):
        b = schlick(layer(1.0, r, p), variant="schlick94")
        g = 4 * r * (1 - r)
        # 0.5 from the axis along which the highlight is stretched.
        s = b.sample(at([degrees], np.pi / 2 - 0.5), u)
        weight = np.where((s.lobe & 4) == 0, s.weight[:, 0], 0)
        assert weight.mean() / g == pytest.approx(expected, abs=2e-3), (r, p)
        assert weight.max() < most + 0.05


@pytest.mark.parametrize("variant", ["ggx", "schlick94"])
@pytest.mark.parametrize("r", [0.0, 0.005, 0.1, 0.3, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("p", [1.0, 0.1, 1e-3])
def test_one_layer_never_gains(variant: str, r: float, p: float) -> None:
    b = schlick(layer(1.0, r, p), variant=variant)
    got = b.albedo(at([*DEGREES, 89.9]), n=1 << 14)
    assert (got <= 1 + 1e-3).all(), got


TWO = [
    (layer(0.04, 0.0), layer(1.0, 1.0)),
    (layer(0.04, 0.1), layer(1.0, 1.0)),
    (layer(0.5, 0.3, 0.1), layer(1.0, 0.0)),
    (layer([0.9, 0.1, 0.0], 0.7), layer(1.0, 0.2, 0.3)),
]


@pytest.mark.parametrize("layers", TWO)
def test_two_layers_never_gain_but_in_the_published_form(layers: Any) -> None:
    views = at([*DEGREES, 89.9])
    got = schlick(*layers).albedo(views, n=1 << 15)
    assert (got <= 1 + 1e-3).all(), got
    published = schlick(*layers, variant="schlick94").albedo(views, n=1 << 15)
    print(layers, "ggx", got.max(), "schlick94", published.max())


def test_the_published_second_layer_gains() -> None:
    published = schlick(*TWO[0], variant="schlick94").albedo(at([85]), n=1 << 14)
    assert published.max() > 1.4


def test_a_layer_that_reflects_everything_hides_the_other() -> None:
    wo, wi = at([10, 40, 70]), at([20, 45, 60], 2.8)
    over = schlick(layer(1.0, 0.2), layer(1.0, 1.0))
    alone = schlick(layer(1.0, 0.2))
    assert (over.eval(wo, wi) == alone.eval(wo, wi)).all()


def error(params: dict[str, Any]) -> Any:
    with pytest.raises(_core.SceneError) as caught:
        _core.Bsdf("schlick", params, "float", "/materials/x")
    return caught.value


def test_layers_are_checked_with_their_place() -> None:
    e = error({"layers": [layer(), layer(p=0.0)]})
    assert (e.code, e.pointer) == ("out_of_range", "/materials/x/layers/1/p")
    assert "lobe without density" in e.message
    e = error({"layers": []})
    assert e.pointer == "/materials/x/layers" and "at least 1" in e.message
    assert error({"layers": 3.0}).code == "wrong_type"
    assert error({"layers": [{"q": 1.0}]}).pointer == "/materials/x/layers/0/q"


@pytest.mark.parametrize(
    ("layers", "place", "words"),
    [
        ([{"C": 0.5, "r": 0.2, "p": 0}], ("layers", 0, "p"), "lobe without density"),
        ([{"r": 0.2}, {"r": 2}], ("layers", 1, "r"), "at most 1"),
        ([{"rr": 0.2}], ("layers", 0, "rr"), "did you mean 'r'"),
        ([], ("layers",), "1 to 2 objects"),
        ([{}, {}, {}], ("layers",), "1 to 2 objects"),
        (0.5, ("layers",), "a list of objects"),
        ([0.5], ("layers", 0), "an object"),
    ],
)
def test_scenes_are_told_where_a_layer_is_wrong(layers: Any, place: Any, words: str) -> None:
    with pytest.raises(ValidationError) as caught:
        check_material({"type": "schlick", "layers": layers})
    (found,) = caught.value.errors()
    assert found["loc"] == place and words in found["msg"], found


def test_layers_come_through_json_as_they_are() -> None:
    wo, wi = at([10, 40]), at([20, 45], 2.8)
    made = mt.bsdf({"type": "schlick", "layers": [layer(0.2, 0.3), {}]}, precision="double")
    same = schlick(layer(0.2, 0.3), layer(0.5, 0.1, 1.0))
    assert (made.eval(wo, wi) == same.eval(wo, wi)).all()
    default = mt.bsdf({"type": "schlick"}, precision="double")
    assert (default.eval(wo, wi) == schlick(layer(0.5)).eval(wo, wi)).all()


def model(p: dict[str, Any]) -> Any:
    """f cos of one layer, without the mirror, and the density of its samples."""
    C, r, iso = mpf(p["C"]), mpf(p["r"]), mpf(p["p"])
    g = 4 * r * (1 - r)
    diffuse = 1 - g if p["r"] >= 0.5 else mpf(0)
    ax, ay = sqrt(r * iso), sqrt(r / iso)
    facets = {"alpha_x": ax, "alpha_y": ay, "distribution": "ggx", "masking": "smith"}
    ggx = oracle_models.facets(facets, lambda c: mpf(1))

    def published(o: Any, i: Any, h: Any, u: Any) -> tuple[Any, Any]:
        s2 = h[0] ** 2 + h[1] ** 2
        w2 = h[0] ** 2 / s2
        Z = r / (1 + r * h[2] ** 2 - h[2] ** 2) ** 2
        A = sqrt(iso / (iso**2 * (1 - w2) + w2))

        def mask(v: Any) -> Any:
            smith = 2 * v / (v + sqrt(r * (1 - v * v) + v * v))
            return min(v / (r - r * v + v), smith)

        return Z * A * mask(o[2]) * mask(i[2]) / (4 * pi * o[2]), Z * h[2] * A**2 / (4 * pi * u)

    def both(*x: Any) -> tuple[Any, Any]:
        o, i = oracle_models.split(x)
        h = oracle.vector_sum(o, i, 1)
        u = oracle.dot(o, h)
        glossy, pdf = ggx(*x) if p["variant"] == "ggx" else published(o, i, h, u)
        value = diffuse * i[2] / pi + g * glossy
        return oracle.fresnel_schlick(u, C) * value, diffuse * i[2] / pi + g * pdf

    return both


@pytest.mark.parametrize("variant", ["ggx", "schlick94"])
@pytest.mark.parametrize("r", [1e-10, 1e-6, 1e-3, 0.1, 0.4999, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("p", [1.0, 0.1, 1e-4, 1e-8])
@pytest.mark.parametrize("C", [0.0, 0.5])
def test_schlick_matches_fifty_digits(variant: str, r: float, p: float, C: float) -> None:
    par = {"variant": variant, "r": f32(r), "p": f32(p), "C": f32(C)}
    if variant == "ggx" and (par["r"] * par["p"]) ** 0.5 < 3e-6:
        return  # one width is at the smallest that float carries
    b = schlick(layer(par["C"], par["r"], par["p"]), precision="float", variant=variant)
    check_model(b, model(par), par)


def two_layers(p: dict[str, Any], q: dict[str, Any]) -> Any:
    """The published form of a layer over another: the light that S of the upper leaves."""
    upper, lower = model(p), model(q)
    C, below, least = mpf(p["C"]), mpf(q["C"]), mpf(1) / 21

    def both(*x: Any) -> tuple[Any, Any]:
        o, i = oracle_models.split(x)
        left = (1 - C) * (1 - (1 - oracle.dot(o, oracle.vector_sum(o, i, 1))) ** 5)
        rise = (1 - o[2]) ** 5
        s, t = (c + (1 - c) * max(rise, least) for c in (C, below))
        t *= max(1 - rise, least) * (1 - C)
        (f, pdf), (f_below, pdf_below) = upper(*x), lower(*x)
        return f + left * f_below, (s * pdf + t * pdf_below) / (s + t)

    return both


@pytest.mark.parametrize("r", [1e-6, 0.1, 0.4999, 0.9])
@pytest.mark.parametrize("below", [(1e-3, 1.0), (0.3, 0.1), (1.0, 1.0)])
@pytest.mark.parametrize("C", [0.0, 0.04, 0.999])
def test_two_layers_match_fifty_digits(r: float, below: tuple[float, float], C: float) -> None:
    p = {"variant": "schlick94", "r": f32(r), "p": f32(0.7), "C": f32(C)}
    q = {"variant": "schlick94", "r": f32(below[0]), "p": f32(below[1]), "C": f32(0.8)}
    layers = [layer(x["C"], x["r"], x["p"]) for x in (p, q)]
    check_model(schlick(*layers, precision="float", variant="schlick94"), two_layers(p, q), (p, q))


@pytest.mark.parametrize(
    "layers", [pytest.param(x, marks=[pytest.mark.slow] * (x[0]["p"] < 1)) for x in TWO]
)
def test_a_second_layer_gets_what_the_first_leaves_by_quadrature(layers: Any) -> None:
    both = schlick(*layers, precision="float")
    upper, lower = (schlick(x) for x in layers)
    C, r, iso = (float(np.ravel(layers[0][key])[0]) for key in ("C", "r", "p"))
    ax, ay = max(r * iso, 1e-8) ** 0.5, max(r / iso, 1e-8) ** 0.5
    mirror = 1 - 4 * r * (1 - r) if r < 0.5 else 0.0

    def E(w: np.ndarray) -> float:
        w = w.astype(float) / np.linalg.norm(w.astype(float))
        glossy = facet_quadrature.albedo(upper, w, ax, ay) if r > 0 else 0.0
        return glossy + mirror * (C + (1 - C) * (1 - w[2]) ** 5)

    for o, i in directions():
        h = (o + i).astype(float)
        u = float(o @ h / np.linalg.norm(h))
        left = min((1 - C) * (1 - (1 - u) ** 5), 1 - max(E(o), E(i)))
        exact = upper.eval(o, i)[0, 0] + left * lower.eval(o, i)[0, 0]
        judge_table(both.eval(o, i)[0, 0], exact, i[2] / np.pi, (layers, o, i))


def scene(layers: Any) -> dict[str, Any]:
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 0, 5], "target": [0, 0, 0], "vfov_deg": 30},
        "film": {"width": 8, "height": 8},
        "materials": {"ball": {"type": "schlick", "layers": layers}},
        "shapes": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "ball"}],
        "environment": {"radiance": 1},
    }


def test_a_scene_names_textures_inside_layers() -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene([{"r": 0.2}, {"C": {"texture": "wood"}}]))
    (fault,) = caught.value.faults
    assert fault.code == "unknown_texture"
    assert fault.pointer == "/materials/ball/layers/1/C/texture"


def test_defaults_of_layers_do_not_change_the_digest() -> None:
    written = mt.load(scene([{"C": 0.5, "r": 0.1, "p": 1}])).digest
    assert mt.load(scene([{"C": [0.5, 0.5, 0.5], "r": 0.1}])).digest == written
    assert mt.load(scene([{"C": 0.5, "r": 0.2}])).digest != written
