"""Materials in the world: sides, shading normals, what is rejected and counted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from matiere import _core

UP = (0.0, 0.0, 1.0)
RNG = np.random.default_rng(11)
U = RNG.random((4000, 3), dtype=np.float32)


def sphere_directions(n: int = 4000) -> np.ndarray:
    w = RNG.normal(size=(n, 3))
    return (w / np.linalg.norm(w, axis=1, keepdims=True)).astype(np.float32)


def unit(*v: float) -> tuple[float, float, float]:
    n = np.array(v) / np.linalg.norm(v)
    return float(n[0]), float(n[1]), float(n[2])


def table(kind: str, params: dict[str, Any], **more: Any) -> Any:
    return _core.probe.Materials([{"type": kind, "params": params, **more}])


def point(n_g: Any = UP, n_s: Any = UP, **more: Any) -> dict[str, Any]:
    return {"n_g": n_g, "n_s": n_s, **more}


def test_a_rotated_surface_scatters_like_a_level_one() -> None:
    n = unit(0.3, -0.5, 0.8)
    t = table("cook_torrance", {"F0": 0.5, "alpha": 0.3})
    local = _core.Bsdf("cook_torrance", {"F0": 0.5, "alpha": 0.3})
    wo = unit(0.2, 0.1, 0.9)
    wi = sphere_directions()
    f, pdf = t.eval(0, point(n, n), wo, wi)
    cos_o, cos_i = np.dot(wo, n), wi @ np.array(n)
    # An isotropic lobe depends on the two cosines and the angle between the directions.
    between = wi @ np.array(wo)
    sin_o, sin_i = np.sqrt(1 - cos_o**2), np.sqrt(np.maximum(1 - cos_i**2, 1e-12))
    cos_phi = np.clip((between - cos_o * cos_i) / (sin_o * sin_i), -1, 1)
    flat_i = np.stack([sin_i * cos_phi, sin_i * np.sqrt(1 - cos_phi**2), cos_i], axis=1)
    expected = local.eval((sin_o, 0.0, cos_o), flat_i)
    assert f == pytest.approx(expected, rel=2e-3, abs=1e-5)
    assert pdf == pytest.approx(local.pdf((sin_o, 0.0, cos_o), flat_i), rel=2e-3, abs=1e-5)


def test_opaque_surfaces_scatter_on_both_sides_unless_told_otherwise() -> None:
    below = unit(0.1, 0.2, -0.9)
    wi = sphere_directions()
    both = table("lambert", {"albedo": 1.0})
    f, _ = both.eval(0, point(), below, wi)
    assert (f[wi[:, 2] < 0] > 0).all() and not f[wi[:, 2] > 0].any()
    one = table("lambert", {"albedo": 1.0}, two_sided=False)
    f, pdf = one.eval(0, point(), below, wi)
    assert not f.any() and not pdf.any()
    _, _, pdf, rejected = one.sample(0, point(), below, U)
    assert not pdf.any() and not any(rejected.values())
    f, _ = one.eval(0, point(), unit(0.1, 0.2, 0.9), wi)
    assert (f[wi[:, 2] > 0] > 0).all()


@pytest.mark.parametrize(
    ("kind", "params"),
    [
        ("lambert", {"albedo": 1.0}),
        ("cook_torrance", {"F0": 1.0, "alpha": 0.4}),
        ("plastic", {"albedo": 0.8, "alpha": 0.2}),
        ("dielectric", {"eta": 1.5, "alpha": 0.4}),
    ],
)
def test_no_light_leaks_where_normals_disagree(kind: str, params: dict[str, Any]) -> None:
    n_g, n_s = np.array(UP), np.array(unit(0.6, 0.0, 0.8))
    t = table(kind, params)
    wo = unit(-0.2, 0.3, 0.7)
    wi = sphere_directions()
    f, pdf = t.eval(0, point(UP, tuple(n_s)), wo, wi, eta_rel=1.5)
    disagree = (wi @ n_g) * (wi @ n_s) < 0
    assert disagree.sum() > 100
    assert not f[disagree].any() and not pdf[disagree].any()
    wi, weight, pdf, rejected = t.sample(0, point(UP, tuple(n_s)), wo, U, eta_rel=1.5)
    kept = pdf > 0
    assert ((wi[kept] @ n_g) * (wi[kept] @ n_s) > 0).all()
    assert rejected["side_mismatch"] > 0
    assert rejected["non_finite_sample"] == 0
    assert (weight[kept] <= 1.6).all()


def test_samples_agree_with_eval_in_the_world() -> None:
    n_s = unit(0.3, 0.1, 0.9)
    t = table("plastic", {"albedo": [0.9, 0.4, 0.1], "alpha": 0.3})
    wo = unit(0.4, -0.3, 0.8)
    wi, weight, pdf, _ = t.sample(0, point(UP, n_s), wo, U)
    kept = pdf > 0
    f, again = t.eval(0, point(UP, n_s), wo, wi[kept])
    assert again == pytest.approx(pdf[kept], rel=2e-3)
    assert f / again[:, None] == pytest.approx(weight[kept], rel=1e-3)


def test_a_shading_normal_turned_away_from_the_viewer_still_scatters() -> None:
    # Silhouettes of coarse meshes: the viewer is above the surface, below the shading horizon.
    wo = unit(-0.95, 0.0, 0.3)
    n_s = unit(0.7, 0.0, 0.7)
    assert np.dot(wo, n_s) < 0 < wo[2]
    t = table("lambert", {"albedo": 1.0})
    _, weight, pdf, _ = t.sample(0, point(UP, n_s), wo, U)
    assert (pdf > 0).mean() > 0.5 and np.allclose(weight[pdf > 0], 1, atol=1e-6)


def test_the_tangent_turns_an_anisotropic_lobe() -> None:
    t = table("cook_torrance", {"F0": 1.0, "alpha_x": 0.02, "alpha_y": 0.6})
    for tangent, wide in (((1.0, 0.0, 0.0), 1), ((0.0, 1.0, 0.0), 0), ((0.0, 5.0, 0.3), 0)):
        wi, _, pdf, _ = t.sample(0, point(dpdu=tangent), UP, U)
        spread = np.median(np.abs(wi[pdf > 0]), axis=0)
        assert spread[wide] > 10 * spread[1 - wide], (tangent, spread)


def test_the_relative_index_of_the_hit_decides() -> None:
    t = table("dielectric", {"eta": 1.5})
    wo = unit(0.5, 0.0, 0.8)
    # Water outside: 1.5 / 1.33; and media that match: nothing happens.
    wi, weight, pdf, _ = t.sample(0, point(), wo, U, eta_rel=1.5 / 1.33)
    through = wi[:, 2] < 0
    assert through.any()
    assert np.allclose(wi[through][:, 0], -wo[0] / (1.5 / 1.33), atol=1e-6)
    assert np.allclose(weight[through], (1.33 / 1.5) ** 2, rtol=1e-5)
    wi, weight, pdf, _ = t.sample(0, point(), wo, U, eta_rel=1.0)
    assert np.allclose(wi, -np.array(wo), atol=1e-6) and (pdf == 1).all() and (weight == 1).all()


def test_records_tell_what_the_integrator_needs() -> None:
    glass = table("dielectric", {"eta": 1.4, "sigma_a": [1.0, 2.0, 3.0]}).record(0)
    assert glass["has_interior"] and glass["delta_only"]
    assert glass["eta_interior"] == pytest.approx((1.4, 1.4, 1.4))
    assert glass["sigma_a"] == pytest.approx((1, 2, 3))
    wall = table("lambert", {"albedo": 0.5}, emission=[1.0, 2.0, 3.0]).record(0)
    assert wall["emissive"] and not wall["delta_only"] and not wall["has_interior"]
    assert not table("plastic", {"alpha": 0.0}).record(0)["delta_only"]
    assert table("mirror", {}).record(0)["delta_only"]
    assert table("conductor", {"eta": 0.2, "k": 3.0, "alpha": 0.0}).record(0)["delta_only"]
    assert not table("conductor", {"eta": 0.2, "k": 3.0, "alpha": 0.1}).record(0)["delta_only"]
