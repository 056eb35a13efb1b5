"""Webhooks: signatures, where they may go, the outbox, attempts, and no message lost to a kill."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import http.server
import json
import shutil
import signal
import ssl
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fake_engine import FakeEngine
from fastapi import FastAPI
from postgres_server import shared_server
from serving import serve

from matiere.errors import SceneValidationError
from matiere.jobs import webhooks as rules
from matiere.jobs.store import events
from matiere.jobs.store.database import Database
from matiere.jobs.webhooks import ENDS, KINDS, MOST_TRIES, Webhooks, pause_s
from matiere.service import webhook_sender
from matiere.service.webhook_guard import AddressRefused, Guard, is_public
from matiere.service.webhook_sender import Sender, sign

QUICK = {"width": 16, "height": 16, "value": 0.5, "render": {"spp": 16}}
INSIDE = [
    "127.0.0.1", "127.8.9.1", "0.0.0.0", "10.0.0.1", "172.16.0.1", "192.168.1.1", "169.254.169.254",
    "100.64.0.1", "100.100.100.200", "168.63.129.16", "192.0.0.1", "192.0.2.1", "198.18.0.1",
    "198.51.100.7", "203.0.113.9", "224.0.0.1", "239.255.255.250", "240.0.0.1", "255.255.255.255",
    "192.88.99.1", "::", "::1", "::ffff:127.0.0.1", "::ffff:10.0.0.1", "::ffff:a9fe:a9fe",
    "::127.0.0.1", "fe80::1", "fe80::1%eth0", "fec0::1", "fc00::1", "fd00:ec2::254", "ff02::1",
    "2001:db8::1", "2002:7f00:1::", "2001:0:a::1", "64:ff9b::7f00:1", "64:ff9b:1::a00:1", "100::1",
]  # fmt: skip
OUTSIDE = ["93.184.215.14", "8.8.8.8", "2606:2800:21f:cb07::1", "::ffff:8.8.8.8"]


# -- signatures ----------------------------------------------------------------------------------
def test_the_signature_is_that_of_the_published_example() -> None:
    secret = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
    body = b'{"test": 2432232314}'
    made = sign(secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, body)
    assert made == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def checked(secret: str, headers: dict[str, str], body: bytes) -> dict[str, Any]:
    """Verify a message as its receiver would, by the text of the convention; return it."""
    stamp = headers["webhook-timestamp"]
    signed = b".".join([headers["webhook-id"].encode(), stamp.encode(), body])
    key = base64.b64decode(secret.split("_", 1)[1])
    wanted = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    assert f"v1,{wanted}" in headers["webhook-signature"].split(" ")
    assert abs(time.time() - int(stamp)) < 300
    said: dict[str, Any] = json.loads(body)
    return said


# -- the guard -----------------------------------------------------------------------------------
def test_addresses_inside_and_outside_are_told_apart() -> None:
    assert [one for one in INSIDE if is_public(one)] == []
    assert [one for one in OUTSIDE if not is_public(one)] == []


def literal(address: str) -> str:
    """Return an address as it stands in a URL."""
    return f"[{address}]" if ":" in address else address


@pytest.mark.parametrize(
    "url",
    [f"https://{literal(one)}/x" for one in INSIDE if "%" not in one]
    + ["https://127.1/", "https://2130706433/", "https://0x7f.1/", "https://0177.0.0.1/",
       "http://example.org/", "ftp://example.org/", "//example.org/", "https:///x", "x", "https://",
       "https://u:p@example.org/", "https://u@example.org/", "https://example.org/#x",
       "https://example.org:0/", "https://example.org:99999/", "https://exa mple.org/",
       "https://example.org/\n", "https://\u00e9.org/", "https://[::1", "https://[fe80::1%25eth0]/",
       "https://example.org/" + "x" * 2000, "file:///etc/passwd", "unix:/run/x"],
)  # fmt: skip
def test_what_leads_inside_is_refused_at_registration(url: str) -> None:
    with pytest.raises(SceneValidationError) as refused:
        Guard().check(url)
    (fault,) = refused.value.faults
    assert (fault.pointer, fault.code) == ("/url", "address_refused")


@pytest.mark.parametrize("address", OUTSIDE)
def test_other_addresses_are_taken(address: str) -> None:
    Guard().check(f"https://{literal(address)}:8443/x?y=z")
    Guard().check("https://hooks.example.org/x")
    Guard(http=True).check("http://hooks.example.org/x")
    Guard(hosts=["127.0.0.1", "Internal"], http=True).check("http://127.0.0.1:9/")


def names(**known: list[str]) -> Callable[[str, int], Any]:
    """Return a resolver of these names only, which counts."""
    asked: list[str] = []

    async def resolver(host: str, port: int) -> list[str]:
        asked.append(host)
        return known[host.partition(".")[0]]

    resolver.asked = asked  # type: ignore[attr-defined]
    return resolver


def test_every_address_of_a_name_is_judged_at_every_attempt() -> None:
    both = Guard(resolver=names(mixed=["8.8.8.8", "10.0.0.1"], good=["8.8.8.8"], none=[]))
    url, name = asyncio.run(both.target("https://good.example.org:8443/x?y=1"))
    assert (str(url), name) == ("https://8.8.8.8:8443/x?y=1", "good.example.org")
    for host in ("mixed", "none"):
        with pytest.raises(AddressRefused):
            asyncio.run(both.target(f"https://{host}.example.org/"))
    six = Guard(resolver=names(six=["2606:2800:21f:cb07::1"]))
    assert asyncio.run(six.target("https://six.example.org/"))[0].netloc == (
        b"[2606:2800:21f:cb07::1]"
    )


# -- a receiver ----------------------------------------------------------------------------------
class Receiver(http.server.ThreadingHTTPServer):
    """Takes messages; `answers` are the statuses of the next ones, then 204."""

    def __init__(self) -> None:
        """Listen on a free loopback port."""
        super().__init__(("127.0.0.1", 0), _Handler)
        self.got: list[tuple[dict[str, str], bytes]] = []
        self.answers: list[int] = []
        self.stalled = threading.Event()  # clear: requests get no answer
        self.stalled.set()
        self.url = f"http://127.0.0.1:{self.server_port}/hook"

    def wait(self, count: int, timeout_s: float = 60.0) -> None:
        """Return when so many messages came."""
        end = time.monotonic() + timeout_s
        while len(self.got) < count:
            assert time.monotonic() < end, f"{len(self.got)} of {count} messages came"
            time.sleep(0.02)


class _Handler(http.server.BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        """Take a message."""
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.got.append(({k.lower(): v for k, v in self.headers.items()}, body))
        self.server.stalled.wait(60)
        status = self.server.answers.pop(0) if self.server.answers else 204
        self.send_response(status)
        if status == 302:
            self.send_header("Location", self.server.url + "/elsewhere")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    """Run a receiver."""
    with Receiver() as made:
        threading.Thread(target=made.serve_forever, daemon=True).start()
        yield made
        made.stalled.set()
        made.shutdown()


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """Open a store with an outbox."""
    if request.param == "postgresql":
        database = Database(None, shared_server().database())
    else:
        database = Database(tmp_path / "store.sqlite")
    database.outbox = True
    yield database
    database.close()


INSIDE_GUARD = Guard(hosts=["127.0.0.1"], http=True)


def emit(store: Database, kind: str = "failed", **more: Any) -> None:
    """Let an event happen."""
    store.write(lambda c: events.emit(c, kind, more.pop("job_id", "a-job"), **more))


# -- the outbox ----------------------------------------------------------------------------------
def test_only_wanted_events_go_to_the_outbox(store: Database) -> None:
    hooks = Webhooks(store)
    ends, _ = hooks.create("https://a.example.org/")
    cells, _ = hooks.create("https://b.example.org/", ["succeeded"], cells=True)
    for kind in ("look", "progress", "queued", "failed"):
        emit(store, kind)
    many = [(f"cell-{i}", "a-sweep", {}) for i in range(3)]
    store.write(lambda c: events.emit_all(c, "succeeded", many))
    store.write(lambda c: events.emit(c, "sweep_finished", sweep_id="a-sweep"))
    assert (hooks.get(ends.id).waiting, hooks.get(cells.id).waiting) == (2, 3)
    hooks.remove(cells.id)
    assert [one.id for one in hooks.list()] == [ends.id]
    store.outbox = False
    emit(store)
    assert hooks.get(ends.id).waiting == 2, "nothing is kept where nothing is sent"


def test_an_event_that_is_rolled_back_tells_nobody(store: Database) -> None:
    hooks = Webhooks(store)
    made, _ = hooks.create("https://a.example.org/")

    def fail(c: Any) -> None:
        events.emit(c, "failed", "a-job")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        store.write(fail)
    assert hooks.get(made.id).waiting == 0


def test_claims_are_held_put_off_and_given_up(store: Database) -> None:
    clock = [1e9]
    hooks = Webhooks(store, lambda: clock[0])
    made, _ = hooks.create("https://a.example.org/")
    emit(store)
    clock[0] = time.time() + 1
    (first,) = hooks.claim(9)
    assert first.tries == 1 and hooks.claim(9) == [], "held"
    hooks.recover()
    if store.shared:  # the sender may live in another process
        assert hooks.claim(9) == []
        clock[0] += rules.HELD_S + 1
    (again,) = hooks.claim(9)
    assert (again.id, again.tries) == (first.id, 2), "the sender that held it is dead"
    clock[0] += rules.HELD_S + 1
    (again,) = hooks.claim(9)
    assert (again.id, again.tries) == (first.id, 3), "or the claim ran out"
    while again.tries < MOST_TRIES:
        hooks.failed(again, "refused")
        hooks.recover()
        assert hooks.claim(9) == [], "recovering does not shorten a pause"
        assert hooks.get(made.id).error == "refused"
        clock[0] += 1.5 * rules.LONGEST_PAUSE_S
        (again,) = hooks.claim(9)
    hooks.failed(again, "refused")
    clock[0] += 1.5 * rules.LONGEST_PAUSE_S
    assert hooks.claim(9) == []
    assert (hooks.get(made.id).given_up, hooks.get(made.id).waiting) == (1, 0)


def test_pauses_grow_with_jitter_and_have_an_end() -> None:
    low = [pause_s(tries, lambda: 0.0) for tries in range(1, MOST_TRIES)]
    high = [pause_s(tries, lambda: 1.0) for tries in range(1, MOST_TRIES)]
    assert low[:3] == [2.5, 10.0, 40.0] and high[:3] == [7.5, 30.0, 120.0]
    assert max(high) == 1.5 * 86400 and 86400 < sum(low) < sum(high) < 7 * 86400


# -- sending -------------------------------------------------------------------------------------
def until(done: Callable[[], bool], timeout_s: float = 60.0) -> None:
    """Wait for `done`."""
    end = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_messages_are_signed_and_sent_again_under_the_same_id(
    store: Database, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rules, "FIRST_PAUSE_S", 0.01)
    receiver.answers = [500, 302, 204]
    hooks = Webhooks(store)
    made, secret = hooks.create(receiver.url)
    with Sender(hooks, INSIDE_GUARD):
        emit(store, code="memory_limit")
        receiver.wait(3)
        until(lambda: hooks.get(made.id).delivered == 1)
    ids = {headers["webhook-id"] for headers, _ in receiver.got}
    assert len(ids) == 1 and len(receiver.got) == 3, "no redirect was followed"
    for headers, body in receiver.got:
        said = checked(secret, headers, body)
        assert headers["content-type"] == "application/json"
        assert (said["type"], said["data"]["job_id"]) == ("failed", "a-job")
        assert said["data"]["code"] == "memory_limit"
        assert said["data"]["links"] == {"job": "/v1/jobs/a-job", "sweep": None}
    after = hooks.get(made.id)
    assert (after.waiting, after.given_up, after.error) == (0, 0, None)


def test_a_receiver_that_is_gone_is_told_nothing_more(store: Database, receiver: Receiver) -> None:
    receiver.answers = [410]
    hooks = Webhooks(store)
    made, _ = hooks.create(receiver.url)
    emit(store)
    with Sender(hooks, INSIDE_GUARD):
        until(lambda: hooks.get(made.id).disabled is not None)
    emit(store)
    assert hooks.get(made.id).waiting == 0 and "410" in (hooks.get(made.id).disabled or "")


def test_a_stalled_receiver_is_left_and_holds_up_no_other(
    store: Database, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webhook_sender, "ATTEMPT_S", 0.5)
    hooks = Webhooks(store)
    with Receiver() as stalled:
        threading.Thread(target=stalled.serve_forever, daemon=True).start()
        stalled.stalled.clear()
        bad, _ = hooks.create(stalled.url)
        for _ in range(40):
            emit(store)
        good, _ = hooks.create(receiver.url)
        emit(store)
        with Sender(hooks, INSIDE_GUARD):
            until(lambda: hooks.get(good.id).delivered == 1)
            until(lambda: "within" in (hooks.get(bad.id).error or ""))
        assert hooks.get(bad.id).delivered == 0
        stalled.stalled.set()
        stalled.shutdown()


def test_a_name_that_turns_inward_is_not_followed(store: Database, receiver: Receiver) -> None:
    """DNS rebinding: the first answer is public, the second, and every later one, loopback."""
    answers = [["203.0.114.1"], ["127.0.0.1"]]

    async def resolver(host: str, port: int) -> list[str]:
        return answers.pop(0) if len(answers) > 1 else answers[0]

    guard = Guard(http=True, resolver=resolver)
    guard.check(f"http://rebind.example.org:{receiver.server_port}/")
    url, _ = asyncio.run(guard.target(f"http://rebind.example.org:{receiver.server_port}/"))
    assert url.host == "203.0.114.1", "the connection goes to what was judged, not to the name"
    hooks = Webhooks(store)
    made, _ = hooks.create(f"http://rebind.example.org:{receiver.server_port}/")
    emit(store)
    with Sender(hooks, guard):
        until(lambda: "127.0.0.1, which is not public" in (hooks.get(made.id).error or ""))
    assert receiver.got == [] and hooks.get(made.id).waiting == 1


def test_no_name_is_resolved_twice_in_an_attempt(store: Database, receiver: Receiver) -> None:
    resolver = names(internal=["127.0.0.1"])
    guard = Guard(hosts=["internal.example.org"], http=True, resolver=resolver)
    hooks = Webhooks(store)
    hooks.create(f"http://internal.example.org:{receiver.server_port}/x")
    emit(store)
    with Sender(hooks, guard):
        receiver.wait(1)
    assert resolver.asked == ["internal.example.org"]  # type: ignore[attr-defined]
    assert receiver.got[0][0]["host"] == f"internal.example.org:{receiver.server_port}"


def test_the_certificate_is_that_of_the_name(
    store: Database, receiver: Receiver, tmp_path: Path
) -> None:
    """The connection goes to an address, TLS is checked against the name that stands in the URL."""
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl to make a certificate")
    name, cert, key = "internal.example.org", tmp_path / "cert.pem", tmp_path / "key.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2",
         "-keyout", key, "-out", cert, "-subj", f"/CN={name}", "-addext",
         f"subjectAltName=DNS:{name}"],
        check=True, capture_output=True,
    )  # fmt: skip
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(cert, key)
    receiver.socket = server.wrap_socket(receiver.socket, server_side=True)
    resolver = names(internal=["127.0.0.1"], other=["127.0.0.1"])
    guard = Guard(hosts=[name, "other.example.org"], resolver=resolver)
    hooks = Webhooks(store)
    made, _ = hooks.create(f"https://{name}:{receiver.server_port}/")
    emit(store)
    with Sender(hooks, guard):
        until(lambda: "CERTIFICATE_VERIFY_FAILED" in (hooks.get(made.id).error or ""))
    hooks.remove(made.id)
    made, _ = hooks.create(f"https://{name}:{receiver.server_port}/")
    other, _ = hooks.create(f"https://other.example.org:{receiver.server_port}/")
    emit(store)
    sender = Sender(hooks, guard)
    sender.tls = ssl.create_default_context(cafile=cert)
    with sender:
        until(lambda: hooks.get(made.id).delivered == 1)
        until(lambda: "CERTIFICATE_VERIFY_FAILED" in (hooks.get(other.id).error or ""))
    assert len(receiver.got) == 1


# -- the service ---------------------------------------------------------------------------------
def test_webhooks_are_off_by_default_and_an_administrators(
    client: httpx.Client, app: FastAPI, engine: FakeEngine
) -> None:
    owner = {"Authorization": f"Bearer {app.state.gate.owner_token}"}
    body = {"url": "https://example.org/"}
    assert client.post("/v1/webhooks", json=body).status_code == 401
    off = client.post("/v1/webhooks", json=body, headers=owner)
    assert (off.status_code, off.json()["code"]) == (409, "webhooks_off")
    assert set(ENDS) < set(KINDS)


def as_owner(data: Path) -> httpx.Client:
    """Return a client with the token that only the owner of the data directory can read."""
    note = json.loads((data / "server.json").read_text())
    headers = {"Authorization": f"Bearer {note['token']}"}
    return httpx.Client(base_url=note["url"], headers=headers, timeout=30)


def test_no_message_is_lost_to_kills(
    tmp_path: Path, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed with the message in the outbox, and again with it in the receiver's hands."""
    data = tmp_path / "d"
    monkeypatch.setenv("MATIERE_WEBHOOKS", "true")
    monkeypatch.setenv("MATIERE_WEBHOOK_HTTP", "true")
    with serve(data, "--children", 1) as (_, client):
        owner = {
            "Authorization": f"Bearer {json.loads((data / 'server.json').read_text())['token']}"
        }
        with httpx.Client(base_url=client.url, headers=owner, timeout=30) as http:
            inside = http.post("/v1/webhooks", json={"url": receiver.url})
            assert (inside.status_code, inside.json()["errors"][0]["code"]) == (
                422, "address_refused",
            )  # fmt: skip
    monkeypatch.setenv("MATIERE_WEBHOOK_HOSTS", "127.0.0.1, internal")
    receiver.stalled.clear()
    with serve(data, "--children", 1) as (first, client):
        owner = {
            "Authorization": f"Bearer {json.loads((data / 'server.json').read_text())['token']}"
        }
        with httpx.Client(base_url=client.url, headers=owner, timeout=30) as http:
            made = http.post("/v1/webhooks", json={"url": receiver.url})
            assert made.status_code == 201, made.text
            assert "secret" not in http.get("/v1/webhooks").json()["webhooks"][0]
            assert (
                http.post("/v1/webhooks", json={"url": receiver.url, "kinds": ["x"]}).json()[
                    "errors"
                ][0]["pointer"]
                == "/kinds/0"
            )
        job = client.submit(QUICK)
        assert client.wait(job.id, timeout_s=60).state == "succeeded"
        receiver.wait(1)
        first.process.send_signal(signal.SIGKILL)
        first.process.wait()
    receiver.stalled.set()
    with serve(data, "--children", 1) as (second, client):
        receiver.wait(2)
        owner = {
            "Authorization": f"Bearer {json.loads((data / 'server.json').read_text())['token']}"
        }
        with httpx.Client(base_url=client.url, headers=owner, timeout=30) as http:
            until(lambda: http.get("/v1/webhooks").json()["webhooks"][0]["delivered"] == 1)
            gone = http.delete(made.headers["location"])
            assert gone.status_code == 204
            again = http.delete(made.headers["location"])
            assert (again.status_code, again.json()["code"]) == (404, "webhook_not_found")
        assert second.stop() == 0
    assert len({headers["webhook-id"] for headers, _ in receiver.got}) == 1
    for headers, body in receiver.got:
        said = checked(made.json()["secret"], headers, body)
        assert (said["type"], said["data"]["job_id"]) == ("succeeded", job.id)
