"""The page of a service with keys: the browser asks its user, then everything works."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
from page_support import scene
from real_queue import served_queue


def test_a_browser_with_a_key_sees_pictures_and_events_and_may_submit(
    browser: Any, tmp_path: Path
) -> None:
    with served_queue(tmp_path / "data") as (engine, url):
        _, key = engine.keys.create("me", "submit")
        job = engine.submit_job(scene(), stop={"spp": 1_000_000})
        done = engine.submit_job(scene(), stop={"spp": 1}, priority=100)
        assert httpx.get(f"{url}/jobs/{job.id}", timeout=30).status_code == 401
        login = {"username": "me", "password": key}
        context = browser.new_context(base_url=url, http_credentials=login)
        page = context.new_page()
        streams: list[int] = []
        page.on(
            "response",
            lambda one: streams.append(one.status) if one.url.endswith("/events") else None,
        )
        page.goto(f"/jobs/{job.id}")
        picture = "document.querySelector('#picture')"
        page.wait_for_function(f"() => {picture} && {picture}.naturalWidth > 0", timeout=60_000)
        page.get_by_role("button", name="Cancel").click()
        page.locator(".status .state.cancelled").wait_for(timeout=30_000)
        assert 200 in streams, streams
        engine.wait_job(done.id, 60)
        page.goto(f"/jobs/{done.id}")
        page.wait_for_function(f"() => {picture} && {picture}.naturalWidth > 0", timeout=60_000)
        context.close()
