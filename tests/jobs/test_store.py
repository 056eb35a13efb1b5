"""The database: schema, one writer, fences, idempotency, crash leftovers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa
from conftest_jobs import stored

from matiere.jobs.errors import IdempotencyConflict, StoreError
from matiere.jobs.job import JobError, JobState
from matiere.jobs.store import events, files, films, jobs, tables, views
from matiere.jobs.store.database import Database
from matiere.jobs.store.files import Blob
from matiere.jobs.store.films import Claim, Loss, Merged, Report


@pytest.fixture
def db(tmp_path: Path, store: str) -> Iterator[Database]:
    database = open_store(tmp_path / "store.sqlite")
    database.write(lambda c: films.void_dead(c, "first", 1))
    yield database
    database.close()


def open_store(path: Path) -> Database:
    """Open the store that the fixture `store` chose; `path` names it."""
    return Database(path, stored(path).get("database_url"))


def spec(key: str = "a" * 64, spp: int = 64, priority: int = 50) -> jobs.JobSpec:
    film = jobs.FilmSpec(key, "g", {"w": 1}, {}, 8, 8, 2)
    return jobs.JobSpec(film, {"spp": spp}, spp, {}, priority, "label")


def blob(n: int) -> Blob:
    return Blob(f"{n:064x}", 10 + n)


def submit(db: Database, **facts: object) -> str:
    return db.write(lambda c: jobs.submit_job(c, spec(**facts)))  # type: ignore[arg-type]


def claim(db: Database, *chunks: int, instance: str = "first") -> int | None:
    return db.write(lambda c: films.claim(c, Claim(1, chunks, instance, 123, 30.0)))


def complete(db: Database, token: int | None, number: int = 1) -> bool:
    assert token is not None
    return db.write(lambda c: films.complete(c, Report(token, 1, blob(number), 0.5, 64)))


def film_row(db: Database) -> films.FilmRow:
    return db.read(lambda c: films.load_film(c, 1))


def test_migrations_make_the_tables_the_code_uses(db: Database) -> None:
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext

    differences = db.read(
        lambda c: compare_metadata(MigrationContext.configure(c), tables.metadata)
    )
    assert differences == []


def test_a_store_newer_than_the_program_is_refused(tmp_path: Path, store: str) -> None:
    path = tmp_path / "store.sqlite"
    first = open_store(path)
    first.write(lambda c: c.execute(sa.text("UPDATE alembic_version SET version_num='9999'")))
    first.close()
    with pytest.raises(StoreError, match="newer than this program"):
        open_store(path)


def test_a_damaged_store_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "store.sqlite"
    Database(path).close()
    data = bytearray(path.read_bytes())
    data[4096:12288] = b"\xff" * 8192
    path.write_bytes(bytes(data))
    with pytest.raises(StoreError, match=r"damaged|refused"):
        Database(path)


def test_commits_are_durable_and_readers_cannot_write(db: Database) -> None:
    def ask(text: str) -> object:
        return db.write(lambda c: c.exec_driver_sql(text).scalar())

    if db.shared:
        assert ask("SHOW synchronous_commit") == "on"
    else:
        found = [ask(f"PRAGMA {name}") for name in ("journal_mode", "synchronous", "foreign_keys")]
        assert found == ["wal", 2, 1]
    with pytest.raises(StoreError, match=r"readonly|read-only"):
        db.read(lambda c: c.execute(sa.text("DELETE FROM job")))


def test_the_standard_sqlite_module_is_never_imported(tmp_path: Path) -> None:
    program = (
        "import sys\nfrom pathlib import Path\nfrom matiere.jobs.store.database import Database\n"
        f"Database(Path({str(tmp_path / 's.sqlite')!r})).close()\n"
        "assert 'sqlite3' not in sys.modules and '_sqlite3' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_chunk_is_given_to_one_claim_only(db: Database) -> None:
    submit(db)
    assert claim(db, 0, 1) is not None
    assert claim(db, 1, 2) is None
    assert claim(db, 2) is not None


def test_nobody_claims_for_a_film_that_no_job_wants(db: Database) -> None:
    job_id = submit(db)
    db.write(lambda c: jobs.cancel_job(c, job_id))
    assert claim(db, 0) is None


def test_a_report_of_an_old_attempt_is_refused_and_counted(db: Database) -> None:
    submit(db)
    old = claim(db, 0, 1)
    assert old is not None
    db.write(lambda c: films.give_back(c, Loss(old, 1, "lost", "lost", "killed")))
    new = claim(db, 0, 1)
    assert complete(db, old, 7) is False
    assert complete(db, new, 8) is True
    assert complete(db, new, 8) is False, "a second report of the same attempt"
    row = film_row(db)
    assert row.done == {0: new, 1: new}
    assert row.losses == {0: 1, 1: 1}
    counts = db.read(
        lambda c: c.execute(
            sa.select(tables.film.c.reports_superseded, tables.film.c.chunks_rendered)
        ).one()
    )
    assert tuple(counts) == (2, 2)
    assert blob(7).digest in db.read(files.pending_deletions), "the late file may go"
    assert blob(8).digest not in db.read(files.pending_deletions)


def test_progress_is_that_of_the_nearest_stop(db: Database) -> None:
    job_id = submit(db, spp=64)
    token = claim(db, 0)
    assert complete(db, token)
    before = db.read(lambda c: views.get_job(c, job_id)).progress
    assert before == 64 / (8 * 8 * 64)
    facts = {"spp": 1, "seconds": 0.5, "relmse": 0.5, "lower": 0.4, "upper": 0.6}
    for share, progress in ((0.4, 0.4), (1e-4, before), (7.0, 0.99)):
        merged = Merged(1, 0, 0, None, facts, [], {job_id: share})
        assert db.write(lambda c, merged=merged: films.commit_merge(c, merged))
        assert db.read(lambda c: views.get_job(c, job_id)).progress == progress


def test_a_merge_frees_chunk_files_and_ends_jobs_in_one_transaction(db: Database) -> None:
    job_id = submit(db)
    first, second = claim(db, 0, 1), claim(db, 2)
    assert complete(db, first, 1) and complete(db, second, 2)
    facts = {"spp": 4, "seconds": 1.0, "relmse": 0.5, "lower": 0.4, "upper": 0.6}
    ended = [{"job_id": job_id, "reason": "spp", "cached": False, **facts}]
    merged = Merged(1, 0, 2, blob(9), facts, ended, {})
    assert db.write(lambda c: films.commit_merge(c, merged)) is True
    assert db.write(lambda c: films.commit_merge(c, merged)) is False, "made from an old prefix"
    row = film_row(db)
    assert (row.prefix, row.prefix_chunks, row.done) == (blob(9), 2, {2: second})
    assert db.read(files.pending_deletions) == [blob(1).digest]
    assert claim(db, 1) is None, "inside the prefix"
    job = db.read(lambda c: views.get_job(c, job_id))
    assert (job.state, job.spp, job.stop_reason) == (JobState.RUNNING, 4, "spp")
    assert db.read(jobs.jobs_to_develop) == [job_id]
    db.write(lambda c: jobs.finish_job(c, job_id, {"image.png": blob(3)}))
    assert db.read(lambda c: views.get_job(c, job_id)).artifacts == ("image.png",)


def test_a_cancelled_job_never_becomes_succeeded(db: Database) -> None:
    job_id = submit(db)
    db.write(lambda c: jobs.cancel_job(c, job_id))
    assert db.write(lambda c: jobs.finish_job(c, job_id, {"image.png": blob(3)})) is False
    assert db.read(lambda c: views.get_job(c, job_id)).state is JobState.CANCELLED
    assert db.read(files.pending_deletions) == [blob(3).digest]


def test_work_of_a_dead_instance_is_void_at_once(db: Database) -> None:
    submit(db)
    old = claim(db, 0, 1)
    done = claim(db, 2)
    complete(db, done, 2)
    found = db.write(lambda c: films.void_dead(c, "second", 2))
    assert found == {"claims_voided": 1, "chunks_voided": 2, "chunks_present": 1}
    assert film_row(db).tries == {}, "the death of the service is not the chunk's fault"
    assert complete(db, old, 1) is False
    assert claim(db, 0, 1) is None, "whoever lost the lease claims nothing any more"
    assert claim(db, 0, 1, instance="second") is not None


def test_a_failed_film_fails_its_jobs_and_may_be_asked_for_again(db: Database) -> None:
    first = submit(db)
    token = claim(db, 0)
    assert token is not None
    db.write(lambda c: films.give_back(c, Loss(token, 1, "failed", "signal", "crashed")))
    db.write(lambda c: jobs.fail_film(c, 1, JobError("signal", "crashed", "", "log")))
    job = db.read(lambda c: views.get_job(c, first))
    assert job.error is not None
    assert (job.state, job.error.code, job.error.log_tail) == (JobState.FAILED, "signal", "log")
    submit(db)
    assert film_row(db).tries == {}


def test_an_idempotency_key_gives_the_same_job_and_refuses_another_body(db: Database) -> None:
    key = jobs.Key("k", "hash")
    first = db.write(lambda c: jobs.submit_job(c, spec(), key))
    assert db.write(lambda c: jobs.submit_job(c, spec(), key)) == first
    with pytest.raises(IdempotencyConflict):
        db.write(lambda c: jobs.submit_job(c, spec(), jobs.Key("k", "other")))
    assert len(db.read(lambda c: views.list_jobs(c, None, None, None, 10))) == 1


def test_urgent_films_come_first(db: Database) -> None:
    for n, priority in enumerate([10, 90, 50, 90]):
        submit(db, key=f"{n:064d}", priority=priority)
    assert db.read(lambda c: films.next_films(c, 10)) == [2, 4, 3, 1]


def test_a_failed_transaction_leaves_nothing(db: Database) -> None:
    def half(c: sa.Connection) -> None:
        jobs.submit_job(c, spec())
        raise RuntimeError("after the insert")

    with pytest.raises(RuntimeError):
        db.write(half)
    assert db.read(lambda c: views.list_jobs(c, None, None, None, 10)) == []
    assert db.read(lambda c: events.read_events(c, 0, None, None, 10)) == []


def test_shared_files_stay_while_anyone_refers_to_them(db: Database) -> None:
    db.write(lambda c: files.add_reference(c, ("film", 1), "prefix", blob(1)))
    db.write(lambda c: files.add_reference(c, ("film", 2), "prefix", blob(1)))
    db.write(lambda c: files.drop_reference(c, ("film", 1)))
    assert db.read(files.pending_deletions) == []
    db.write(lambda c: files.drop_reference(c, ("film", 2)))
    assert db.read(files.pending_deletions) == [blob(1).digest]
    db.write(lambda c: files.add_reference(c, ("film", 3), "prefix", blob(1)))
    assert db.read(files.pending_deletions) == [], "wanted again before it was unlinked"


def test_the_tables_are_legal_on_postgresql_too() -> None:
    from sqlalchemy.dialects import postgresql
    from sqlalchemy.schema import CreateIndex, CreateTable

    dialect = postgresql.dialect()
    for table in tables.metadata.sorted_tables:
        text = str(CreateTable(table).compile(dialect=dialect))
        assert "AUTOINCREMENT" not in text
        for index in table.indexes:
            str(CreateIndex(index).compile(dialect=dialect))
    assert "BIGSERIAL" in str(CreateTable(tables.event).compile(dialect=dialect))


def test_lists_go_page_by_page_in_any_order(db: Database) -> None:
    """Ends come in another order than submissions, two at the same moment; one job never ends."""
    ids = [submit(db, key=f"{n:064x}") for n in range(7)]
    ends = dict(zip(ids, [5.0, 3.0, 3.0, 9.5, 1.25, 7.0], strict=False))
    for name, at in ends.items():
        db.write(jobs.cancel_job, name)
        row = sa.update(tables.job).where(tables.job.c.id == name)
        db.write(sa.Connection.execute, row.values(finished=at, label=f"label {at}"))
    by_end = sorted(ends, key=lambda name: (ends[name], name))
    wanted = {"created": ids, "-created": ids[::-1], "finished": by_end, "-finished": by_end[::-1]}
    for order, names in wanted.items():
        found: list[str] = []
        after = None
        while page := db.read(
            lambda c, o=order, a=after: views.list_jobs(c, None, None, a, 2, order=o)  # type: ignore[misc]
        ):
            found += [job.id for job in page]
            after = views.position(page[-1], order)
            assert len(after) <= 64
        assert found == names, order
    three = db.read(lambda c: views.list_jobs(c, None, None, None, 9, label="label 3.0"))
    assert {job.id for job in three} == set(ids[1:3])
    assert not db.read(lambda c: views.list_jobs(c, None, None, None, 9, label="labe"))
    for strange in ("x", "zz_1", "00_1"):
        db.read(lambda c, a=strange: views.list_jobs(c, None, None, a, 9, order="finished"))  # type: ignore[misc]
