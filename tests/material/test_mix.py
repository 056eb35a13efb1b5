"""Materials made of materials: `mix`, `null`, and opacity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import matiere as mt
from matiere import _core

RED = {"type": "lambert", "albedo": [1, 0, 0]}
GREEN = {"type": "lambert", "albedo": [0, 1, 0]}
UP = {"n_g": (0.0, 0.0, 1.0), "n_s": (0.0, 0.0, 1.0)}
WO = (0.6, 0.0, 0.8)
RNG = np.random.default_rng(4)
WI = np.array([0.0, 0.6, 0.8])
NULL = 4 | 16 | 32


@pytest.mark.parametrize("weight", [0.0, 0.25, 1.0])
def test_a_mix_is_the_weighted_sum_of_its_parts(weight: float) -> None:
    gold = {"type": "conductor", "metal": "Au", "alpha": 0.3}
    mix = mt.bsdf({"type": "mix", "a": RED, "b": gold, "weight": weight}, precision="double")
    parts = [mt.bsdf(m, precision="double") for m in (RED, gold)]
    for part in ("eval", "pdf"):
        a, b = (getattr(p, part)(WO, WI) for p in parts)
        assert getattr(mix, part)(WO, WI) == pytest.approx((1 - weight) * a + weight * b)


def test_the_limits_of_a_mix_are_its_parts_alone() -> None:
    u = RNG.random((1000, 3))
    mirror = {"type": "mirror"}
    assert mt.bsdf({"type": "mix", "a": RED, "b": mirror, "weight": 1}).lobes == 4 | 8
    assert mt.bsdf({"type": "mix", "a": RED, "b": mirror, "weight": 0}).lobes == 1 | 8
    for weight, part in ((0, RED), (1, mirror)):
        mixed = mt.bsdf({"type": "mix", "a": RED, "b": mirror, "weight": weight}).sample(WO, u)
        alone = mt.bsdf(part).sample(WO, u)
        assert np.array_equal(mixed.wi, alone.wi) and np.allclose(mixed.weight, alone.weight)


def test_null_goes_straight_through() -> None:
    s = mt.bsdf({"type": "null"}).sample(WO, RNG.random((10, 3)))
    assert np.allclose(s.wi, -np.array(WO)) and (s.weight == 1).all() and (s.lobe == NULL).all()


def table(material: dict[str, Any], *textures: Any, **more: Any) -> Any:
    params = {k: v for k, v in material.items() if k != "type"}
    kind = material["type"]
    return _core.probe.Materials([{"type": kind, "params": params, **more}], textures, "clamp")


def test_a_texture_weighs_the_parts_at_each_point() -> None:
    pixels = np.array([[[0, 0, 0], [1, 1, 1]]], np.float32)  # left half a, right half b
    t = table({"type": "mix", "a": RED, "b": GREEN, "weight": ("texture", 0)}, pixels)
    for u, expected in ((0.1, [1, 0, 0]), (0.5, [0.5, 0.5, 0]), (0.9, [0, 1, 0])):
        f, _ = t.eval(0, {**UP, "uv": (u, 0.5)}, WO, np.array([WI], np.float32))
        assert f[0] * np.pi / 0.8 == pytest.approx(expected, abs=1e-6)


def test_textures_of_nested_materials_are_looked_up() -> None:
    pixels = np.array([[[0.2, 0.2, 0.2], [0.8, 0.8, 0.8]]], np.float32)
    inner = {"type": "lambert", "albedo": ("texture", 0)}
    nest = {"type": "mix", "a": inner, "b": {"type": "mix", "a": inner, "b": RED, "weight": 0.0}}
    t = table(nest, pixels)
    for u, albedo in ((0.1, 0.2), (0.9, 0.8)):
        f, _ = t.eval(0, {**UP, "uv": (u, 0.5)}, WO, np.array([WI], np.float32))
        assert f[0] * np.pi / 0.8 == pytest.approx([albedo] * 3, rel=1e-5)


@pytest.mark.parametrize("opacity", [0.0, 0.25, 1.0])
def test_opacity_lets_the_rest_pass(opacity: float) -> None:
    t = table(RED, opacity=opacity)
    assert t.record(0)["passes"] == (opacity < 1)
    assert t.pass_through(0, 0.5, 0.5) == pytest.approx(1 - opacity)
    f, pdf = t.eval(0, UP, WO, np.array([WI], np.float32))
    assert f[0, 0] == pytest.approx(opacity * 0.8 / np.pi)
    assert pdf[0] == pytest.approx(opacity * 0.8 / np.pi)
    wi, weight, _, _ = t.sample(0, UP, WO, RNG.random((20_000, 3)).astype(np.float32))
    through = np.isclose(wi, -np.array(WO), atol=1e-7).all(axis=1)
    assert through.mean() == pytest.approx(1 - opacity, abs=0.02)
    assert (weight[through] == 1).all() and np.allclose(weight[~through], [1, 0, 0])


def test_null_parts_and_opacity_multiply() -> None:
    t = table({"type": "mix", "a": {"type": "null"}, "b": RED, "weight": 0.5}, opacity=0.5)
    assert t.pass_through(0, 0.5, 0.5) == pytest.approx(0.75)
    assert t.record(0)["passes"]
    assert not table(RED).record(0)["passes"]


def test_opacity_thins_emission() -> None:
    t = table(RED, opacity=0.25, emission=8.0)
    assert t.emission(0, 0.5, 0.5) == pytest.approx([2, 2, 2])


BAD: list[tuple[dict[str, Any], str, str]] = [
    ({"type": "mix", "a": RED}, "missing_key", "/b"),
    ({"type": "mix", "a": RED, "b": {"type": "lambart"}}, "unknown_type", "/b/type"),
    ({"type": "mix", "a": RED, "b": {"type": "lambert", "albedo": 2}}, "out_of_range", "/b/albedo"),
    ({"type": "mix", "a": RED, "b": 3}, "wrong_type", "/b"),
    ({"type": "mix", "a": RED, "b": {**RED, "opacity": 0.5}}, "unsupported", "/b/opacity"),
    ({"type": "mix", "a": RED, "b": RED, "weight": 1.5}, "out_of_range", "/weight"),
    ({**RED, "opacity": -0.1}, "out_of_range", "/opacity"),
]


@pytest.mark.parametrize(("material", "code", "at"), BAD, ids=[b[2] + " " + b[1] for b in BAD])
def test_faults_of_nested_materials_have_their_place(
    material: dict[str, Any], code: str, at: str
) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.bsdf(material)
    assert [(f.code, f.pointer) for f in caught.value.faults] == [(code, at)]


def test_the_core_refuses_what_it_cannot_nest() -> None:
    glass = {"type": "dielectric"}
    with pytest.raises(_core.SceneError) as caught:
        _core.Bsdf("mix", {"a": glass, "b": glass}, pointer="/m")
    assert caught.value.pointer == "/m" and "bound a medium" in str(caught.value)
    deep: dict[str, Any] = RED
    for _ in range(5):
        deep = {"type": "mix", "a": deep, "b": RED}
    with pytest.raises(_core.SceneError) as caught:
        _core.Bsdf("mix", {k: v for k, v in deep.items() if k != "type"})
    assert caught.value.code == "too_many"
    with pytest.raises(_core.SceneError) as caught:
        _core.Bsdf("mix", {"a": RED, "b": {"type": "lambert", "albedo": 2.0}}, pointer="/m")
    assert caught.value.pointer == "/m/b/albedo"
