"""Parameter tables: what they list, and what is refused with which words."""

from __future__ import annotations

from typing import Any

import pytest

from matiere import _core

ROWS = {row["type"]: row for row in _core.materials()}
KINDS = {"scalar", "color", "bool", "enum", "metal", "material", "file", "list"}


def test_the_first_six_models_are_listed() -> None:
    assert {"lambert", "mirror", "conductor", "cook_torrance", "plastic", "dielectric"} <= set(ROWS)


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_every_row_is_complete(row: dict[str, Any]) -> None:
    assert row["doc"] and row["source"]
    names = [p["name"] for p in row["params"]]
    assert len(names) == len(set(names))
    for p in row["params"]:
        assert p["kind"] in KINDS and p["doc"], p
        assert (p["choices"] is not None) == (p["kind"] == "enum"), p
        if p["kind"] == "enum" and p["default"] is not None:
            assert p["default"] in p["choices"]
        if p["kind"] in ("scalar", "color") and p["default"] is not None:
            assert p["min"] <= p["default"] and (p["max"] is None or p["default"] <= p["max"])
    for rule in ("exclusive", "one_of", "together", "requires"):
        for group in row[rule]:
            assert set(group) <= set(names), (rule, group)


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_defaults_may_be_filled_in_without_changing_the_material(row: dict[str, Any]) -> None:
    needed: dict[str, Any] = {"eta": 0.5, "k": 2.0} if row["type"] == "conductor" else {}
    if row["type"] == "measured":
        pytest.skip("has no defaults, and needs a file")
    nested = [p["name"] for p in row["params"] if p["kind"] == "material" and p["required"]]
    needed |= {name: {"type": "lambert"} for name in nested}
    defaults = {p["name"]: p["default"] for p in row["params"] if p["default"] is not None}
    u = [[0.3, 0.4, 0.6]]
    wo = [[0.6, 0.0, 0.8]]
    plain = _core.Bsdf(row["type"], needed).sample(wo, u)
    filled = _core.Bsdf(row["type"], {**defaults, **needed}).sample(wo, u)
    assert (plain.wi == filled.wi).all() and (plain.weight == filled.weight).all()


BAD = [
    ("lambert", {"albedo": 1.5}, "out_of_range", "/albedo", "at most 1"),
    ("lambert", {"albedo": [0.5, -0.1, 0.5]}, "out_of_range", "/albedo", "at least 0"),
    ("lambert", {"albedo": float("nan")}, "out_of_range", "/albedo", "nan"),
    ("lambert", {"albedo": "red"}, "wrong_type", "/albedo", "number or [r, g, b]"),
    ("lambert", {"albedo": True}, "wrong_type", "/albedo", "number or [r, g, b]"),
    ("lambert", {"colour": 1.0}, "unknown_parameter", "/colour", "no parameter 'colour'"),
    ("varnish", {}, "unknown_material", "/type", "known are lambert"),
    ("mirror", {"F0": 0.5, "eta": 1.5}, "exclusive", "/eta", "only one of F0, eta"),
    ("mirror", {"fresnel": "fast"}, "bad_choice", "/fresnel", "schlick, exact"),
    ("conductor", {}, "missing", "", "one of metal, eta"),
    ("conductor", {"eta": 0.2}, "missing", "/eta", "together"),
    ("conductor", {"metal": "Au"}, "unresolved_metal", "/metal", "resolved"),
    ("conductor", {"eta": 1, "k": 3, "alpha": -0.1}, "out_of_range", "/alpha", "at least 0"),
    ("plastic", {"eta": 0.9}, "out_of_range", "/eta", "at least 1"),
    ("plastic", {"alpha": 0.1, "roughness": 0.3}, "exclusive", "/roughness", "only one of"),
    ("plastic", {"alpha_x": 0.1}, "missing", "/alpha_x", "alpha_x, alpha_y together"),
    ("dielectric", {"eta": 0.0}, "out_of_range", "/eta", "above 0"),
    ("dielectric", {"transmittance": 0.5}, "missing", "/transmittance", "at_distance"),
    (
        "dielectric",
        {"sigma_a": 1.0, "attenuation_per_metre": 0.5},
        "exclusive",
        "/attenuation_per_metre",
        "only one of",
    ),
    ("dielectric", {"sigma_a": float("inf")}, "out_of_range", "/sigma_a", "inf"),
    ("cook_torrance", {"F82_tint": 0.5}, "missing", "/F82_tint", "needs F0"),
    ("cook_torrance", {"k": 3.0}, "missing", "/k", "needs eta"),
]


@pytest.mark.parametrize(("kind", "params", "code", "pointer", "words"), BAD)
def test_bad_parameters_are_refused_with_their_place(
    kind: str, params: dict[str, Any], code: str, pointer: str, words: str
) -> None:
    with pytest.raises(_core.SceneError) as caught:
        _core.Bsdf(kind, params, "float", "/materials/x")
    assert caught.value.code == code, caught.value.message
    assert caught.value.pointer == "/materials/x" + pointer
    assert words in caught.value.message, caught.value.message


def test_none_means_not_given() -> None:
    assert _core.Bsdf("mirror", {"F0": 0.5, "eta": None}).lobes


def test_the_probe_refuses_arrays_of_the_wrong_shape() -> None:
    b = _core.Bsdf("lambert", {})
    with pytest.raises(ValueError, match="shape"):
        b.eval([[0.0, 1.0]], [[0.0, 1.0]])
    with pytest.raises(ValueError, match="rows"):
        b.eval([[0, 0, 1]] * 2, [[0, 0, 1]] * 3)
    with pytest.raises(ValueError, match="precision"):
        _core.Bsdf("lambert", {}, "half")
