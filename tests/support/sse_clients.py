"""Listeners of an event stream that connect again by themselves, as a browser does."""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import httpx


@dataclass
class Listener:
    """One client of one address; `numbers` are the ids of what it received, in order."""

    address: str
    numbers: list[int] = field(default_factory=list)
    first: int | None = None  # number of the snapshot it began with
    last: str | None = None
    resets: int = 0
    connections: int = 0
    heartbeats: int = 0

    async def listen(self, base_url: str, over: asyncio.Event) -> None:
        """Receive until `over` is set, resuming with Last-Event-ID whenever the stream ends."""
        transport = httpx.AsyncHTTPTransport(retries=0)
        timeout = httpx.Timeout(20.0, connect=5.0)
        async with httpx.AsyncClient(
            base_url=base_url, transport=transport, timeout=timeout, trust_env=False
        ) as client:
            while not over.is_set():
                headers = {"Last-Event-ID": self.last} if self.last is not None else {}
                try:
                    async with client.stream("GET", self.address, headers=headers) as answer:
                        if answer.status_code == 200:
                            self.connections += 1
                            await self._receive(answer, over)
                except httpx.TransportError:
                    pass
                await asyncio.sleep(0.05)

    async def _receive(self, answer: httpx.Response, over: asyncio.Event) -> None:
        event: dict[str, str] = {}
        async for line in answer.aiter_lines():
            if over.is_set():
                return
            if line.startswith(":"):
                self.heartbeats += 1
            elif line:
                name, _, value = line.partition(": ")
                event[name] = value
            elif "id" in event:
                self._take(event)
                event = {}
            else:
                event = {}

    def _take(self, event: dict[str, str]) -> None:
        self.last = event["id"]
        number = int(event["id"])
        if event.get("event") == "snapshot":
            self.first = number
        elif event.get("event") == "reset":
            self.resets += 1
        else:
            assert json.loads(event["data"])["seq"] == number
            self.numbers.append(number)


def truth(base_url: str, address: str) -> list[int]:
    """Return the numbers of all events of an address, read page by page."""
    numbers: list[int] = []
    after = 0
    while True:
        answer = httpx.get(
            base_url + address, params={"after": after, "limit": 1000},
            headers={"Accept": "application/json"}, timeout=30, trust_env=False,
        )  # fmt: skip
        page: dict[str, Any] = answer.raise_for_status().json()
        if not page["events"]:
            return numbers
        numbers += [event["seq"] for event in page["events"]]
        after = page["last"]


def tally(listener: Listener, expected: list[int]) -> tuple[int, int, int]:
    """Return how many events a listener missed, got again, and got after a later one."""
    numbers = listener.numbers
    wanted = {n for n in expected if n > (listener.first or 0)}
    falls = sum(b < a for a, b in pairwise(numbers))
    return len(wanted - set(numbers)), len(numbers) - len(set(numbers)), falls


def faults(listener: Listener, expected: list[int]) -> list[str]:
    """Return what is wrong with what a listener received: gaps, repeats, disorder, resets."""
    found = []
    numbers = listener.numbers
    if numbers != sorted(set(numbers)):
        found.append("not strictly rising")
    wanted = [n for n in expected if n > (listener.first or 0)]
    if numbers != wanted:
        missing = sorted(set(wanted) - set(numbers))
        strange = sorted(set(numbers) - set(wanted))
        found.append(f"{len(missing)} missing {missing[:5]}, {len(strange)} strange {strange[:5]}")
    if listener.resets:
        found.append(f"{listener.resets} resets")
    return found
