"""Artifacts in a folder and in an object store keep the same promises; jobs run on both."""

from __future__ import annotations

import builtins
import hashlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import FAKE, SCENE, wait_until
from s3_server import S3

from matiere.jobs import open_engine
from matiere.jobs.artifacts import Artifacts, DamagedFile, StorageFault, open_artifacts
from matiere.jobs.errors import StoreError


@pytest.fixture
def s3(monkeypatch: pytest.MonkeyPatch) -> Iterator[S3]:
    server = S3()
    for name, value in {
        "AWS_ENDPOINT_URL": server.url,
        "AWS_ACCESS_KEY_ID": "tests",
        "AWS_SECRET_ACCESS_KEY": "tests",
        "AWS_REGION": "us-east-1",
        "AWS_ALLOW_HTTP": "true",
    }.items():
        monkeypatch.setenv(name, value)
    yield server
    server.close()


@pytest.fixture(params=["folder", "file", "s3"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path, s3: S3) -> Artifacts:
    places = {"folder": str(tmp_path), "file": f"file://{tmp_path}", "s3": "s3://bucket/deep/down"}
    return open_artifacts(places[request.param])


def test_what_was_written_is_read_and_removed(artifacts: Artifacts) -> None:
    data = os.urandom(3_000_000)
    digest, size = artifacts.write([data[:5], data[5:]])
    assert (digest, size) == (hashlib.sha256(data).hexdigest(), len(data))
    assert artifacts.write([data]) == (digest, size), "the same again is no error"
    assert artifacts.read(digest) == data
    assert b"".join(artifacts.stream(digest)) == data
    assert artifacts.has(digest, size) and not artifacts.has(digest, size + 1)
    assert list(artifacts.written_before(time.time() + 60)) == [digest]
    assert list(artifacts.written_before(time.time() - 60)) == []
    other, _ = artifacts.write([b"other"])
    artifacts.remove_all([other, "0" * 64, digest])
    assert not artifacts.has(digest, size) and not artifacts.has(other, 5)
    artifacts.remove(digest)
    with pytest.raises(DamagedFile, match="missing"):
        artifacts.read(digest)
    with pytest.raises(DamagedFile, match="missing"):
        list(artifacts.stream(digest))


def test_the_same_location_opens_the_same_files(artifacts: Artifacts) -> None:
    digest, _ = artifacts.write([b"seen by a child"])
    assert open_artifacts(artifacts.location).read(digest) == b"seen by a child"


def test_damaged_bytes_are_noticed_and_can_be_written_again(s3: S3) -> None:
    store = open_artifacts("s3://bucket/x")
    digest, size = store.write([b"right"])
    (path,) = s3.objects
    s3.objects[path] = (b"wrong", s3.objects[path][1])
    with pytest.raises(DamagedFile, match="does not hold"):
        store.read(digest)
    assert store.write([b"right"]) == (digest, size)
    assert store.read(digest) == b"right"


def test_an_object_is_created_once_and_never_overwritten(s3: S3) -> None:
    store = open_artifacts("s3://bucket/x")
    store.write([b"right"])
    (path,) = s3.objects
    first = s3.objects[path][1]
    store.write([b"right"])
    assert s3.puts == 2 and s3.objects[path][1] == first


def test_a_store_that_does_not_answer_is_a_storage_fault(s3: S3) -> None:
    store = open_artifacts("s3://bucket/x")
    s3.close()
    with pytest.raises(StorageFault, match="does not answer"):
        store.write([b"data"])
    assert not store.has("0" * 64, 1)


def test_jobs_run_on_an_object_store_as_on_a_folder(tmp_path: Path, s3: S3) -> None:
    sums = []
    for name, url in (("a", None), ("b", "s3://bucket/films")):
        with open_engine(tmp_path / name, children=2, artifacts_url=url, **FAKE) as engine:
            job = engine.wait_job(engine.submit_job(SCENE).id, 30)
            assert (job.state, job.spp) == ("succeeded", 64), job.error
            image = engine.artifact(job.id, "image.exr")
            assert bool(image.path) == (url is None)
            data = b"".join(engine.stream(image))
            assert hashlib.sha256(data).hexdigest() == image.digest
            sums.append(image.digest)
            assert engine.submit_job(SCENE).cached
            if url:
                wait_until(lambda: len(s3.objects) == 7)  # film, results, signature
                assert not list((tmp_path / name / "artifacts").glob("??"))
                assert engine.readiness().checks["artifacts"].ok
    assert sums[0] == sums[1]


def test_a_store_that_is_away_delays_jobs_and_loses_none(tmp_path: Path, s3: S3) -> None:
    with open_engine(tmp_path, children=1, artifacts_url="s3://bucket/films", **FAKE) as engine:
        wait_until(lambda: engine.readiness().ready)
        s3.down = True
        job = engine.submit_job(SCENE)
        wait_until(lambda: engine.status()["disk_full"], 60)
        assert not engine.get_job(job.id).state.final
        s3.down = False
        assert engine.wait_job(job.id, 60).state == "succeeded"


@pytest.mark.parametrize("url", ["http://host/bucket", "s3://", "gs://bucket"])
def test_another_url_is_refused_in_words(url: str) -> None:
    with pytest.raises(StoreError, match="s3://bucket/prefix"):
        open_artifacts(url)


def test_without_the_library_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith("obstore"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(StoreError, match=r"matiere\[s3\]"):
        open_artifacts("s3://bucket")
