"""`matiere nightly`: run sweeps every night and say in the morning what changed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def nightly(
    config: Annotated[
        Path, typer.Argument(help="Configuration (TOML); see docs/nightly.md.", show_default=False)
    ],
    night: Annotated[
        str | None, typer.Option(help="Name of the night (default: today's date).")
    ] = None,
    accept: Annotated[
        bool,
        typer.Option("--accept", help="Run nothing: call the newest night good, changes and all."),
    ] = False,
) -> None:
    """Run the listed sweeps, compare each with its last good night, keep the reports.

    Cut by a reboot, the same command goes on where it stopped. Exit code 0: no change beyond noise;
    1: some cells changed; 2: wrong use, or a sweep could not run; 3: cells failed or are missing.
    Example: matiere nightly nightly.toml
    """
    from matiere.errors import MatiereError
    from matiere.service.nightly import Nightly, worst
    from matiere.service.nightly_config import check_name, load_config

    try:
        name = None if night is None else check_name(night)
    except ValueError as error:
        raise MatiereError(str(error)) from None
    runner = Nightly(load_config(config), typer.echo)
    if accept:
        for one in runner.accept(name):
            typer.echo(f"accepted {one}")
        return
    raise typer.Exit(worst(runner.run(name)))
