"""States, axes, artifacts: the parts without a process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from matiere.errors import SceneValidationError
from matiere.jobs import sweep, work
from matiere.jobs.artifacts import ArtifactFolder, DamagedFile, StorageFault, pack, unpack
from matiere.jobs.errors import IllegalTransition
from matiere.jobs.job import JobState, check_transition

LEGAL = {
    ("queued", "running"), ("queued", "succeeded"), ("queued", "failed"), ("queued", "cancelled"),
    ("queued", "expired"), ("running", "succeeded"), ("running", "failed"),
    ("running", "cancelled"), ("running", "expired"), ("queued", "paused"), ("running", "paused"),
    ("paused", "queued"), ("paused", "cancelled"), ("paused", "expired"),
    ("queued", "unfinished"), ("running", "unfinished"),
    ("failed", "queued"), ("cancelled", "queued"), ("expired", "queued"),
}  # fmt: skip


@pytest.mark.parametrize("old", list(JobState))
@pytest.mark.parametrize("new", list(JobState))
def test_only_listed_transitions_are_legal(old: JobState, new: JobState) -> None:
    if (old.value, new.value) in LEGAL:
        check_transition(old, new)
    else:
        with pytest.raises(IllegalTransition, match=f"{old.value} job cannot become {new.value}"):
            check_transition(old, new)


def test_an_ended_job_stays_as_it_is() -> None:
    ended = {"succeeded", "unfinished", "failed", "cancelled", "expired"}
    assert {s.value for s in JobState if s.final} == ended


BASE: dict[str, Any] = {
    "materials": {"ball": {"type": "conductor", "alpha": 0.1}, "a/b~c": {"type": "mirror"}},
    "lights": [{"intensity": 1.0}],
}


def axes_of(*raw: dict[str, Any], mode: str = "grid") -> list[sweep.Axis]:
    return sweep.parse_axes(list(raw), BASE, mode)


def test_a_grid_has_every_combination_and_the_last_axis_runs_fastest() -> None:
    axes = axes_of(
        {"pointer": "/materials/ball/alpha", "linspace": [0.1, 0.5, 3]},
        {"pointer": "/lights/0/intensity", "values": [1, 2]},
    )
    cells = list(sweep.expand(BASE, axes, "grid"))
    assert [c.parameters for c in cells[:3]] == [
        {"alpha": 0.1, "intensity": 1}, {"alpha": 0.1, "intensity": 2},
        {"alpha": pytest.approx(0.3), "intensity": 1},
    ]  # fmt: skip
    assert cells[5].scene["lights"][0]["intensity"] == 2
    assert BASE["lights"][0]["intensity"] == 1.0, "the base must not change"
    assert cells[2].label == "0.3, 1"
    assert sweep.guess_columns(axes, "grid", 6) == 2


def test_zip_walks_axes_together() -> None:
    axes = axes_of(
        {"pointer": "/materials/ball/alpha", "logspace": [0.01, 1, 3]},
        {"pointer": "/lights/0/intensity", "values": [1, 2, 3]}, mode="zip",
    )  # fmt: skip
    cells = list(sweep.expand(BASE, axes, "zip"))
    assert [c.parameters["alpha"] for c in cells] == [0.01, pytest.approx(0.1), 1.0]
    assert len(cells) == 3


def test_a_pointer_may_be_escaped_and_may_set_a_key_the_base_leaves_out() -> None:
    axes = axes_of({"pointer": ["/materials/a~1b~0c/two_sided", "/materials/ball/two_sided"],
                    "values": [False], "label": "sides"})  # fmt: skip
    cell = next(sweep.expand(BASE, axes, "grid"))
    assert cell.scene["materials"]["a/b~c"]["two_sided"] is False
    assert cell.scene["materials"]["ball"]["two_sided"] is False


LIGHT = "/lights/0/intensity"


@pytest.mark.parametrize(
    ("axis", "pointer", "words"),
    [
        ({"values": [1]}, "/axes/0", "needs 'pointer'"),
        ({"pointer": "alpha", "values": [1]}, "/axes/0/pointer", "starts with '/'"),
        ({"pointer": "/materials/bell/alpha", "values": [1]}, "/axes/0/pointer", "no /materials"),
        ({"pointer": "/lights/3/intensity", "values": [1]}, "/axes/0/pointer", "1 entries"),
        ({"pointer": "/lights/0/intensity/x", "values": [1]}, "/axes/0/pointer", "plain value"),
        ({"pointer": "/materials/ball/alpha"}, "/axes/0", "exactly one of"),
        ({"pointer": LIGHT, "values": [1], "linspace": [0, 1, 2]}, "/axes/0", "exactly"),
        ({"pointer": LIGHT, "values": []}, "/axes/0/values", "not empty"),
        ({"pointer": LIGHT, "linspace": [0, 1]}, "/axes/0/linspace", "count"),
        ({"pointer": LIGHT, "linspace": [0, float("nan"), 3]}, "/axes/0/linspace", "finite"),
        ({"pointer": LIGHT, "logspace": [0, 1, 3]}, "/axes/0/logspace", "above 0"),
        ({"pointer": LIGHT, "values": [1], "labels": []}, "/axes/0/labels", "one label"),
        ({"pointer": LIGHT, "values": [1], "valuse": 1}, "/axes/0/valuse", "unknown key"),
        ({"pointer": LIGHT, "linspace": [0, 1, 1e9]}, "/axes/0/linspace", "count"),
    ],
)  # fmt: skip
def test_a_bad_axis_is_refused_in_words(axis: Any, pointer: str, words: str) -> None:
    with pytest.raises(SceneValidationError) as caught:
        axes_of(axis)
    assert [f.pointer for f in caught.value.faults] == [pointer]
    assert words in caught.value.message


def test_too_many_cells_are_refused() -> None:
    axis = {"pointer": "/lights/0/intensity", "linspace": [0, 1, 1000]}
    other = axis | {"label": "other"}
    with pytest.raises(SceneValidationError, match="1,000,000 cells"):
        axes_of(axis, other)
    with pytest.raises(SceneValidationError, match="two axes are called"):
        axes_of(axis, axis)
    short = other | {"linspace": [0, 1, 3]}
    with pytest.raises(SceneValidationError, match="one length"):
        axes_of(axis, short, mode="zip")


def test_an_artifact_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    folder = ArtifactFolder(tmp_path)
    digest, size = folder.write([b"ab", b"c"])
    assert (folder.read(digest), size) == (b"abc", 3)
    assert folder.path(digest) == tmp_path / digest[:2] / digest[2:4] / digest

    def breaks() -> Any:
        yield b"x"
        raise OSError(28, "No space left on device")

    with pytest.raises(StorageFault, match="No space"):
        folder.write(breaks())
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [folder.path(digest)]


def test_a_changed_artifact_is_found_out(tmp_path: Path) -> None:
    folder = ArtifactFolder(tmp_path)
    digest, _ = folder.write([b"abc"])
    folder.path(digest).write_bytes(b"abd")
    with pytest.raises(DamagedFile):
        folder.read(digest)


def test_packed_records_come_back(tmp_path: Path) -> None:
    data = b"".join(pack({"film": "x"}, [b"one", b"", b"three"]))
    header, records = unpack(data)
    assert header["film"] == "x"
    assert [bytes(r) for r in records] == [b"one", b"", b"three"]
    with pytest.raises(DamagedFile):
        unpack(data[:-1])


@pytest.mark.parametrize(
    ("target", "row", "share"),
    [
        ({"relmse": 0.5}, {"any_time_upper": 1.0}, 0.5),
        ({"rmse_percent": 2}, {"rmse_percent_any_time_upper": 4.0}, 0.25),
        ({"display": {"code_values": 1, "pixels_percent": 95}}, {"display_excess": 2.0}, 0.5),
        ({"display": {"code_values": 1, "pixels_percent": 95}}, {}, None),
        (None, {"any_time_upper": 1.0}, None),
    ],
)
def test_every_target_tells_how_far_it_is(
    target: dict[str, object] | None, row: dict[str, float], share: float | None
) -> None:
    assert work.target_share({"target_error": target}, row) == share
