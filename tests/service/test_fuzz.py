"""Thousands of random changes to good submissions: never a 5xx, always a job or a problem."""

from __future__ import annotations

import copy
import json
import random
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

pytest.importorskip("matiere._core", reason="needs the built core")

from malformed import GOOD
from real_queue import served_queue

from matiere.jobs.engine import Engine

CASES = 400
STRANGE: list[Any] = [
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**63), 2**64 - 1, 0.1, -0.0, 1e308, 1e-320, 1e39,
    "", "a", "\x00", "../x", "/etc/passwd", "é" * 300, "\U0001f600", "x" * 5000, "1", "null",
    [], [1], [1, 2, 3], [[1, 2, 3]], [None], ["a", "b"], {}, {"a": 1}, {"type": "sphere"},
    {"texture": "wood"}, {"file": "x.png"}, {"relmse": 0.1}, {"scale": 0}, [0, 0, 0], [1e308] * 3,
    "sha256:" + "0" * 64, "0" * 64,
]  # fmt: skip
KEYS = ["type", "file", "alpha", "metal", "", "a/b~c", "version", "spp", "texture", "\u0000", "é"]


@pytest.fixture(scope="module")
def queue(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Engine, str]]:
    """Serve a queue that renders for real."""
    with served_queue(tmp_path_factory.mktemp("fuzz") / "data") as served:
        yield served


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value inside `value`."""
    yield path
    items: Any = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    for key, item in items:
        yield from places(item, (*path, key))


def change(document: dict[str, Any], rng: random.Random) -> None:
    """Replace, remove, add or move one random value."""
    *parents, last = rng.choice([path for path in places(document) if path])
    holder: Any = document
    for key in parents:
        holder = holder[key]
    what = rng.random()
    if what < 0.5:
        holder[last] = copy.deepcopy(rng.choice(STRANGE))
    elif what < 0.8:
        del holder[last]
    elif isinstance(holder, dict):
        holder[rng.choice(KEYS)] = copy.deepcopy(rng.choice(STRANGE))
    else:
        holder.append(copy.deepcopy(rng.choice([*STRANGE, *holder])))


def submissions(seed: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (address, body): jobs and sweeps with one to three random changes."""
    rng = random.Random(seed)
    job = {"scene": GOOD, "assets": {}, "stop": {"spp": 4}, "priority": 1, "label": "x"}
    axes = [{"pointer": "/materials/ball/alpha", "values": [0.1, 0.2], "labels": ["a", "b"]},
            {"pointer": ["/render/seed"], "linspace": [1, 2, 2], "label": "seed"}]  # fmt: skip
    sweep = {"base": GOOD, "axes": axes, "mode": "grid", "columns": 2, "stop": {"spp": 4}}
    while True:
        address, start = rng.choice([("/v1/jobs", job), ("/v1/sweeps", sweep)])
        body = copy.deepcopy(start)
        for _ in range(rng.choice([1, 1, 1, 2, 3])):
            change(body, rng)
        yield address, body


def test_no_change_makes_the_service_fail(
    queue: tuple[Engine, str], caplog: pytest.LogCaptureFixture
) -> None:
    _, url = queue
    seen: Counter[str] = Counter()
    with httpx.Client(base_url=url, timeout=60) as client:
        for _, (address, body) in zip(range(CASES), submissions(7), strict=False):
            text = json.dumps(body)
            answer = client.post(
                address, content=text, headers={"Content-Type": "application/json"}
            )
            seen[f"{address} {answer.status_code}"] += 1
            assert answer.status_code in (202, 422), (answer.text[:800], text)
            if answer.status_code == 422:
                problem = answer.json()
                assert problem["errors"], problem
                assert all(error["message"] for error in problem["errors"])
            else:
                client.post(f"{answer.headers['location']}:cancel")
        end = time.monotonic() + 60
        while client.get("/readyz").status_code != 200:
            assert time.monotonic() < end, client.get("/readyz").text
            time.sleep(0.1)
    print(dict(seen))
    for address in ("/v1/jobs", "/v1/sweeps"):
        accepted, refused = seen[f"{address} 202"], seen[f"{address} 422"]
        assert accepted > 0.03 * (accepted + refused), "too few cases reach the queue"
    # A busy child may be ended because it reacts to `cancel` too slowly; it must never crash.
    ended = [r.getMessage() for r in caplog.records if "(pid " in r.getMessage()]
    assert all("killed by the service" in text for text in ended), ended
