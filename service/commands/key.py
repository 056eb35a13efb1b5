"""`matiere key create | list | rotate | revoke`: through the running service, or without one."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from matiere.jobs.keys import Key, Keys
    from matiere.service.client import Client

ACTIONS = ("create", "list", "rotate", "revoke")


def key(
    action: Annotated[str, typer.Argument(help="create, list, rotate or revoke.")],
    key_id: Annotated[str, typer.Argument(help="Id of the key to rotate or revoke.")] = "",
    name: Annotated[str, typer.Option(help="Whose key it is.")] = "",
    scope: Annotated[
        str, typer.Option(help="read, submit or admin; each includes those before it.")
    ] = "submit",
    days: Annotated[
        float | None, typer.Option(help="Days until the new key expires (default: never).")
    ] = None,
    overlap_hours: Annotated[
        float, typer.Option(help="After rotate: hours until the old key ends.")
    ] = 24.0,
    data: Annotated[
        Path | None, typer.Option(help="Data directory (default: as `matiere serve`).")
    ] = None,
    url: Annotated[
        str | None, typer.Option(help="A running service; needs MATIERE_API_KEY, an admin's.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Make, list, rotate and revoke the API keys of a service.

    Example: matiere key create --name ci --scope submit --days 90
    """
    if action not in ACTIONS:
        raise typer.BadParameter(f"{action!r} is none of {', '.join(ACTIONS)}")
    if (action in ("rotate", "revoke")) != bool(key_id):
        raise typer.BadParameter("rotate and revoke take the id of a key, the others none")
    if action == "create" and not name:
        raise typer.BadParameter("say whose key it is", param_hint="--name")
    with _keys(data, url) as keys:
        if action == "list":
            _print_all(keys.keys(), as_json)
            return
        if action == "revoke":
            done = keys.revoke_key(key_id)
            typer.echo(json.dumps(done, indent=1) if as_json else f"key {key_id} is revoked")
            return
        if action == "create":
            made = keys.create_key(name, scope, days)
        else:
            made = keys.rotate_key(key_id, days=days, overlap_hours=overlap_hours)
    if as_json:
        typer.echo(json.dumps(made, indent=1))
        return
    typer.echo(made["key"])
    until = f"until {made['expires']}" if made["expires"] else "without end"
    typer.echo(f"key {made['id']} of {made['name']}, scope {made['scope']}, {until}", err=True)
    typer.echo("It is shown this once. Clients take it from MATIERE_API_KEY.", err=True)


def _print_all(found: list[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(found, indent=1))
        return
    for one in found:
        end = f"revoked {one['revoked']}" if one["revoked"] else one["expires"] or "never"
        typer.echo(f"{one['id']}  {one['scope']:<6}  expires {end}  {one['name']}")


class _Idle:
    """The keys of a data directory that no service has open."""

    def __init__(self, keys: Keys) -> None:
        self._keys = keys

    def keys(self) -> list[dict[str, Any]]:
        return [_shown(one) for one in self._keys.list()]

    def create_key(self, name: str, scope: str, days: float | None) -> dict[str, Any]:
        made, text = self._keys.create(name, scope, days)
        return _shown(made) | {"key": text}

    def rotate_key(
        self, key_id: str, *, days: float | None, overlap_hours: float
    ) -> dict[str, Any]:
        made, text = self._keys.rotate(key_id, days=days, overlap_hours=overlap_hours)
        return _shown(made) | {"key": text}

    def revoke_key(self, key_id: str) -> dict[str, Any]:
        return _shown(self._keys.revoke(key_id))


def _shown(one: Key) -> dict[str, Any]:
    times = {
        name: value and datetime.fromtimestamp(value, UTC).isoformat().replace("+00:00", "Z")
        for name, value in (
            ("created", one.created), ("expires", one.expires), ("revoked", one.revoked)
        )
    }  # fmt: skip
    return {"id": one.id, "name": one.name, "scope": one.scope, **times}


@contextlib.contextmanager
def _keys(data: Path | None, url: str | None) -> Iterator[Client | _Idle]:
    from matiere.jobs.keys import open_keys
    from matiere.service.find import running

    with running(data, url) as (client, settings):
        if client:
            yield client
            return
        with open_keys(settings.data, settings.database_url) as keys:
            yield _Idle(keys)
