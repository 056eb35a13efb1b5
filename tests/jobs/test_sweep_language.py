"""The sweep language: modes, conditions, overrides, baseline, and plans that make cells late."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import random
import tracemalloc
from collections.abc import Iterator
from typing import Any

import pytest

from matiere.errors import Fault, SceneValidationError
from matiere.jobs import sweep
from matiere.jobs.condition import ConditionError, parse_condition
from matiere.jobs.sobol import Sobol

BASE: dict[str, Any] = {
    "materials": {
        "ball": {"type": "conductor", "metal": "Au", "alpha_x": 0.1, "alpha_y": 0.1},
        "a/b": {"type": "mirror"},
    },
    "lights": [{"intensity": 1.0}, {"intensity": 2.0}],
}
BALL = "/materials/ball"
LIGHT = "/lights/0/intensity"
X = {"pointer": f"{BALL}/alpha_x", "values": [0.1, 0.2, 0.3]}
Y = {"pointer": f"{BALL}/alpha_y", "linspace": [0.1, 0.3, 3]}


def plan_of(*axes: dict[str, Any], **more: Any) -> sweep.SweepPlan:
    return sweep.parse_sweep({"axes": list(axes), **more}, BASE)


def refused(raw: dict[str, Any], **more: Any) -> list[Fault]:
    with pytest.raises(SceneValidationError) as caught:
        sweep.parse_sweep(raw, BASE, **more)
    return list(caught.value.faults)


# -- grid, zip and named sets -------------------------------------------------------------------
def test_a_cell_of_a_grid_is_made_by_its_number() -> None:
    plan = plan_of(X, Y, {"pointer": LIGHT, "values": [1, 5]})
    want = list(itertools.product([0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [1, 5]))
    assert len(plan) == 18
    for i, (x, y, light) in enumerate(want):
        assert plan.parameters(i) == {"alpha_x": x, "alpha_y": pytest.approx(y), "intensity": light}
        scene = plan.scene(i)
        assert scene["materials"]["ball"]["alpha_x"] == x
        assert scene["lights"] == [{"intensity": light}, {"intensity": 2.0}]
    assert plan.place(17) == (2, 2, 1)
    assert plan.label(17) == "0.3, 0.3, 5"
    assert plan.patches(5) == [(f"{BALL}/alpha_x", 0.1), (f"{BALL}/alpha_y", 0.3), (LIGHT, 5)]
    assert BASE["lights"][0]["intensity"] == 1.0, "the base must not change"
    plan.scene(0)["materials"]["a/b"]["type"] = "x"
    assert plan.scene(0)["materials"]["a/b"]["type"] == "mirror", "cells share nothing"
    with pytest.raises(IndexError):
        plan.label(18)


def test_named_sets_are_metals_and_ones_own() -> None:
    plan = plan_of({"pointer": f"{BALL}/metal", "set": "metals"})
    assert {"Au", "Ag", "Cu"} <= {plan.parameters(i)["metal"] for i in range(len(plan))}
    plan = plan_of(
        {"pointer": BALL, "set": "mine", "label": "material"}, {"pointer": LIGHT, "set": "levels"},
        sets={"mine": {"gold": {"type": "conductor", "metal": "Au"}, "chalk": {"type": "lambert"}},
              "levels": [1, 10]},
    )  # fmt: skip
    assert [plan.label(i) for i in range(4)] == ["gold, 1", "gold, 10", "chalk, 1", "chalk, 10"]
    assert plan.scene(3)["materials"]["ball"] == {"type": "lambert"}
    [fault] = refused({"axes": [{"pointer": BALL, "set": "metal"}]})
    assert (fault.pointer, "did you mean 'metals'?" in fault.message) == ("/axes/0/set", True)


# -- conditions ---------------------------------------------------------------------------------
def test_cells_that_break_a_condition_are_left_out_and_the_rest_numbered_anew() -> None:
    plan = plan_of(X, Y, where=["alpha_x <= alpha_y", "alpha_y != 0.3"])
    pairs = [tuple(plan.parameters(i).values()) for i in range(len(plan))]
    assert pairs == [(0.1, 0.1), (0.1, pytest.approx(0.2)), (0.2, pytest.approx(0.2))]
    assert [plan.place(i) for i in range(3)] == [(0, 0), (0, 1), (1, 1)]
    assert [f.pointer for f in refused({"axes": [X], "where": ["alpha_x > 7"]})] == ["/where"]


CELL: dict[str, Any] = {"a": 0.1, "b": 2, "metal": "Au", "on": True, "coat alpha": 3, "none": None,
                        "big": 10**10, "huge": 10**400}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("a < b", True), ("a + 0.2 == 0.3", True), ("a + 0.2 > 0.3", False),
        ("0 < a <= 0.1 < b", True), ("3 > b > 2", False), ("not a < b", False),
        ("not not on", True), ("metal == 'Au' and b == 2", True), ('metal == "Ag" or on', True),
        ("metal in ['Cu', 'Au']", True), ("b not in [1, 2.0]", False),
        ("`coat alpha` * 2 == 6", True),
        ("-b + 2 == 0", True), ("b - 1 - 1 == 0", True), ("b * (1 + 1) / 4 == 1", True),
        ("none == null", True), ("none < 1", False), ("none >= 1", False),
        ("none + 1 == null", True), ("b == '2'", False), ("on == 1", False), ("metal < 'B'", True),
        ("b >= 1e0", True),
        ("on or a", True), ("a == 1 or b == 2 and a == 1", False), ("--b == 2", True),
        ("big == 10000000001", False), ("big < 10000000001", True), ("huge > 1", True),
        ("huge == 1.5", False),
    ],
)  # fmt: skip
def test_conditions_mean_what_they_say(text: str, holds: bool) -> None:
    assert parse_condition(text)(CELL.__getitem__) is holds


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "a condition is a text"), (7, "a condition is a text"), ("a <", "value is missing"),
        ("a = 1", "'equal' is =="), ("a b", "operator is missing"), ("(a < 1", "')' is missing"),
        ("a in 3", "'[' is missing"), ("a.b < 1", "'.'"), ("__import__('os')", "operator"),
        ("(" * 30 + "a" + ")" * 30, "nested"), ("a < 1 and " * 80 + "a < 1", "500 characters"),
        ("a < 1e999", "too large"), ("lambda: 1", "':'"), ("a[0] < 1", "operator is missing"),
    ],
)  # fmt: skip
def test_what_is_no_condition_is_refused_in_words(text: Any, words: str) -> None:
    with pytest.raises(ConditionError) as caught:
        parse_condition(text)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("metal < 1", "only numbers have an order"), ("b", "neither true nor false"),
        ("metal * 2 == 1", "only numbers"), ("a / (b - 2) > 1", "divides by zero"),
        ("b * 1e200 * 1e200 > 1", "too large"), ("huge * 2 > 1", "too large"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_for_a_cell_is_said(text: str, words: str) -> None:
    with pytest.raises(ConditionError) as caught:
        parse_condition(text)(CELL.__getitem__)
    assert words in str(caught.value)


def test_a_condition_names_whole_materials_by_their_label() -> None:
    axis = {"pointer": BALL, "label": "material", "labels": ["gold", "chalk"],
            "values": [{"type": "conductor"}, {"type": "lambert"}]}  # fmt: skip
    plan = plan_of(axis, X, where=["material == 'gold' or alpha_x == 0.1"])
    assert len(plan) == 4


def test_bad_conditions_point_at_their_place() -> None:
    raw = {"axes": [X], "where": ["alpha < 1", "alpha_x <"]}
    assert [f.pointer for f in refused(raw)] == ["/where/0", "/where/1"]
    assert "did you mean 'alpha_x'" in refused(raw)[0].message
    [fault] = refused({"axes": [X], "where": ["alpha_x < 'Au'"]})
    assert fault.pointer == "/where/0"


# -- Sobol --------------------------------------------------------------------------------------
def test_every_dimension_and_neighbouring_pair_of_the_sequence_is_stratified() -> None:
    sequence = Sobol(16, seed=9)
    points = [sequence.point(i) for i in range(256)]
    for d in range(16):
        assert sorted(int(p[d] * 256) for p in points) == list(range(256)), d
    boxes = {(int(p[0] * 16), int(p[1] * 16)) for p in points}
    assert len(boxes) == 256, "the first pair is a (0, 2)-net"
    pairs = [len({(int(p[a] * 8), int(p[b] * 8)) for p in points})
             for a, b in itertools.combinations(range(16), 2)]  # fmt: skip
    assert min(pairs) >= 16 and sum(pairs) / len(pairs) > 55, pairs  # 62.9 of 64 if random


def test_a_sobol_sweep_fills_its_box_evenly_and_grows_without_changing() -> None:
    axes = [
        {"pointer": f"{BALL}/alpha_x", "loguniform": [0.01, 1]},
        {"pointer": LIGHT, "uniform": [-2, 6]},
        {"pointer": f"{BALL}/metal", "values": ["Au", "Ag"]},
    ]
    few = plan_of(*axes, mode="sobol", sobol={"count": 64, "seed": 5})
    many = plan_of(*axes, mode="sobol", sobol={"count": 128, "seed": 5})
    cells = [few.parameters(i) for i in range(64)]
    assert cells == [many.parameters(i) for i in range(64)]
    assert cells != [plan_of(*axes, mode="sobol", sobol={"count": 64, "seed": 6}).parameters(i)
                     for i in range(64)]  # fmt: skip
    logs = sorted(math.log10(c["alpha_x"]) for c in cells)
    assert all(-2 + 2 * k / 64 <= x <= -2 + 2 * (k + 1) / 64 for k, x in enumerate(logs))
    lights = sorted(c["intensity"] for c in cells)
    assert all(-2 + 8 * k / 64 <= x <= -2 + 8 * (k + 1) / 64 for k, x in enumerate(lights))
    assert [c["metal"] for c in cells].count("Au") == 32
    scene = few.scene(7)
    assert scene["lights"][0]["intensity"] == cells[7]["intensity"]
    assert few.place(7)[:2] == (7, 7) and few.place(7)[2] in (0, 1)


def test_a_sobol_sweep_with_a_condition_keeps_the_points_that_hold() -> None:
    axes = [{"pointer": f"{BALL}/alpha_{d}", "uniform": [0, 1]} for d in "xy"]
    plan = plan_of(*axes, mode="sobol", sobol={"count": 1000}, where=["alpha_x <= alpha_y"])
    assert abs(len(plan) - 500) < 25
    assert all(p["alpha_x"] <= p["alpha_y"] for p in map(plan.parameters, range(len(plan))))


# -- lists --------------------------------------------------------------------------------------
def test_a_list_names_its_cells_one_by_one() -> None:
    raw = {
        "mode": "list",
        "axes": [{"pointer": [f"{BALL}/alpha_x", f"{BALL}/alpha_y"], "label": "alpha"}],
        "list": [{"alpha": 0.5, "label": "rough"}, {"alpha": 0.1, LIGHT: 9},
                 {"/lights/1/intensity": 3}],
    }  # fmt: skip
    plan = sweep.parse_sweep(raw, BASE)
    assert [plan.label(i) for i in range(3)] == ["rough", "0.1, 9", "3"]
    assert plan.parameters(1) == {"alpha": 0.1, "intensity": 9}
    assert plan.parameters(2) == {"/lights/1/intensity": 3}, "two pointers end in the same word"
    assert plan.scene(0)["materials"]["ball"]["alpha_y"] == 0.5
    assert plan.scene(2)["lights"] == [{"intensity": 1.0}, {"intensity": 3}]
    some = sweep.parse_sweep({**raw, "where": ["intensity == null and alpha > 0.2"]}, BASE)
    assert [some.label(i) for i in range(len(some))] == ["rough"]


@pytest.mark.parametrize(
    ("raw", "pointer", "words"),
    [
        ({"mode": "list", "list": [{"alhpa": 1}]}, "/list/0/alhpa", "no axis is called"),
        ({"mode": "list", "list": [{"/nowhere/x": 1}]}, "/list/0/~1nowhere~1x", "no /nowhere"),
        ({"mode": "list", "list": [{}]}, "/list/0", "not empty"),
        ({"mode": "list", "list": [{LIGHT: 1, "label": 2}]}, "/list/0/label", "text"),
        ({"mode": "list", "list": []}, "/list", "not empty"),
        ({"mode": "list"}, "/list", "go together"),
        ({"mode": "list", "axes": [X], "list": [{"alpha_x": 1}]}, "/axes/0/values", "stand in"),
        ({"axes": [X], "sobol": {"count": 3}}, "/sobol", "go together"),
        ({"axes": [X], "mode": "sobol", "sobol": {"count": 0}}, "/sobol/count", "whole number"),
        ({"axes": [X], "mode": "sobol", "sobol": {"count": 1, "seed": -1}}, "/sobol/seed", "whole"),
        ({"axes": [X], "mode": "sobol", "sobol": {"cuont": 1}}, "/sobol", "'count'"),
        ({"axes": [{"pointer": LIGHT, "uniform": [0, 1]}]}, "/axes/0/uniform", "mode sobol"),
        ({"axes": [{"pointer": LIGHT, "uniform": [1, 1]}]}, "/axes/0/uniform", "low below high"),
        ({"axes": [{"pointer": LIGHT, "loguniform": [0, 1]}]}, "/axes/0/loguniform", "above 0"),
        ({"axes": [{"pointer": LIGHT, "linspace": [0, 10**400, 3]}]}, "/axes/0/linspace", "finite"),
        ({"axes": [X], "mode": "random"}, "/mode", "grid, zip, sobol or list"),
        ({"axes": [X], "wehre": []}, "/wehre", "no 'wehre'"),
        ({"axes": [X], "sets": [1]}, "/sets", "object"),
        ({"axes": [X, {"pointer": BALL, "values": [{}]}]}, "/axes/1/pointer", "put it first"),
        ({"axes": [X], "overrides": [{"when": "alpha_x > 0.2"}]}, "/overrides/0", "'set'"),
        ({"axes": [X], "overrides": [{"when": "alpha_x > 5", "set": {LIGHT: 1}}]},
         "/overrides/0/when", "no cell"),
        ({"axes": [X], "overrides": [{"when": "alpha_x > 0", "set": {"/x/y": 1}}]},
         "/overrides/0/set/~1x~1y", "no /x"),
        ({"axes": [X], "baseline": 3}, "/baseline", "cell 0 to 2"),
        ({"axes": [X], "baseline": {"alpha": 0.1}}, "/baseline/alpha", "did you mean"),
        ({"axes": [X], "baseline": {"alpha_x": 0.15}}, "/baseline", "no cell"),
        ({"axes": [X, Y], "baseline": {"alpha_x": 0.1}}, "/baseline", "3 cells"),
        ({"axes": [X], "baseline": "first"}, "/baseline", "number of a cell"),
    ],
)  # fmt: skip
def test_a_bad_sweep_is_refused_in_words(raw: Any, pointer: str, words: str) -> None:
    faults = refused(raw)
    assert [f.pointer for f in faults] == [pointer]
    assert words in faults[0].message


# -- overrides, baseline, blame -----------------------------------------------------------------
def test_overrides_lie_on_top_where_their_condition_holds() -> None:
    plan = plan_of(X, Y, overrides=[
        {"when": "alpha_x == 0.3", "set": {LIGHT: 7, f"{BALL}/alpha_y": 0.9}, "label": "bright"},
        {"when": "alpha_x > 0.2 and alpha_y == 0.1", "set": {LIGHT: 8}},
    ])  # fmt: skip
    lights = [plan.scene(i)["lights"][0]["intensity"] for i in range(9)]
    assert lights == [1.0] * 6 + [8, 7, 7]
    assert plan.scene(7)["materials"]["ball"]["alpha_y"] == 0.9
    assert plan.label(7) == "0.3, 0.2, bright"
    assert plan.patches(6)[-1] == (LIGHT, 8)


def test_the_baseline_is_a_cell_by_number_or_by_values() -> None:
    assert plan_of(X, Y, baseline=4).baseline == 4
    assert plan_of(X, Y, baseline={"alpha_x": 0.2, "alpha_y": 0.3}).baseline == 5
    where = ["alpha_x <= alpha_y"]
    assert plan_of(X, Y, where=where, baseline={"alpha_x": 0.3}).baseline == 5
    chalk = {"pointer": BALL, "label": "m", "values": [{"type": "lambert"}], "labels": ["chalk"]}
    assert plan_of(chalk, baseline={"m": "chalk"}).baseline == 0
    assert plan_of(X).baseline is None


def test_a_fault_of_a_scene_is_laid_at_the_part_of_the_request_that_caused_it() -> None:
    plan = plan_of(X, Y, overrides=[{"when": "alpha_x == 0.3", "set": {LIGHT: {"r": -1}}}])

    def blame(i: int, at: str) -> str:
        return plan.blame(i, Fault(at, "x", "y")).pointer

    assert blame(4, f"{BALL}/alpha_x") == "/axes/0/values/1"
    assert blame(4, f"{BALL}/alpha_y") == "/axes/1/linspace"
    assert blame(4, f"{LIGHT}/r") == f"{LIGHT}/r", "the base's own"
    assert blame(8, f"{LIGHT}/r") == "/overrides/0/set/~1lights~10~1intensity/r"
    listed = sweep.parse_sweep({"mode": "list", "list": [{LIGHT: 1}, {LIGHT: [2]}]}, BASE)
    assert (
        listed.blame(1, Fault(f"{LIGHT}/0", "x", "y")).pointer == "/list/1/~1lights~10~1intensity/0"
    )


def test_a_setting_that_finds_no_place_in_a_cell_is_said() -> None:
    material = {"pointer": BALL, "values": [{"type": "lambert"}, 7]}
    plan = plan_of(material, {"pointer": f"{BALL}/coat", "values": [1]})
    assert plan.scene(0)["materials"]["ball"]["coat"] == 1
    with pytest.raises(SceneValidationError) as caught:
        plan.scene(1)
    assert caught.value.faults[0].pointer == "/axes/1/values/0"


def test_probes_meet_every_value_and_every_override() -> None:
    more = {"overrides": [{"when": "alpha_x == 0.2 and alpha_y == 0.3", "set": {LIGHT: 3}}]}
    for where in ([], ["alpha_x + alpha_y > 0.25"]):
        plan = plan_of(X, Y, where=where, **more)
        places = {(k, spot) for i in plan.probes() for k, spot in enumerate(plan.place(i))}
        assert places == {(k, spot) for k in range(2) for spot in range(3)}
        assert any(plan.scene(i)["lights"][0]["intensity"] == 3 for i in plan.probes())
        assert len(plan.probes()) <= 7
    assert plan_of(X, Y).probes() == [0, 1, 2, 3, 6]


# -- size and storage ---------------------------------------------------------------------------
SHAPES: list[dict[str, Any]] = [
    {"axes": [X, Y, {"pointer": LIGHT, "logspace": [1, 100, 3]}], "baseline": 2,
     "where": ["alpha_x < alpha_y"],
     "overrides": [{"when": "intensity > 50", "set": {"/lights/1/intensity": 0}, "label": "o"}]},
    {"axes": [X, Y], "mode": "zip"},
    {"axes": [{"pointer": LIGHT, "loguniform": [1, 9]}, X], "mode": "sobol",
     "sobol": {"count": 20, "seed": 3}, "where": ["intensity < 5"]},
    {"mode": "list", "list": [{LIGHT: 4, "label": "four"}, {f"{BALL}/alpha_x": 0.2}]},
]  # fmt: skip


@pytest.mark.parametrize("raw", SHAPES, ids=["grid", "zip", "sobol", "list"])
def test_a_stored_plan_makes_the_same_cells(raw: dict[str, Any]) -> None:
    plan = sweep.parse_sweep(raw, BASE)
    stored = json.loads(json.dumps(plan.to_dict(), allow_nan=False))
    again = sweep.SweepPlan.from_dict(stored, json.loads(json.dumps(BASE)))
    assert len(again) == len(plan) > 0
    assert list(again.cells()) == list(plan.cells())
    assert [again.patches(i) for i in range(len(again))] == [
        plan.patches(i) for i in range(len(plan))
    ]
    assert again.baseline == plan.baseline
    assert again.to_dict() == plan.to_dict()


def test_a_hundred_thousand_cells_take_next_to_no_memory() -> None:
    first = {"pointer": f"{BALL}/alpha_x", "linspace": [0.01, 1, 100]}
    second = {"pointer": f"{BALL}/alpha_y", "linspace": [0.01, 1, 1000]}
    tracemalloc.start()
    plan = plan_of(first, second)
    some = plan_of(first, {**second, "linspace": [0, 1, 200]}, where=["alpha_x * alpha_y < 2"])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (len(plan), len(some)) == (100_000, 20_000)
    assert plan.place(99_999) == (99, 999)
    assert peak < 1e6, peak
    [fault] = refused({"axes": [first, {**second, "linspace": [0, 1, 1001]}]})
    assert "100,100 cells" in fault.message
    few = {"pointer": LIGHT, "values": list(range(51))}
    assert "at most 50" in refused({"axes": [few]}, max_cells=50)[0].message


# -- hostile ------------------------------------------------------------------------------------
JUNK: list[Any] = [
    None, True, 0, -1, 3.5, 1e308, 10**400, "", "x", "/", "/a", "/lights/9", "/lights/-1", "~", [],
    [1], [[]], {}, {"": 2}, "alpha_x <", "label", "list", "metals", [0, 1, 3], [1, "2", 3], [{}],
    {"count": 5, "seed": 2}, {"count": True}, {"label": 3}, {"/": 1},
]  # fmt: skip
WORDS = ["where", "list", "label", "labels", "set", "sobol", "overrides", "uniform", "baseline"]


def spots(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield (container, key) of everything inside."""
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        yield value, key
        if isinstance(value[key], dict | list):
            yield from spots(value[key])


@pytest.mark.parametrize("seed", range(3))
def test_no_request_gets_past_the_checks_or_through_them_with_another_error(seed: int) -> None:
    rng = random.Random(seed)
    good = 0
    for _ in range(600):
        raw = json.loads(json.dumps(rng.choice(SHAPES)))
        for _ in range(rng.randint(1, 3)):
            holder, key = rng.choice(list(spots(raw)) or [(raw, "axes")])
            key = rng.choice(WORDS) if isinstance(holder, dict) and rng.random() < 0.2 else key
            holder[key] = json.loads(json.dumps(rng.choice(JUNK)))
        try:
            plan = sweep.parse_sweep(raw, BASE)
        except SceneValidationError:
            continue
        good += 1
        assert plan.probes()
        for i in (0, len(plan) - 1):
            assert len(plan.place(i)) == len(plan.axes) and isinstance(plan.label(i), str)
            with contextlib.suppress(SceneValidationError):  # a setting without a place
                plan.scene(i)
        assert len(sweep.SweepPlan.from_dict(plan.to_dict(), BASE)) == len(plan)
    assert good > 20


# -- through the queue --------------------------------------------------------------------------
def test_the_queue_takes_the_whole_language(engine: Any) -> None:
    axes = [{"pointer": "/value", "set": "levels", "label": "level"},
            {"pointer": "/x", "values": [1, 2]}]  # fmt: skip
    scene = {"width": 8, "height": 8, "value": 1.0, "render": {"spp": 4}}
    language = {
        "sets": {"levels": {"low": 1, "high": 2}}, "where": ["level >= x"],
        "baseline": {"level": 1},
        "overrides": [{"when": "x == 2", "set": {"/value": 9}, "label": "bright"}],
    }  # fmt: skip
    made = engine.submit_sweep(scene, axes, idempotency_key="k", **language)
    assert engine.submit_sweep(scene, axes, idempotency_key="k", **language).id == made.id
    assert (made.cells, made.baseline, made.columns) == (3, 0, 3)
    labels = [job.label for job in engine.list_jobs(sweep_id=made.id)]
    assert labels == ["low, 1", "high, 1", "high, 2, bright"]
    assert engine.wait_sweep(made.id, 30).counts["succeeded"] == 3
    bad = {**language, "overrides": [{"when": "x == 2", "set": {"/value": -1}}]}
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_sweep(scene, axes, **bad)
    assert [f.pointer for f in caught.value.faults] == ["/overrides/0/set/~1value"]
