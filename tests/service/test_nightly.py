"""`matiere nightly`: nights, the last good one, what a kill leaves, and what is refused."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from serving import command, serve

from matiere.errors import MatiereError, SceneValidationError
from matiere.service.nightly import Nightly, worst
from matiere.service.nightly_config import load_config

CONFIG = """
folder = "nights"
data = "data"
keep = 2
[[sweep]]
file = "fast.json"
"""


def write_sweep(path: Path, **scene: Any) -> None:
    """Write a sweep of three cells, milliseconds each."""
    base = {"width": 16, "height": 16, "value": 1, "render": {"spp": 64}} | scene
    axes = [{"pointer": "/value", "values": [1, 2, 3], "label": "value"}]
    path.write_text(json.dumps({"version": 1, "base": base, "axes": axes}))


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Write a configuration and its sweep."""
    write_sweep(tmp_path / "fast.json")
    path = tmp_path / "nightly.toml"
    path.write_text(CONFIG)
    return path


def run(config: Path, night: str, *more: str) -> tuple[int, str]:
    """Run a night and return exit code and output."""
    with command("nightly", config, "--night", night, *more) as found:
        said = found.output()
        return found.process.wait(30), said


def verdicts(config: Path) -> dict[str, dict[str, Any]]:
    """Return the verdicts by night."""
    found = Nightly(load_config(config), print).nights("fast")
    return {verdict["night"]: verdict for verdict in found}


@pytest.mark.slow
def test_a_change_alarms_every_night_until_it_is_accepted(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("matiere.service.nightly.POLL_S", 0.05)
    sweep, folder, lines = config.parent / "fast.json", config.parent / "nights", list[str]()
    runner = Nightly(load_config(config), lines.append)

    def night(name: str) -> tuple[int, str]:
        outcomes = runner.run(name)
        return worst(outcomes), outcomes[0].statement

    with serve(config.parent / "data"):
        code, said = night("n1")
        assert code == 0 and "no earlier good night" in said
        code, said = night("n2")
        assert code == 0 and "equal to the last bit" in said
        write_sweep(sweep, brightness=1.2)
        for name in ("n3", "n4"):
            code, said = night(name)
            assert code == 1 and "3 of 3 cells changed" in said
            assert verdicts(config)[name]["against"] == "n2"
        assert "n4 against n2" in (folder / "fast" / "n4" / "report.html").read_text()
        assert set(verdicts(config)) == {"n2", "n3", "n4"}, "the last good one outlives `keep`"
        assert runner.accept() == ["fast/n4"]
        assert night("n5")[0] == 0 and verdicts(config)["n5"]["against"] == "n4"
        assert set(verdicts(config)) == {"n4", "n5"}
        index = (folder / "index.html").read_text()
        assert 'href="fast/n5/report.html"' in index and "(accepted)" in index
        assert night("n5")[0] == 0 and "was done before" in lines[-1]
    assert not (folder / "open.json").exists()


@pytest.mark.slow
def test_a_killed_night_goes_on_as_the_same_sweep(config: Path) -> None:
    write_sweep(config.parent / "fast.json", chunk_s=0.2)
    with serve(config.parent / "data") as (_, client):
        with command("nightly", config, "--night", "n1") as cut:
            cut.line("fast: sweep")
            cut.process.send_signal(signal.SIGKILL)
        assert json.loads((config.parent / "nights" / "open.json").read_text())["night"] == "n1"
        code, said = run(config, "n2")
        assert code == 0, said
        assert list(verdicts(config)) == ["n1", "n2"], "the cut night was finished first"
        sweeps = {v["sweep_id"] for v in verdicts(config).values()}
        assert len(sweeps) == 2
        listed = client._request("GET", "/v1/sweeps").json()["sweeps"]
        assert {sweep["id"] for sweep in listed} == sweeps, "no sweep was submitted twice"


def test_two_at_once_are_refused(config: Path) -> None:
    runner = Nightly(load_config(config), print)
    with runner._alone(), pytest.raises(MatiereError, match="another `matiere nightly`"):
        runner.accept()


def test_a_sweep_that_cannot_run_does_not_stop_the_others(config: Path) -> None:
    runner = Nightly(load_config(config), print)
    (config.parent / "fast.json").unlink()
    begin = time.monotonic()
    (outcome,) = runner.run("n1")
    assert outcome.exit_code == 2 and "fast.json" in outcome.statement
    assert time.monotonic() - begin < 60
    assert "fast.json" in (config.parent / "nights" / "nightly.log").read_text()


@pytest.mark.parametrize(
    ("line", "pointer"),
    [("keep = 1", "/keep"), ("colour = 1", "/colour"), ('method = "t"', "/method"),
     ('[[sweep]]\nfile = "fast.json"', "/sweep/1/name"),
     ('[[sweep]]\nfile = "a b.json"', "/sweep/1/name"),
     ('[[sweep]]\nfile = "c.json"\nname = "../x"', "/sweep/1/name")],
)  # fmt: skip
def test_a_wrong_configuration_is_refused_with_its_place(
    config: Path, line: str, pointer: str
) -> None:
    text = CONFIG + line if line.startswith("[[") else line + CONFIG.replace("keep = 2", "")
    config.write_text(text)
    with pytest.raises(SceneValidationError) as error:
        load_config(config)
    assert [fault.pointer for fault in error.value.faults] == [pointer]


def test_a_file_that_is_no_toml_is_refused(config: Path) -> None:
    config.write_text("= 3")
    with pytest.raises(MatiereError, match="not valid TOML"):
        load_config(config)
    with pytest.raises(MatiereError, match="cannot read"):
        load_config(config.parent / "none.toml")
