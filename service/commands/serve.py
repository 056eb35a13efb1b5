"""`matiere serve`: the HTTP service over one data directory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def serve(
    data: Annotated[
        Path | None, typer.Option(help="Data directory (default: $XDG_DATA_HOME/matiere).")
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            help="Address to listen on (default: 127.0.0.1); beyond loopback only with API keys."
        ),
    ] = None,
    port: Annotated[
        int | None, typer.Option(help="Port; 0 takes any free one (default: 8470).")
    ] = None,
    uds: Annotated[
        Path | None,
        typer.Option(help="Unix socket to listen on instead; only you may connect to it."),
    ] = None,
    children: Annotated[
        int | None, typer.Option(help="Render processes (default: one per usable core).")
    ] = None,
    threads_per_child: Annotated[
        int | None, typer.Option(help="Render threads of each process (default: 1).")
    ] = None,
    executor: Annotated[
        str | None, typer.Option(help="local, or ray: render on a cluster (default: local).")
    ] = None,
    ray_address: Annotated[
        str | None, typer.Option(help="Ray cluster (default: the one of this machine).")
    ] = None,
    log_level: Annotated[
        str | None, typer.Option(help="debug, info, warning or error (default: info).")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration file (TOML).")] = None,
) -> None:
    """Serve the HTTP API: take jobs and sweeps, render them, keep the results.

    Every setting can also come from MATIERE_<NAME> or a configuration file: see `matiere config`.
    """
    from matiere.service import server
    from matiere.service.settings import resolve

    flags = {
        "data": data,
        "host": host,
        "port": port,
        "uds": uds,
        "children": children,
        "threads_per_child": threads_per_child,
        "executor": executor,
        "ray_address": ray_address,
        "log_level": log_level,
    }
    resolved = resolve(flags, config=config)
    server.run(resolved.settings, announce=_announce)


def _announce(lines: list[tuple[str, str]]) -> None:
    width = max(len(name) for name, _ in lines)
    for name, value in lines:
        typer.echo(f"{name:<{width}}  {value}")
