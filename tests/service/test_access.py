"""Keys and scopes: every route has a rule, and answers 401 and 403 by it."""

from __future__ import annotations

import base64
import json
import re
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fake_engine import FakeEngine
from fastapi import APIRouter, FastAPI
from serving import command, serve

from matiere.errors import MatiereError
from matiere.jobs.keys import SCOPES, Keys, match, open_keys
from matiere.jobs.store.database import Database
from matiere.service import app as app_module
from matiere.service import broadcast
from matiere.service.access import ADMIN, PUBLIC, RULES, unruled
from matiere.service.cli import main
from matiere.service.client import Client
from matiere.service.credentials import key_of_environment, place_of
from matiere.service.routes import health
from matiere.service.security import own_names
from matiere.service.server import ServeError, check_keys
from matiere.service.settings import Settings

JSON = {"Content-Type": "application/json"}


class Clock:
    """A clock that a test sets."""

    now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Keys]:
    """Return the keys of a store."""
    database = Database(tmp_path_factory.mktemp("keys") / "store.sqlite")
    yield Keys(database)
    database.close()


@pytest.fixture(scope="module")
def made(keys: Keys) -> dict[str, str]:
    """Make a key of every scope; return their texts."""
    return {scope: keys.create(f"{scope} key", scope)[1] for scope in SCOPES}


@pytest.fixture
def texts(
    engine: FakeEngine, app: FastAPI, keys: Keys, made: dict[str, str]
) -> Iterator[dict[str, str]]:
    """Put the keys before the application; return their texts."""
    engine.some_keys = keys
    app.state.gate.forget()
    yield made
    engine.some_keys = None
    app.state.gate.forget()


def bearer(key: str) -> dict[str, str]:
    """Return the headers that carry a key."""
    return {"Authorization": f"Bearer {key}"}


# -- the table -----------------------------------------------------------------------------------
def test_every_route_has_a_rule_and_every_rule_a_route(app: FastAPI) -> None:
    assert unruled(app.routes) == []
    served = {
        f"{method.upper()} {path}"
        for path, item in app.openapi()["paths"].items()
        for method in item
    }
    pages = {name for name in RULES if " /v1/" not in name and not name.endswith("z")}
    assert served <= set(RULES)
    assert set(RULES) - served - pages <= {"GET /v1/openapi.json", "GET /metrics"}


def test_a_route_without_a_rule_cannot_be_served(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    router = APIRouter()

    @router.get("/v1/new", include_in_schema=False)
    def new() -> None:
        """Answer nothing."""

    monkeypatch.setattr(health, "router", router)
    with pytest.raises(RuntimeError, match=r"no rule for GET /v1/new"):
        app_module.create_app(FakeEngine(tmp_path), Settings(data=tmp_path))


@pytest.mark.parametrize("name", sorted(RULES))
def test_each_route_asks_for_its_scope(
    client: httpx.Client, texts: dict[str, str], name: str
) -> None:
    method, path = name.split(" ", 1)
    address, needed = re.sub(r"\{[^}]*\}", "nothing", path), RULES[name]
    headers = {"Accept": "application/json"} | (JSON if method in ("POST", "PATCH") else {})

    def ask(given: dict[str, str]) -> tuple[int, str]:
        answer = client.request(method, address, headers=headers | given)
        code = ""
        if answer.status_code in (401, 403) and answer.content:
            assert answer.headers["content-type"] == "application/problem+json"
            code = answer.json()["code"]
        if answer.status_code == 401:
            assert answer.headers["www-authenticate"].startswith("Bearer")
        return answer.status_code, code

    without, wrong = ask({}), ask(bearer(f"mt_{'0' * 8}_{'A' * 43}"))
    if needed == PUBLIC:
        assert {without[0], wrong[0]} <= {200, 404}
        return
    hidden = method == "HEAD"  # its problem has no body to read
    assert without == (401, "" if hidden else "key_missing")
    assert wrong == (401, "" if hidden else "key_invalid")
    for scope in SCOPES:
        status, code = ask(bearer(texts[scope]))
        if SCOPES.index(scope) < SCOPES.index(needed):
            assert (status, code) == (403, "" if hidden else "scope_missing"), scope
        else:
            assert status not in (401, 403), (scope, status, code)


def test_an_address_that_is_no_route_is_told_to_readers_only(
    client: httpx.Client, texts: dict[str, str]
) -> None:
    assert client.get("/v1/nothing").status_code == 401
    assert client.get("/v1/nothing", headers=bearer(texts["read"])).status_code == 404
    assert client.get("/v1/jobs/../keys", headers=bearer(texts["read"])).status_code in (403, 404)
    assert client.delete("/v1/jobs", headers=bearer(texts["read"])).status_code == 405


def test_without_any_key_loopback_is_open_but_for_keys(
    client: httpx.Client, app: FastAPI, engine: FakeEngine
) -> None:
    app.state.gate.forget()
    assert client.get("/v1/jobs").status_code == 200
    for name in (name for name, scope in RULES.items() if scope == ADMIN):
        method, path = name.split(" ", 1)
        address = re.sub(r"\{[^}]*\}", "nothing", path)
        assert client.request(method, address, headers=JSON).status_code == 401, name
    owner = bearer(app.state.gate.owner_token)
    assert client.get("/v1/keys", headers=owner).json() == {"keys": []}


def test_a_browser_asks_its_user_and_the_whole_page_works(
    client: httpx.Client, texts: dict[str, str], engine: FakeEngine
) -> None:
    job = engine.submit_job({"version": 1})
    engine.finish(job.id)
    reader = {"Accept": "text/html,application/xhtml+xml"}
    refused = client.get("/jobs", headers=reader)
    assert refused.status_code == 401
    assert refused.headers["content-type"].startswith("text/html")
    assert "API key" in refused.text and "script-src" in refused.headers["content-security-policy"]
    assert client.get(re.findall(r'href="(/static/[^"]*css)"', refused.text)[0]).status_code == 200
    basic = base64.b64encode(f"me:{texts['read']}".encode()).decode()
    mine = {"Authorization": f"Basic {basic}"}
    assert client.get("/submit", headers=reader | mine).status_code == 200
    assert client.get(f"/v1/jobs/{job.id}/image.png", headers=mine).status_code == 200
    stream = {"Accept": "text/event-stream"}
    address = f"/v1/jobs/{job.id}/events"
    with client.stream("GET", address, headers=stream | mine) as answer:
        assert answer.status_code == 200 and "snapshot" in next(answer.iter_text())
    for asked in ("/v1/jobs", address, f"/v1/jobs/{job.id}/image.png", "/metrics"):
        schemes = client.get(asked, headers=stream).headers.get_list("www-authenticate")
        assert schemes == ['Bearer realm="matiere"', 'Basic realm="matiere"'], (
            "browsers answer a challenge of each address with what they know"
        )
    less = client.post("/v1/jobs", json={"scene": {"version": 1}}, headers=mine)
    assert (less.status_code, less.json()["code"]) == (403, "scope_missing")


def test_a_stream_ends_with_its_key(
    client: httpx.Client,
    texts: dict[str, str],
    keys: Keys,
    app: FastAPI,
    engine: FakeEngine,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(broadcast, "HEARTBEAT_S", 0.05)
    job = engine.submit_job({"version": 1})
    key, text = keys.create("listener", "read")
    app.state.gate.forget()
    headers = bearer(text) | {"Accept": "text/event-stream"}
    with client.stream("GET", f"/v1/jobs/{job.id}/events", headers=headers) as answer:
        pieces = answer.iter_text()
        assert "snapshot" in next(pieces)
        assert next(pieces).startswith(":"), "goes on"
        keys.revoke(key.id)
        app.state.gate.forget()
        for _ in pieces:  # until the service ends it
            pass


@pytest.mark.parametrize("end", ["%0A", "%0D", "/", "%2F", "%00", "?x=1", ";x"])
def test_no_way_of_writing_an_address_evades_its_rule(
    client: httpx.Client, texts: dict[str, str], keys: Keys, end: str
) -> None:
    before = len(keys.list())
    body = {"name": "mine", "scope": "admin"}
    for scope in ("read", "submit"):
        answer = client.post(f"/v1/keys{end}", json=body, headers=bearer(texts[scope]))
        assert answer.status_code in (400, 403, 404), answer.text
        answer = client.get(f"/v1/keys{end}", headers=bearer(texts[scope]))
        assert answer.status_code in (400, 403, 404), answer.text
    assert len(keys.list()) == before


@pytest.mark.parametrize(
    "header", ["Bearer", "Basic", "Basic !!", "Basic //8=", "Digest x", "é", "Bearer é"]
)
def test_strange_credentials_are_401(
    client: httpx.Client, texts: dict[str, str], header: str
) -> None:
    answer = client.get("/v1/jobs", headers=[(b"Authorization", header.encode("latin-1"))])
    assert (answer.status_code, answer.json()["code"]) == (401, "key_invalid")


# -- keys ----------------------------------------------------------------------------------------
def test_keys_end(tmp_path: Path) -> None:
    clock, database = Clock(), Database(tmp_path / "store.sqlite")
    keys = Keys(database, clock)
    key, text = keys.create("ci", "submit", days=1.0)
    other, _ = keys.create("other", "read")
    known = {one.id: one for one in keys.list()}
    assert match(text, known) == key and match(text[:-1] + "~", known) is None
    assert match(text.replace(key.id, other.id), known) is None
    assert text not in (tmp_path / "store.sqlite").read_bytes().decode("latin-1")
    assert text not in (tmp_path / "store.sqlite-wal").read_bytes().decode("latin-1")
    new, _ = keys.rotate(key.id, days=90, overlap_hours=2.0)
    assert (new.name, new.scope) == ("ci", "submit")
    old = keys.get(key.id)
    assert old.valid(clock.now + 7199) and not old.valid(clock.now + 7201)
    assert not keys.revoke(new.id).valid(clock.now)
    clock.now += 2 * 86400
    with pytest.raises(Exception, match="has ended"):
        keys.rotate(key.id)
    database.close()


def test_a_revoked_key_opens_nothing_from_then_on(
    client: httpx.Client, texts: dict[str, str]
) -> None:
    admin = bearer(texts["admin"])
    made = client.post("/v1/keys", json={"name": "x", "scope": "read"}, headers=admin)
    assert made.status_code == 201 and made.headers["cache-control"] == "no-store"
    mine = bearer(made.json()["key"])
    assert client.get("/v1/jobs", headers=mine).status_code == 200
    address = made.headers["location"]
    assert client.delete(address, headers=admin).json()["revoked"]
    assert client.get("/v1/jobs", headers=mine).json()["code"] == "key_invalid"
    assert "key" not in client.get("/v1/keys", headers=admin).json()["keys"][-1]
    again = client.post(f"{address}:rotate", headers=admin)
    assert (again.status_code, again.json()["code"]) == (409, "illegal_transition")


# -- serving -------------------------------------------------------------------------------------
def run(*words: object) -> Any:
    """Run a `matiere` command."""
    line = [sys.executable, "-m", "matiere.service", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, timeout=60)


def test_beyond_loopback_only_with_a_key(tmp_path: Path) -> None:
    data = tmp_path / "d"
    with command("serve", "--data", data, "--host", "0.0.0.0", "--port", 0) as refused:
        said = refused.output()
        assert refused.process.wait(30) == 2
    assert "asks every client for an API key" in said and "matiere key create" in said
    made = run("key", "create", "--name", "me", "--scope", "admin", "--data", data)
    assert made.returncode == 0, made.stderr
    key = made.stdout.strip()
    with command("serve", "--data", data, "--host", "0.0.0.0", "--port", 0) as serving:
        url = serving.url.replace("0.0.0.0", "127.0.0.1")
        assert httpx.get(f"{url}/v1/jobs").status_code == 401
        with Client(url, key=key) as client:
            assert list(client.jobs()) == []
        listed = run("key", "list", "--data", data, "--json")  # as owner, through the service
        (known,) = json.loads(listed.stdout)
        assert known["name"] == "me" and known["scope"] == "admin"
        rotated = run("key", "rotate", known["id"], "--overlap-hours", 0, "--data", data)
        assert rotated.returncode == 0, rotated.stderr
        time.sleep(0.05)
        assert httpx.get(f"{url}/v1/jobs", headers=bearer(key)).json()["code"] == "key_invalid"
        new = bearer(rotated.stdout.strip())
        assert httpx.get(f"{url}/v1/jobs", headers=new).status_code == 200
        assert run("key", "revoke", "nothing", "--data", data).returncode == 2


def test_a_unix_socket_is_its_owners_alone(tmp_path: Path) -> None:
    data, path = tmp_path / "d", tmp_path / "http.sock"
    with command("serve", "--data", data, "--uds", path) as serving:
        serving.line("socket")
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE((data / "server.json").stat().st_mode) == 0o600
        with Client(f"unix:{path}") as client:
            assert list(client.jobs()) == []
        assert run("du", "--data", data).returncode == 0, "found through server.json"
        assert serving.stop() == 0
    assert not path.exists()


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "::", "example.org"])
def test_a_refused_address_leaves_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], host: str
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["serve", "--data", str(tmp_path / "data"), "--host", host])
    said = capsys.readouterr().err
    assert end.value.code == 2 and host in said and "API key" in said and "ssh -L" in said
    assert not (tmp_path / "data").exists()


def test_a_key_that_ended_lets_nobody_listen(tmp_path: Path) -> None:
    with open_keys(tmp_path) as keys:
        key, _ = keys.create("me", "read", days=1e-9)
        assert not keys.get(key.id).valid(time.time() + 1)
    with pytest.raises(ServeError, match="none that is valid"):
        check_keys(Settings(data=tmp_path, host="0.0.0.0"))
    with pytest.raises(ServeError, match="require_key"):
        check_keys(Settings(data=tmp_path, require_key=True))
    check_keys(Settings(data=tmp_path))
    with open_keys(tmp_path) as keys:
        keys.create("me", "read")
    check_keys(Settings(data=tmp_path, host="0.0.0.0"))


def test_clients_know_keys_and_sockets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MATIERE_API_KEY", raising=False)
    assert key_of_environment() is None
    monkeypatch.setenv("MATIERE_API_KEY_FILE", str(tmp_path / "key"))
    with pytest.raises(MatiereError, match="MATIERE_API_KEY_FILE"):
        key_of_environment()
    (tmp_path / "key").write_text("mt_x\n")
    assert key_of_environment() == "mt_x"
    monkeypatch.setenv("MATIERE_API_KEY", "mt_y")
    assert key_of_environment() == "mt_y"
    assert place_of("unix:/run/m.sock") == ("http://localhost", "/run/m.sock")
    assert place_of("http://host:1/") == ("http://host:1", None)


def test_the_names_of_an_address() -> None:
    assert own_names("192.0.2.1") == ["192.0.2.1"]
    assert own_names("::1") == ["[::1]"]
    assert "127.0.0.1" in own_names("0.0.0.0")


def test_commands_need_no_key_where_they_own_the_data(tmp_path: Path) -> None:
    with serve(tmp_path / "d", "--children", 1) as (_, client):
        run("key", "create", "--name", "me", "--data", tmp_path / "d")
        assert httpx.get(f"{client.url}/v1/jobs").status_code == 401
        assert run("gc", "--data", tmp_path / "d").returncode == 0
