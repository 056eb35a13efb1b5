"""Rows of artifacts and who needs them. A file goes when nobody refers to it any more.

Removal has three steps, so that a crash at any point leaves nothing wrong: the row is marked
`deleting`, the file is unlinked, the row is dropped (`garbage.unlink_marked`, which repeats what a
crash cut). Chunk files and replaced films are marked in the transaction that drops their last
reference; other files wait for the collector, which spares young ones. A reference to a file
without a row, or that is being deleted, is refused unless the file is there.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.errors import JobsError
from matiere.jobs.store.tables import artifact, job, reference, sweep

# Owners of results. What only they named waits for the collector; samples go at once.
LASTING = ("job", "sweep")


class FileGone(JobsError):
    """A file that was to be recorded is not there any more: it must be made again."""

    default_code = "file_missing"


@dataclass(frozen=True)
class Blob:
    """A file as a child reported it: SHA-256 (hex) and size in bytes."""

    digest: str
    size: int


def add_reference(c: Connection, owner: tuple[str, object], kind: str, blob: Blob) -> None:
    """Record `blob` as `kind` of `owner`, replacing what stood there."""
    add_references(c, owner, {kind: blob})


def add_references(c: Connection, owner: tuple[str, object], blobs: Mapping[str, Blob]) -> None:
    """Record files of `owner` by kind, replacing what stood there.

    Those of a job or sweep that was deleted meanwhile go, unless others name them.
    """
    sizes = {blob.digest: blob.size for blob in blobs.values()}
    _record(c, sizes)
    if owner[0] in LASTING and not _is_there(c, owner):
        mark_unreferenced(c, sizes)
        return
    place = (reference.c.owner == owner[0]) & (reference.c.owner_id == str(owner[1]))
    place &= reference.c.kind.in_(list(blobs))
    held = {r.kind: r.digest for r in c.execute(sa.select(reference).where(place))}
    if held:
        c.execute(sa.delete(reference).where(place))
    line = {"owner": owner[0], "owner_id": str(owner[1])}
    rows = [line | {"kind": kind, "digest": blob.digest} for kind, blob in blobs.items()]
    c.execute(sa.insert(reference), rows)
    if owner[0] not in LASTING:
        mark_unreferenced(c, set(held.values()) - set(sizes))


def _is_there(c: Connection, owner: tuple[str, object]) -> bool:
    table = {"job": job, "sweep": sweep}[owner[0]]
    return c.scalar(sa.select(table.c.id).where(table.c.id == owner[1])) is not None


def _record(c: Connection, sizes: Mapping[str, int]) -> None:
    """Have a live row for each file. Raises FileGone for one that the collector has taken."""
    mine = artifact.c.digest.in_(list(sizes))
    states = {r.digest: r.state for r in c.execute(sa.select(artifact).where(mine))}
    present = c.info.get("has_file")
    for digest, size in sizes.items():
        if present is not None and states.get(digest) != "live" and not present(digest, size):
            raise FileGone(f"artifact {digest} was deleted meanwhile")
    if "deleting" in states.values():
        c.execute(sa.update(artifact).where(mine).values(state="live"))
    row = {"state": "live", "created": time.time()}
    if new := [row | {"digest": d, "size": n} for d, n in sizes.items() if d not in states]:
        c.execute(sa.insert(artifact), new)


def set_references(
    c: Connection, owner: str, kind: str, held: Sequence[tuple[object, Blob]]
) -> None:
    """Record one file each for many owners, replacing what stood there."""
    if not held:
        return
    sizes = {blob.digest: blob.size for _, blob in held}
    _record(c, sizes)
    names = [str(owner_id) for owner_id, _ in held]
    place = (reference.c.owner == owner) & (reference.c.kind == kind)
    place &= reference.c.owner_id.in_(names)
    old = c.execute(sa.delete(reference).where(place).returning(reference.c.digest)).scalars().all()
    line = {"owner": owner, "kind": kind}
    rows = [line | {"owner_id": str(i), "digest": blob.digest} for i, blob in held]
    c.execute(sa.insert(reference), rows)
    if owner not in LASTING:
        mark_unreferenced(c, set(old) - set(sizes))


def drop_reference(c: Connection, owner: tuple[str, object], kind: str | None = None) -> None:
    """Forget what `owner` refers to: one kind or all."""
    drop_references(c, owner[0], [str(owner[1])], kind)


def drop_attempts(c: Connection, tokens: Iterable[int]) -> None:
    """Forget the chunk files of attempts."""
    drop_references(c, "attempt", [str(token) for token in tokens])


def drop_references(
    c: Connection, owner: str, owner_ids: Sequence[str], kind: str | None = None
) -> None:
    """Forget what several owners refer to; mark samples that nobody needs as `deleting`."""
    mine = (reference.c.owner == owner) & reference.c.owner_id.in_(owner_ids)
    if kind is not None:
        mine &= reference.c.kind == kind
    dropped = sa.delete(reference).where(mine).returning(reference.c.digest, reference.c.kind)
    gone = c.execute(dropped).all()
    mark_unreferenced(c, [digest for digest, k in gone if owner not in LASTING or k == "film"])


def discard(c: Connection, blobs: Iterable[Blob]) -> None:
    """Hand files that nobody wants to the collector."""
    for blob in blobs:
        add_reference(c, ("orphan", blob.digest[:32]), "file", blob)
        drop_reference(c, ("orphan", blob.digest[:32]))


def mark_unreferenced(c: Connection, digests: Iterable[str]) -> None:
    """Mark those of `digests` as `deleting` that no reference names."""
    if not (names := list(digests)):
        return
    wanted = sa.exists().where(reference.c.digest == artifact.c.digest)
    mine = artifact.c.digest.in_(names)
    c.execute(sa.update(artifact).where(mine, ~wanted).values(state="deleting"))


def pending_deletions(c: Connection, limit: int = 1000) -> list[str]:
    """Return digests whose files may be unlinked."""
    rows = sa.select(artifact.c.digest).where(artifact.c.state == "deleting").limit(limit)
    return list(c.execute(rows).scalars())


def unknown(c: Connection, digests: Sequence[str]) -> list[str]:
    """Return those digests that no row knows: left by a child that was killed before its report."""
    known = set(
        c.execute(sa.select(artifact.c.digest).where(artifact.c.digest.in_(digests))).scalars()
    )
    return [digest for digest in digests if digest not in known]


def references_of(c: Connection, owner: str, owner_ids: Iterable[str]) -> dict[str, list[str]]:
    """Return the kinds that each of `owner_ids` holds, sorted."""
    rows = c.execute(
        sa.select(reference.c.owner_id, reference.c.kind).where(
            reference.c.owner == owner, reference.c.owner_id.in_(list(owner_ids))
        )
    )
    kinds: dict[str, list[str]] = {}
    for owner_id, kind in rows:
        kinds.setdefault(owner_id, []).append(kind)
    return {owner_id: sorted(found) for owner_id, found in kinds.items()}


def find_reference(c: Connection, owner: tuple[str, object], kind: str) -> Blob | None:
    """Return digest and size of one referenced file."""
    row = c.execute(
        sa.select(artifact.c.digest, artifact.c.size)
        .join(reference, reference.c.digest == artifact.c.digest)
        .where(
            reference.c.owner == owner[0],
            reference.c.owner_id == str(owner[1]),
            reference.c.kind == kind,
        )
    ).first()
    return Blob(row.digest, row.size) if row else None
