"""The public probe: shapes, precisions, lobe flags, and words for what is wrong."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import matiere as mt

GLASS = {"type": "dielectric", "eta": 1.5, "alpha": 0.2}
UP = [0.0, 0.0, 1.0]
TILTED = np.array([[0.6, 0.0, 0.8]], dtype=np.float32)
U = np.random.default_rng(1).random((500, 3), dtype=np.float32)


@pytest.mark.parametrize(("precision", "kind"), [("float", np.float32), ("double", np.float64)])
def test_shapes_and_types(precision: str, kind: Any) -> None:
    b = mt.bsdf(GLASS, precision=precision)
    s = b.sample(TILTED, U)
    assert isinstance(s, mt.BsdfSample)
    assert s._fields == ("wi", "weight", "pdf", "lobe", "eta")
    for part, shape in zip(s, ((500, 3), (500, 3), (500,), (500,), (500,)), strict=True):
        assert part.shape == shape
    assert s.lobe.dtype == np.uint32
    assert {a.dtype for a in (s.wi, s.weight, s.pdf, s.eta)} == {np.dtype(kind)}
    wi = s.wi[s.lobe != 0]
    assert b.eval(TILTED, wi).shape == wi.shape and b.pdf(TILTED, wi).shape == wi.shape[:1]
    assert b.eval(wi, TILTED).shape == wi.shape
    assert b.albedo([UP, TILTED[0]], n=64).shape == (2, 3)
    assert b.precision == precision


def test_the_issues_example_runs() -> None:
    b = mt.bsdf({"type": "cook_torrance", "distribution": "beckmann", "alpha": 0.2,
                 "F0": [1, 1, 1]})  # fmt: skip
    assert b.lobes == mt.Lobe.GLOSSY | mt.Lobe.REFLECTION
    assert (b.albedo(UP) < 1 + 1e-6).all() and (b.albedo(UP) > 0.9).all()


def test_flags_and_eta_tell_what_happened() -> None:
    s = mt.bsdf(GLASS).sample(TILTED, U)
    through = (s.lobe & mt.Lobe.TRANSMISSION) != 0
    reflected = (s.lobe & mt.Lobe.REFLECTION) != 0
    assert through.any() and reflected.any() and not (through & reflected).any()
    assert (s.wi[through, 2] < 0).all() and (s.wi[reflected, 2] > 0).all()
    assert (s.eta[through] == 1.5).all() and (s.eta[reflected] == 1).all()
    below = mt.bsdf(GLASS).sample(-TILTED, U)
    assert below.eta[(below.lobe & mt.Lobe.TRANSMISSION) != 0] == pytest.approx(1 / 1.5)


def test_a_rejected_row_is_all_zero() -> None:
    s = mt.bsdf({"type": "cook_torrance", "masking": "v_cavity", "alpha": 1.0}).sample(UP, U)
    nothing = s.lobe == 0
    assert nothing.any()
    assert not s.pdf[nothing].any() and not s.weight[nothing].any() and not s.wi[nothing].any()


def test_single_rows_broadcast_and_lists_do() -> None:
    b = mt.bsdf({"type": "lambert", "albedo": 0.5})
    many = np.tile(TILTED, (4, 1))
    assert (b.eval(UP, many) == b.eval([UP] * 4, many)).all()
    assert b.eval(UP, [0, 0, 1])[0] == pytest.approx([0.5 / np.pi] * 3)
    assert b.eval(UP, np.zeros((0, 3))).shape == (0, 3)


def test_numbers_just_below_one_stay_below_it() -> None:
    almost = np.full((1, 3), 1 - 1e-12)  # rounds to 1 in float
    s = mt.bsdf({"type": "lambert"}).sample(UP, almost)
    assert np.isfinite(s.wi).all() and s.lobe[0] != 0


NAN = float("nan")
WRONG: list[tuple[str, Any, str, str]] = [
    ("wo", np.zeros((2, 2)), "/wo", "shape"),
    ("wo", np.zeros((2, 3, 1)), "/wo", "shape"),
    ("wo", "up", "/wo", "real numbers"),
    ("wo", [[0, 0, 1], [0, 1]], "/wo", "real numbers"),
    ("wo", [UP, [0, NAN, 1]], "/wo/1", "finite"),
    ("wo", [UP, UP, [0, 0, 2]], "/wo/2", "length 1"),
    ("wi", [[0, 0, 0]], "/wi/0", "length 1"),
    ("wi", [[0, 0, float("inf")]], "/wi/0", "finite"),
    ("u", [[0.5, 0.5]], "/u", "shape"),
    ("u", [[0.5, 0.5, 1.0]], "/u/0", r"\[0, 1\)"),
    ("u", [[0.5, -0.1, 0.5]], "/u/0", r"\[0, 1\)"),
    ("u", [[0.5, NAN, 0.5]], "/u/0", r"\[0, 1\)"),
]


@pytest.mark.parametrize(("name", "value", "pointer", "words"), WRONG)
def test_bad_arrays_are_named(name: str, value: Any, pointer: str, words: str) -> None:
    b = mt.bsdf(GLASS)
    calls = {
        "wo": [lambda: b.eval(value, UP), lambda: b.pdf(value, UP), lambda: b.albedo(value),
               lambda: b.sample(value, U[:1])],
        "wi": [lambda: b.eval(UP, value), lambda: b.pdf(UP, value)],
        "u": [lambda: b.sample(UP, value)],
    }  # fmt: skip
    for call in calls[name]:
        with pytest.raises(mt.ProbeError, match=words) as caught:
            call()
        assert caught.value.pointer == pointer


def test_unequal_rows_and_counts_are_named() -> None:
    b = mt.bsdf(GLASS)
    with pytest.raises(mt.ProbeError, match="3 rows and wi 2") as caught:
        b.eval([UP] * 3, [UP] * 2)
    assert caught.value.pointer == "/wi"
    with pytest.raises(mt.ProbeError, match="n must be"):
        b.albedo(UP, n=0)
    with pytest.raises(ValueError, match="precision"):
        mt.bsdf(GLASS, precision="half")


def test_bad_materials_carry_pointers() -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.bsdf({"type": "dielectric", "eta": -1.0, "alpha": 2.0})
    assert [e["pointer"] for e in caught.value.errors] == ["/eta", "/alpha"]
    with pytest.raises(mt.SceneValidationError, match="no textures"):
        mt.bsdf({"type": "lambert", "albedo": {"texture": "wood"}})


def test_double_and_float_are_the_same_formula() -> None:
    a, b = (mt.bsdf(GLASS, precision=p) for p in ("float", "double"))
    wi = a.sample(TILTED, U).wi
    wi = wi[np.abs(wi).sum(axis=1) > 0]
    assert a.eval(TILTED, wi) == pytest.approx(b.eval(TILTED, wi), rel=1e-4, abs=1e-6)


def test_params_tell_defaults_and_the_repr_is_readable() -> None:
    b = mt.bsdf(GLASS)
    assert b.type == "dielectric" and b.params["eta"] == (1.5, 1.5, 1.5)
    assert "emission" not in b.params and b.params["distribution"] == "ggx"
    assert "dielectric" in repr(b) and "float" in repr(b)


def test_the_material_list_is_whole_plain_and_a_copy() -> None:
    rows = mt.materials()
    json.dumps(rows)
    for row in rows:
        assert row["doc"] and row["source"]
        for p in row["params"]:
            kinds = ("scalar", "color", "bool", "enum", "metal", "material", "file", "list")
            assert p["doc"] and p["kind"] in kinds, p
    rows[0]["params"].clear()
    assert mt.materials()[0]["params"]


@pytest.mark.parametrize("name", ["eval", "pdf", "sample", "albedo"])
def test_methods_say_shapes_and_errors(name: str) -> None:
    doc = getattr(mt.Bsdf, name).__doc__
    assert "(N," in doc and "ProbeError" in doc
