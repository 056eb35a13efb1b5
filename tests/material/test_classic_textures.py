"""The classic lobes under textures: every texel is the material with that constant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from matiere import _core

POINT = {"n_g": (0.0, 0.0, 1.0), "n_s": (0.0, 0.0, 1.0), "dpdu": (1.0, 0.0, 0.0)}
WIDTHS = [0.0, 0.001, 0.03, 0.1, 0.37, 1.0]
CASES: list[tuple[str, str, list[float], dict[str, Any]]] = [
    ("oren_nayar", "roughness", WIDTHS, {"albedo": 1.0}),
    ("blinn_phong", "exponent", [0.0, 1.0, 10.0, 300.0, 1e4, 1e8], {"diffuse": 1.0}),
    ("ashikhmin_shirley", "nu", [0.0, 1.0, 100.0, 1e8], {"diffuse": 0.0, "F0": 0.5}),
    ("ashikhmin_shirley", "rotation_deg", [-90.0, 0.0, 45.0], {"diffuse": 1.0, "nu": 10}),
    ("ward", "alpha", WIDTHS, {"diffuse": 1.0, "specular": 0.3}),
    ("ward", "roughness", WIDTHS, {"diffuse": 1.0, "specular": 0.3}),
]
LAYERS: list[tuple[str, list[float]]] = [
    ("C", [0.0, 0.5, 1.0]),
    ("r", [0.0, 1e-3, 0.3, 0.5, 0.8, 1.0]),
    ("p", [1e-3, 0.1, 1.0]),
]


def table(kind: str, params: dict[str, Any], values: list[float] | None = None) -> Any:
    row = np.repeat(np.array([values or [0.0]], dtype=np.float32)[..., None], 3, axis=2)
    return _core.probe.Materials([{"type": kind, "params": params}], [row] if values else [])


def compare(kind: str, values: list[float], textured: Any, constant: Any) -> None:
    rng = np.random.default_rng(4)
    u = rng.random((4000, 3), dtype=np.float32)
    over = table(kind, textured, values)
    for k, x in enumerate(values):
        at = {**POINT, "uv": ((k + 0.5) / len(values), 0.5)}
        one = table(kind, constant(x))
        for degrees in (0.0, 60.0, 85.0):
            theta = np.radians(degrees)
            wo = (float(np.sin(theta)), 0.0, float(np.cos(theta)))
            _, weight, _, _ = over.sample(0, at, wo, u)
            _, exact, _, _ = one.sample(0, POINT, wo, u)
            # The same samples: their own noise drops out of the difference. Tables over a textured
            # width are interpolated between its rows.
            gap = float(weight.mean() - exact.mean())
            assert abs(gap) < 2e-3, (kind, x, degrees, gap)


@pytest.mark.parametrize(("kind", "name", "values", "more"), CASES)
def test_a_texture_is_its_constants(
    kind: str, name: str, values: list[float], more: dict[str, Any]
) -> None:
    compare(kind, values, {**more, name: ("texture", 0)}, lambda x: {**more, name: x})


@pytest.mark.parametrize(("name", "values"), LAYERS)
def test_a_texture_in_a_layer_is_its_constants(name: str, values: list[float]) -> None:
    base = {"C": 0.7, "r": 0.2, "p": 0.6}
    compare(
        "schlick", values, {"layers": [{**base, name: ("texture", 0)}]},
        lambda x: {"layers": [{**base, name: x}]},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "params", "pointer"),
    [
        ("ashikhmin_shirley", {"nu": ("texture", 0)}, "/nu"),
        ("ward", {"alpha_x": ("texture", 0), "alpha_y": 0.1}, "/alpha_x"),
        ("schlick", {"layers": [{"r": ("texture", 0)}, {}]}, "/layers/0/r"),
        ("blinn_phong", {"diffuse": ("texture", 0), "coupling": "add"}, "/diffuse"),
    ],
)
def test_what_a_table_or_a_sum_needs_takes_no_texture(
    kind: str, params: dict[str, Any], pointer: str
) -> None:
    with pytest.raises(_core.SceneError) as caught:
        table(kind, params, [0.1, 0.95])
    assert caught.value.pointer == "/materials/0" + pointer, caught.value.message
