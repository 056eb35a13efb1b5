"""What is kept between commits is never older than a commit that somebody was told of."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from matiere.jobs.engine import open_engine
from matiere.jobs.recent import FRESH_S, Recent
from matiere.jobs.store.database import Database


def test_a_value_is_read_once_between_commits() -> None:
    version, read = [0], []

    def look() -> int:
        read.append(version[0])
        return version[0]

    recent: Recent[int] = Recent(lambda: version[0])
    assert [recent.get("a", look) for _ in range(5)] == [0] * 5 and len(read) == 1
    assert (recent.peek("a"), recent.peek("b")) == (0, None)
    version[0] = 1
    assert recent.peek("a") is None, "a commit came"
    assert [recent.get("a", look) for _ in range(5)] == [1] * 5 and len(read) == 2
    assert recent.peek("a") == 1
    time.sleep(FRESH_S)
    assert recent.peek("a") is None
    recent.get("a", look)
    assert len(read) == 3, "ages rise without a commit"


def test_a_value_read_before_a_commit_is_not_shown_after_it() -> None:
    version = [0]
    recent: Recent[str] = Recent(lambda: version[0])

    def slow() -> str:
        version[0] = 1  # the commit comes while the old state is being read
        return "old"

    assert recent.get("a", slow) == "old"
    assert recent.get("a", lambda: "new") == "new"


def test_nothing_is_kept_where_others_write_too() -> None:
    recent: Recent[int] = Recent(None)
    values = iter(range(3))
    assert [recent.get("a", lambda: next(values)) for _ in range(3)] == [0, 1, 2]


def test_whoever_was_told_of_a_change_reads_it(tmp_path: Path) -> None:
    scene = {"width": 16, "height": 16, "value": 0.5, "chunk_s": 20.0, "render": {"spp": 16}}
    with open_engine(tmp_path / "data", children=1, work="fake_work") as engine:
        job = engine.submit_job(scene)
        stop = threading.Event()

        def poll() -> None:
            while not stop.is_set():
                engine.get_job(job.id)

        pollers = [threading.Thread(target=poll) for _ in range(4)]
        for one in pollers:
            one.start()
        try:
            for priority in range(1, 100):
                engine.set_priority(job.id, priority)
                assert engine.get_job(job.id).priority == priority
            engine.cancel_job(job.id)
            assert engine.get_job(job.id).state == "cancelled"
        finally:
            stop.set()
            for one in pollers:
                one.join()


def test_a_store_shrinks_when_most_of_it_went(tmp_path: Path) -> None:
    path = tmp_path / "store.sqlite"
    database = Database(path)
    database.close()  # its log goes into the file
    database = Database(path)
    before = path.stat().st_size
    insert = "INSERT INTO event (time, kind, data) VALUES (0, 'x', ?)"
    for _ in range(20):
        database.write(lambda c: c.exec_driver_sql(insert, [("y" * 4000,)] * 50))
    assert not database.compact(), "nothing is free"
    database.write(lambda c: c.exec_driver_sql("DELETE FROM event"))
    assert database.compact()
    database.write(lambda c: c.exec_driver_sql(insert, [("y",)]))
    after = path.stat().st_size
    database.close()
    print(f"{before} bytes, then {after}")
    assert after <= 1.1 * before
    with pytest.raises(Exception, match="closed"):
        database.write(lambda c: None)


def test_many_who_ask_at_once_cost_one_reading() -> None:
    entered, go, read = threading.Event(), threading.Event(), []
    recent: Recent[int] = Recent(lambda: 0)

    def slow() -> int:
        read.append(1)
        entered.set()
        assert go.wait(10)
        return 7

    found: list[int] = []
    askers = [threading.Thread(target=lambda: found.append(recent.get("a", slow)))]
    askers[0].start()
    assert entered.wait(10)
    askers += [threading.Thread(target=lambda: found.append(recent.get("a", slow))) for _ in "abc"]
    for one in askers[1:]:
        one.start()
    time.sleep(0.05)
    go.set()
    for one in askers:
        one.join()
    assert found == [7] * 4 and len(read) == 1

    def fails() -> int:
        raise KeyError("b")

    for _ in range(2):
        with pytest.raises(KeyError):
            recent.get("b", fails)
