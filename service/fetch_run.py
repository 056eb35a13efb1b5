"""Bringing files of ended jobs from the store: of one job, or of chosen cells of a sweep."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import typer

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.axes import did_you_mean
from matiere.jobs.condition import Condition, ConditionError, parse_condition
from matiere.service.client import Client, JobStatus, ServiceError, SweepStatus
from matiere.service.console import live
from matiere.service.settings import resolve
from matiere.service.sweep_output import CELL_FILES, OutputFolder
from matiere.service.sweep_run import open_client
from matiere.service.sweep_table import check_parquet, plain_of, texts_of

DIFFERENCE = "difference"  # a kind of file that sweeps with a baseline have
OF_A_JOB = ("cell", "state", "spp", "seconds", "relmse")  # names beside the axes
_RANGE = re.compile(r"(\d+)(?:-(\d+))?")


def run_fetch(
    what: str,
    output: Path | None,
    *,
    where: Sequence[str] = (),
    cells: str | None = None,
    kinds: Sequence[str] = (),
    parquet: bool = False,
    url: str | None = None,
    data: Path | None = None,
) -> int:
    """Bring the files; return how many cells have none because they did not succeed."""
    differences = DIFFERENCE in kinds
    plain = [kind for kind in kinds if kind != DIFFERENCE]
    endings = _endings(plain) if plain or not differences else ()
    conditions = [_condition(text) for text in where]
    wanted = _numbers(cells) if cells else None
    if parquet:
        check_parquet()
    folder = OutputFolder(Path(what)) if Path(what).is_dir() else None
    if folder is not None and folder.sweep_id is None:
        raise typer.BadParameter(f"{what} is not a folder that `matiere sweep` wrote")
    settings = resolve({"data": data}).settings
    with open_client(url, settings) as (client, _):
        sweep = _sweep(client, folder.sweep_id if folder and folder.sweep_id else what)
        if sweep is None and differences:
            why = "a job has no difference image; name its sweep, and the cell with --cells"
            raise typer.BadParameter(why, param_hint="--kind")
        if sweep is None:
            return _fetch_job(client, what, output or Path(), endings)
        target = _target(folder, output, sweep)
        jobs = list(client.jobs(sweep=sweep.id))
        chosen = choose(sweep, jobs, conditions, wanted)
        _bring(client, target, [j for j in chosen if j.rendered], endings)
        if differences:
            _bring_differences(client, target, sweep, [j for j in chosen if j.rendered])
        for path in target.finish(client, sweep, jobs, parquet=parquet):
            typer.echo(f"wrote {path}")
    bad = [job for job in chosen if not job.rendered]
    typer.echo(f"{len(chosen) - len(bad)} of {sweep.cells} cells are here", err=True)
    return len(bad)


def choose(
    sweep: SweepStatus,
    jobs: Sequence[JobStatus],
    conditions: Sequence[Condition],
    wanted: set[int] | None,
) -> list[JobStatus]:
    """Return the cells with these numbers for which every condition holds."""
    texts = texts_of(sweep)
    names = [*dict.fromkeys(label for job in jobs for label in job.parameters), *OF_A_JOB]
    for condition in conditions:
        for name in condition.names:
            if name not in names:
                raise _refused(f"no axis is called {name!r}; {did_you_mean(name, names)}")

    def getter(job: JobStatus) -> Callable[[str], Any]:
        def get(name: str) -> Any:
            if name in job.parameters:
                return plain_of(texts, name, job.parameters[name])
            return getattr(job, name) if name in OF_A_JOB else None

        return get

    try:
        return [
            job
            for job in jobs
            if (wanted is None or job.cell in wanted) and all(c(getter(job)) for c in conditions)
        ]
    except ConditionError as error:
        raise _refused(str(error)) from None


def _bring(
    client: Client, folder: OutputFolder, jobs: Sequence[JobStatus], endings: Sequence[str]
) -> None:
    with live("fetch") as show:
        for number, job in enumerate(jobs, 1):
            if not folder.has(job, endings):
                folder.fetch(client, job, endings)
            show(number, len(jobs), f"{number}/{len(jobs)} cells")


def _bring_differences(
    client: Client, folder: OutputFolder, sweep: SweepStatus, jobs: Sequence[JobStatus]
) -> None:
    if sweep.baseline is None:
        raise typer.BadParameter("this sweep has no baseline", param_hint="--kind")
    others = [job for job in jobs if job.cell != sweep.baseline]
    with live("differences") as show:
        for number, job in enumerate(others, 1):
            folder.fetch_difference(client, job)
            show(number, len(others), f"{number}/{len(others)} cells")


def _sweep(client: Client, name: str) -> SweepStatus | None:
    try:
        return client.sweep(name)
    except ServiceError as error:
        if error.code != "sweep_not_found":
            raise
        return None


def _target(folder: OutputFolder | None, output: Path | None, sweep: SweepStatus) -> OutputFolder:
    """Return the folder to write: that of the sweep, or another that is bound to it now."""
    if folder is not None and (output is None or output == folder.folder):
        return folder
    if output is None:
        raise typer.BadParameter("say where with -o", param_hint="--output")
    target = OutputFolder(output)
    if target.sweep_id != sweep.id:
        target.begin(sweep.id, f"sweep {sweep.id}")
    return target


def _fetch_job(client: Client, job_id: str, output: Path, endings: Sequence[str]) -> int:
    job = client.job(job_id)
    if not job.rendered:
        typer.echo(f"job {job_id} is {job.state}", err=True)
        return 1
    output.mkdir(parents=True, exist_ok=True)
    for ending in endings:
        typer.echo(f"wrote {client.fetch(job_id, CELL_FILES[ending], output / (job_id + ending))}")
    return 0


def _endings(kinds: Sequence[str]) -> tuple[str, ...]:
    endings = tuple("." + kind.lower().removeprefix(".") for kind in kinds) or tuple(CELL_FILES)
    if unknown := [ending for ending in endings if ending not in CELL_FILES]:
        known = ", ".join(ending[1:] for ending in CELL_FILES)
        raise typer.BadParameter(f"{unknown[0][1:]} is none of {known}", param_hint="--kind")
    return endings


def _numbers(text: str) -> set[int]:
    found: set[int] = set()
    for part in text.replace(" ", "").split(","):
        if not (match := _RANGE.fullmatch(part)):
            raise typer.BadParameter(f"{part!r} is no cell and no range", param_hint="--cells")
        found.update(range(int(match[1]), min(int(match[2] or match[1]), 10**6) + 1))
    return found


def _condition(text: str) -> Condition:
    try:
        return parse_condition(text)
    except ConditionError as error:
        raise _refused(str(error)) from None


def _refused(why: str) -> SceneValidationError:
    return SceneValidationError([Fault("--where", "bad_condition", why)])
