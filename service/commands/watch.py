"""`matiere watch`: follow a job or a sweep to its end."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer


def watch(
    id: Annotated[str, typer.Argument(help="Id of a job or sweep, as it was answered.")],
    patience: Annotated[
        float, typer.Option(min=0, help="Seconds to wait for a service that does not answer.")
    ] = 600.0,
    url: Annotated[
        str | None, typer.Option(help="The service (default: the one of the data directory).")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Data directory of the service.")] = None,
) -> None:
    """Show how a job or sweep goes on until it has ended: samples, error, time to its target.

    On a terminal a bar, elsewhere a line at every change. Goes on when the service is restarted.
    Exit code: 0 succeeded, 1 failed, 3 cancelled, 4 expired, 5 unfinished.
    """
    from matiere.service.client import SweepStatus
    from matiere.service.client_watch import find
    from matiere.service.find import client_of
    from matiere.service.watching import CODES, Watch, ended, goes_on

    with client_of(url, data) as client:
        status = find(client, id)
        client.patience_s = patience
        shown = Watch(client, status, sys.stdout)
        try:
            status = shown.run()
        except KeyboardInterrupt:
            kind = "sweep" if isinstance(status, SweepStatus) else "job"
            typer.echo(goes_on(kind, id, client.url), err=True)
            raise typer.Exit(130) from None
        typer.echo(ended(status))
        raise typer.Exit(CODES.get(status.state, 1))
