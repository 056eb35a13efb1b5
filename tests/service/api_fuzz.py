"""Schemathesis against a real `matiere serve`: renders paused, a small queue, every open recorded.

Cases are made from the served OpenAPI document, half of them right by the schema and half wrong; of
the right submissions some have parts put into an example, so that they reach the queue. An audit
hook in every Python process of the service notes what is opened.
"""

from __future__ import annotations

import copy
import json
import os
import random
import sys
import sysconfig
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from serving import Serving, command

from matiere.service.errors import CODES, TYPE_PREFIX
from matiere.service.openapi_examples import BODIES

ROOT = Path(__file__).resolve().parents[2]
QUEUED = 40
GROWTH_BYTES = 64 * 2**20
ACCEPTED_SHARE = 0.05
WEIGHTS = {"POST /v1/jobs": 8, "POST /v1/sweeps": 6, "POST /v1/checks": 4}  # others: 1
STREAMS = ("/events",)
# Answered 503 while nothing is wrong with the service: readiness alone.
READY = "/readyz"

# Every Python process of the service reads this at its start (as sitecustomize).
RECORDER = """
import os, sys
_out = os.open(os.environ["FUZZ_OPENS"] + f"/{os.getpid()}", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
_seen = set()
def _note(event, arguments):
    if event not in ("open", "os.listdir", "os.scandir", "os.chdir", "os.link", "os.symlink"):
        return
    for path in arguments[:2]:
        if isinstance(path, bytes):
            path = os.fsdecode(path)
        if isinstance(path, str) and path not in _seen and path.startswith(("/", ".")):
            _seen.add(path)
            os.write(_out, (os.path.realpath(path) + "\\n").encode("utf-8", "replace"))
sys.addaudithook(_note)
"""
PAUSED = (
    "import matiere.jobs.scheduler as s;"
    "s.Scheduler._hand_out = lambda self, now: None;"
    "from matiere.service.cli import main; main()"
)


@dataclass
class Result:
    """What was sent and what came back."""

    answers: Counter[tuple[str, int]] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    rss_bytes: list[int] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)
    processes: int = 0
    opened: int = 0

    @property
    def cases(self) -> int:
        """All requests."""
        return sum(self.answers.values())

    def share(self) -> float:
        """Return the share of the POSTs that were accepted."""
        posts = {key: n for key, n in self.answers.items() if key[0].startswith("POST")}
        accepted = sum(n for (_, status), n in posts.items() if status < 300)
        return accepted / max(sum(posts.values()), 1)

    def growth(self) -> int:
        """Return by how many bytes the service grew since it was warm."""
        return max(self.rss_bytes) - self.rss_bytes[0]

    def table(self) -> str:
        """Return accepted, refused and failed cases of every route."""
        lines = [f"{'route':<48} accepted  refused   failed"]
        for route in sorted({route for route, _ in self.answers}):
            found = {status: n for (name, status), n in self.answers.items() if name == route}
            parts = [sum(n for s, n in found.items() if low <= s < high)
                     for low, high in ((200, 400), (400, 500), (500, 600))]  # fmt: skip
            lines.append(f"{route:<48} {parts[0]:8d} {parts[1]:8d} {parts[2]:8d}")
        lines.append(f"{self.cases} cases, {100 * self.share():.1f} % of the POSTs accepted, "
                     f"{self.growth() / 2**20:.1f} MiB more memory, {self.opened} paths opened "
                     f"by {self.processes} processes, {len(self.outside)} outside")  # fmt: skip
        return "\n".join(lines)


@contextmanager
def paused_service(folder: Path, *more: object) -> Iterator[tuple[Serving, str]]:
    """Serve without rendering; what is opened is recorded below `folder`."""
    opens, site = folder / "opens", folder / "site"
    for made in (opens, site):
        made.mkdir(parents=True)
    (site / "sitecustomize.py").write_text(RECORDER)
    paths = [str(site), os.environ.get("PYTHONPATH", "")]
    environ = {"FUZZ_OPENS": str(opens), "PYTHONPATH": os.pathsep.join(p for p in paths if p)}
    environ["XDG_CONFIG_HOME"] = str(folder / "data")
    environ["MATIERE_MAX_QUEUED_JOBS"] = str(QUEUED)
    arguments = ("serve", "--data", folder / "data", "--port", 0, "--children", 1, *more)
    with command(*arguments, code=PAUSED, environ=environ) as serving:
        yield serving, serving.url


def roots(folder: Path) -> tuple[str, ...]:
    """Return where the service may open files: its data, its program, what the system needs."""
    import matiere

    own = [folder / "data", folder / "site", folder / "opens", ROOT / "service", ROOT / "jobs"]
    own += [ROOT / "bindings", Path(matiere.__file__).parent]
    code = [Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib")]
    code += [Path(sys.prefix), Path(sys.base_prefix) / "lib"]
    system = ["/proc", "/sys", "/dev", "/etc/localtime", "/usr/share/zoneinfo", "/usr/share/locale"]
    system += ["/etc/mime.types", "/etc/matiere", "/etc/apache2/mime.types", "/etc/httpd"]
    return tuple(dict.fromkeys([*(os.path.realpath(path) for path in (*own, *code)), *system]))


def read_opens(folder: Path, result: Result) -> None:
    """Note which paths were opened, and those outside the roots."""
    allowed = roots(folder)
    imports = {
        os.path.realpath(entry or ".") for entry in (*sys.path, ".")
    }  # listed by the importer
    for path in (folder / "opens").iterdir():
        result.processes += 1
        for line in path.read_text(encoding="utf-8").splitlines():
            result.opened += 1
            inside = any(line == root or line.startswith(root + "/") for root in allowed)
            inside = inside or line in imports
            scratch = "/matiere-" in line and line.startswith(os.path.realpath("/tmp"))
            if not inside and not scratch:
                result.outside.append(line)


class Fuzzer:
    """Sends cases to a service and judges the answers."""

    def __init__(self, url: str, pid: int, start: int = 1) -> None:
        """`start` is the seed of all random choices."""
        self.url, self.start = url, start
        self.process = psutil.Process(pid)
        self.result = Result()
        self.rounds = 0
        self.known: dict[str, list[str]] = {"job_id": [], "sweep_id": [], "sha256": ["0" * 64]}
        self.rng = random.Random(start)
        self.schema = schemathesis.openapi.from_url(url + "/v1/openapi.json")

    def run(self, cases: int) -> Result:
        """Send so many cases at least, shared between the routes by weight."""
        while self.result.cases < cases:  # some routes have fewer different cases than their share
            self.round(cases - self.result.cases)
            self.rounds += 1
        return self.result

    def round(self, cases: int) -> None:
        """Send about so many cases."""
        operations = [found.ok() for found in self.schema.get_all_operations()]
        operations.sort(key=lambda one: -WEIGHTS.get(one.label, 1))  # what makes ids, first
        weights = [WEIGHTS.get(one.label, 1) for one in operations]
        for number, (operation, weight) in enumerate(zip(operations, weights, strict=True)):
            each = -(-cases * weight // (2 * sum(weights)))
            for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
                self.some(operation, mode, max(each, 1), 2 * number)
            if self.rounds == 0 and number == 1:
                self.result.rss_bytes.clear()  # what came before was its warming up
            self.result.rss_bytes.append(self.process.memory_info().rss)

    def some(self, operation: Any, mode: GenerationMode, cases: int, number: int) -> None:
        """Send cases of one route."""
        left = [cases]

        @seed(10_000 * self.start + 100 * self.rounds + number)
        @settings(
            max_examples=cases,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=operation.as_strategy(generation_mode=mode))
        def send(case: Any) -> None:
            if left[0] > 0:
                left[0] -= 1
                try:
                    self.send(operation, case, mode)
                except Exception as error:  # a connection cut, no answer in time
                    self.result.faults.append(f"{operation.label}: {error!r}")

        while left[0] > 0:  # a route with few different cases gives fewer than asked for
            before = left[0]
            try:
                send()
            except Unsatisfiable:  # nothing can be wrong with a route that takes nothing
                break
            if left[0] == before:
                break

    def send(self, operation: Any, case: Any, mode: GenerationMode) -> None:
        """Send one case and judge the answer."""
        for name, ids in self.known.items():
            if name in (case.path_parameters or {}) and ids and self.rng.random() < 0.5:
                case.path_parameters[name] = self.rng.choice(ids[-20:])
        if mode == GenerationMode.POSITIVE and operation.label in BODIES:
            case.body = self.mixed(operation.label, case.body)
        if operation.path.endswith(STREAMS):
            case.headers["Accept"] = "application/json"
        answer = case.call(timeout=60)
        self.result.answers[operation.label, answer.status_code] += 1
        if fault := self.judge(operation, answer):
            shown = json.dumps(case.body, default=str)[:2000] if case.body is not None else ""
            self.result.faults.append(f"{operation.label}: {fault}\n  {shown}")
        elif operation.method == "post" and answer.status_code < 300:
            self.learn(operation.label, answer.json())

    def mixed(self, route: str, body: Any) -> Any:
        """Return a body in which an example's parts are replaced by those of a case."""
        if not isinstance(body, dict) or self.rng.random() < 0.3:
            return body
        made = copy.deepcopy(self.rng.choice(list(BODIES[route].values()))["value"])
        places = [(made, body)]
        shared = [
            key for key in ("scene", "base") if key in made and isinstance(body.get(key), dict)
        ]
        places += [(made[key], body[key]) for key in shared]
        holder, given_parts = self.rng.choice(places)
        parts = [key for key in given_parts if key not in ("scene", "base", "version")]
        for key in self.rng.sample(parts, min(len(parts), self.rng.randint(0, 2))):
            holder[key] = given_parts[key]
        return made

    def learn(self, route: str, made: Any) -> None:
        """Keep ids, so that other routes find something."""
        if route in ("POST /v1/jobs", "POST /v1/sweeps") and "id" in made:
            self.known["job_id" if route == "POST /v1/jobs" else "sweep_id"].append(made["id"])
            if len(self.known["job_id"]) % 4:  # most are cancelled again: the queue stays open
                self.schema_call(f"/v1/{route[9:]}/{made['id']}:cancel")

    def schema_call(self, path: str) -> None:
        """Send a POST of our own."""
        import httpx

        httpx.post(self.url + path, timeout=60, trust_env=False).raise_for_status()

    def judge(self, operation: Any, answer: Any) -> str | None:
        """Return what is wrong with an answer."""
        status = answer.status_code
        kind = answer.headers.get("content-type", [""])[0]
        about = f"{status} {kind} {answer.content[:600]!r}"
        if status >= 500 and not (status == 503 and operation.path == READY):
            return about
        if status < 400:
            return None if str(status) in operation.definition.raw["responses"] else about
        if operation.method == "head":
            return None
        if kind != "application/problem+json":
            return about
        problem = answer.json()
        right = (
            problem["type"] == TYPE_PREFIX + problem["code"]
            and problem["status"] == status == CODES[problem["code"]].status
            and problem["title"] and problem["detail"] and problem["remedy"]
            and isinstance(problem["errors"], list)
            and (status not in (429, 503) or "retry-after" in answer.headers)
        )  # fmt: skip
        return None if right else about


def ask_for_secrets(url: str, folder: Path) -> list[str]:
    """Submit scenes that name files outside the assets; return what was not refused."""
    import httpx

    secret = folder / "secret.png"
    secret.write_bytes(b"not an image, and not for you")
    assets = folder / "data" / "assets"
    assets.mkdir(exist_ok=True)
    (assets / "link.png").symlink_to(secret)
    (assets / "folder").symlink_to(folder)
    names = ["../secret.png", "../../secret.png", str(secret), f"file://{secret}", "link.png",
             "folder/secret.png", "./link.png", "a/../../../secret.png", "..%2f..%2fsecret.png",
             "/proc/self/root" + str(secret), "http://127.0.0.1/x.png"]  # fmt: skip
    taken = []
    for name in names:
        for part in ({"environment": {"file": name}}, {"textures": {"wood": {"file": name}}}):
            scene = copy.deepcopy(BODIES["POST /v1/jobs"]["smallest"]["value"]["scene"]) | part
            if "textures" in part:
                scene["materials"]["ball"]["albedo"] = {"texture": "wood"}
            answer = httpx.post(
                f"{url}/v1/jobs", json={"scene": scene}, timeout=60, trust_env=False
            )
            if answer.status_code != 422:
                taken.append(f"{name}: {answer.status_code} {answer.text[:300]}")
    return taken


def fuzz(folder: Path, cases: int, start: int = 1) -> Result:
    """Serve, send so many cases, and return what came of it."""
    import httpx

    with paused_service(folder) as (serving, url):
        end = time.monotonic() + 120
        while httpx.get(f"{url}/readyz", trust_env=False).status_code != 200:
            assert time.monotonic() < end, "not ready"
            time.sleep(0.1)
        result = Fuzzer(url, serving.pid, start).run(cases)
        result.faults += ask_for_secrets(url, folder)
        alive = httpx.get(f"{url}/healthz", trust_env=False)
        assert alive.status_code == 200
        serving.stop()
    read_opens(folder, result)
    return result
