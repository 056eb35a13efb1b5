"""Adaptive films over the queue: decided where they are merged, the bits of `mt.render`."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from conftest_jobs import killed_in_the_middle, report_of
from film_scenes import scenes

import matiere as mt
from matiere import _core
from matiere.imageio import read_image, write_image
from matiere.jobs import open_engine
from matiere.jobs.course import AdaptiveCourse

OPTIONS: dict[str, Any] = {"min_free_bytes": 0}


def scene(spp: int, size: int = 64) -> dict[str, Any]:
    return scenes(size)["glass"] | {"render": {"spp": spp, "seed": 5, "adaptive": True}}


def pixels(path: str | Path) -> str:
    return hashlib.sha256(np.ascontiguousarray(read_image(path).pixels).tobytes()).hexdigest()


def direct(tmp_path: Path, document: dict[str, Any]) -> tuple[mt.Film, str]:
    film = mt.render(mt.load(document), threads=2)
    write_image(tmp_path / "direct.exr", film)
    return film, pixels(tmp_path / "direct.exr")


def test_adaptive_jobs_have_the_pixels_of_mt_render(tmp_path: Path) -> None:
    """Two jobs wait for one film: one ends between two bases, one beyond the second."""
    with open_engine(tmp_path / "data", children=2, **OPTIONS) as engine:
        longer, shorter = (engine.submit_job(scene(spp)).id for spp in (160, 64))
        for job_id, spp in ((shorter, 64), (longer, 160)):
            job = engine.wait_job(job_id, 120)
            assert (job.state, job.spp) == ("succeeded", spp), job.error
            film, expected = direct(tmp_path, scene(spp))
            assert pixels(engine.artifact(job_id, "image.exr").path) == expected
            report, counts = report_of(engine, job_id), film.sample_counts
            assert report["adaptive"] and report["samples"] == counts.sum()
            assert report["samples_per_pixel"] == [counts.min(), counts.max()]
            assert counts.min() < counts.max()
        assert engine.get_job(shorter).film_key == engine.get_job(longer).film_key


def test_an_adaptive_job_killed_in_the_middle_resumes_with_the_same_bits(tmp_path: Path) -> None:
    document = scene(192, 96)
    killed_in_the_middle(tmp_path / "a", document, children=2, **OPTIONS)
    with open_engine(tmp_path / "a", children=2, **OPTIONS) as engine:
        job = engine.wait_job(engine.list_jobs()[0].id, 120)
        assert (job.state, job.spp) == ("succeeded", 192), job.error
        film, expected = direct(tmp_path, document)
        assert report_of(engine, job.id)["samples"] == film.sample_counts.sum()
        assert pixels(engine.artifact(job.id, "image.exr").path) == expected


def test_a_course_is_the_order_in_which_the_film_wants_its_chunks() -> None:
    studio = mt.load(scenes(64)["diffuse"])  # with a plain sky, which keeps to the base
    film = _core.Film(64, 64, 4, True)
    course = AdaptiveCourse(film.plan, 0, 0)
    assert not course.told and course.waits(0) and course.end(64) == 0
    course.tell(film.course(10**6))
    uniform = 3 * film.plan.strips
    assert [course.chunk(i) for i in range(uniform)] == film.missing(16)
    assert (course.end(16), course.end(64), course.following(0)) == (uniform, uniform, uniform // 3)
    film = mt.render(studio, spp=32, adaptive=True).core
    course.tell(film.course(10**6))
    assert course.spp(course.end(32)) == 32 and course.ends_round(course.end(48))
    assert [course.chunk(i) for i in range(course.end(32), course.end(64))] == film.missing(64)
    barrier = course.whole(10**9)
    assert course.waits(barrier) and not course.ends_round(barrier)
    assert course.spp(barrier) == 64 and course.end(96) == barrier
    few = AdaptiveCourse(film.plan, course.end(32), 32)
    few.tell(film.course(1))
    assert few.end(64) == few.following(course.end(32)) == course.end(48), "at least one round"
