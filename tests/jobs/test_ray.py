"""Rendering on a Ray cluster of two nodes: the bits and the promises of one machine."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import FAKE
from ray_cluster import run_inside, why_not

from matiere.jobs import open_engine
from matiere.jobs.errors import JobsError

SCRIPT = Path(__file__).with_name("ray_scenes.py")
proved = pytest.mark.skipif("PROVE_RAY" not in os.environ, reason="minutes: ./dev prove cluster")
clusters = pytest.mark.skipif(why_not() is not None, reason=str(why_not()))


def nothing_is_left(facts: dict[str, Any]) -> None:
    assert facts["ours"] == [], "a driver or a render child outlived its engine"
    assert facts["left"] == [], "processes that Ray left behind"


@pytest.mark.slow
@clusters
def test_killed_drivers_and_a_killed_node_change_no_bit_and_count_as_nobodys_fault() -> None:
    facts = run_inside(SCRIPT, "kills")
    assert facts["ports"] == [], "something listens beyond loopback"
    assert (facts["state"], facts["spp"]) == ("succeeded", 24)
    report = facts["report"]
    assert report["sums"] == facts["expected"]
    assert (report["min_count"], report["max_count"]) == (24, 24)
    assert "lost lost" in facts["kills"]
    assert not [kill for kill in facts["kills"] if kill.startswith("failed")], facts["kills"]
    assert facts["at_kills"] == ["running"] * 4
    assert facts["started"]["children_lost"] == 3
    assert facts["cells"] == facts["cells_expected"] and len(set(facts["cells"])) == 8
    kind, words = facts["poison"]
    assert kind == "signal" and "after 3 attempts" in words and "SIGSEGV (on node " in words
    assert facts["cancel_s"] < 30.0, "it stopped in the middle of a chunk of 60 s"
    assert {kind for kind, _ in facts["events"]} == {"node_ready", "node_gone"}
    nothing_is_left(facts)


def test_without_ray_the_message_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(JobsError, match=r"pip install 'matiere\[ray\]'"):
        open_engine(tmp_path / "data", executor="ray", **FAKE)
    with pytest.raises(JobsError, match="'local' or 'ray', not 'dask'"):
        open_engine(tmp_path / "data", executor="dask", **FAKE)
    assert not (tmp_path / "data").exists()


@proved
@clusters
def test_nodes_that_would_render_other_bits_or_read_other_files_are_refused() -> None:
    facts = run_inside(SCRIPT, "refusals")
    assert facts["state"] == "succeeded", facts["error"]
    reasons = sorted(facts["reasons"])
    assert reasons[:2] == ["", ""], "the good ones"
    artifacts, folder, files, other = reasons[2:]
    assert "does not see the artifacts of the service" in artifacts
    assert folder.startswith("it does not see the folder") and "/assets of" in folder
    assert other == "it renders other bits than the service: matiere is 'another', not 'fake'"
    assert files.startswith("it reads other files: ") and "a.txt" in files
    assert facts["attempts"] == ["void node_refused"], "counted against no film"
    assert sorted(event["reason"] for event in facts["events"]) == reasons[2:]
    nothing_is_left(facts)


@proved
@clusters
def test_a_hung_and_an_absent_cluster_hold_work_up_and_lose_none() -> None:
    facts = run_inside(SCRIPT, "outage", timeout_s=400)
    assert "cannot join the cluster at 127.0.0.1:" in facts["stuck"]
    assert not facts["ready"] and facts["waiting"] == "running"
    assert facts["state"] == "succeeded"
    assert facts["report"]["sums"] == facts["expected"]
    assert set(facts["kills"]) <= {"lost lost", "void lost"}, "counted against no film"
    nothing_is_left(facts)
