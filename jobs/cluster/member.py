"""The Ray driver seen from the scheduler: a child like any other that holds many claims at once.

It never opens the database, so nothing is lost with it; however it ends, that is nobody's fault
(class `lost`), and the next one begins after a pause that grows.
"""

from __future__ import annotations

import importlib.util
import logging
import queue
import sys
from dataclasses import dataclass
from typing import Any

from matiere.jobs.children import Child, ChildOptions
from matiere.jobs.errors import JobsError
from matiere.jobs.job import JsonDict

log = logging.getLogger("matiere.jobs.cluster")

MISSING = "the executor 'ray' needs one more package: pip install 'matiere[ray]'"


@dataclass(frozen=True)
class Cluster:
    """Where claims are rendered when this machine does not do it."""

    address: str = "auto"  # of the cluster's head; "auto": the one that this machine is part of
    limit: int | None = None  # claims rendered at once; none: as many as the nodes have room for
    child_memory_bytes: int = 0  # of one render child on a node; 0: three quarters of the node's
    claim_limit_s: float = 3600.0


def cluster_of(
    executor: str, address: str | None, limit: int | None, memory_bytes: int, claim_limit_s: float
) -> Cluster | None:
    """Return the cluster that an executor means; None for `local`.

    Raises JobsError for another word, or when Ray is not installed here.
    """
    if executor == "local":
        return None
    if executor != "ray":
        raise JobsError(f"executor is 'local' or 'ray', not {executor!r}", code="invalid_setting")
    if importlib.util.find_spec("ray") is None:
        raise JobsError(MISSING, code="missing_package")
    return Cluster(address or "auto", limit, memory_bytes, claim_limit_s)


class Driver(Child):
    """The process that turns claims into Ray tasks; `nodes` are those it knows."""

    remote = True

    def __init__(
        self, options: ChildOptions, cluster: Cluster, inbox: queue.SimpleQueue[Any]
    ) -> None:
        """Start the process."""
        self._cluster = cluster
        self._reason = ""
        super().__init__(options, inbox)
        self.capacity = 0  # until it has seen a node
        self.nodes = ()

    def greet(self, body: JsonDict) -> list[JsonDict]:
        """Learn which nodes there are; return an event for each that came, went or is refused."""
        if body.get("trouble"):
            self._reason = str(body["trouble"])
            return []
        self.ready = True
        known = {node["id"]: node["state"] for node in self.nodes}
        self.capacity, self.nodes = body["capacity"], body["nodes"]
        found = {node["id"]: node for node in self.nodes}
        changed = [node for node in self.nodes if known.get(node["id"]) != node["state"]]
        gone = [{"id": i, "state": "gone", "reason": ""} for i in known if i not in found]
        news = []
        for node in (*changed, *gone):
            if node["state"] == "asked":
                continue
            log.log(
                logging.WARNING if node["state"] in ("refused", "gone") else logging.INFO,
                "node %s (%s) is %s%s", node["id"][:12], node.get("name", ""), node["state"],
                f": {node['reason']}" if node["reason"] else "",
            )  # fmt: skip
            news.append({"kind": f"node_{node['state']}", "node": node["id"],
                         "name": node.get("name", ""), "reason": node["reason"]})  # fmt: skip
        return news

    @property
    def trouble(self) -> str:
        """Why nothing can be rendered now."""
        if self._reason or self.capacity:
            return self._reason
        refused = [f"{node['name']}: {node['reason']}" for node in self.nodes if node["reason"]]
        return "no node of the Ray cluster can be used" + "".join(f"; {why}" for why in refused)

    def press(self, now: float) -> bool:
        """Return false: the driver itself sees to it that its cancels are obeyed."""
        return False

    def exit_class(self, code: int | None) -> tuple[str, str]:
        """Return `lost`: the death of Ray, or of the driver, is the fault of no film."""
        words = super().exit_class(code)[1]
        return "lost", f"the Ray driver: {self._reason or words}"

    def _command(self) -> list[str]:
        o, c = self.options, self._cluster
        command = [sys.executable, "-m", "matiere.jobs.cluster.driver", "--address", c.address]
        command += ["--artifacts", str(o.artifacts), "--data", str(o.data), "--work", o.work]
        command += ["--threads", str(o.threads), "--limit", str(c.limit or 0)]
        command += ["--memory", str(c.child_memory_bytes), "--claim-limit", str(c.claim_limit_s)]
        return command
