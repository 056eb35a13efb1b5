"""Running a sweep from the command line, through a service or with a queue of its own.

Both ways speak HTTP: when no service holds the data directory, the same application is served on a
Unix socket that only this process knows, so there is one road for cells, files and errors.
"""

from __future__ import annotations

import contextlib
import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import typer

from matiere.errors import MatiereError
from matiere.jobs.errors import DataDirLocked
from matiere.service.client import Client, JobStatus, ServiceError, SweepStatus, local_files
from matiere.service.console import (
    Holdup,
    Remaining,
    check_writable,
    describe,
    format_time,
    live,
    upload_progress,
    worded,
)
from matiere.service.find import client_for
from matiere.service.lockfile import read_announcement
from matiere.service.settings import Settings, resolve
from matiere.service.sweep_check import verdicts
from matiere.service.sweep_output import CELL_FILES, OutputFolder
from matiere.service.sweep_table import check_parquet
from matiere.service.sweepfile import LoadedSweep, load_sweep

POLL_S = 0.5
MOST_FETCHED = 1000  # cells of which every file is brought without being asked for
FETCHED = {"all": tuple(CELL_FILES), "images": (".png",), "reports": (".json",), "none": ()}
MAX_LISTED = 3000  # cells up to which every poll lists them all
SHOWN_FAILURES = 10


def run_sweep(
    sweep_file: Path,
    output: Path,
    *,
    url: str | None = None,
    data: Path | None = None,
    children: int | None = None,
    fetch: str = "auto",
    parquet: bool = False,
    check: bool = False,
) -> int:
    """Render a sweep into `output`; return the number of cells that did not succeed.

    `fetch` says which files of cells to bring: a key of FETCHED, or "auto". With `check` the
    materials of every cell are tested too.
    """
    with worded(sweep_file):
        sweep = load_sweep(sweep_file)
    if parquet:
        check_parquet()
    check_writable(output / "table.csv")
    settings = resolve({"data": data, "children": children}).settings
    with open_client(url, settings) as (client, own):
        folder = OutputFolder(output)
        with worded(sweep_file):
            status = _attach(client, folder, sweep)
        where = "this process" if own else client.url
        typer.echo(f"{sweep.label}: {status.cells} cells, rendered by {where}", err=True)
        endings = FETCHED[_chosen(fetch, status.cells, output)]
        try:
            status, jobs = _follow(client, folder, status, sweep.label, endings)
            stability = verdicts(client, sweep.plan, jobs) if check else {}
        except KeyboardInterrupt:
            typer.echo(_farewell(client, status, own), err=True)
            raise typer.Exit(130) from None
        wrote = folder.finish(client, status, jobs, parquet=parquet, stability=stability)
        wrote += _night(client, status, output / "night")
        for path in wrote:
            typer.echo(f"wrote {path}")
    if open_ends := sum(job.state == "unfinished" for job in jobs):
        typer.echo(_unfinished(status, open_ends), err=True)
    failed = [job for job in jobs if job.state not in ("succeeded", "unfinished")]
    for job in failed[:SHOWN_FAILURES]:
        typer.echo(f"cell {job.cell} {describe(job)}", err=True)
    if len(failed) > SHOWN_FAILURES:
        typer.echo(f"... and {len(failed) - SHOWN_FAILURES} more; see table.csv", err=True)
    return len(failed)


def _unfinished(status: SweepStatus, cells: int) -> str:
    seconds = f"{status.budget.seconds:g} s" if status.budget else "the budget"
    return (
        f"{cells} of {status.cells} cells did not reach the target error within {seconds}; the "
        "table says how far they are, and a larger budget goes on from there"
    )


def _chosen(fetch: str, cells: int, output: Path) -> str:
    if fetch != "auto":
        return fetch
    if cells <= MOST_FETCHED:
        return "all"
    typer.echo(
        f"{cells:,} cells: their images stay in the store; bring some with\n"
        f"  matiere fetch {output} --where 'relmse > 0.01'   (or --fetch all with this command)",
        err=True,
    )
    return "none"


def _night(client: Client, status: SweepStatus, place: Path) -> list[Path]:
    """Write the sweep's night, unless something else of that name is there."""
    from matiere.jobs.night import may_replace
    from matiere.service.night_run import export

    with contextlib.suppress(MatiereError):  # a service of an older matiere keeps no nights
        if may_replace(place):
            return [export(client, status.id, place)]
    return []


def _farewell(client: Client, status: SweepStatus, own: bool) -> str:
    if own:
        return "stopped; what was rendered is kept, and the same command goes on from there"
    return (
        f"the sweep goes on at {client.url}; the same command shows it again, and\n"
        f"  curl -X POST {client.url}/v1/sweeps/{status.id}:cancel\ncancels it"
    )


@contextlib.contextmanager
def open_client(url: str | None, settings: Settings) -> Iterator[tuple[Client, bool]]:
    """Give a client, and whether the queue behind it is this process's own."""
    found = None if url else read_announcement(settings.data)
    if url or found:
        with client_for(found) if found else Client(url or "") as client:
            yield client, False
        return
    try:
        with own_service(settings) as client:
            yield client, True
    except DataDirLocked as locked:  # a service that started a moment ago
        if not locked.url:
            raise
        again = read_announcement(settings.data)
        with client_for(again) if again else Client(locked.url) as client:
            yield client, False


@contextlib.contextmanager
def own_service(settings: Settings) -> Iterator[Client]:
    """Open the data directory's queue in this process and give a client of it."""
    from matiere.jobs.engine import open_engine
    from matiere.service.app import create_app
    from matiere.service.logs import open_log
    from matiere.service.server import BackgroundServer, private_socket

    with contextlib.ExitStack() as stack:
        engine = stack.enter_context(open_engine(settings.data, **settings.engine_options()))
        open_log(settings.data, settings.log_level)
        sock, path = stack.enter_context(private_socket())
        app = create_app(engine, settings)
        stack.enter_context(BackgroundServer(app, sock))
        token = app.state.gate.owner_token
        yield stack.enter_context(Client("http://localhost", socket_path=path, key=token))


def _attach(client: Client, folder: OutputFolder, sweep: LoadedSweep) -> SweepStatus:
    """Return the sweep this folder was begun with if it can still succeed, else a new one.

    A new one costs little: cells whose films are stored are answered from them.
    """
    files = local_files(sweep.base, sweep.root)
    digest = sweep.digest(files)
    if folder.sweep_id is not None and folder.digest == digest:
        with contextlib.suppress(ServiceError):
            status = client.sweep(folder.sweep_id)
            lost = status.counts.get("failed", 0) + status.counts.get("cancelled", 0)
            if not lost:
                folder.begin(status.id, digest)
                return status
    status = submit(client, sweep)
    folder.begin(status.id, digest)
    return status


def submit(client: Client, sweep: LoadedSweep, key: str | None = None) -> SweepStatus:
    """Submit a sweep file's sweep, uploading what the service lacks."""
    with upload_progress() as on_upload:
        return client.submit_sweep(
            sweep.base,
            sweep.axes,
            mode=sweep.mode,
            columns=sweep.columns,
            label=sweep.label,
            priority=sweep.priority,
            asset_root=sweep.root,
            idempotency_key=key,
            on_upload=on_upload,
            **sweep.language,
        )


def _follow(
    client: Client,
    folder: OutputFolder,
    status: SweepStatus,
    label: str,
    endings: Sequence[str],
) -> tuple[SweepStatus, list[JobStatus]]:
    """Show progress and fetch each cell as it ends; return the sweep and all its cells."""
    remaining, holdup = Remaining(), Holdup(client)
    with live(label) as show:
        while True:
            status = client.sweep(status.id)
            if status.cells <= MAX_LISTED or status.ended:
                jobs = list(client.jobs(sweep=status.id))
                for job in jobs:
                    if endings and job.rendered and not folder.has(job, endings):
                        folder.fetch(client, job, endings)
                share = sum(job.progress for job in jobs) / max(len(jobs), 1)
            else:
                jobs = []
                share = status.ended_cells / max(status.cells, 1)
            if status.budget is not None:
                share = 1.0 if status.ended else min(status.budget.share, 0.99)
            left = None if status.ended else remaining.seconds(share)
            held = "" if status.ended else holdup.text()
            show(share, 1.0, _line(status, jobs, left) + held)
            if status.ended:
                return status, jobs
            time.sleep(POLL_S)


def _line(status: SweepStatus, jobs: list[JobStatus], left: float | None) -> str:
    parts = [f"{status.ended_cells}/{status.cells} cells"]
    open_ends = status.counts.get("unfinished", 0)
    if open_ends:
        parts.append(f"{open_ends} unfinished")
    if bad := status.ended_cells - status.counts.get("succeeded", 0) - open_ends:
        parts.append(f"{bad} failed")
    if status.budget is not None:
        parts.append(f"{status.budget.spent_s:.3g} of {status.budget.seconds:g} s spent")
    errors = [job.relmse for job in jobs if job.relmse is not None]
    if errors:
        parts.append(f"median relMSE {statistics.median(errors):.2e}")
    if not status.ended:
        parts.append(f"{format_time(left)} left")
    return ", ".join(parts)
