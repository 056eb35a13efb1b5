"""`/metrics` tells what happened, exactly; JSON logs and spans name job, chunk and attempt."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any
from uuid import UUID

import httpx
import pytest
from fake_engine import FakeEngine
from prometheus_client.parser import text_string_to_metric_families
from serving import serve

from matiere.jobs import tracing
from matiere.jobs.job import FINAL_STATES
from matiere.service.settings import Settings

SCENE = {"width": 16, "height": 16, "value": 0.5, "render": {"spp": 16}}


def scrape(client: httpx.Client) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    """Return every sample by its name and labels."""
    answer = client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    return {
        (s.name, tuple(sorted(s.labels.items()))): s.value
        for family in text_string_to_metric_families(answer.text)
        for s in family.samples
    }


def test_requests_are_counted_by_route_and_status(client: httpx.Client, engine: FakeEngine) -> None:
    def count(route: str, status: str, method: str = "GET") -> float:
        labels = (("method", method), ("route", route), ("status", status))
        return scrape(client).get(("matiere_http_requests_total", labels), 0.0)

    before = count("/v1/jobs/{job_id}", "404"), count("other", "404", "other")
    for number in range(3):
        client.get(f"/v1/jobs/none-{number}")
        client.request("BREW", f"/nowhere/{number}")
        client.get(f"/nowhere/{number}")
    after = count("/v1/jobs/{job_id}", "404"), count("other", "404", "other")
    assert (after[0] - before[0], after[1] - before[1]) == (3, 3 + 3 * 1)


def test_a_service_tells_what_it_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MATIERE_LOG_FORMAT", "json")
    data = tmp_path / "data"
    with (
        serve(data, "--children", 1) as (_, client),
        httpx.Client(base_url=client.url, timeout=10) as http,
    ):
        job = client.submit(SCENE)
        bad = client.submit({**SCENE, "value": 0.7, "misdeed": {"kind": "SIGSEGV"}})
        done, failed = client.wait(job.id, timeout_s=30), client.wait(bad.id, timeout_s=60)
        again = client.wait(client.submit(SCENE).id, timeout_s=30)
        queued = client.submit({**SCENE, "value": 0.9, "chunk_s": 30.0}, priority=7)
        held = [client.submit({**SCENE, "value": 2.0 + n}, priority=7) for n in range(3)]
        running, end = ("matiere_jobs", (("state", "running"),)), time.monotonic() + 30
        while (found := scrape(http))[running] < 2:  # one at work and one that waits in the child
            assert time.monotonic() < end
            time.sleep(0.5)
        for one in (queued, *held):
            client.cancel(one.id)

    def value(name: str, **labels: str) -> float:
        return found[name, tuple(sorted(labels.items()))]

    assert done.state == again.state == "succeeded"
    assert value("matiere_jobs_ended_total", state="succeeded") == 2
    ended = [labels for name, labels in found if name == "matiere_jobs_ended_total"]
    counted = {dict(labels)["state"] for labels in ended}
    assert counted == set(FINAL_STATES)
    assert failed.state == "failed" and value("matiere_jobs_ended_total", state="failed") == 1
    assert value("matiere_claims_ended_early_total", **{"class": "signal"}) == 3  # attempts
    assert value("matiere_children_ended_total", **{"class": "signal"}) == 3
    assert value("matiere_cache_hits_total") == 1
    assert value("matiere_jobs_queued_total") == 7
    assert value("matiere_queue_jobs", priority="7") == 2
    assert 0 < value("matiere_queue_oldest_seconds", priority="7") < 60
    assert value("matiere_jobs", state="running") == 2
    assert value("matiere_pixel_samples_total") >= 16 * 16 * 16
    assert value("matiere_chunk_seconds_count") >= 1
    assert value("matiere_merge_seconds_count") >= 1
    assert value("matiere_images_seconds_count") >= 1
    assert value("matiere_store_write_seconds_bucket", le="+Inf") == value(
        "matiere_store_write_seconds_count"
    )
    assert value("matiere_child_resident_bytes", child="child-1") > 2**20
    assert value("matiere_child_ready", child="utility") == 1
    assert value("matiere_store_bytes") > 0 and value("process_open_fds") > 3
    lines = [json.loads(line) for line in (data / "logs/serve.log").read_text().splitlines()]
    rendered = [line for line in lines if line.get("job") == [job.id] and "chunk" in line]
    assert rendered and all(line["attempt"] > 0 and line["film"] for line in rendered)
    assert rendered[0]["chunk"][0] == 0 and rendered[0]["time"].endswith("Z")
    assert all({"time", "level", "logger", "message"} <= set(line) for line in lines)


def test_a_scrape_scans_no_table(tmp_path: Path) -> None:
    """Whatever the planner is asked at a scrape, it goes along an index."""
    from matiere.jobs.store import gauges
    from matiere.jobs.store.database import Database

    database = Database(tmp_path / "store.sqlite")
    asked: list[tuple[str, Any]] = []

    def explain(c: Any) -> list[str]:
        import sqlalchemy as sa

        def note(_conn: Any, _cursor: Any, text: str, values: Any, *_: Any) -> None:
            asked.append((text, values))

        sa.event.listen(c, "before_cursor_execute", note)
        gauges.live_jobs(c)
        gauges.queue(c)
        sa.event.remove(c, "before_cursor_execute", note)
        return [
            str(row[-1])
            for text, values in asked
            for row in c.exec_driver_sql(f"EXPLAIN QUERY PLAN {text}", values)
        ]

    steps = database.read(explain)
    database.close()
    print(steps)
    assert len(steps) >= 4
    assert not [s for s in steps if s.startswith("SCAN")]


def test_spans_of_a_job_share_the_trace_that_its_id_names(tmp_path: Path) -> None:
    pytest.importorskip("opentelemetry.sdk")
    from opentelemetry.sdk.trace.export import SimpleSpanProcessor
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
    from real_queue import served_queue

    kept = InMemorySpanExporter()
    tracing.install(SimpleSpanProcessor(kept))
    try:
        with served_queue(tmp_path / "data") as (engine, _):
            scene = json.loads(
                (Path(__file__).parents[2] / "examples/scenes/first.json").read_text()
            )
            scene["film"] = {"width": 32, "height": 32}
            job = engine.wait_job(engine.submit_job(scene, stop={"spp": 4}).id, 60)
    finally:
        tracing.disable()
    spans = {span.name: span for span in kept.get_finished_spans()}
    assert job.state == "succeeded" and set(spans) == {"submit", "claim", "merge", "images"}
    assert {span.context.trace_id for span in spans.values()} == {UUID(job.id).int}
    root = spans.pop("submit")
    assert root.parent is None
    assert {span.parent.span_id for span in spans.values()} == {root.context.span_id}
    assert all(span.start_time < span.end_time for span in spans.values())
    assert spans["claim"].attributes["matiere.attempt"] > 0


def test_without_tracing_nothing_of_opentelemetry_is_loaded() -> None:
    """But for its API, which FastAPI looks for by itself where it is installed."""
    code = (
        "import matiere.service.app, matiere.jobs.engine, sys;"
        "parts = ('opentelemetry.sdk', 'opentelemetry.exporter');"
        "print([m for m in sys.modules if m.startswith(parts)])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_tracing_without_its_extra_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opentelemetry.exporter.otlp.proto.http.trace_exporter", None)
    with pytest.raises(Exception, match=r"pip install 'matiere\[otel\]'"):
        tracing.enable()
    assert Settings().tracing is False
