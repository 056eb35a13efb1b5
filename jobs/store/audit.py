"""An audit of the store: what must hold between transactions, whatever was killed when.

Counters equal sums over rows, no chunk is without its attempt, no reference without its artifact,
no artifact without its file. The tests of kills and crash points end with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.artifacts import Artifacts
from matiere.jobs.job import FINAL_STATES, RENDERED, JobState, queue_rank
from matiere.jobs.store import dependencies
from matiere.jobs.store.tables import (
    artifact,
    attempt,
    chunk,
    dependency,
    event,
    film,
    instance,
    job,
    job_history,
    reference,
    sweep,
)

FINAL = {state.value for state in FINAL_STATES}
HELD = {"claimed": "running", "done": "done"}  # state of a chunk -> state of its attempt
Samples = Callable[[Any, int], int]  # of a film's row and a chunk


def audit(c: Connection, samples: Samples | None = None) -> list[str]:
    """Return what is wrong with the rows, in words; `samples` tells those of a chunk."""
    checks = (_chunks(c), _attempts(c), _films(c, samples), _references(c), _jobs(c), _waiting(c),
              _history(c))  # fmt: skip
    return list(itertools.chain.from_iterable(checks))


def audit_files(c: Connection, folder: Artifacts) -> list[str]:
    """Return artifacts whose files are missing or of another size."""
    live = sa.select(artifact.c.digest, artifact.c.size).where(artifact.c.state == "live")
    return [
        f"artifact {row.digest} of {row.size} bytes has no such file"
        for row in c.execute(live)
        if not folder.has(row.digest, row.size)
    ]


def _chunks(c: Connection) -> Iterator[str]:
    rows = c.execute(
        sa.select(chunk, attempt.c.state.label("held"), attempt.c.film_id.label("of"))
        .add_columns(film.c.prefix_chunks)
        .join(film, film.c.id == chunk.c.film_id)
        .outerjoin(attempt, attempt.c.id == chunk.c.token)
    )
    for r in rows:
        name = f"chunk {r.idx} of film {r.film_id}"
        if r.held is None or r.of != r.film_id:
            yield f"{name} has no attempt"
        if r.state in HELD and r.held != HELD[r.state]:
            yield f"{name} is {r.state}, its attempt {r.held}"
        if r.idx < r.prefix_chunks:
            yield f"{name} lies inside the prefix of {r.prefix_chunks}"


def _attempts(c: Connection) -> Iterator[str]:
    held: dict[int, set[str]] = {}
    for token, state in c.execute(sa.select(chunk.c.token, chunk.c.state)):
        held.setdefault(token, set()).add(state)
    files = sa.select(reference.c.owner_id).where(reference.c.owner == "attempt")
    with_file = set(c.execute(files).scalars())
    over = set(c.execute(sa.select(instance.c.id).where(instance.c.ended.is_not(None))).scalars())
    for r in c.execute(sa.select(attempt)):
        name, states = f"attempt {r.id}", held.get(r.id, set())
        if r.state == "running" and "claimed" not in states:
            yield f"{name} runs and holds no chunk"
        if r.state == "running" and r.instance_id in over:
            yield f"{name} runs for an instance that has ended"
        if r.state == "done" and "done" not in states:
            yield f"{name} is done and holds no chunk"
        if (r.state == "done") != (str(r.id) in with_file):
            yield f"{name} is {r.state}, its file is {'kept' if str(r.id) in with_file else 'gone'}"
        if (r.ended is None) != (r.state == "running") and r.state != "void":
            yield f"{name} is {r.state} and ended at {r.ended}"


def _films(c: Connection, samples: Samples | None) -> Iterator[str]:
    kept = sa.select(reference.c.owner_id).where(
        reference.c.owner == "film", reference.c.kind == "prefix"
    )
    prefixes = set(c.execute(kept).scalars())
    done: dict[int, list[int]] = {}
    for film_id, idx in c.execute(
        sa.select(chunk.c.film_id, chunk.c.idx).where(chunk.c.state == "done")
    ):
        done.setdefault(film_id, []).append(idx)
    for r in c.execute(sa.select(film)):
        if (r.prefix_chunks > 0) != (str(r.id) in prefixes):
            yield f"film {r.id} has {r.prefix_chunks} merged chunks and no file of them"
        if samples is None:
            continue
        total = r.width * r.height * r.prefix_spp + sum(samples(r, i) for i in done.get(r.id, []))
        if r.pixel_samples != total:
            yield f"film {r.id} counts {r.pixel_samples} samples, its rows make {total}"


def _references(c: Connection) -> Iterator[str]:
    states = {r.digest: r.state for r in c.execute(sa.select(artifact))}
    owners = {"job": job, "film": film, "sweep": sweep, "attempt": attempt}
    known = {
        name: {str(i) for i in c.execute(sa.select(table.c.id)).scalars()}
        for name, table in owners.items()
    }
    for r in c.execute(sa.select(reference)):
        if states.get(r.digest) != "live":
            yield f"{r.owner} {r.owner_id} refers to {r.kind}, which is {states.get(r.digest)}"
        if r.owner in known and r.owner_id not in known[r.owner]:
            yield f"a {r.kind} is kept for {r.owner} {r.owner_id}, which is gone"


def _jobs(c: Connection) -> Iterator[str]:
    kinds: dict[str, set[str]] = {}
    for owner_id, kind in c.execute(
        sa.select(reference.c.owner_id, reference.c.kind).where(reference.c.owner == "job")
    ):
        kinds.setdefault(owner_id, set()).add(kind)
    for r in c.execute(sa.select(job)):
        name, mine = f"the {r.state} job {r.id}", kinds.get(r.id, set())
        ended = r.ended_spp is not None
        if (r.finished is not None) != (r.state in FINAL):
            yield f"{name} finished at {r.finished}"
        cut_short = r.state == JobState.UNFINISHED.value and not ended  # without a sample
        if r.state in RENDERED and not cut_short and not (ended and mine and "film" not in mine):
            yield f"{name} has files {sorted(mine)}, samples {r.ended_spp}"
        if r.state == JobState.CANCELLED.value and mine:
            yield f"{name} keeps {sorted(mine)}"
        if r.state not in FINAL and ended != ("film" in mine):
            yield f"{name} is complete: {ended}, and keeps {sorted(mine)}"
        if (r.error_code is not None) and r.state not in FINAL:
            yield f"{name} has the error {r.error_code}"
        if r.state == JobState.FAILED.value and r.error_code is None:
            yield f"{name} does not say why"
        if abs(r.rank - queue_rank(r.priority, r.queued)) > 1e-3:
            yield f"{name} has rank {r.rank}"


def _waiting(c: Connection) -> Iterator[str]:
    needs = {
        waiter: dependencies.count_open(c, waiter)
        for waiter in c.execute(sa.select(dependency.c.waiter).distinct()).scalars().all()
    }
    for r in c.execute(sa.select(job)):
        open_needs = needs.get(r.sweep_id or r.id, 0)
        if r.state not in FINAL and r.blockers != open_needs:
            yield f"the {r.state} job {r.id} waits for {r.blockers}, {open_needs} are not met"
        if r.state in ("running", "succeeded") and open_needs:
            yield f"the {r.state} job {r.id} did not wait for {open_needs} others"


def _history(c: Connection) -> Iterator[str]:
    past: dict[str, list[int]] = {}
    rows = sa.select(job_history.c.job_id, job_history.c.attempt, job_history.c.state)
    for job_id, number, state in c.execute(rows.order_by(job_history.c.attempt)):
        past.setdefault(job_id, []).append(number)
        if state not in FINAL or state in RENDERED:
            yield f"attempt {number} of job {job_id} was given up as {state}"
    for r in c.execute(sa.select(job.c.id, job.c.attempt)):
        if past.get(r.id, []) != list(range(1, r.attempt)):
            yield f"job {r.id} is at attempt {r.attempt} and remembers {past.get(r.id, [])}"
    begun = sa.select(event.c.job_id).where(event.c.kind == "queued").distinct()
    told = set(c.execute(begun).scalars())
    yield from (
        f"no event tells of job {i}" for i in c.execute(sa.select(job.c.id)).scalars()
        if i not in told
    )  # fmt: skip
