"""Real materials: stiff ones pass, limits are told, the chart keeps up with any lobe."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import matiere as mt
from matiere.stability.charts import Chart, Region, regions
from matiere.stability.measures import direction
from matiere.stability.views import Effort, look

STIFF: list[dict[str, Any]] = [
    {"type": "conductor", "metal": "Au", "alpha": 1e-4},
    {"type": "conductor", "metal": "Au", "alpha_x": 1e-4, "alpha_y": 0.1},
    {"type": "plastic", "alpha": 1e-4, "albedo": 1.0},
    {"type": "plastic", "alpha": 0.3, "albedo": 1.0},
    {"type": "dielectric", "alpha": 1e-4},
    {"type": "dielectric", "alpha": 0.5, "eta": 1.0001},
    {"type": "dielectric", "alpha": 1.0},
]


@pytest.mark.parametrize("material", STIFF, ids=str)
def test_stiff_materials_pass(material: dict[str, Any]) -> None:
    report = mt.check(material)
    assert report.verdict == "pass", str(report)
    assert len(report.views) == (12 if material["type"] == "dielectric" else 6)
    assert report.material == material


@pytest.mark.parametrize(("degrees", "side"), [(0, 1), (30, 1), (30, -1), (89.9, 1), (60, -1)])
def test_a_thousandfold_narrower_lobe_costs_no_more(degrees: float, side: float) -> None:
    wo = direction(degrees, side)
    for alpha in (0.1, 1e-4):
        b = mt.bsdf({"type": "dielectric", "alpha": alpha}, precision="double")
        view = look(b, wo, effort=Effort(samples=8000, tolerance=1e-5, budget=150_000))
        assert view.uncertain < 1e-4 and view.p_value > 1e-4, (alpha, view)
        assert abs(view.gap) < 5 * view.gap_error + 1e-3, (alpha, view)


LIMITS: list[tuple[dict[str, Any], dict[str, str]]] = [
    ({"type": "plastic", "alpha": 0.0}, {"/alpha": "delta"}),
    ({"type": "plastic", "alpha": 1e-6}, {"/alpha": "delta"}),
    ({"type": "plastic", "alpha": 1e-4}, {}),
    ({"type": "dielectric"}, {"/alpha": "delta"}),
    ({"type": "dielectric", "roughness": 0.001}, {"/roughness": "delta"}),
    ({"type": "dielectric", "eta": 1.0, "alpha": 0.3}, {"/eta": "null"}),
    ({"type": "dielectric", "eta": 1.0, "alpha": 0.0}, {"/eta": "null"}),
    ({"type": "mirror"}, {}),
    ({"type": "lambert"}, {}),
]


@pytest.mark.parametrize(("material", "expected"), LIMITS, ids=str)
def test_limits_are_told(material: dict[str, Any], expected: dict[str, str]) -> None:
    report = mt.check(material)
    assert {row["pointer"]: row["limit"] for row in report.limits} == expected
    assert report.verdict == "pass", str(report)
    for row in report.limits:
        assert row["text"] in str(report)


def test_every_model_can_be_checked_as_it_is_by_default() -> None:
    for row in mt.materials():
        needed = {p["name"]: 0.5 for p in row["params"] if p["required"] and p["kind"] == "scalar"}
        try:
            mt.bsdf({"type": row["type"], **needed})
        except mt.SceneValidationError:
            continue  # needs more than numbers
        report = mt.check({"type": row["type"], **needed})
        assert report.verdict in ("pass", "warn"), (row["type"], str(report))


COURSE = [
    row["type"]
    for row in mt.materials()
    if any("course" in (p["choices"] or ()) for p in row["params"] if p["name"] == "normalization")
]


@pytest.mark.parametrize("kind", COURSE)
def test_the_courses_normalisation_is_caught(kind: str) -> None:
    names = {p["name"] for row in mt.materials() if row["type"] == kind for p in row["params"]}
    bright = {n: 1.0 for n in ("specular", "F0") if n in names}
    report = mt.check({"type": kind, "normalization": "course", **bright, "diffuse": 0.0})
    assert report.verdict == "fail" and "gains energy" in report.reason, str(report)


def test_the_json_is_whole_and_versioned() -> None:
    report = mt.check({"type": "dielectric", "alpha": 0.2})
    document = json.loads(json.dumps(report.as_dict(), allow_nan=False))
    assert document["version"] == 1
    assert set(document) == {
        "version", "material", "verdict", "reason", "findings", "limits", "views", "furnace",
        "seconds",
    }  # fmt: skip
    names = [f["name"] for f in document["findings"]]
    assert len(names) == len(set(names)) == 9
    assert {row["side"] for row in document["furnace"]} == {1.0, -1.0}


def test_a_wrong_material_is_refused_with_its_pointer() -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.check({"type": "plastic", "alpha": 3})
    assert caught.value.errors[0]["pointer"] == "/alpha"


@pytest.mark.parametrize("eta", [1.0, 1.5, 1 / 1.5, 1.0001])
def test_charts_cover_the_sphere_once_and_keep_areas(eta: float) -> None:
    rng = np.random.default_rng(2)
    wi = rng.normal(size=(4000, 3))
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    for degrees in (1.0, 45.0, 89.0):
        parts = regions(direction(degrees), eta)
        assert (sum(part.contains(wi).astype(int) for part in parts) == 1).all()
        for part in parts:
            check_area(part, wi[part.contains(wi)])


def check_area(part: Region, wi: np.ndarray) -> None:
    """Compare the chart's area factor with differences of its map, and its map with its inverse."""
    if len(wi) < 50:
        return
    chart = Chart.fitted(part, wi, np.ones(len(wi)))
    xy = chart.place(wi)
    back, area = chart.direction(xy)
    assert np.abs(back - wi).max() < 1e-6 and (area > 0).mean() > 0.99
    step = 1e-5
    dx, dy = (
        (chart.direction(xy + d)[0] - chart.direction(xy - d)[0]) / (2 * step)
        for d in (np.array([step, 0]), np.array([0, step]))
    )
    measured = np.linalg.norm(np.cross(dx, dy), axis=1)
    inside = area > 1e-12
    assert np.median(np.abs(measured[inside] / area[inside] - 1)) < 1e-4


def test_measured_files_are_found_and_not_held_to_reciprocity() -> None:
    folder = Path(__file__).resolve().parents[3] / "shared" / "assets" / "measured" / "rgl"
    file = next(iter(sorted(folder.glob("*.bsdf"))), None)
    if file is None:
        pytest.skip("no measured files in ../shared/assets")
    report = mt.check({"type": "measured", "file": file.name}, asset_root=folder)
    finding = next(f for f in report.findings if f.name == "reciprocity")
    assert finding.verdict == "pass" and finding.limit is None
    assert set(report.plots()) == {"albedo", "polar"}
    with pytest.raises(mt.SceneValidationError):
        mt.check({"type": "measured", "file": file.name})


def test_a_mix_is_seen_from_both_sides_and_its_parts_limits_are_told() -> None:
    parts = {"a": {"type": "dielectric", "alpha": 0.0}, "b": {"type": "lambert", "albedo": 0.8}}
    report = mt.check({"type": "mix", **parts, "weight": 0.5})
    assert report.verdict == "pass", str(report)
    assert {row["side"] for row in report.views} == {1.0, -1.0}
    assert [row["pointer"] for row in report.limits] == ["/a/alpha"]
