"""Retention and garbage: what goes, what stays, and that nothing wanted goes in between."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from conftest_jobs import FAKE, SCENE, open_engine, report_of, stored, submit_sweep, wait_until

from matiere.jobs import Engine
from matiere.jobs.datadir import DataDir
from matiere.jobs.errors import JobNotFound
from matiere.jobs.rules import Rules
from matiere.jobs.storage import DAY_S, Storage, holding
from matiere.jobs.store import files, films, garbage, jobs, tables, views
from matiere.jobs.store.database import Database
from matiere.jobs.store.files import Blob, FileGone

RULES = Rules(result_days=30.0, film_bytes=0, grace_hours=24.0)


class Shelf:
    """A store with files, whose clock the test turns."""

    def __init__(self, root: Path, rules: Rules = RULES) -> None:
        self.data = DataDir.open(root)
        url = stored(root).get("database_url")
        self.db = Database(None if url else self.data.store, url)
        self.db.write(lambda c: films.void_dead(c, "first", 1))
        self.db.has_file = self.data.artifacts.has
        self.now = time.time()
        self.storage = Storage(self.data, self.db, rules, lambda: self.now)

    def close(self) -> None:
        self.db.close()
        self.data.close()

    def blob(self, text: str) -> Blob:
        return Blob(*self.data.artifacts.write([text.encode()]))

    def spec(self, number: int) -> jobs.JobSpec:
        film = jobs.FilmSpec(f"{number:064x}", "g", {"w": 1}, {}, 8, 8, 2)
        return jobs.JobSpec(film, {"spp": 8}, 8, {}, 50, str(number))

    def submit(self, number: int) -> str:
        return self.db.write(lambda c: jobs.submit_job(c, self.spec(number)))

    def done(self, number: int) -> str:
        """Submit a job, give its film a prefix and the job an image, as the scheduler does."""
        job_id = self.submit(number)
        film_id = self.db.read(lambda c: films.film_of(c, job_id))
        prefix = self.blob(f"film {number}")
        facts = {"spp": 8, "seconds": 1.0, "relmse": 0.5, "lower": 0.4, "upper": 0.6}
        ended = [{"job_id": job_id, "reason": "spp", "cached": False, **facts}]
        merged = films.Merged(film_id, 0, 4, prefix, facts, ended, {})
        assert self.db.write(lambda c: films.commit_merge(c, merged))
        image = self.blob(f"image {number}")
        assert self.db.write(lambda c: jobs.finish_job(c, job_id, {"image.png": image}))
        return job_id

    def image(self, number: int) -> Path:
        return self._path(f"image {number}")

    def film(self, number: int) -> Path:
        return self._path(f"film {number}")

    def _path(self, text: str) -> Path:
        return self.data.artifacts.path(hashlib.sha256(text.encode()).hexdigest())

    def state(self, job_id: str) -> str:
        return self.db.read(lambda c: views.get_job(c, job_id)).state.value

    def count(self, table: Any) -> int:
        return self.db.read(lambda c: c.scalar(sa.select(sa.func.count()).select_from(table)) or 0)


@pytest.fixture
def shelf(tmp_path: Path, store: str) -> Iterator[Shelf]:
    made = Shelf(tmp_path / "data")
    yield made
    made.close()


# -- retention ----------------------------------------------------------------------------------
def test_results_go_after_their_days_and_pinned_ones_stay(shelf: Shelf) -> None:
    old, pinned = shelf.done(1), shelf.done(2)
    assert shelf.storage.pin(pinned, True) == "job"
    shelf.now += 29 * DAY_S
    assert shelf.storage.collect().jobs == 0
    shelf.now += 2 * DAY_S
    young = shelf.submit(3)
    foreseen = shelf.storage.collect(dry_run=True)
    assert (foreseen.jobs, shelf.state(old)) == (1, "succeeded"), "a dry run removes nothing"
    assert shelf.storage.collect().jobs == 1
    with pytest.raises(JobNotFound):
        shelf.state(old)
    assert (shelf.state(pinned), shelf.state(young)) == ("succeeded", "queued")
    assert not shelf.image(1).exists() and shelf.image(2).exists() and shelf.film(2).exists()
    assert not shelf.storage.collect().anything, "a second collection finds nothing"
    shelf.storage.pin(pinned, False)
    assert shelf.storage.collect().jobs == 1
    assert shelf.count(tables.film) == 1, "only the film somebody waits for"
    left = shelf.db.read(lambda c: c.execute(sa.select(tables.event.c.job_id).distinct()).all())
    assert [row[0] for row in left] == [young], "the events of removed jobs went with them"


def test_a_sweep_goes_whole_or_stays_whole(shelf: Shelf) -> None:
    sweeps = []
    for base in (10, 20, 30):
        sweeps.append(submit_sweep(shelf.db, 3, str(base), plan=shelf.blob("plan")))
        shelf.db.write(jobs.cancel_sweep, sweeps[-1])
        shelf.db.write(jobs.finish_sweep, sweeps[-1], shelf.blob(sweeps[-1]))
    gone, kept, by_cell = sweeps
    assert shelf.storage.pin(kept, True) == "sweep"
    cell = shelf.db.read(lambda c: views.list_jobs(c, None, by_cell, None, 9))[1]
    shelf.storage.pin(cell.id, True)
    shelf.now += 31 * DAY_S
    assert shelf.storage.collect().sweeps == 1
    found = shelf.db.read(lambda c: views.list_sweeps(c, None, 9))
    left = {sweep.id: sum(sweep.counts.values()) for sweep in found}
    assert left == {kept: 3, by_cell: 3}
    with pytest.raises(JobNotFound):
        shelf.storage.pin(gone, True)


def test_films_go_in_the_order_of_their_last_use(tmp_path: Path, store: str) -> None:
    shelf = Shelf(tmp_path / "data", Rules(film_bytes=13))  # two films of 6 bytes
    named = [shelf.done(n) for n in (1, 2, 3)]
    used = sa.update(tables.film)
    for film_id, age in ((1, 300.0), (2, 500.0), (3, 400.0)):
        then = used.where(tables.film.c.id == film_id).values(used=shelf.now - age)
        shelf.db.write(sa.Connection.execute, then)
    found = shelf.storage.collect()
    assert (found.films, found.film_bytes) == (1, 6)
    assert [shelf.film(n).exists() for n in (1, 2, 3)] == [True, False, True]
    assert all(shelf.image(n).exists() for n in (1, 2, 3)), "results outlive their film"
    assert shelf.db.read(lambda c: views.get_job(c, named[1])).spp == 8
    again = shelf.submit(2)
    assert shelf.state(again) == "succeeded", "the same request is answered from the results"
    shelf.close()


def test_rows_of_past_work_go_and_no_token_comes_twice(shelf: Shelf) -> None:
    def count() -> list[int]:
        tables_of = (tables.attempt, tables.instance)
        wanted = [sa.select(sa.func.count()).select_from(table) for table in tables_of]
        return shelf.db.read(lambda c: [int(c.scalar(one) or 0) for one in wanted])

    job_id = shelf.submit(1)
    film_id = shelf.db.read(lambda c: films.film_of(c, job_id))

    def claim(chunk: int, instance: str = "first") -> int:
        wanted = films.Claim(film_id, [chunk], instance, 1, 30.0)
        token = shelf.db.write(lambda c: films.claim(c, wanted))
        assert token is not None
        return token

    lost = claim(0)
    shelf.db.write(lambda c: films.give_back(c, films.Loss(lost, film_id, "failed")))
    kept = claim(0)
    report = films.Report(kept, film_id, shelf.blob("chunk"), 1.0, 64)
    assert shelf.db.write(lambda c: films.complete(c, report))
    gone = claim(1)
    shelf.db.write(lambda c: films.give_back(c, films.Loss(gone, film_id, "lost")))
    shelf.db.write(lambda c: films.void_dead(c, "second", 2))
    newest = claim(1, "second")
    shelf.db.write(lambda c: films.give_back(c, films.Loss(newest, film_id, "lost")))
    shelf.storage.collect()
    assert count() == [4, 2]  # too young
    shelf.now += 31 * DAY_S
    shelf.storage.collect()
    assert count() == [2, 2]  # one holds a chunk that is not merged, one is the newest
    assert claim(2, "second") > newest


def test_a_file_nobody_names_is_spared_for_a_day(shelf: Shelf) -> None:
    job_id = shelf.done(1)
    shelf.db.write(lambda c: files.drop_reference(c, ("job", job_id)))
    assert shelf.storage.collect(dry_run=True).files == 0 and shelf.image(1).exists()
    shelf.now += 25 * 3600
    found = shelf.storage.collect(dry_run=True)
    assert (found.files, found.file_bytes) == (1, 7)
    shelf.storage.collect()
    assert not shelf.image(1).exists()


# -- interleavings ------------------------------------------------------------------------------
def test_a_hit_between_choosing_and_evicting_keeps_the_film(shelf: Shelf) -> None:
    shelf.done(1)
    chosen = shelf.db.read(lambda c: garbage.cold_films(c, 10))
    other = jobs.JobSpec(shelf.spec(1).film, {"spp": 8}, 8, {"view": 2}, 50, "other view")
    hit = shelf.db.write(lambda c: jobs.submit_job(c, other))  # answered from the film
    assert shelf.db.read(lambda c: views.get_job(c, hit)).cached
    assert shelf.db.write(lambda c: garbage.evict_films(c, [film.id for film in chosen])) == 0
    assert shelf.film(1).exists()


def test_a_hit_between_choosing_and_removing_keeps_the_result(shelf: Shelf) -> None:
    old = shelf.done(1)
    before = time.time() + 1
    chosen = shelf.db.read(lambda c: garbage.old_jobs(c, before, 10))
    assert chosen == [old]
    hit = shelf.submit(1)  # takes its references in the transaction of the lookup
    assert shelf.state(hit) == "succeeded"
    assert shelf.db.write(lambda c: garbage.remove_jobs(c, chosen, before)) == 1
    shelf.now += 25 * 3600
    shelf.storage.collect()
    assert shelf.image(1).exists(), "the second job names it"


def test_a_reference_between_marking_and_unlinking_keeps_the_file(shelf: Shelf) -> None:
    job_id = shelf.done(1)
    shelf.db.write(lambda c: files.drop_reference(c, ("job", job_id)))
    assert shelf.db.write(lambda c: garbage.mark_unnamed(c, time.time() + 1, 10)) == 1
    again = shelf.blob("image 1")  # a child makes the same image again
    shelf.db.write(lambda c: files.add_reference(c, ("job", job_id), "image.png", again))
    shelf.storage.unlink()
    assert shelf.image(1).exists()


def test_a_reference_after_unlinking_is_refused_and_its_file_made_again(shelf: Shelf) -> None:
    job_id = shelf.done(1)
    shelf.db.write(lambda c: files.drop_reference(c, ("job", job_id)))
    late = shelf.blob("image 1")  # written while the old one is still there ...
    shelf.db.write(lambda c: garbage.mark_unnamed(c, time.time() + 1, 10))
    assert shelf.storage.unlink() == 1  # ... unlinked before its report arrives
    with pytest.raises(FileGone):
        shelf.db.write(lambda c: files.add_reference(c, ("job", job_id), "image.png", late))
    made = shelf.blob("image 1")
    shelf.db.write(lambda c: files.add_reference(c, ("job", job_id), "image.png", made))
    assert shelf.image(1).exists()


def test_a_collector_killed_after_unlinking_leaves_nothing_wrong(
    shelf: Shelf, monkeypatch: pytest.MonkeyPatch
) -> None:
    job_id = shelf.done(1)
    shelf.db.write(lambda c: files.drop_reference(c, ("job", job_id)))
    shelf.db.write(lambda c: garbage.mark_unnamed(c, time.time() + 1, 10))
    folder = shelf.data.artifacts

    def die(digests: Any) -> None:
        for digest in digests:
            folder.remove(digest)
        raise KeyboardInterrupt("killed before the commit")

    with pytest.raises(KeyboardInterrupt):
        shelf.db.write(lambda c: garbage.unlink_marked(c, die, 10))
    row = shelf.db.read(lambda c: c.execute(sa.select(tables.artifact.c.state)).scalars().all())
    assert sorted(row) == ["deleting", "live"], "the row still tells what was begun"
    with pytest.raises(FileGone):
        late = Blob(shelf.image(1).name, 7)
        shelf.db.write(lambda c: files.add_reference(c, ("job", job_id), "image.png", late))
    assert shelf.storage.unlink() == 1


def test_nothing_is_unlinked_while_a_backup_holds_the_files(shelf: Shelf) -> None:
    job_id = shelf.done(1)
    shelf.db.write(lambda c: files.drop_reference(c, ("job", job_id)))
    shelf.now += 25 * 3600
    with holding(shelf.data.root, exclusive=False) as held:
        assert held
        shelf.storage.collect()
        assert shelf.image(1).exists()
    shelf.storage.unlink()
    assert not shelf.image(1).exists()


def test_a_stranger_that_is_recorded_meanwhile_stays(
    shelf: Shelf, monkeypatch: pytest.MonkeyPatch
) -> None:
    late, lost, owner = shelf.blob("late"), shelf.blob("lost"), shelf.submit(9)
    for blob in (late, lost):
        os.utime(shelf.data.artifacts.path(blob.digest), (1e9, 1e9))
    real, seen = files.unknown, []

    def slow(c: Any, digests: Any) -> list[str]:
        found = real(c, digests)
        if not seen:  # after the first look, before the transaction that unlinks
            seen.append(1)
            shelf.db.write(lambda w: files.add_reference(w, ("job", owner), "image.png", late))
        return found

    monkeypatch.setattr(files, "unknown", slow)
    shelf.storage.remove_strangers(2e9, lambda: False)
    assert shelf.data.artifacts.path(late.digest).exists()
    assert not shelf.data.artifacts.path(lost.digest).exists()


def test_where_services_share_a_store_strangers_have_their_grace(shelf: Shelf) -> None:
    grace = 24 * 3600.0 if shelf.db.shared else 0.0
    assert shelf.storage.strangers_before(1e9) == 1e9 - grace


# -- a running service --------------------------------------------------------------------------
def test_an_evicted_film_is_rendered_again_to_the_same_bits(tmp_path: Path, store: str) -> None:
    rules = Rules(film_bytes=0)
    with open_engine(tmp_path / "data", children=2, rules=rules, **FAKE) as engine:
        first = engine.wait_job(engine.submit_job(SCENE).id, 30)
        sums = report_of(engine, first.id)["sums"]
        assert engine.storage.collect().films == 0, "of use a moment ago"
        age(engine, 120.0)
        assert engine.storage.collect().films == 1
        assert engine.storage.usage()["artifacts"]["films"] == {"files": 0, "bytes": 0}
        view = engine.submit_job(SCENE | {"output": {"exposure": 1}})
        view = engine.wait_job(view.id, 30)
        assert (view.state, view.cached) == ("succeeded", False)
        assert report_of(engine, view.id)["sums"] == sums
        assert engine.status()["counters"].get("files_damaged", 0) == 0


def age(engine: Engine, seconds: float) -> None:
    """Make all films older."""
    older = sa.update(tables.film).values(used=tables.film.c.used - seconds)
    engine._db.write(lambda c: c.execute(older))


def test_usage_counts_every_file_once(tmp_path: Path, store: str) -> None:
    with open_engine(tmp_path / "data", children=1, **FAKE) as engine:
        engine.wait_job(engine.submit_job(SCENE).id, 30)
        engine.submit_job(SCENE)  # the same files again
        folder = tmp_path / "data" / "artifacts"
        wait_until(lambda: len(list(folder.glob("??/??/*"))) == 7)  # film, results, signature
        found = engine.storage.usage()
        there = [path.stat().st_size for path in folder.glob("??/??/*")]
        kinds = found["artifacts"].values()
        assert sum(kind["files"] for kind in kinds) == 7
        assert sum(kind["bytes"] for kind in kinds) == sum(there)
        assert found["artifacts"]["films"]["files"] == 1
        assert found["store_bytes"] > 10_000 and found["disk_free_bytes"] > 0
        half = (found["disk_free_bytes"] + found["artifacts"]["films"]["bytes"]) // 2
        assert abs(found["film_limit_bytes"] - min(50 * 10**9, half)) < 2**30
