"""The page without a browser: every view answers, with nothing inline, and reads without script."""

from __future__ import annotations

import re
import time
from html import unescape

import httpx
import pytest
from page_support import Site

from matiere.jobs.job import JobState
from matiere.service.page import examples, words

VIEWS = ["/", "/?state=succeeded", "/jobs/{job}", "/jobs/{job}/live", "/submit",
         "/submit?job={job}", "/submit?example=cornell", "/workers", "/workers/live", "/sweeps",
         "/sweeps/{sweep}", "/sweeps/{sweep}/live?rows=1&columns=0", "/nights",
         "/nights?a={sweep}&b={later}", "/materials", "/materials/conductor"]  # fmt: skip


def get(site: Site, address: str, status: int = 200) -> httpx.Response:
    named = address.format(job=site.job, sweep=site.sweep, later=site.later)
    for _ in range(10):
        answer = httpx.get(site.url + named, follow_redirects=True, timeout=30)
        if answer.status_code != 429:  # a picture for which a loaded machine has no time yet
            break
        time.sleep(float(answer.headers["retry-after"]))
    assert answer.status_code == status, answer.text
    return answer


@pytest.mark.parametrize("address", VIEWS)
def test_nothing_of_a_view_is_inline(site: Site, address: str) -> None:
    answer = get(site, address)
    policy = answer.headers["content-security-policy"]
    assert "unsafe" not in policy and "default-src 'none'" in policy
    text = answer.text
    assert not re.search(r"<style|\sstyle=|\son[a-z]+=|javascript:|data:", text)
    for tag in re.findall(r"<script[^>]*>", text):
        assert "src=" in tag or 'type="application/json"' in tag, tag
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', text)


@pytest.mark.parametrize("address", VIEWS)
def test_what_a_view_names_is_there(site: Site, address: str) -> None:
    found = set(re.findall(r'(?:src|href)="(/[^"#]*)"', get(site, address).text))
    for name in found:
        get(site, unescape(name).replace("{", "%7B").replace("}", "%7D"))


def test_words_of_a_job_are_text_not_markup(site: Site) -> None:
    assert "gold &lt;ball&gt;" in get(site, "/jobs/{job}").text
    assert "<ball>" not in get(site, "/").text


def test_a_job_tells_its_error_without_script(site: Site) -> None:
    text = get(site, "/jobs/{job}").text
    report = httpx.get(f"{site.url}/v1/jobs/{site.job}/report").json()
    assert report["certificate"]["statement"] in text.replace("&#39;", "'")
    assert '<svg class="plot"' in text and "render time / s" in text
    for name in report["kernel"]["left_out"]:
        assert name.replace("_", " ") in text


def test_the_newest_looks_of_a_long_job_are_told(site: Site) -> None:
    whole = [event for event in site.engine.events(job_id=site.job) if event.kind != "progress"]
    assert len(whole) > 3 and site.engine.history(site.job) == whole
    assert site.engine.history(site.job, 2) == whole[-2:], "not the oldest"


def test_every_example_has_its_picture() -> None:
    shelf = examples.shelf().values()
    assert len(shelf) == 1 + len(examples.ABOUT)
    assert [one.name for one in shelf if one.picture is None] == [], "examples/make_shelf.py"


@pytest.mark.parametrize(
    ("passed", "told"),
    [(1, "just now"), (50, "50 s ago"), (65, "1 min ago"), (306, "5 min ago"), (7300, "2 h ago"),
     (100_000, "27 h ago"), (200_000, "2 days ago"), (-125, "in 2 min")],
)  # fmt: skip
def test_moments_are_told_in_whole_units(passed: float, told: str) -> None:
    assert words.ago(time.time() - passed - 0.4) == told


def test_every_state_has_words() -> None:
    assert set(words.STATES) == set(JobState)


def test_the_list_leaves_out_cells_of_sweeps(site: Site) -> None:
    text = get(site, "/").text
    cells = site.engine.list_jobs(sweep_id=site.sweep)
    assert site.job in text and len(cells) == 6
    assert not any(cell.id in text for cell in cells)
    single = httpx.get(f"{site.url}/v1/jobs", params={"sweep": "none"}).json()["jobs"]
    assert site.job in {job["id"] for job in single}
    assert all(job["sweep_id"] is None for job in single)


def test_what_is_missing_is_told_in_html(site: Site) -> None:
    answer = get(site, "/jobs/no-such-job", status=404)
    assert answer.headers["content-type"].startswith("text/html")
    assert "no-such-job" in answer.text and "List the jobs" in answer.text
    get(site, "/static/x/../site.py", status=404)
    get(site, "/static/x/%2e%2e/site.py", status=404)


def test_style_and_script_are_kept_by_browsers(site: Site) -> None:
    (address,) = set(re.findall(r'href="(/static/[^"]*style.css)"', get(site, "/").text))
    assert "immutable" in get(site, address).headers["cache-control"]
