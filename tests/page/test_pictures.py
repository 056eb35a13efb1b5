"""Pictures drawn while somebody waits, over HTTP: previews, other views, differences, balls."""

from __future__ import annotations

import json
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from page_support import Site, scene

import matiere as mt
from matiere.jobs.work import smaller


def get(site: Site, address: str, status: int = 200, **asked: object) -> httpx.Response:
    named = address.format(job=site.job)
    answer = httpx.get(f"{site.url}/v1{named}", params=asked, timeout=30)
    assert answer.status_code == status, answer.text[:400]
    return answer


def pixels(answer: httpx.Response, tmp_path: Path, suffix: str = ".png") -> np.ndarray:
    path = tmp_path / f"picture{suffix}"
    path.write_bytes(answer.content)
    return mt.read_image(path).pixels


def test_the_jobs_own_view_asked_for_by_name_gives_its_image(site: Site, tmp_path: Path) -> None:
    own = pixels(get(site, "/jobs/{job}/image.png"), tmp_path)
    drawn = pixels(get(site, "/jobs/{job}/image.png", exposure=0), tmp_path)
    assert np.abs(own - drawn).max() <= 1 / 255 + 1e-6


def test_a_stop_more_is_that_of_the_renderer(site: Site, tmp_path: Path) -> None:
    linear = pixels(get(site, "/jobs/{job}/image.exr"), tmp_path, ".exr")[:, :, :3]
    wanted = np.clip(mt.develop(linear, exposure=1.0, view="Raw"), 0, 1)
    found = pixels(get(site, "/jobs/{job}/image.png", exposure=1, view="Raw"), tmp_path)
    assert np.abs(wanted - found).max() <= 0.5 / 255 + 1e-6
    assert found.mean() > pixels(get(site, "/jobs/{job}/image.png", view="Raw"), tmp_path).mean()


def test_jpeg_thumbnail_and_preview_are_small_jpegs(site: Site, tmp_path: Path) -> None:
    for address in ("/jobs/{job}/image.jpg", "/jobs/{job}/thumbnail.jpg", "/jobs/{job}/preview"):
        answer = get(site, address)
        assert answer.headers["content-type"] == "image/jpeg"
        assert pixels(answer, tmp_path, ".jpg").shape == (24, 32, 3)
    assert pixels(get(site, "/jobs/{job}/preview", longest=16), tmp_path, ".jpg").shape[1] == 16


def test_a_view_that_is_unknown_is_refused_with_the_choices(site: Site) -> None:
    refused = get(site, "/jobs/{job}/image.png", 422, view="nope").json()
    assert "Un-tone-mapped" in refused["detail"]
    get(site, "/jobs/{job}/image.png", 422, exposure=99)


def test_a_client_that_has_the_picture_gets_304(site: Site) -> None:
    first = get(site, "/jobs/{job}/image.png", exposure=2)
    again = httpx.get(
        f"{site.url}/v1/jobs/{site.job}/image.png?exposure=2",
        headers={"If-None-Match": first.headers["etag"]},
    )
    assert again.status_code == 304 and not again.content


def test_a_job_in_work_has_a_preview_and_no_image(site: Site, tmp_path: Path) -> None:
    job = site.engine.submit_job(scene(), stop={"spp": 1_000_000})
    try:
        end = time.monotonic() + 60
        while not site.engine.get_job(job.id).spp:
            assert time.monotonic() < end
            time.sleep(0.1)
        shown = httpx.get(f"{site.url}/v1/jobs/{job.id}/preview", timeout=30)
        assert pixels(shown, tmp_path, ".jpg").shape == (24, 32, 3)
        refused = httpx.get(f"{site.url}/v1/jobs/{job.id}/image.png", params={"exposure": 1})
        assert refused.status_code == 409
        assert refused.json()["links"]["preview"].endswith("/preview")
    finally:
        site.engine.cancel_job(job.id)


def test_two_cells_are_compared_as_the_library_does(site: Site, tmp_path: Path) -> None:
    a, b = (cell.id for cell in site.engine.list_jobs(sweep_id=site.sweep)[:2])
    answer = httpx.get(f"{site.url}/v1/jobs/{b}/difference", params={"against": a}, timeout=30)
    report = answer.json()
    assert report["paired"] and not report["identical"] and report["statement"]
    same = httpx.get(f"{site.url}/v1/jobs/{a}/difference", params={"against": a}, timeout=30)
    assert same.json()["identical"]
    drawn = httpx.get(f"{site.url}/v1/jobs/{b}/difference.png", params={"against": a}, timeout=30)
    assert pixels(drawn, tmp_path).shape[2] == 3
    tag = {"If-None-Match": drawn.headers["etag"]}
    again = httpx.get(str(drawn.url), headers=tag, timeout=30)
    assert again.status_code == 304


def test_films_of_other_size_are_not_compared(site: Site) -> None:
    other = site.engine.submit_job(scene(film={"width": 16, "height": 16}))
    site.engine.wait_job(other.id, 60)
    refused = get(site, "/jobs/{job}/difference", 422, against=other.id).json()
    assert refused["code"] == "not_comparable" and "16 x 16" in refused["detail"]


def test_a_ball_shows_its_material(site: Site, tmp_path: Path) -> None:
    def ball(metal: str) -> np.ndarray:
        material = {"type": "conductor", "metal": metal, "alpha": 0.3}
        return pixels(get(site, "/ball.png", material=json.dumps(material)), tmp_path)

    gold, silver = (ball(metal)[60:130, 60:130].mean((0, 1)) for metal in ("Au", "Ag"))
    assert gold[0] / gold[2] > 1.3 > silver[0] / silver[2]


@pytest.mark.parametrize(
    ("material", "pointer"),
    [('{"type": "conductor", "metal": "Au", "alpha": 3}', "/alpha"), ('{"type": "no"}', "/type")],
)
def test_a_wrong_material_is_told_with_its_pointer(site: Site, material: str, pointer: str) -> None:
    refused = get(site, "/ball.png", 422, material=material).json()
    assert refused["errors"][0]["pointer"] == pointer
    get(site, "/ball.png", 400, material="{")


def test_smaller_pictures_are_means_of_blocks() -> None:
    image = np.arange(5 * 9 * 3, dtype=np.float64).reshape(5, 9, 3)
    small = smaller(image, 4)
    assert small.shape == (1, 3, 3)
    assert np.allclose(small[0, 1], image[0:3, 3:6].mean((0, 1)))
    assert smaller(image, 9) is image
    assert smaller(np.ones((1, 50, 3)), 10).shape == (1, 10, 3)
