"""`matiere pause | resume | cancel | requeue | priority`: steer what is in the queue."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from matiere.service.client import Client, JobStatus, ServiceError, SweepStatus

Ids = Annotated[list[str], typer.Argument(help="Ids of jobs or sweeps, as they were answered.")]
Url = Annotated[
    str | None, typer.Option(help="The service (default: the one of the data directory).")
]
Data = Annotated[Path | None, typer.Option(help="Data directory of the service.")]


def pause(ids: Ids, url: Url = None, data: Data = None) -> None:
    """Hold jobs or sweeps back: what is being rendered ends, all samples are kept."""
    _steer("pause", ids, url, data)


def resume(ids: Ids, url: Url = None, data: Data = None) -> None:
    """Let paused jobs or sweeps go on, in their old place in the queue."""
    _steer("resume", ids, url, data)


def cancel(ids: Ids, url: Url = None, data: Data = None) -> None:
    """Cancel jobs or sweeps; a film that another job wants goes on."""
    _steer("cancel", ids, url, data)


def requeue(ids: Ids, url: Url = None, data: Data = None) -> None:
    """Start the next attempt of what failed, expired or was cancelled; samples are kept."""
    _steer("requeue", ids, url, data)


def delete(ids: Ids, url: Url = None, data: Data = None) -> None:
    """Remove jobs or sweeps with their results; what is being rendered is cancelled."""
    from matiere.service.client import ServiceError
    from matiere.service.find import client_of

    with client_of(url, data) as client:
        for name in ids:
            try:
                client.delete(name)
                typer.echo(f"job {name}  deleted")
            except ServiceError as error:
                if error.code != "job_not_found":
                    raise
                try:
                    client.delete_sweep(name)
                except ServiceError as second:
                    raise _unknown(second, name) from None
                typer.echo(f"sweep {name}  deleted")


def priority(
    id: Annotated[str, typer.Argument(help="Id of a job or sweep.")],
    value: Annotated[int, typer.Argument(min=0, max=100, help="0 to 100; higher runs first.")],
    url: Url = None,
    data: Data = None,
) -> None:
    """Change the priority of a job or sweep; the time it has waited still counts."""
    from matiere.service.find import client_of

    with client_of(url, data) as client:
        _each(
            id,
            lambda: client.set_priority(id, value),
            lambda: client.set_sweep_priority(id, value),
        )


def _steer(step: str, ids: list[str], url: str | None, data: Path | None) -> None:
    from matiere.service.find import client_of

    with client_of(url, data) as client:
        for name in ids:
            _each(name, *_ways(client, name, step))


def _ways(
    client: Client, name: str, step: str
) -> tuple[Callable[[], JobStatus], Callable[[], SweepStatus]]:
    return (lambda: client.steer(name, step)), (lambda: client.steer_sweep(name, step))


def _each(name: str, of_job: Callable[[], JobStatus], of_sweep: Callable[[], SweepStatus]) -> None:
    """Ask for a job, then for a sweep of this id, and print what stands."""
    from matiere.service.client import ServiceError

    try:
        job = of_job()
        typer.echo(f"job {job.id}  {job.state}  priority {job.priority}")
    except ServiceError as error:
        if error.code != "job_not_found":
            raise
        try:
            sweep = of_sweep()
        except ServiceError as second:
            raise _unknown(second, name) from None
        counts = ", ".join(f"{n} {state}" for state, n in sweep.counts.items() if n)
        typer.echo(f"sweep {sweep.id}  {counts}")


def _unknown(error: ServiceError, name: str) -> ServiceError:
    """Return what to raise when neither a job nor a sweep has this id."""
    from matiere.service.client import ServiceError

    if error.code != "sweep_not_found":
        return error
    return ServiceError({"code": "not_found", "detail": f"no job or sweep has the id {name}"}, 404)
