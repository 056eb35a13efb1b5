"""`matiere submit`: send a scene to a running service, and fetch the image if asked."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from matiere.service.client import Client, FileKind, JobStatus

KINDS: dict[str, FileKind] = {
    ".png": "image.png",
    ".exr": "image.exr",
    ".json": "report.json",
    ".svg": "error.svg",
}


def submit(
    scene: Annotated[Path, typer.Argument(help="Scene file (JSON).")],
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help="Wait and write the result: .png image, .exr image with standard error,"
            " .json report, .svg plot of error against time. Can be given more than once.",
        ),
    ] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until the job has ended.")] = False,
    spp: Annotated[int | None, typer.Option(help="Samples per pixel.")] = None,
    seconds: Annotated[float | None, typer.Option(help="Render seconds.")] = None,
    target_error: Annotated[
        str | None,
        typer.Option(
            help="Stop at this error: 0.001 (relMSE), rmse_percent=1, or "
            "code_values=1,pixels_percent=95 (8-bit steps in the delivered image)."
        ),
    ] = None,
    priority: Annotated[int | None, typer.Option(help="0 to 100; higher runs first.")] = None,
    label: Annotated[str, typer.Option(help="A name for people.")] = "",
    deadline: Annotated[
        str | None,
        typer.Option(
            help="Seconds from now, or a moment (2026-11-24T06:00:00Z): the job ends then, as"
            " expired, with the samples it has."
        ),
    ] = None,
    after: Annotated[
        list[str] | None,
        typer.Option(
            help="Begin when this job or sweep has succeeded. Can be given more than once."
        ),
    ] = None,
    url: Annotated[
        str | None, typer.Option(help="The service (default: the one of the data directory).")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Data directory of the service.")] = None,
) -> None:
    """Submit a scene to a running service; files it names are uploaded if the service lacks them.

    Example: matiere submit scene.json --spp 64 -o out.png
    """
    from matiere.service.console import check_writable, upload_progress, worded
    from matiere.service.find import client_of
    from matiere.target import parse

    for path in output or []:
        if path.suffix.lower() not in KINDS:
            raise typer.BadParameter(
                f"{path}: the ending must be one of {', '.join(KINDS)}", param_hint="--output"
            )
        check_writable(path)
    stop = {"spp": spp, "seconds": seconds}
    given = {name: value for name, value in stop.items() if value is not None}
    rule = given | ({} if target_error is None else {"target_error": parse(target_error)})
    with client_of(url, data) as client:
        with worded(scene), upload_progress() as on_upload:
            job = client.submit(
                scene,
                stop=rule or None,
                priority=priority,
                label=label or scene.stem,
                deadline=_deadline(deadline),
                after=after or (),
                on_upload=on_upload,
            )
        if not (wait or output):
            typer.echo(f"{job.id}  {job.state}  {client.url}{job.links['self']}")
            return
        job = _wait(client, job)
        for path in output or []:
            client.fetch(job.id, KINDS[path.suffix.lower()], path)
            typer.echo(f"wrote {path}")
        if job.state != "succeeded":
            raise typer.Exit(1)


def _deadline(text: str | None) -> float | str | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def _wait(client: Client, job: JobStatus) -> JobStatus:
    from matiere.service.console import describe
    from matiere.service.watching import goes_on, job_progress

    try:
        with job_progress(job.label, client) as on_change:
            job = client.wait(job.id, on_change=on_change)
    except KeyboardInterrupt:
        typer.echo(
            goes_on("job", job.id, client.url),
            err=True,
        )
        raise typer.Exit(130) from None
    typer.echo(describe(job))
    if job.state != "succeeded" and "image_png" not in job.links:
        raise typer.Exit(1)
    return job
