"""The FastAPI application: routes, checks and error shape around one job queue.

The application neither opens nor closes the queue: `server.py` (and a test) does that around it.
Handlers are plain `def`: they run in a thread pool, call the queue's short methods and touch no
pixels.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import cast

import anyio.to_thread
from fastapi import FastAPI
from fastapi.responses import JSONResponse

from matiere.jobs.engine import Engine
from matiere.service import errors
from matiere.service.access import Gate, unruled
from matiere.service.broadcast import Broadcaster
from matiere.service.deps import InFlight
from matiere.service.metrics import Metrics, MetricsMiddleware, RouteNote
from matiere.service.openapi import Application
from matiere.service.page.router import router as page
from matiere.service.routes import (
    assets,
    checks,
    events,
    health,
    history,
    jobs,
    keys,
    materials,
    metrics,
    nights,
    pictures,
    storage,
    sweeps,
    webhooks,
)
from matiere.service.security import LOOPBACK_NAMES, SecurityMiddleware, own_names
from matiere.service.settings import Settings
from matiere.service.webhook_guard import Guard

API_VERSION = "1.0.0"
HANDLER_THREADS = 32
UPLOADS_AT_ONCE = 16

_DESCRIPTION = """Renders materials described in JSON and says how large the error of each image is.
Every error is an RFC 9457 problem document with a stable `code` and JSON pointers."""


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    anyio.to_thread.current_default_thread_limiter().total_tokens = HANDLER_THREADS
    app.state.uploads = anyio.CapacityLimiter(UPLOADS_AT_ONCE)
    yield


def create_app(engine: Engine, settings: Settings) -> FastAPI:
    """Return the ASGI application that serves `engine`."""
    problem = {"description": "Problem document", "content": {errors.MEDIA_TYPE: {}}}
    app = Application(
        title="matiere",
        version=API_VERSION,
        description=_DESCRIPTION,
        openapi_url="/v1/openapi.json",
        docs_url=None,  # the stock pages load scripts from elsewhere
        redoc_url=None,
        redirect_slashes=False,
        lifespan=_lifespan,
        default_response_class=JSONResponse,
        responses={"4XX": problem, "5XX": problem},
    )
    app.state.engine = engine
    app.state.settings = settings
    app.state.in_flight = InFlight()
    app.state.broadcaster = Broadcaster(lambda: cast(Engine, app.state.engine))
    app.state.metrics = Metrics(lambda: cast(Engine, app.state.engine))
    gate = Gate(lambda: cast(Engine, app.state.engine), always=settings.asks_for_keys)
    app.state.gate = gate
    app.state.guard = Guard(hosts=settings.webhook_hosts, http=settings.webhook_http)
    errors.install(app)
    app.add_middleware(RouteNote)
    app.add_middleware(
        SecurityMiddleware,
        hosts=(*LOOPBACK_NAMES, *own_names(settings.host), *settings.allowed_hosts),
        max_body_bytes=settings.max_body_bytes,
        max_asset_bytes=settings.max_asset_bytes,
        body_timeout_s=settings.body_timeout_s,
        gate=gate,
    )
    app.add_middleware(MetricsMiddleware, metrics=app.state.metrics)  # outermost
    of_jobs = (events, jobs, history, sweeps, nights, pictures, assets)
    for routes in (*of_jobs, materials, checks, storage, keys, webhooks, health, metrics):
        app.include_router(routes.router)
    app.include_router(page)
    if missing := unruled(app.routes):
        raise RuntimeError(f"service/access.py has no rule for {', '.join(missing)}")
    return app
