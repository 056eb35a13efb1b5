"""`matiere backup`: a copy made while the service renders is a data directory that goes on."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import FAKE, SCENE, report_of, wait_until
from postgres_server import binaries, shared_server

from matiere.jobs import open_engine
from matiere.jobs.backup import BackupError, _without_password, backup
from matiere.jobs.store import views
from matiere.jobs.store.database import Database

SLOW = SCENE | {
    "value": 2.0,
    "chunk_s": 0.05,
    "files": ["named.txt", "sent.txt"],
    "render": {"spp": 96},
}


def assets(engine: Any) -> dict[str, str]:
    (engine.data_dir / "assets" / "named.txt").write_text("named")
    digest = hashlib.sha256(b"sent").hexdigest()
    engine.put_asset(digest, [b"sent"])
    return {"sent.txt": digest}


def test_a_copy_of_a_working_service_goes_on_elsewhere(tmp_path: Path) -> None:
    with open_engine(tmp_path / "data", children=2, **FAKE) as engine:
        done = engine.wait_job(engine.submit_job(SCENE).id, 30)
        slow = engine.submit_job(SLOW, assets=assets(engine))
        wait_until(lambda: engine.get_job(slow.id).progress > 0)

        def meanwhile() -> None:
            """Between store and files the service merges on, and would free what it merged."""
            before = engine.get_job(slow.id).spp
            wait_until(lambda: (job := engine.get_job(slow.id)).spp > before or job.state.final)

        made = backup(tmp_path / "data", tmp_path / "copy", after_store=meanwhile)
        assert made.files >= 5 and made.linked == made.files and made.assets == 2
        slow = engine.wait_job(slow.id, 60)
        sums = report_of(engine, slow.id)["sums"]
        kept = list((tmp_path / "copy" / "artifacts").glob("??/??/*"))
        assert {p.name for p in kept} >= {
            engine.artifact(done.id, k).digest for k in done.artifacts
        }
    (tmp_path / "data").rename(tmp_path / "lost")  # nothing may be read from the old place
    copied = Database(tmp_path / "copy" / "store.sqlite")
    state = copied.read(lambda c: views.get_job(c, slow.id)).state
    copied.close()
    assert not state.final, "as it was at the moment of the copy"
    with open_engine(tmp_path / "copy", children=2, **FAKE) as engine:
        assert engine.get_job(done.id).state == "succeeded"
        again = engine.wait_job(slow.id, 60)
        assert (again.state, again.spp) == ("succeeded", 96), again.error
        assert report_of(engine, slow.id)["sums"] == sums
        assert engine.status()["counters"].get("files_damaged", 0) == 0, "nothing was missing"


def test_a_copy_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(BackupError, match="no data directory"):
        backup(tmp_path / "nowhere", tmp_path / "copy")
    open_engine(tmp_path / "data", children=1, **FAKE).close()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("")
    with pytest.raises(BackupError, match="not empty"):
        backup(tmp_path / "data", tmp_path / "full")
    assert not (tmp_path / "full.part").exists()


def test_a_password_is_not_on_the_command_line_of_pg_dump() -> None:
    url, environment = _without_password("postgresql+psycopg://me:se%2Fcret@host:5433/db?x=1")
    assert url == "postgresql://me@host:5433/db?x=1"
    assert environment["PGPASSWORD"] == "se/cret"
    socket = "postgresql://matiere@/t1?host=/tmp/x"
    assert _without_password(socket)[0] == socket


def test_a_postgresql_store_is_dumped_and_comes_back(tmp_path: Path) -> None:
    url, other = shared_server().database(), shared_server().database()
    options = FAKE | {"children": 1}
    with open_engine(tmp_path / "data", database_url=url, **options) as engine:
        job = engine.wait_job(engine.submit_job(SCENE).id, 30)
        made = backup(tmp_path / "data", tmp_path / "copy", database_url=url)
        assert made.files == 7, "film, signature, four images and the report"
    programs = binaries()
    assert programs is not None
    restore = [str(programs / "pg_restore"), "--no-owner", "--dbname", other]
    subprocess.run([*restore, str(tmp_path / "copy" / "store.dump")], check=True)
    with open_engine(tmp_path / "copy", database_url=other, **options) as engine:
        assert engine.get_job(job.id).state == "succeeded"
        assert Path(engine.artifact(job.id, "image.png").path).read_bytes().startswith(b"png ")
        assert engine.submit_job(SCENE).cached
