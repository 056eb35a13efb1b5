"""`matiere du | gc | pin | unpin | backup`: what is kept, for how long, and a copy of it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from matiere.jobs.storage import Storage
    from matiere.service.client import Client

Data = Annotated[Path | None, typer.Option(help="Data directory (default: as `matiere serve`).")]
Url = Annotated[str | None, typer.Option(help="A running service (default: the data directory's).")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Ids = Annotated[list[str], typer.Argument(help="Ids of jobs or sweeps, as they were answered.")]


def du(data: Data = None, url: Url = None, as_json: AsJson = False) -> None:
    """Print the bytes and files of the store, results, films and assets, and the limits."""
    with _storage(data, url) as storage:
        found = storage.usage()
    if as_json:
        typer.echo(json.dumps(found, indent=1))
        return
    rows = [("job store", found["store_bytes"], "")]
    words = {"results": "results", "films": "films", "chunks": "chunks of unfinished films",
             "unnamed": "nobody's"}  # fmt: skip
    for name, word in words.items():
        entry = found["artifacts"][name]
        rows.append((word, entry["bytes"], f"{entry['files']} files"))
    rows += [("assets", found["asset_bytes"], ""), ("logs", found["log_bytes"], "")]
    width = max(len(name) for name, _, _ in rows)
    for name, size, note in rows:
        typer.echo(f"{name:<{width}}  {_size(size):>9}  {note}".rstrip())
    typer.echo("")
    typer.echo(f"films may take {_size(found['film_limit_bytes'])}, the longest unused go first")
    typer.echo(f"results stay {found['result_days']:g} days; pinned ones for ever")
    low = " (disk_low: no new work is begun)" if found["disk_low"] else ""
    typer.echo(f"free disk {_size(found['disk_free_bytes'])}{low}, data in {found['data_dir']}")


def gc(
    data: Data = None,
    url: Url = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only tell what would be removed.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Remove results past their days, films beyond the limit and files that nobody names.

    The service does so by itself every ten minutes, and at once when the disk is low.
    """
    with _storage(data, url) as storage:
        found = storage.collect(dry_run=dry_run)
    if as_json:
        typer.echo(json.dumps(found, indent=1))
        return
    verb = "would remove" if dry_run else "removed"
    typer.echo(
        f"{verb} {found['jobs']} jobs, {found['sweeps']} sweeps, {found['films']} films "
        f"({_size(found['film_bytes'])}), {found['files']} files that nobody names "
        f"({_size(found['file_bytes'])})"
    )


def pin(ids: Ids, data: Data = None, url: Url = None) -> None:
    """Keep jobs or sweeps, with their results and films, whatever their age."""
    _pin(ids, True, data, url)


def unpin(ids: Ids, data: Data = None, url: Url = None) -> None:
    """Keep jobs or sweeps no longer than others."""
    _pin(ids, False, data, url)


def backup(
    target: Annotated[Path, typer.Argument(help="New folder to make.")], data: Data = None
) -> None:
    """Copy the data directory while the service runs; the copy is a data directory itself.

    Example: matiere backup /mnt/backup/matiere-monday; matiere serve --data /mnt/backup/...
    """
    from matiere.jobs.backup import backup as make
    from matiere.service.settings import resolve

    settings = resolve({"data": data}).settings
    done = make(
        settings.data,
        target.absolute(),
        database_url=settings.database_url,
        artifacts_url=settings.artifacts_url,
    )
    shared = f", {done.linked} as hard links" if done.linked else ""
    typer.echo(
        f"copied the job store, {done.files} files ({_size(done.bytes)}{shared}) and "
        f"{done.assets} assets to {target} in {done.seconds:.1f} s"
    )
    if settings.artifacts_url:
        typer.echo(f"not copied: the artifacts in {settings.artifacts_url}")


def _pin(ids: list[str], pinned: bool, data: Path | None, url: str | None) -> None:
    with _storage(data, url) as storage:
        for name in ids:
            kind = storage.pin(name, pinned)
            typer.echo(f"{kind} {name} {'is kept' if pinned else 'is kept no longer than others'}")


class _Served:
    """The storage of a running service."""

    def __init__(self, client: Client) -> None:
        self._client = client

    def usage(self) -> dict[str, Any]:
        return self._client.storage()

    def collect(self, *, dry_run: bool) -> dict[str, Any]:
        return self._client.collect(dry_run=dry_run)

    def pin(self, name: str, pinned: bool) -> str:
        return self._client.pin(name, pinned)


class _Idle:
    """The storage of a data directory that no service has open."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def usage(self) -> dict[str, Any]:
        return self._storage.usage()

    def collect(self, *, dry_run: bool) -> dict[str, Any]:
        return asdict(self._storage.collect(dry_run=dry_run))

    def pin(self, name: str, pinned: bool) -> str:
        return self._storage.pin(name, pinned)


@contextlib.contextmanager
def _storage(data: Path | None, url: str | None) -> Iterator[_Served | _Idle]:
    from matiere.jobs.storage import open_storage
    from matiere.service.find import running

    with running(data, url) as (client, settings):
        if client:
            yield _Served(client)
            return
        with open_storage(
            settings.data,
            settings.rules(),
            database_url=settings.database_url,
            artifacts_url=settings.artifacts_url,
        ) as storage:
            yield _Idle(storage)


def _size(size: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1000
    raise AssertionError
