"""PostgreSQL as the store: several processes, one scheduler, lost connections, clear refusals."""

from __future__ import annotations

import builtins
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import FAKE, SCENE, Service, report_of, wait_until
from postgres_server import shared_server

from matiere.jobs import Engine, open_engine
from matiere.jobs.errors import StoreError
from matiere.jobs.job import Event
from matiere.jobs.store import events, films, jobs, postgresql
from matiere.jobs.store.database import Database

SLOW = SCENE | {"chunk_s": 0.02, "render": {"spp": 24}}


@pytest.fixture
def url() -> str:
    return shared_server().database()


def opened(path: Path, url: str, **more: Any) -> Engine:
    return open_engine(path, database_url=url, **(FAKE | {"children": 1} | more))


def scheduling(*engines: Engine) -> list[bool]:
    return [engine.status()["scheduling"] for engine in engines]


def test_of_two_services_on_one_database_one_schedules_and_the_other_takes_over(
    tmp_path: Path, url: str
) -> None:
    first = opened(tmp_path / "a", url)
    with opened(tmp_path / "b", url) as second:
        assert scheduling(first, second) == [True, False]
        wait_until(lambda: second.readiness().ready, 30)
        renderers = [c["pid"] for c in second.status()["children"] if c["name"] != "utility"]
        assert renderers == [None], "no render child without the lease"
        job = second.submit_job(SCENE)  # asked here, rendered there
        seen = second.events(0, job_id=job.id, wait_s=10.0)
        assert seen[0].kind == "queued"
        assert second.wait_job(job.id, 30).state == "succeeded"
        assert first.status()["counters"]["jobs_succeeded"] == 1
        assert second.submit_job(SCENE).cached
        first.close()
        wait_until(lambda: scheduling(second) == [True])
        other = second.submit_job(SCENE | {"value": 2.0})
        assert second.wait_job(other.id, 30).state == "succeeded"
        assert second.status()["counters"]["jobs_succeeded"] == 1


def test_a_killed_service_gives_up_the_lease_and_its_claims_at_once(
    tmp_path: Path, url: str
) -> None:
    script = f"engine.submit_job({SLOW!r})"
    service = Service(tmp_path / "a", script, children=1, database_url=url, **FAKE)
    with opened(tmp_path / "b", url) as engine:
        assert scheduling(engine) == [False]
        job = engine.list_jobs()[0]
        wait_until(lambda: engine.get_job(job.id).state == "running")
        service.kill()
        job = engine.wait_job(job.id, 30)
        assert (job.state, job.spp) == ("succeeded", 24)
        with opened(tmp_path / "c", shared_server().database()) as quiet:
            plain = quiet.wait_job(quiet.submit_job(SLOW).id, 30)
            assert report_of(quiet, plain.id)["sums"] == report_of(engine, job.id)["sums"]


def test_a_lost_connection_costs_no_job_and_no_bit(tmp_path: Path, url: str) -> None:
    name = url.split("/")[3].split("?")[0]
    cut = "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity WHERE application_name"
    with opened(tmp_path / "a", url, children=2) as engine:
        job = engine.submit_job(SLOW)
        for _ in range(3):
            wait_until(lambda: any(c["claims"] for c in engine.status()["children"]))
            shared_server().sql(name, f"{cut} = 'matiere' AND datname = '{name}'")
            time.sleep(0.2)
        job = engine.wait_job(job.id, 60)
        assert (job.state, job.spp) == ("succeeded", 24)
        report = report_of(engine, job.id)
        assert (report["min_count"], report["max_count"]) == (24, 24)
        with opened(tmp_path / "b", shared_server().database()) as quiet:
            plain = quiet.wait_job(quiet.submit_job(SLOW).id, 30)
            assert report_of(quiet, plain.id)["sums"] == report["sums"]


def events_after(database: Database, seq: int) -> list[Event]:
    return database.read(lambda c: events.read_events(c, seq, None, None, 1000))


def test_writers_of_two_processes_follow_one_another(tmp_path: Path, url: str) -> None:
    """A number that a reader has seen is never followed by a smaller one that appears later."""
    one, two = Database(None, url), Database(None, url)
    stop = threading.Event()

    def emit(database: Database, name: str) -> None:
        while not stop.is_set():
            database.write(lambda c: events.emit(c, name))

    writers = [threading.Thread(target=emit, args=pair) for pair in ((one, "a"), (two, "b"))]
    for writer in writers:
        writer.start()
    seen: list[int] = []
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        seen += [e.seq for e in events_after(one, seen[-1] if seen else 0)]
    stop.set()
    for writer in writers:
        writer.join()
    whole: list[int] = []
    kinds: set[str] = set()
    while more := events_after(two, whole[-1] if whole else 0):
        whole += [e.seq for e in more]
        kinds |= {e.kind for e in more}
    assert len(seen) > 20 and seen == whole[: len(seen)]
    assert kinds == {"a", "b"}
    one.close()
    two.close()


def test_two_processes_that_start_on_an_empty_database_migrate_it_once(url: str) -> None:
    made: list[Database] = []
    threads = [threading.Thread(target=lambda: made.append(Database(None, url))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 4
    assert sorted(database.lead() for database in made) == [False, False, False, True]
    for database in made:
        database.close()


def test_a_claim_of_a_process_that_lost_the_lease_is_refused(url: str) -> None:
    old, new = Database(None, url), Database(None, url)
    assert old.lead() and not new.lead()
    old.write(lambda c: films.void_dead(c, "old", 1))
    film = jobs.FilmSpec("a" * 64, "g", {"w": 1}, {}, 8, 8, 2)
    spec = jobs.JobSpec(film, {"spp": 64}, 64, {}, 50, "label")
    old.write(lambda c: jobs.submit_job(c, spec))
    old.follow()
    assert new.lead()
    new.write(lambda c: films.void_dead(c, "new", 2))
    late, mine = (films.Claim(1, [0], name, 1, 30.0) for name in ("old", "new"))
    assert old.write(lambda c: films.claim(c, late)) is None
    assert new.write(lambda c: films.claim(c, mine)) is not None
    old.close()
    new.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mysql://secret@host/x", "'mysql'.*PostgreSQL"),
        ("not a url secret", "is not a URL"),
        ("sqlite:///secret.db", "'sqlite'"),
    ],
)
def test_another_database_is_refused_in_words(text: str, words: str) -> None:
    with pytest.raises(StoreError, match=words) as caught:
        postgresql.parse_url(text)
    assert "secret" not in str(caught.value)


def test_a_server_that_is_not_there_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"cannot reach|refused"):
        open_engine(tmp_path, database_url=f"postgresql://nobody@/none?host={tmp_path}", **FAKE)
    assert not (tmp_path / "server.json").exists()


def test_without_the_driver_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == "psycopg":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(StoreError, match=r"matiere\[postgres\]"):
        postgresql.parse_url("postgresql://user@host/db")
