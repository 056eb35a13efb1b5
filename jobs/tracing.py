"""Spans for OpenTelemetry, off until `enable`: without it nothing of its SDK is imported.

All spans of a job share one trace, whose id is the job's: a restart, another process and the
client that has only the job's id find it, and nothing has to be stored. `submit` is its root.
"""

from __future__ import annotations

import threading
import time
from typing import Any
from uuid import UUID

from matiere.jobs.errors import JobsError

_tracer: Any = None
_provider: Any = None
_root = threading.local()


def enable(service: str = "matiere") -> None:
    """Send spans as the environment says (`OTEL_EXPORTER_OTLP_ENDPOINT` and its kin).

    Raises `JobsError` where the libraries are missing.
    """
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError:
        raise JobsError(
            "`tracing` needs OpenTelemetry: pip install 'matiere[otel]'", code="missing_extra"
        ) from None
    install(BatchSpanProcessor(OTLPSpanExporter()), service)


def install(processor: Any, service: str = "matiere") -> None:
    """Give every span to an OpenTelemetry span processor."""
    global _tracer, _provider
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.id_generator import RandomIdGenerator

    class Ids(RandomIdGenerator):
        """Gives the ids that a root span was asked to have."""

        def generate_trace_id(self) -> int:
            chosen = getattr(_root, "job", None)
            return chosen.int if chosen else super().generate_trace_id()

        def generate_span_id(self) -> int:
            chosen = getattr(_root, "job", None)
            return _span_id(chosen) if chosen else super().generate_span_id()

    _provider = TracerProvider(
        resource=Resource.create({"service.name": service}), id_generator=Ids()
    )
    _provider.add_span_processor(processor)
    _tracer = _provider.get_tracer("matiere")


def disable() -> None:
    """Send what is left, and stop."""
    global _tracer, _provider
    provider, _tracer, _provider = _provider, None, None
    if provider is not None:
        provider.shutdown()


def record(name: str, job_id: str, seconds: float, **attributes: Any) -> None:
    """Record a span that ended now after `seconds`; `submit` is the root of a job's trace."""
    if _tracer is None:
        return
    from opentelemetry import trace
    from opentelemetry.context import Context

    job, end = UUID(job_id), time.time_ns()
    if name == "submit":
        context = Context()
        _root.job = job
    else:
        flags = trace.TraceFlags(trace.TraceFlags.SAMPLED)
        parent = trace.SpanContext(job.int, _span_id(job), is_remote=True, trace_flags=flags)
        context = trace.set_span_in_context(trace.NonRecordingSpan(parent), Context())
    try:
        span = _tracer.start_span(
            name, context, start_time=end - int(1e9 * seconds),
            attributes={f"matiere.{key}": value for key, value in attributes.items()}
            | {"matiere.job": job_id},
        )  # fmt: skip
    finally:
        _root.job = None
    span.end(end)


def _span_id(job: UUID) -> int:
    return (job.int & (2**64 - 1)) or 1
