"""T3: one hash for any processes x threads and any order of completion."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from conftest_jobs import FAKE, SCENE, report_of

from matiere.jobs import open_engine
from matiere.jobs.film_work import FilmWork

FILM = SCENE | {"render": {"spp": 32}, "value": 3.0}


def sums(data: Path, children: int, threads: int) -> str:
    """Render the film and return the hash of its samples."""
    with open_engine(data, children=children, threads_per_child=threads, **FAKE) as engine:
        job = engine.wait_job(engine.submit_job(FILM).id, 60)
        report = report_of(engine, job.id)
        assert (report["min_count"], report["max_count"]) == (32, 32)
        return str(report["sums"])


def test_the_order_in_which_chunks_come_changes_no_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = sums(tmp_path / "plain", 1, 1)
    chance, orders = random.Random(5), list[list[int]]()

    def take(film: FilmWork, samples: float, most: int) -> list[int]:
        """Hand out three chunks from anywhere, in any order."""
        free = [
            index
            for index in range(film.prefix_chunks, film.horizon())
            if index not in film.done and index not in film.claimed
        ]
        chunks = chance.sample(free, min(3, len(free)))
        orders.append(chunks)
        return chunks

    monkeypatch.setattr(FilmWork, "take", take)
    monkeypatch.setattr(FilmWork, "available", lambda film, limit=1: bool(
        set(range(film.prefix_chunks, film.horizon())) - set(film.done) - set(film.claimed)
    ))  # fmt: skip
    for children, threads in ((1, 1), (1, 2), (2, 1)):
        assert sums(tmp_path / f"{children}x{threads}", children, threads) == expected
    flat = [index for chunks in orders for index in chunks]
    assert flat != sorted(flat), "shuffled"
