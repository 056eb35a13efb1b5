"""A served queue with real renders of a few pixels, and one browser for all tests of the page."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="needs the extra matiere[service]")

from page_support import Site, fill
from real_queue import served_queue


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Serve a queue with a job and two sweeps that have ended."""
    with served_queue(tmp_path_factory.mktemp("page") / "data") as (engine, url):
        yield fill(engine, url)


@pytest.fixture(scope="module")  # its event loop may not run on beside tests of other files
def browser() -> Iterator[Any]:
    """Start Debian's chromium; skip where it is not installed."""
    driver = pytest.importorskip("playwright.sync_api", reason="needs the test group's playwright")
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("chromium is not installed; ./dev test installs it")
    with driver.sync_playwright() as play:
        started = play.chromium.launch(
            executable_path=program, args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        yield started
        started.close()


@pytest.fixture
def page(browser: Any, site: Site) -> Iterator[Any]:
    """Open a tab on the site; whatever the browser complains of fails the test."""
    context = browser.new_context(base_url=site.url, viewport={"width": 1280, "height": 900})
    tab = context.new_page()
    complaints: list[str] = []
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("console", lambda line: complaints.append(line.text) if _is_ours(line) else None)
    yield tab
    context.close()
    assert not complaints, complaints


def _is_ours(line: Any) -> bool:
    """Tell a complaint about policy or script from a refused request, which tests provoke."""
    return line.type in ("error", "warning") and "status of 4" not in line.text
