"""Sends what waits in the outbox to webhooks, signed as standardwebhooks.com describes.

One thread with an event loop of its own. An attempt has a limit of time as a whole, follows no
redirect, uses no proxy of the environment, and reads little of the answer.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import hmac
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable

import httpx

from matiere import __version__
from matiere.errors import MatiereError
from matiere.jobs.webhooks import HELD_S, Message, Webhooks
from matiere.service.webhook_guard import AddressRefused, Guard

ATTEMPT_S = 15.0
POLL_S = 0.5
MOST_AT_ONCE, MOST_PER_WEBHOOK = 16, 2
MAX_ANSWER = 4096

assert ATTEMPT_S < HELD_S

log = logging.getLogger("matiere.service.webhooks")


class Gone(Exception):
    """The receiver answered 410: it wants nothing any more."""


class Refused(Exception):
    """The receiver did not take the message."""


def sign(secret: str, message_id: str, timestamp: int, body: bytes) -> str:
    """Return the `webhook-signature` of a message."""
    key = base64.b64decode(secret.removeprefix("whsec_"))
    signed = f"{message_id}.{timestamp}.".encode() + body
    return "v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()


class Sender(threading.Thread):
    """Sends until it is stopped; use it in a `with` block."""

    def __init__(
        self, webhooks: Webhooks, guard: Guard, clock: Callable[[], float] = time.time
    ) -> None:
        """Send what waits in `webhooks` where `guard` allows."""
        super().__init__(name="matiere-webhooks", daemon=True)
        self._webhooks, self._guard, self._clock = webhooks, guard, clock
        self._stopping = threading.Event()
        self._busy: Counter[str] = Counter()  # attempts under way by webhook
        self.tls = httpx.create_ssl_context(trust_env=False)

    def __enter__(self) -> Sender:
        """Start."""
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop; attempts under way are broken off, and made again after the next start."""
        self._stopping.set()
        self.join(5.0)

    def run(self) -> None:
        """Send."""
        asyncio.run(self._run())

    async def _run(self) -> None:
        await asyncio.to_thread(self._webhooks.recover)
        tasks: set[asyncio.Task[None]] = set()
        while not self._stopping.is_set():
            try:
                for message in await asyncio.to_thread(self._claim):
                    self._busy[message.webhook_id] += 1
                    task = asyncio.create_task(self._attempt(message))
                    tasks.add(task)
                    task.add_done_callback(tasks.discard)
            except MatiereError:  # a full disk, a database that is away for a moment
                log.warning("cannot read the outbox; trying again", exc_info=True)
            await asyncio.sleep(POLL_S)
        for task in tasks:
            task.cancel()

    def _claim(self) -> list[Message]:
        """Hold what may be sent now: one message of each webhook that has time for it."""
        found: list[Message] = []
        while len(found) + self._busy.total() < MOST_AT_ONCE:
            taken = Counter(message.webhook_id for message in found) + self._busy
            full = [name for name, count in taken.items() if count >= MOST_PER_WEBHOOK]
            more = self._webhooks.claim(1, full)
            if not more:
                break
            found += more
        return found

    async def _attempt(self, message: Message) -> None:
        try:
            action = await self._outcome(message)
            await asyncio.to_thread(action)
        except MatiereError:  # it could not be written down: the claim runs out
            log.warning("cannot note what became of %s", message.id, exc_info=True)
        finally:
            self._busy[message.webhook_id] -= 1

    async def _outcome(self, message: Message) -> Callable[[], None]:
        """Send a message; return what is to be written down."""
        try:
            async with asyncio.timeout(ATTEMPT_S):
                await self._post(message)
        except Gone:
            log.info("webhook %s wants nothing any more (410)", message.webhook_id)
            return lambda: self._webhooks.gone(message, "the receiver answered 410 Gone")
        except TimeoutError:
            error = f"no answer within {ATTEMPT_S:g} s"
        except (AddressRefused, Refused) as refused:
            error = str(refused)
        except (OSError, httpx.HTTPError) as failure:  # no such name, no connection, no TLS
            error = f"{type(failure).__name__}: {failure}"[:200]
        else:
            return lambda: self._webhooks.delivered(message)
        log.info("webhook %s, attempt %d of %s: %s", message.webhook_id, message.tries,
                 message.id, error)  # fmt: skip
        return lambda: self._webhooks.failed(message, error)

    async def _post(self, message: Message) -> None:
        url, name = await self._guard.target(message.url)
        now = int(self._clock())
        headers = {
            "Host": httpx.URL(message.url).netloc.decode("ascii"),
            "Content-Type": "application/json",
            "User-Agent": f"matiere/{__version__}",
            "Accept-Encoding": "identity",
            "webhook-id": message.id,
            "webhook-timestamp": str(now),
            "webhook-signature": sign(message.secret, message.id, now, message.body),
        }
        async with (
            httpx.AsyncClient(
                verify=self.tls, trust_env=False, follow_redirects=False, timeout=ATTEMPT_S
            ) as client,
            client.stream(
                "POST", url, content=message.body, headers=headers,
                extensions={"sni_hostname": name},
            ) as answer,
        ):  # fmt: skip
            status = answer.status_code
            with contextlib.suppress(httpx.HTTPError):  # the status says it all
                await _read_some(answer)
        if status == 410:
            raise Gone
        if not 200 <= status < 300:
            raise Refused(f"the receiver answered {status}")


async def _read_some(answer: httpx.Response) -> None:
    """Read a short answer to its end, so that the receiver sees no broken connection."""
    size = 0
    async for piece in answer.aiter_raw():
        size += len(piece)
        if size > MAX_ANSWER:
            return
