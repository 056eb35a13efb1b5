"""Settings: precedence, origins, errors that say where a bad value was set."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from matiere.service import settings as module
from matiere.service.cli import main
from matiere.service.settings import Settings, SettingsError, resolve


@pytest.fixture(autouse=True)
def no_system_config(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Read no configuration of this machine."""
    monkeypatch.setattr(module, "SYSTEM_CONFIG", tmp_path / "etc" / "config.toml")


def write(path: Path, text: str) -> Path:
    """Write a file with its folders."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_earlier_sources_win_and_every_value_knows_its_origin(tmp_path: Path) -> None:
    given = write(tmp_path / "given.toml", 'port = 1\nhost = "::1"\nlog_level = "debug"\n')
    user = write(
        tmp_path / "xdg/matiere/config.toml", "port = 2\nchildren = 3\nhost = '127.0.0.9'\n"
    )
    system = write(tmp_path / "etc/config.toml", "children = 4\nthreads_per_child = 5\n")
    environ = {"XDG_CONFIG_HOME": str(tmp_path / "xdg"), "MATIERE_HOST": "localhost"}
    resolved = resolve({"port": 7, "data": None}, config=given, environ=environ)
    expected = {
        "port": (7, "flag --port"),
        "host": ("localhost", "environment MATIERE_HOST"),
        "log_level": ("debug", f"file {given}"),
        "children": (3, f"file {user}"),
        "threads_per_child": (5, f"file {system}"),
        "max_body_bytes": (8 * 2**20, "default"),
    }
    for name, (value, origin) in expected.items():
        assert (getattr(resolved.settings, name), resolved.origins[name]) == (value, origin), name
    assert resolved.files == (given, user, system)


def test_data_directory_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def data(flag: str | None = None, **environ: str) -> tuple[str, str]:
        resolved = resolve({"data": flag}, environ={"HOME": str(tmp_path), **environ})
        return str(resolved.settings.data), resolved.origins["data"]

    both = {"MATIERE_DATA": "/m", "STATE_DIRECTORY": "/s:/t"}
    assert data("/f", **both) == ("/f", "flag --data")
    assert data(**both) == ("/m", "environment MATIERE_DATA")
    assert data(STATE_DIRECTORY="/s:/t") == ("/s", "environment STATE_DIRECTORY")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "share"))
    assert data() == (str(tmp_path / "share" / "matiere"), "default")


def test_a_list_in_the_environment_is_separated_by_commas() -> None:
    resolved = resolve(environ={"MATIERE_ALLOWED_HOSTS": "a.example, b.example"})
    assert resolved.settings.allowed_hosts == ("a.example", "b.example")


@pytest.mark.parametrize(
    ("environ", "words"),
    [
        ({"MATIERE_PORT": "99999"}, ["port", "99999", "environment MATIERE_PORT"]),
        ({"MATIERE_PORT": "x"}, ["port", "'x'", "environment MATIERE_PORT"]),
        ({"MATIERE_CHILDREN": "0"}, ["children", "MATIERE_CHILDREN"]),
        ({"MATIERE_LOG_LEVEL": "loud"}, ["log_level", "loud", "debug"]),
        ({"MATIERE_CONFIG": "/nowhere.toml"}, ["/nowhere.toml", "does not exist"]),
    ],
)
def test_a_bad_value_says_where_it_was_set(environ: dict[str, str], words: list[str]) -> None:
    with pytest.raises(SettingsError) as caught:
        resolve(environ=environ)
    assert all(word in str(caught.value) for word in words), caught.value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("prot = 1", ["'prot'", "did you mean 'port'", "config.toml"]),
        ("port = [", ["config.toml", "not valid TOML"]),
        ("port = 'x'", ["port", "file", "config.toml"]),
        ("zzz = 1", ["'zzz'", "the settings are", "port"]),
    ],
)
def test_a_bad_file_says_which(tmp_path: Path, text: str, words: list[str]) -> None:
    path = write(tmp_path / "config.toml", text)
    with pytest.raises(SettingsError) as caught:
        resolve(config=path, environ={})
    assert all(word in str(caught.value) for word in words), caught.value


def test_config_command_prints_every_setting_with_its_origin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("MATIERE_PORT", "1234")
    monkeypatch.setenv("MATIERE_PROT", "1")
    path = write(tmp_path / "matiere/config.toml", "children = 3\n")
    with pytest.raises(SystemExit) as end:
        main(["config"])
    assert end.value.code == 0
    out = capsys.readouterr().out
    lines = {line.split()[0]: line for line in out.splitlines() if line}
    assert set(Settings.model_fields) <= set(lines)
    assert lines["port"].split()[1:] == ["1234", "environment", "MATIERE_PORT"]
    assert lines["children"].split()[1:] == ["3", "file", str(path)]
    assert str(path) in lines["configuration"]
    assert "MATIERE_PROT is not a setting" in out
    with pytest.raises(SystemExit):
        main(["config", "--json"])
    shown = json.loads(capsys.readouterr().out)
    assert shown["port"] == {"value": 1234, "origin": "environment MATIERE_PORT"}


def test_config_command_refuses_a_bad_setting(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MATIERE_PORT", "-1")
    with pytest.raises(SystemExit) as end:
        main(["config"])
    assert end.value.code == 2
    assert "environment MATIERE_PORT" in capsys.readouterr().err
