"""The only Ray driver: `python -m matiere.jobs.cluster.driver`, a child of the scheduler.

It speaks the pipe protocol of the render children (see `matiere.jobs.child`), is handed many claims
and makes one Ray task of each. It never opens the database and keeps nothing that matters: killed
at any moment, it is started anew and its claims are given out again. Reports besides the child's:
`{"op": "nodes", "capacity": n, "nodes": [...]}` when nodes come, go or are refused, and
`{"op": "returned", "token": n, "state": "lost"|"failed"|"void", ...}` for a claim that was not
rendered. A ping is answered only while the thread that talks to Ray gets on: a hung Ray looks like
a hung child, and is killed like one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import os
import queue
import secrets
import signal
import socket
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matiere.jobs.artifacts import open_artifacts
from matiere.jobs.child import Reports, harden, locate
from matiere.jobs.cluster import node as at_node
from matiere.jobs.job import JsonDict

log = logging.getLogger("matiere.jobs.cluster.driver")

DEPTH = 2  # claims in flight per place of a node: one at work, one waiting
SURVEY_S = 1.0  # between two looks at the nodes of the cluster
ASK_AGAIN_S = 60.0  # after which a refused node may have been mended
CONNECT_S, JOIN_S = 10.0, 45.0  # to reach the address of the cluster; to become part of it
HUNG_S = 10.0  # without progress for so long, pings are left unanswered
FORCE_S = 5.0  # after a cancel that a node has not obeyed its worker process is killed,
FORGET_S = 10.0  # and after so long its claim is taken for cancelled whatever becomes of it


@dataclass
class Node:
    """A node of the cluster as the driver knows it."""

    id: str
    name: str
    slots: int  # tasks of `threads` processors it has room for
    state: str = "asked"  # then "ready" or "refused"
    reason: str = ""
    since: float = 0.0
    flights: int = 0

    def row(self) -> JsonDict:
        """Return what the scheduler learns."""
        return {"id": self.id, "name": self.name, "slots": self.slots, "state": self.state,
                "reason": self.reason}  # fmt: skip


@dataclass
class Flight:
    """A claim that is a Ray task now."""

    request: JsonDict
    node: Node
    ref: Any
    cancelled: float | None = None
    forced: bool = False


@dataclass(frozen=True)
class Landed:
    """The end of a task: of a claim (`token`), or of the examination of a node (`node`)."""

    outcome: Any  # a finished future
    token: int | None = None
    node: str | None = None


class Driver:
    """Turns claims into tasks; the main thread alone talks to Ray."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Open the pipes."""
        self._options = options
        self._reports = Reports(options.report)
        self._control = os.fdopen(options.control, "rb")
        self._inbox: queue.SimpleQueue[JsonDict | Landed] = queue.SimpleQueue()
        self._folder = open_artifacts(options.artifacts)
        self._post = at_node.Post(options.artifacts, options.data, options.work, options.threads,
                                  options.memory, options.claim_limit)  # fmt: skip
        self._nodes: dict[str, Node] = {}
        self._waiting: deque[JsonDict] = deque()
        self._flights: dict[int, Flight] = {}
        self._beat = time.monotonic()
        self._surveyed = 0.0
        self._told: JsonDict = {}
        self._ray: Any = None

    def run(self) -> None:
        """Serve until the control pipe closes."""
        threading.Thread(target=self._listen, name="control", daemon=True).start()
        self._connect()
        self._reports.send("hello", pid=os.getpid(), capacity=0, nodes=[])
        while True:
            self._beat = now = time.monotonic()
            if now - self._surveyed > SURVEY_S:
                self._surveyed = now
                self._survey(now)
            self._press(now)
            self._launch()
            self._tell()
            with suppress(queue.Empty):
                item = self._inbox.get(timeout=SURVEY_S / 4)
                while True:
                    self._take(item)
                    item = self._inbox.get_nowait()

    def _listen(self) -> None:
        for line in self._control:
            message = json.loads(line)
            if message["op"] != "ping":
                self._inbox.put(message)
            elif time.monotonic() - self._beat < HUNG_S:
                self._reports.send("pong", n=message["n"])
        os._exit(0)  # the service has ended: Ray ends the tasks of a driver that is gone

    # -- the cluster ----------------------------------------------------------------------------
    def _connect(self) -> None:
        import ray

        self._ray = ray
        work = at_node.fingerprint(self._options.work)
        mark = secrets.token_hex(16)
        for name in at_node.SHARED_FOLDERS:
            path = Path(self._options.data) / name / at_node.MARK
            path.with_suffix(".tmp").write_text(mark)
            path.with_suffix(".tmp").replace(path)
        probe, _ = self._folder.write([f"probe {mark}".encode()])
        patience = threading.Timer(JOIN_S, self._cannot_join, [f"no answer within {JOIN_S:g} s"])
        patience.daemon = True
        patience.start()
        try:
            _knock(self._options.address)
            ray.init(address=self._options.address, namespace="matiere", log_to_driver=False,
                     configure_logging=False)  # fmt: skip
        except Exception as error:
            self._cannot_join(str(error).strip().split("\n")[0])
        patience.cancel()
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # Ray's would end in order, and slowly
        self._render = ray.remote(max_retries=0)(at_node.render)
        self._examine = ray.remote(max_retries=0)(at_node.examine)
        self._question = (self._post, mark, probe, work)

    def _cannot_join(self, reason: str) -> None:
        """Say why and end: Ray itself would try for minutes, and answer nothing meanwhile."""
        why = f"cannot join the cluster at {self._options.address}: {reason}"
        self._reports.send("nodes", trouble=why)
        print(f"the Ray driver {why}", file=sys.stderr, flush=True)
        os._exit(1)

    def _survey(self, now: float) -> None:
        """Look which nodes there are; ask new ones, and refused ones from time to time."""
        found = {}
        for row in self._ray.nodes():
            slots = int(row["Resources"].get("CPU", 0.0) + 1e-6) // self._options.threads
            if row["Alive"] and slots:
                found[row["NodeID"]] = (row["NodeManagerHostname"], slots)
        self._nodes = {key: node for key, node in self._nodes.items() if key in found}
        for key, (name, slots) in found.items():
            node = self._nodes.setdefault(key, Node(key, name, slots, since=-ASK_AGAIN_S))
            if node.state != "ready" and now - node.since > ASK_AGAIN_S:
                node.since = now
                ref = self._at(node, self._examine, 0).remote(*self._question)
                ref.future().add_done_callback(
                    lambda done, key=key: self._inbox.put(Landed(done, node=key))
                )

    def _at(self, node: Node, task: Any, threads: int) -> Any:
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        place = NodeAffinitySchedulingStrategy(node.id, soft=False)
        return task.options(num_cpus=threads, scheduling_strategy=place)

    def _examined(self, node: Node, outcome: Any) -> None:
        error = outcome.exception()
        if error is not None:
            node.state, node.reason = "refused", f"it cannot be asked: {_last_line(error)}"
            return
        answer = outcome.result()
        node.reason = answer["reason"]
        if (written := answer["written"]) is not None:
            digest, size = written
            if self._folder.has(digest, size):
                self._folder.remove(digest)
            else:
                node.reason = "what it writes to the artifacts is not seen by the service"
        node.state = "refused" if node.reason else "ready"

    @property
    def _capacity(self) -> int:
        slots = sum(node.slots for node in self._nodes.values() if node.state == "ready")
        return min(slots, self._options.limit or slots)

    def _tell(self) -> None:
        facts = {
            "capacity": self._capacity,
            "nodes": [node.row() for node in self._nodes.values()],
        }
        if facts != self._told:
            self._told = facts
            self._reports.send("nodes", **facts)

    # -- claims ---------------------------------------------------------------------------------
    def _take(self, item: JsonDict | Landed) -> None:
        if isinstance(item, Landed):
            if item.node is not None and item.node in self._nodes:
                self._examined(self._nodes[item.node], item.outcome)
            elif item.token is not None and item.token in self._flights:
                self._landed(item.token, item.outcome)
        elif item["op"] == "cancel":
            self._cancel(item["token"])
        else:
            self._waiting.append(item)

    def _launch(self) -> None:
        while self._waiting and (node := self._roomiest()) is not None:
            request = self._waiting.popleft()
            token: int = request["token"]
            slots = max(1, self._capacity) * self._options.threads
            task = self._at(node, self._render, self._options.threads)
            ref = task.remote(self._post, {**request, "slots": slots})
            node.flights += 1
            self._flights[token] = Flight(request, node, ref)
            ref.future().add_done_callback(
                lambda done, token=token: self._inbox.put(Landed(done, token=token))
            )

    def _roomiest(self) -> Node | None:
        if len(self._flights) >= DEPTH * self._capacity:
            return None
        ready = [n for n in self._nodes.values() if n.state == "ready"]
        node = min(ready, key=lambda n: n.flights / n.slots, default=None)
        return node if node is not None and node.flights < DEPTH * node.slots else None

    def _cancel(self, token: int) -> None:
        for request in [r for r in self._waiting if r["token"] == token]:
            self._waiting.remove(request)
            self._reports.send("cancelled", token=token)
        flight = self._flights.get(token)
        if flight is not None and flight.cancelled is None:
            flight.cancelled = time.monotonic()
            self._ray.cancel(flight.ref, force=False)

    def _press(self, now: float) -> None:
        for token, flight in list(self._flights.items()):
            waited = 0.0 if flight.cancelled is None else now - flight.cancelled
            if waited > FORGET_S:
                self._end(token)
                self._reports.send("cancelled", token=token)
            elif waited > FORCE_S and not flight.forced:
                flight.forced = True
                self._ray.cancel(flight.ref, force=True)

    def _end(self, token: int) -> Flight:
        flight = self._flights.pop(token)
        flight.node.flights -= 1
        return flight

    def _landed(self, token: int, outcome: Any) -> None:
        flight = self._end(token)
        where = f"on node {flight.node.name} ({flight.node.id[:12]})"
        error = outcome.exception()
        report = outcome.result() if error is None else {"op": "ended", **describe(error)}
        if report["op"] == "ended":
            if flight.cancelled is not None:
                self._reports.send("cancelled", token=token)
                return
            state = "lost" if report["error"] == "lost" else "failed"
            if error is not None and state == "lost":  # the node may be gone: Ray takes 15 s to say
                flight.node.state, flight.node.since = "asked", -ASK_AGAIN_S
            message = f"{report['message']} ({where})"
            self._return(token, state, report["error"], message, report)
        elif report["op"] == "failed" and self._is_of_node(flight, report):
            flight.node.state, flight.node.since = "refused", time.monotonic()
            flight.node.reason = f"it reads other files: {report['message']}"
            self._return(token, "void", "node_refused", f"{report['message']} ({where})", report)
        else:
            self._reports.send(**report)

    def _return(self, token: int, state: str, error: str, message: str, report: JsonDict) -> None:
        more = {"log_tail": report.get("log_tail", ""), "begun": report.get("begun")}
        about = {"token": token, "state": state, "error": error, "message": message}
        self._reports.send("returned", **about, **more)

    def _is_of_node(self, flight: Flight, report: JsonDict) -> bool:
        """Tell whether the files of a claim are good here, so that the node's are not."""
        assets = flight.request.get("assets")
        if not report["error"].startswith("asset_") or not assets or not assets.get("pins"):
            return False
        root = Path(locate(Path(self._options.data), assets["root"]))
        return all(_sha256(root / name) == digest for name, digest in assets["pins"].items())


def _knock(address: str) -> None:
    """Raise OSError if nobody listens at `host:port`: Ray itself takes minutes to say so."""
    host, _, port = address.rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_S).close()


def describe(error: BaseException) -> JsonDict:
    """Return class and words for a task that ended without a report.

    Only what our own code raises there counts against the film; the rest is Ray's.
    """
    from ray import exceptions

    kind = "lost"
    if isinstance(error, exceptions.OutOfMemoryError):
        kind = "out_of_memory"
    elif isinstance(error, exceptions.RayTaskError):
        kind = "python_error"
    return {"error": kind, "message": f"{type(error).__name__}: {_last_line(error)}"}


def _last_line(error: BaseException) -> str:
    from ray import exceptions

    lines = str(error).strip().split("\n")
    return lines[-1 if isinstance(error, exceptions.RayTaskError) else 0].strip()


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def main() -> None:
    """Parse the command line and serve."""
    parser = argparse.ArgumentParser(prog="matiere.jobs.cluster.driver", description=__doc__)
    parser.add_argument("--control", type=int, required=True, help="file descriptor to read")
    parser.add_argument("--report", type=int, required=True, help="file descriptor to write")
    parser.add_argument("--parent", type=int, required=True, help="pid of the service")
    parser.add_argument("--address", required=True, help="address of the cluster, or auto")
    parser.add_argument("--artifacts", required=True, help="folder or URL of artifacts")
    parser.add_argument("--data", required=True, help="data directory")
    parser.add_argument("--work", required=True, help="module that renders")
    parser.add_argument("--threads", type=int, required=True, help="render threads of a task")
    parser.add_argument(
        "--limit", type=int, default=0, help="tasks at once; 0: all there is room for"
    )
    parser.add_argument("--memory", type=int, default=0, help="bytes of a render child; 0: any")
    parser.add_argument("--claim-limit", type=float, required=True, help="seconds of one claim")
    options = parser.parse_args()
    harden(options.parent)
    os.chdir(options.data)
    logging.basicConfig(level=logging.INFO)
    Driver(options).run()


if __name__ == "__main__":
    main()
