"""`matiere nightly`: run the listed sweeps, compare each with its last good night, keep reports.

Everything it knows lies in its folder, so that whatever cuts it, the same command goes on:

    open.json                  the night that is being run; there only until it is done
    metals/2026-11-23/         a night of the sweep `metals` (`matiere.jobs.night`), with
        report.html, ...       its comparison with the last good night
        verdict.json           its outcome; written last: without it the night is not done
    index.html, nightly.log    all nights with links; what happened when

Submissions carry an idempotency key made of the night, the sweep and its content: a run that was
cut after submitting finds its sweep again.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from matiere.errors import MatiereError
from matiere.jobs import night as nights
from matiere.jobs.job import RENDERED
from matiere.jobs.night_options import CHANGED, INCOMPLETE, NO_CHANGE
from matiere.service import night_run
from matiere.service.client import Client, ServiceError, local_files
from matiere.service.nightly_config import NightlyConfig, NightlySweep
from matiere.service.sweep_run import submit
from matiere.service.sweepfile import load_sweep

Verdict = dict[str, Any]
OPEN, VERDICT, LOG, INDEX, LOCK = "open.json", "verdict.json", "nightly.log", "index.html", ".lock"
BROKEN = 2  # a sweep could not be run at all
POLL_S = 1.0
SAY_EVERY_S = 300.0
PATIENCE_S = 600.0  # a service may restart


@dataclass(frozen=True)
class Outcome:
    """What a night of one sweep came to."""

    sweep: str
    night: str
    exit_code: int
    statement: str


class Nightly:
    """The nights of a configuration file."""

    def __init__(self, config: NightlyConfig, say: Callable[[str], None]) -> None:
        """Report progress to `say`; it is logged too."""
        self.config, self.folder, self._tell = config, config.folder, say

    def run(self, name: str | None = None) -> list[Outcome]:
        """Finish a night that was cut, then run tonight's (or the one called `name`)."""
        tonight = name or datetime.now().astimezone().strftime("%Y-%m-%d")
        with self._alone():
            cut = self._open_night()
            todo = [cut, tonight] if cut not in (None, tonight) else [tonight]
            outcomes: list[Outcome] = []
            for one in todo:
                outcomes = self._night(str(one))
            return outcomes

    def accept(self, name: str | None = None) -> list[str]:
        """Call the newest night (or the one called `name`) of every sweep good; return which."""
        found = []
        with self._alone():
            for sweep in self.config.sweep:
                done = self.nights(sweep.title)
                chosen = [v for v in done if name in (None, v["night"])]
                if chosen:
                    place = self.folder / sweep.title / chosen[-1]["night"] / VERDICT
                    _write(place, chosen[-1] | {"good": True, "accepted": True})
                    found.append(f"{sweep.title}/{chosen[-1]['night']}")
            self._write_index()
        return found

    def nights(self, sweep: str) -> list[Verdict]:
        """Return the verdicts of a sweep's finished nights, oldest first."""
        found = []
        for path in (self.folder / sweep).glob(f"*/{VERDICT}"):
            with contextlib.suppress(OSError, ValueError):
                found.append(json.loads(path.read_text(encoding="utf-8")))
        return sorted(found, key=lambda v: (v["begun"], v["night"]))

    # -- one night ------------------------------------------------------------------------------
    def _night(self, name: str) -> list[Outcome]:
        begun = time.time()
        _write(self.folder / OPEN, {"night": name, "begun": begun})
        outcomes = []
        for sweep in self.config.sweep:
            try:
                outcomes.append(self._sweep(sweep, name, begun))
            except (MatiereError, OSError, TimeoutError) as error:
                self._say(f"{sweep.title}: {error}")
                outcomes.append(Outcome(sweep.title, name, BROKEN, str(error)))
            self._tidy(sweep.title, name)
        self._write_index()
        if not any(outcome.exit_code == BROKEN for outcome in outcomes):
            (self.folder / OPEN).unlink(missing_ok=True)
        return outcomes

    def _sweep(self, sweep: NightlySweep, name: str, begun: float) -> Outcome:
        place = self.folder / sweep.title / name
        for verdict in self.nights(sweep.title):
            if verdict["night"] == name:
                self._say(f"{sweep.title}: {name} was done before: {verdict['statement']}")
                return Outcome(sweep.title, name, verdict["exit_code"], verdict["statement"])
        with night_run.client_for(self.config.url, self.config.data) as client:
            client.patience_s = max(client.patience_s, PATIENCE_S)
            sweep_id = self._run_sweep(client, sweep, name)
            if place.exists():
                shutil.rmtree(place)  # what a cut run left
            night_run.export(client, sweep_id, place, name)
            verdict = self._compare(client, sweep.title, name) | {"begun": begun}
        _write(place / VERDICT, verdict)
        self._say(f"{sweep.title}: {verdict['statement']}")
        return Outcome(sweep.title, name, verdict["exit_code"], verdict["statement"])

    def _run_sweep(self, client: Client, sweep: NightlySweep, name: str) -> str:
        """Submit the sweep, or find it again, and wait for its end."""
        loaded = load_sweep(sweep.file)
        digest = loaded.digest(local_files(loaded.base, loaded.root))
        whole = f"{self.folder.resolve()}|{sweep.title}|{name}|{digest}"
        key = f"night-{hashlib.sha256(whole.encode()).hexdigest()}"
        status = submit(client, loaded, key)
        self._say(f"{sweep.title}: sweep {status.id}, {status.cells:,} cells")
        said = time.monotonic()
        while True:
            with contextlib.suppress(_NotYet):
                _ask_for_night(client, status.id)
                return status.id
            if time.monotonic() - said > SAY_EVERY_S:
                said = time.monotonic()
                now = client.sweep(status.id)
                waiting = sum(now.counts.get(s, 0) for s in ("queued", "running", "paused"))
                self._say(f"{sweep.title}: {now.cells - waiting:,} of {now.cells:,} cells ended")
            time.sleep(POLL_S)

    def _compare(self, client: Client, title: str, name: str) -> Verdict:
        """Compare a night with the last good one before it, and write the report beside it."""
        from matiere.jobs.compare_nights import compare_nights

        place = self.folder / title / name
        tonight = nights.open_folder(place)
        failed = sum(row["state"] not in RENDERED for row in tonight.rows())
        earlier = [v["night"] for v in self.nights(title) if v["good"] and v["night"] != name]
        verdict: Verdict = {"night": name, "sweep": title, "failed": failed, "accepted": False,
                            "sweep_id": tonight.head.get("sweep_id")}  # fmt: skip
        if not earlier:
            code = INCOMPLETE if failed else NO_CHANGE
            words = f"{len(tonight.rows()):,} cells, {failed:,} failed; no earlier good night"
            return verdict | {"against": None, "exit_code": code, "good": not failed,
                              "statement": words}  # fmt: skip
        before = nights.open_folder(self.folder / title / earlier[-1])
        report = compare_nights(before, tonight, self.config.options())
        pictures = {}
        with contextlib.suppress(MatiereError, OSError):  # nice to have, never in the way
            pictures = night_run.difference_pictures(client, report, place)
        night_run.write(report, place, pictures)
        code = int(report["exit_code"])
        return verdict | {"against": earlier[-1], "exit_code": code, "good": code == NO_CHANGE,
                          "statement": report["statement"]}  # fmt: skip

    # -- the folder -----------------------------------------------------------------------------
    def _tidy(self, title: str, tonight: str) -> None:
        """Remove the oldest nights beyond `keep`, never tonight or the last good one."""
        done = self.nights(title)
        good = [v["night"] for v in done if v["good"]][-1:]
        for verdict in done[: max(len(done) - self.config.keep, 0)]:
            if verdict["night"] not in (tonight, *good):
                shutil.rmtree(self.folder / title / verdict["night"], ignore_errors=True)

    def _write_index(self) -> None:
        from matiere.service.night_page import index

        found = {sweep.title: self.nights(sweep.title) for sweep in self.config.sweep}
        part = self.folder / f".{INDEX}.part"
        part.write_text(index(found), encoding="utf-8")
        part.replace(self.folder / INDEX)

    def _open_night(self) -> str | None:
        try:
            return str(json.loads((self.folder / OPEN).read_text(encoding="utf-8"))["night"])
        except (OSError, ValueError, KeyError):
            return None

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the folder, which the kernel gives back when the process ends."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / LOCK).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise MatiereError(
                    f"another `matiere nightly` is at work in {self.folder}"
                ) from None
            yield

    def _say(self, line: str) -> None:
        stamp = datetime.now().astimezone().isoformat(timespec="seconds")
        with (self.folder / LOG).open("a", encoding="utf-8") as log:
            log.write(f"{stamp} {line}\n")
        self._tell(line)


class _NotYet(Exception):
    """The sweep has cells that have not ended."""


def _ask_for_night(client: Client, sweep_id: str) -> None:
    try:
        client.night(sweep_id)
    except ServiceError as error:
        if error.code == "sweep_not_finished":
            raise _NotYet from None
        raise


def _write(path: Path, value: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
    part.replace(path)


def worst(outcomes: list[Outcome]) -> int:
    """Return one exit code: a change first, then what could not run, then gaps."""
    codes = {outcome.exit_code for outcome in outcomes}
    return next((code for code in (CHANGED, BROKEN, INCOMPLETE) if code in codes), NO_CHANGE)
