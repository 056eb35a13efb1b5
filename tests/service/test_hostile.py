"""Requests no honest client sends: each gets a 4xx problem document, quickly, and changes nothing.

Raw sockets are used where an HTTP library would refuse to send the request.
"""

from __future__ import annotations

import json
import socket
import time
from urllib.parse import urlsplit

import httpx
import pytest
from fake_engine import BODY_TIMEOUT_S, MAX_ASSET_BYTES, FakeEngine

JSON = {"Content-Type": "application/json"}
OCTETS = {"Content-Type": "application/octet-stream"}
LIMIT = 8 * 2**20


def raw(
    url: str, request: bytes, rest: bytes = b"", wait: float = 5.0
) -> tuple[int, dict[str, object]]:
    """Send bytes as they are and return status and problem document."""
    parts = urlsplit(url)
    with socket.create_connection((parts.hostname, parts.port), timeout=wait) as sock:
        sock.sendall(request)
        try:
            if rest:
                sock.sendall(rest)
        except (BrokenPipeError, ConnectionResetError):
            pass  # refused before all was sent: the answer is what counts
        answer = b""
        while b"\r\n\r\n" not in answer:
            answer += sock.recv(65536) or b"\r\n\r\n"
        head, _, body = answer.partition(b"\r\n\r\n")
        length = int(head.lower().split(b"content-length:")[1].split(b"\r\n")[0])
        while len(body) < length:
            body += sock.recv(65536)
    return int(head.split()[1]), json.loads(body)


def post(body: bytes, more: str = "", path: str = "/v1/jobs") -> bytes:
    """Return the bytes of a POST with a Content-Length."""
    return (
        f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n{more}\r\n"
    ).encode() + body


BAD_JSON = [
    # (name, body, status, code, pointer of the first error)
    ("nothing", b"", 422, "invalid_request", ""),
    ("cut", b'{"scene": {"version": 1', 400, "invalid_json", None),
    ("two values", b"{} {}", 400, "invalid_json", None),
    ("comment", b'{"scene": {} /* */}', 400, "invalid_json", None),
    ("not UTF-8", b'{"label": "\xff"}', 400, "invalid_json", None),
    ("UTF-16", '{"scene": {}}'.encode("utf-16"), 400, "invalid_json", None),
    ("NaN", b'{"scene": {"render": {"spp": NaN}}}', 422, "invalid_request", "/scene/render/spp"),
    ("Infinity", b'{"scene": {"a": [1, -Infinity]}}', 422, "invalid_request", "/scene/a/1"),
    ("1e999", b'{"scene": {"a": 1e999}}', 422, "invalid_request", "/scene/a"),
    ("huge integer", b'{"priority": ' + b"9" * 5000 + b"}", 422, "invalid_request", "/priority"),
    ("duplicate key", b'{"scene": {"a~/b": {"x": 1, "x": 2}}}', 422, "invalid_request",
     "/scene/a~0~1b/x"),
    ("duplicate at top", b'{"scene": {}, "scene": {}}', 422, "invalid_request", "/scene"),
    ("lone surrogate", b'{"label": "\\ud800"}', 422, "invalid_request", "/label"),
    ("surrogate key", b'{"scene": {"\\udfff": 1}}', 422, "invalid_request", "/scene/\ufffd"),
    ("deep arrays", b'{"scene": ' + b"[" * 64 + b"]" * 64 + b"}", 422, "json_too_deep", None),
    ("deep objects", b'{"a":' * 65 + b"1" + b"}" * 65, 422, "json_too_deep", None),
    ("very deep", b"[" * 1_000_000, 422, "json_too_deep", None),
    ("deep, mixed", b'[{"a":' * 100_000, 422, "json_too_deep", None),
    ("array", b"[1]", 422, "invalid_request", ""),
    ("null", b"null", 422, "invalid_request", ""),
    ("string", b'"x"', 422, "invalid_request", ""),
    ("many pairs", b"[" + b"[]," * 1_000_000 + b"[]]", 422, "invalid_request", ""),
    ("open string of escapes", b'{"a": "' + b'\\"' * 2_000_000, 400, "invalid_json", None),
    ("quotes", b'"' * 1_000_001, 400, "invalid_json", None),
]  # fmt: skip


@pytest.mark.parametrize(
    ("body", "status", "code", "pointer"),
    [case[1:] for case in BAD_JSON],
    ids=[case[0] for case in BAD_JSON],
)
@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/sweeps"])
def test_bad_json_is_refused_quickly(
    client: httpx.Client,
    engine: FakeEngine,
    path: str,
    body: bytes,
    status: int,
    code: str,
    pointer: str | None,
) -> None:
    begin = time.perf_counter()
    answer = client.post(path, content=body, headers=JSON)
    seconds = time.perf_counter() - begin
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (status, code), answer.text[:500]
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.content) < 20_000
    if pointer is not None:
        assert problem["errors"][0]["pointer"] == pointer
    assert engine.submissions == 0
    assert seconds < 5, f"{seconds:.1f} s"


def test_depth_64_is_accepted(client: httpx.Client) -> None:
    deep = b"[" * 62 + b"]" * 62  # the body and the scene are two levels more
    body = b'{"scene": {"version": 1, "x": "[[[[{{{{", "a": ' + deep + b"}}"
    assert client.post("/v1/jobs", content=body, headers=JSON).status_code == 202


def test_ordinary_large_numbers_are_accepted(client: httpx.Client) -> None:
    body = b'{"scene": {"version": 1, "a": [1e308, -1e-320, 18446744073709551615]}}'
    assert client.post("/v1/jobs", content=body, headers=JSON).status_code == 202


def test_announced_size_is_refused_before_the_body(url: str, engine: FakeEngine) -> None:
    for length in (LIMIT + 1, 10**15, 10**18):
        head = (
            "POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            f"Content-Length: {length}\r\n\r\n"
        )
        status, problem = raw(url, head.encode())
        assert (status, problem["code"]) == (413, "body_too_large"), length
    assert engine.submissions == 0


def test_chunked_body_is_counted_while_it_streams(url: str, engine: FakeEngine) -> None:
    head = (
        b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Transfer-Encoding: chunked\r\n\r\n"
    )
    chunk = b"100000\r\n" + b" " * 2**20 + b"\r\n"
    status, problem = raw(url, head, chunk * 9)
    assert (status, problem["code"]) == (413, "body_too_large")
    assert engine.submissions == 0


def test_8_mib_is_accepted(client: httpx.Client) -> None:
    body = b'{"scene": {"version": 1}}'
    assert client.post("/v1/jobs", content=body.ljust(LIMIT), headers=JSON).status_code == 202


def test_a_stalled_body_is_408(url: str) -> None:
    begin = time.perf_counter()
    request = post(b"{}").replace(b"Content-Length: 2", b"Content-Length: 20")
    status, problem = raw(url, request)
    assert (status, problem["code"]) == (408, "request_timeout")
    assert BODY_TIMEOUT_S * 0.9 < time.perf_counter() - begin < BODY_TIMEOUT_S + 3


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8470", "127.0.0.1.evil.example", "", "localhost.", "[::2]"],
)
@pytest.mark.parametrize("path", ["/v1/jobs", "/healthz", "/nowhere"])
def test_a_foreign_host_is_refused(client: httpx.Client, host: str, path: str) -> None:
    answer = client.get(path, headers={"Host": host})
    assert (answer.status_code, answer.json()["code"]) == (421, "host_not_allowed")


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:1", "127.0.0.1:8470", "[::1]:8470"])
def test_loopback_hosts_are_answered(client: httpx.Client, host: str) -> None:
    assert client.get("/healthz", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize("hosts", ["", "Host: localhost\r\nHost: localhost\r\n"])
def test_a_request_has_exactly_one_host(url: str, hosts: str) -> None:
    parts = urlsplit(url)
    request = f"GET /healthz HTTP/1.1\r\n{hosts}Connection: close\r\n\r\n".encode()
    with socket.create_connection((parts.hostname, parts.port), timeout=5) as sock:
        sock.sendall(request)
        assert sock.recv(4096).split()[1] == b"400"


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://localhost", "http://localhost:1", ""]
)
def test_a_write_from_another_origin_is_refused(
    client: httpx.Client, engine: FakeEngine, origin: str
) -> None:
    headers = {"Origin": origin, "Host": "localhost"}
    for method, path in (
        ("POST", "/v1/jobs"),
        ("POST", "/v1/jobs/x:cancel"),
        ("PUT", "/v1/assets/x"),
    ):
        answer = client.request(method, path, json={"scene": {"version": 1}}, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (403, "origin_not_allowed")
    assert engine.submissions == 0
    assert client.get("/v1/jobs", headers=headers).status_code == 200


def test_a_write_from_the_same_origin_is_accepted(client: httpx.Client) -> None:
    headers = {"Origin": "http://localhost:8470", "Host": "localhost:8470"}
    answer = client.post("/v1/jobs", json={"scene": {"version": 1}}, headers=headers)
    assert answer.status_code == 202


@pytest.mark.parametrize(
    "content_type",
    [None, "text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x",
     "application/octet-stream", "application/jsonp", "text/plain; application/json", ""],
)  # fmt: skip
def test_a_write_must_say_json(
    client: httpx.Client, engine: FakeEngine, content_type: str | None
) -> None:
    headers = {} if content_type is None else {"Content-Type": content_type}
    body = b'{"scene": {"version": 1}}'
    for path in ("/v1/jobs", "/v1/sweeps", "/v1/jobs/x:cancel"):
        answer = client.post(path, content=body, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (415, "content_type_not_supported")
    assert engine.submissions == 0


def test_json_with_charset_is_accepted(client: httpx.Client) -> None:
    headers = {"Content-Type": "Application/JSON; charset=utf-8"}
    body = b'{"scene": {"version": 1}}'
    assert client.post("/v1/jobs", content=body, headers=headers).status_code == 202


def test_an_asset_must_say_octets(client: httpx.Client) -> None:
    answer = client.put(f"/v1/assets/{'0' * 64}", content=b"x", headers=JSON)
    assert (answer.status_code, answer.json()["code"]) == (415, "content_type_not_supported")


def test_asset_with_another_digest_is_refused(client: httpx.Client, engine: FakeEngine) -> None:
    answer = client.put(f"/v1/assets/{'0' * 64}", content=b"x", headers=OCTETS)
    assert (answer.status_code, answer.json()["code"]) == (422, "asset_mismatch")
    assert not engine.assets


@pytest.mark.parametrize(
    "name", ["x", "0" * 63, "G" * 64, "A" * 64, "..%2f..%2fetc%2fpasswd", "%00"]
)
def test_asset_address_must_be_a_digest(
    client: httpx.Client, engine: FakeEngine, name: str
) -> None:
    answer = client.put(f"/v1/assets/{name}", content=b"x", headers=OCTETS)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
    assert not engine.assets


def test_asset_above_the_limit_is_413(client: httpx.Client, engine: FakeEngine, url: str) -> None:
    answer = client.put(
        f"/v1/assets/{'0' * 64}", content=b"x" * (MAX_ASSET_BYTES + 1), headers=OCTETS
    )
    assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")
    head = (
        f"PUT /v1/assets/{'0' * 64} HTTP/1.1\r\nHost: localhost\r\n"
        "Content-Type: application/octet-stream\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    chunk = b"10000\r\n" + b" " * 2**16 + b"\r\n"
    status, problem = raw(url, head.encode(), chunk * 4)
    assert (status, problem["code"]) == (413, "body_too_large")
    assert not engine.assets


def test_an_asset_cut_short_is_not_kept(client: httpx.Client, engine: FakeEngine, url: str) -> None:
    parts = urlsplit(url)
    with socket.create_connection((parts.hostname, parts.port)) as sock:
        sock.sendall(
            b"PUT /v1/assets/" + b"0" * 64 + b" HTTP/1.1\r\nHost: localhost\r\n"
            b"Content-Type: application/octet-stream\r\nContent-Length: 1000\r\n\r\nabc"
        )
        time.sleep(0.1)
    time.sleep(0.1)
    assert not engine.assets
    assert client.get("/healthz").status_code == 200


@pytest.mark.parametrize(
    "job_id", ["x" * 500, "%00", "..", "%2e%2e%2f", "a b", "\u00e9", "1'--", "*"]
)
def test_strange_ids_are_404(client: httpx.Client, job_id: str) -> None:
    for path in (f"/v1/jobs/{job_id}", f"/v1/sweeps/{job_id}", f"/v1/jobs/{job_id}/image.png"):
        answer = client.get(path)
        assert answer.status_code == 404, path
        assert answer.headers["content-type"] == "application/problem+json"
    assert client.get("/v1/jobs", params={"sweep": job_id}).status_code in (200, 404)


@pytest.mark.parametrize("query", ["limit=0", "limit=1001", "limit=x", "state=done", "limit="])
def test_bad_query_is_422_in_words(client: httpx.Client, query: str) -> None:
    answer = client.get(f"/v1/jobs?{query}")
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")
    assert query.split("=")[0] in answer.json()["detail"]


def test_a_bug_is_500_with_an_incident_and_no_secrets(
    client: httpx.Client, engine: FakeEngine, caplog: pytest.LogCaptureFixture
) -> None:
    engine.failing = RuntimeError("secret-7")
    answer = client.post("/v1/jobs", json={"scene": {"version": 1}})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (500, "internal_error")
    assert "secret-7" not in answer.text
    assert any(problem["incident"] in record.getMessage() for record in caplog.records)
    assert client.get("/healthz").status_code == 200


def test_security_headers_are_on_every_answer(client: httpx.Client) -> None:
    for path in ("/healthz", "/nowhere", "/v1/jobs"):
        headers = client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["content-security-policy"].startswith("default-src 'none'")
        assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize(
    ("asked", "status"),
    [("bytes=9-1", 400), ("bytes=999999-", 416), ("bytes=-", 400), ("x", 400), ("bytes=-5", 206),
     ("bytes=0-0", 206), ("bytes=" + "9" * 5000 + "-", 400)],
)  # fmt: skip
def test_a_bad_range_is_a_problem(
    client: httpx.Client, engine: FakeEngine, asked: str, status: int
) -> None:
    job = client.post("/v1/jobs", json={"scene": {"version": 1}}).json()["id"]
    engine.finish(job)
    answer = client.get(f"/v1/jobs/{job}/image.png", headers={"Range": asked})
    assert answer.status_code == status
    if status >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
