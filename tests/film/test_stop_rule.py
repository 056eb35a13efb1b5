"""The pure stop rule: what it decides at every kind of state."""

import itertools
from typing import Any

import pytest

from matiere import _core, chunks, errors

PLAN = _core.Plan(64, 64, 4)  # boundaries 4 8 16 32 48 64 80 ...
TARGET = {"target_error": {"relmse": 0.01}}


@pytest.mark.parametrize(
    ("stop", "state", "go_on", "reason", "next_spp"),
    [
        ({"spp": 64}, {}, True, None, 4),
        ({"spp": 64}, {"spp": 4}, True, None, 8),
        ({"spp": 64}, {"spp": 32}, True, None, 48),
        ({"spp": 64}, {"spp": 64}, False, "spp", 64),
        ({"spp": 50}, {"spp": 48}, True, None, 64),
        ({"spp": 50}, {"spp": 64}, False, "spp", 64),
        ({"spp": 16}, {"spp": 64}, False, "spp", 64),
        ({"spp": 1}, {}, True, None, 4),
        # seconds: the first pass always runs, later ones only if they end in time
        ({"seconds": 1}, {"elapsed_s": 5.0}, True, None, 4),
        ({"seconds": 10}, {"spp": 32, "elapsed_s": 5.0, "s_per_spp": 0.15}, True, None, 48),
        ({"seconds": 10}, {"spp": 32, "elapsed_s": 8.0, "s_per_spp": 0.15}, True, None, 48),
        ({"seconds": 10}, {"spp": 32, "elapsed_s": 8.2, "s_per_spp": 0.15}, False, "seconds", 32),
        ({"seconds": 10}, {"spp": 32, "elapsed_s": 10.6}, False, "seconds", 32),
        # the target: only a fresh look counts, only its upper end, not before 4R
        (TARGET, {"spp": 16, "excess": 0.9}, False, "target_error", 16),
        (TARGET, {"spp": 16, "excess": 1.1}, True, None, 32),
        (TARGET, {"spp": 8, "excess": 0.1}, True, None, 16),
        (TARGET, {"spp": 32, "excess": 0.9, "error_spp": 16}, True, None, 48),
        (TARGET, {"spp": 32}, True, None, 48),
        (TARGET, {"spp": _core.OPEN_ENDED_SPP}, False, "cap", _core.OPEN_ENDED_SPP),
        # whichever comes first
        ({"spp": 64, **TARGET}, {"spp": 32, "excess": 0.9}, False, "target_error", 32),
        ({"spp": 32, **TARGET}, {"spp": 32, "excess": 2}, False, "spp", 32),
        ({"spp": 64, "seconds": 1}, {"spp": 32, "elapsed_s": 0.9, "s_per_spp": 0.1}, False,
         "seconds", 32),
    ],
)  # fmt: skip
def test_table(
    stop: dict[str, Any], state: dict[str, Any], go_on: bool, reason: str | None, next_spp: int
) -> None:
    step = _core.next_step(PLAN, stop, state)
    assert (step["go_on"], step["reason"], step["next_spp"]) == (go_on, reason, next_spp)


def test_following_the_rule_visits_every_boundary() -> None:
    spp, visited = 0, []
    while (step := _core.next_step(PLAN, {"spp": 100}, {"spp": spp}))["go_on"]:
        spp = step["next_spp"]
        visited.append(spp)
    assert visited == [4, 8, 16, 32, 48, 64, 80, 96, 112]


def test_looks_are_closer_when_an_error_is_asked_for() -> None:
    boundaries = [PLAN.boundary(k) for k in range(1, 60)]
    plain, close = (
        [b for b in boundaries if _core.next_step(PLAN, stop, {"spp": b})["look"]]
        for stop in ({"spp": 10_000}, TARGET)
    )
    assert plain == [4, 8, 16, 32, 48, 64, 96, 128, 192, 256, 368, 512, 736]
    assert set(plain) < set(close)
    steps = [b / a for a, b in itertools.pairwise(close) if a >= 192]
    assert max(steps) < 1.13


def test_seconds_left_is_the_nearest_of_the_goals() -> None:
    now = {"spp": 32, "elapsed_s": 3.2, "s_per_spp": 0.1, "excess": 2}
    left = lambda stop: _core.next_step(PLAN, stop, now)["seconds_left"]  # noqa: E731
    assert left({"spp": 64}) == pytest.approx(3.2)
    assert left({"seconds": 4}) == pytest.approx(0.8)
    assert left(TARGET) == pytest.approx(3.2)  # half the error takes twice the samples
    assert left({"spp": 64, "seconds": 4, **TARGET}) == pytest.approx(0.8)
    assert _core.next_step(PLAN, {"spp": 64}, {"spp": 4})["seconds_left"] is None


@pytest.mark.parametrize(
    ("stop", "pointer"),
    [
        ({"spp": 0}, "/render/spp"),
        ({"seconds": -1}, "/render/seconds"),
        ({"seconds": float("nan")}, "/render/seconds"),
        ({"target_error": {"relmse": 0}}, "/render/target_error/relmse"),
        ({"target_error": {}}, "/render/target_error"),
        ({"target_error": {"rmse_percent": -1}}, "/render/target_error/rmse_percent"),
        ({"target_error": {"relmse": 1, "rmse_percent": 1}}, "/render/target_error"),
    ],
)
def test_bad_rules_are_refused(stop: dict[str, Any], pointer: str) -> None:
    with pytest.raises(errors.RenderError) as caught:
        chunks.next_step(PLAN, stop, 4, 1.0)
    assert caught.value.pointer == pointer
