"""A store of the first schema comes up, on SQLite, with its jobs; the copy made before is whole.

`stores/first-schema.sql` is the dump of a store that the first release wrote and that lost its
process to SIGKILL: a job that had succeeded, one failed, one cancelled, one whose film was merged
but not developed, and a sweep with a cell rendered but not merged and one in a child's hands.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path

import pytest
from conftest_jobs import FAKE, report_of, wait_until

from matiere.jobs import open_engine
from matiere.jobs.artifacts import ArtifactFolder
from matiere.jobs.store import views
from matiere.jobs.store.database import Database
from matiere.jobs.store.sqlite import backup_sqlite

STORES = Path(__file__).parent / "stores"
SCENE = {"width": 8, "height": 16, "value": 1.0}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """Make the data directory of the dump."""
    from pysqlite3 import dbapi2

    data = tmp_path / "data"
    data.mkdir()
    store = dbapi2.connect(str(data / "store.sqlite"))
    store.execute("PRAGMA journal_mode=WAL")
    store.executescript((STORES / "first-schema.sql").read_text())
    store.close()
    folder = ArtifactFolder(data / "artifacts")
    for digest, text in json.loads((STORES / "first-schema.files.json").read_text()).items():
        assert folder.write([base64.b64decode(text)])[0] == digest
    return data


def test_a_store_of_the_first_schema_upgrades_and_finishes_its_jobs(
    old: Path, tmp_path: Path
) -> None:
    with open_engine(old, children=1, **FAKE) as engine:
        assert engine.resumed["claims_voided"] == 1
        jobs = {job.label: job for job in engine.list_jobs(limit=10) if job.sweep_id is None}
        assert {label: job.state.value for label, job in jobs.items()} == {
            "done": "succeeded",
            "failed": "failed",
            "cancelled": "cancelled",
            "half": "running",
        }
        assert jobs["failed"].error is not None and "told to raise" in jobs["failed"].error.message
        assert report_of(engine, jobs["done"].id)["max_count"] == 8
        assert jobs["half"].spp == 64, "the merged prefix is kept"
        half = engine.wait_job(jobs["half"].id, 60)
        sweep = engine.wait_sweep(engine.list_sweeps()[0].id, 60)
        assert (half.state, half.spp, sweep.counts["succeeded"]) == ("succeeded", 64, 2)
        rendered = engine.status()["counters"]["chunks_rendered"]
        assert rendered == 6, "the claimed chunks of one cell; nothing else is rendered again"
        again = engine.submit_job(SCENE, stop={"spp": 8}, label="done", idempotency_key="first-key")
        assert again.id == jobs["done"].id, "idempotency keys outlive the upgrade"
        sums = report_of(engine, half.id)["sums"]
    slow = SCENE | {"value": 2.0, "chunk_s": 0.05}
    with open_engine(tmp_path / "fresh", children=1, **FAKE) as engine:
        fresh = engine.wait_job(engine.submit_job(slow, stop={"spp": 64}).id, 60)
        assert report_of(engine, fresh.id)["sums"] == sums, "the same bits as without upgrade"


def test_the_store_is_copied_before_it_is_upgraded(old: Path, tmp_path: Path) -> None:
    Database(old / "store.sqlite").close()
    copy = old / "store.0001.backup"
    assert not copy.with_name(copy.name + "-wal").exists()
    from pysqlite3 import dbapi2

    store = dbapi2.connect(str(copy))
    assert store.execute("SELECT version_num FROM alembic_version").fetchone() == ("0001",)
    assert store.execute("SELECT count(*) FROM job").fetchone() == (6,)
    store.close()
    back = tmp_path / "back"
    back.mkdir()
    copy.rename(back / "store.sqlite")
    restored = Database(back / "store.sqlite")
    assert len(restored.read(lambda c: views.list_jobs(c, None, None, None, 10))) == 6
    restored.close()


def test_a_backup_holds_what_is_only_in_the_log(tmp_path: Path) -> None:
    """A file copy would miss it: with WAL the newest transactions are in another file."""
    with open_engine(tmp_path / "data", children=1, **FAKE) as engine:
        job = engine.submit_job(SCENE)
        store = tmp_path / "data" / "store.sqlite"
        assert store.stat().st_size < (tmp_path / "data" / "store.sqlite-wal").stat().st_size
        backup_sqlite(store, tmp_path / "copy.sqlite")
        wait_until(lambda: engine.get_job(job.id).state.final)
    copied = Database(tmp_path / "copy.sqlite")
    assert copied.read(lambda c: views.get_job(c, job.id)).id == job.id
    copied.close()
