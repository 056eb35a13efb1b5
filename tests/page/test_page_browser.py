"""The page in a browser: submit, watch, cancel, faults at their lines, accessibility."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from page_support import Site, scene

LONG = {"spp": 1_000_000}
VIEWS = ["/", "/jobs/{job}", "/submit", "/workers", "/sweeps", "/sweeps/{sweep}",
         "/nights?a={sweep}&b={later}", "/materials", "/materials/conductor"]  # fmt: skip


def test_a_scene_is_submitted_watched_and_cancelled(page: Any, site: Site) -> None:
    page.goto("/submit")
    page.get_by_label("Scene, or a sweep").fill(json.dumps(scene(), indent=1))
    page.get_by_label("Name", exact=True).fill("from the page")
    page.get_by_label("Samples per pixel").fill("1000000")
    page.get_by_role("button", name="Submit").click()
    page.wait_for_url("**/jobs/*")
    assert page.get_by_role("heading", level=1).inner_text() == "from the page"
    samples = page.locator("dl.big div", has_text="samples").locator("dd")
    page.wait_for_function(
        "at => !['0 spp', at].includes([...document.querySelectorAll('dl.big div')]"
        ".find(d => d.textContent.includes('samples')).querySelector('dd').textContent)",
        arg=samples.inner_text(),
        timeout=60_000,
    )
    shown = page.locator("#picture").get_attribute("src", timeout=30_000)
    page.wait_for_function(
        "src => document.querySelector('#picture').getAttribute('src') !== src",
        arg=shown,
        timeout=60_000,
    )
    page.get_by_role("button", name="Cancel").click()
    page.locator(".status .state.cancelled").wait_for(timeout=30_000)
    job = site.engine.get_job(page.url.rsplit("/", 1)[1])
    assert job.state.value == "cancelled" and job.stop["spp"] == 1_000_000


def test_a_wrong_value_is_told_at_its_line(page: Any) -> None:
    wrong = scene(materials={"ball": {"type": "conductor", "metal": "Au", "alpha": 7}})
    text = json.dumps(wrong, indent=1)
    line = 1 + text[: text.index('"alpha"')].count("\n")
    page.goto("/submit")
    area = page.get_by_label("Scene, or a sweep")
    area.fill(text)
    page.get_by_role("button", name="Submit").click()
    fault = page.locator("#faults li").first
    fault.wait_for()
    assert f"Line {line}" in fault.inner_text()
    assert "/materials/ball/alpha" in fault.inner_text()
    chosen = area.evaluate("a => a.value.slice(a.selectionStart, a.selectionEnd)")
    assert '"alpha": 7' in chosen
    assert page.url.endswith("/submit")


@pytest.mark.parametrize(
    ("text", "line"), [('{"version": 1,\n "film" {}}', 2), ('{\n "a": [1,\n 2,,]}', 3), ("", 1)]
)
def test_what_is_not_json_is_told_at_its_line(page: Any, text: str, line: int) -> None:
    page.goto("/submit")
    page.get_by_label("Scene, or a sweep").fill(text)
    page.get_by_role("button", name="Submit").click()
    fault = page.locator("#faults li").first
    fault.wait_for()
    assert f"Line {line}:" in fault.inner_text()


def test_materials_of_a_job_are_tested_for_stability(page: Any, site: Site) -> None:
    asked: list[dict[str, Any]] = []

    def answer(route: Any) -> None:  # the report itself has tests of its own, in test_checks
        asked.append(route.request.post_data_json)
        busy = len(asked) == 1
        body = {"detail": "busy"} if busy else {"verdict": "warn", "reason": "it says why"}
        route.fulfill(status=429 if busy else 200, json=body)

    page.route("**/v1/checks", answer)
    page.goto(f"/jobs/{site.job}")
    page.get_by_role("button", name="Test the materials").click()
    page.locator("[data-check=ball] .verdict.warn").wait_for(timeout=30_000)
    assert "passes with a warning: it says why" in page.locator("[data-check=ball]").inner_text()
    assert asked == [{"material": scene()["materials"]["ball"]}] * 2


def test_axes_of_a_sweep_are_switched_and_cells_compared(page: Any, site: Site) -> None:
    page.goto(f"/sweeps/{site.sweep}")
    heads = page.locator("table.grid thead th")
    assert heads.all_inner_texts()[1:] == ["0.1", "0.3", "0.6"]
    page.get_by_label("Across").select_option(label="metal")
    page.wait_for_url("**columns=0**")
    page.locator("table.grid thead th", has_text="Cu").wait_for()
    assert heads.all_inner_texts()[1:] == ["Au", "Cu"]
    assert page.locator("table.grid tbody th").all_inner_texts() == ["0.1", "0.3", "0.6"]
    boxes = page.locator("input[name=cell]")
    for index in range(3):  # the first choice gives way
        boxes.nth(index).check()
    assert page.locator("input[name=cell]:checked").count() == 2
    page.get_by_role("button", name="Compare the two chosen cells").click()
    page.wait_for_url("**/compare?**")
    page.wait_for_function(
        "() => document.querySelector('#statement').textContent.includes('mean luminance')",
        timeout=30_000,
    )
    page.get_by_label("Slide between the two").fill("25")
    assert "75%" in page.locator(".top-image").evaluate("i => i.style.clipPath")
    chosen = [site.engine.get_job(one) for one in re.findall(r"cell=([^&]+)", page.url)]
    shown = page.locator("img.top-image").get_attribute("alt")
    assert shown == chosen[0].label == page.locator(".ends span").first.inner_text()[3:]
    drawn = page.locator("img.map").evaluate("i => i.decode().then(() => i.naturalWidth)")
    assert drawn > 100


def test_a_thumbnail_that_met_a_busy_service_comes_later(page: Any, site: Site) -> None:
    asked: list[str] = []

    def answer(route: Any) -> None:
        asked.append(route.request.url)
        if len(asked) == 1:
            route.fulfill(status=429, json={"detail": "busy"})
        else:
            route.continue_()

    page.route(f"**/{site.job}/thumbnail.jpg", answer)
    page.goto("/")
    page.wait_for_function(
        f"() => document.querySelector('#job-{site.job} img')?.naturalWidth > 0", timeout=60_000
    )
    assert len(asked) == 2


def test_the_ball_follows_its_sliders(page: Any) -> None:
    page.goto("/materials/conductor")
    ball = page.locator("#ball")
    before = ball.get_attribute("src")
    page.locator("#turn [name=alpha]").fill("0.5")
    page.wait_for_function(
        "src => document.querySelector('#ball').getAttribute('src') !== src",
        arg=before,
        timeout=30_000,
    )
    assert "0.5" in page.locator("#json").inner_text()
    assert ball.evaluate("i => i.naturalWidth") == 192


def test_exposure_is_changed_without_rendering(page: Any, site: Site) -> None:
    page.goto(f"/jobs/{site.job}")
    rendered = site.engine.status()["counters"].get("chunks_rendered")
    page.get_by_label("Exposure").fill("2")
    page.wait_for_function(
        "() => document.querySelector('#picture').getAttribute('src').includes('exposure=2')",
        timeout=30_000,
    )
    assert page.locator("#picture").evaluate("i => i.naturalWidth") == 32
    assert site.engine.status()["counters"].get("chunks_rendered") == rendered


@pytest.mark.parametrize("address", VIEWS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_view_is_accessible(browser: Any, site: Site, address: str, scheme: str) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe")
    context = browser.new_context(base_url=site.url, color_scheme=scheme, bypass_csp=True)
    tab = context.new_page()
    tab.goto(address.format(job=site.job, sweep=site.sweep, later=site.later))
    found = axe.Axe().run(tab).response["violations"]
    context.close()
    serious = [
        (one["id"], one["help"], [node["html"][:160] for node in one["nodes"]])
        for one in found
        if one["impact"] in ("serious", "critical")
    ]
    assert not serious, serious


@pytest.mark.parametrize("address", VIEWS)
def test_a_view_fits_a_telephone(browser: Any, site: Site, address: str) -> None:
    context = browser.new_context(base_url=site.url, viewport={"width": 375, "height": 800})
    tab = context.new_page()
    tab.goto(address.format(job=site.job, sweep=site.sweep, later=site.later))
    assert tab.evaluate("document.documentElement.scrollWidth") <= 375
    context.close()


def test_a_view_reads_without_script(browser: Any, site: Site) -> None:
    context = browser.new_context(base_url=site.url, java_script_enabled=False)
    tab = context.new_page()
    tab.goto(f"/jobs/{site.job}")
    assert re.search(r"relMSE of this image lies between", tab.inner_text("main"))
    assert tab.locator("svg.plot").is_visible() and tab.locator("#picture").is_visible()
    context.close()
