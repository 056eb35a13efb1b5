"""Whether the process lives (`/healthz`) and whether it can take and do work (`/readyz`)."""

from __future__ import annotations

from fastapi import APIRouter

from matiere.service.deps import EngineDep
from matiere.service.errors import Problem
from matiere.service.schemas import CheckView, ReadyView

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def healthz() -> dict[str, str]:
    """Answer as long as the process serves requests."""
    return {"status": "ok"}


@router.get("/readyz", response_model=ReadyView)
def readyz(engine: EngineDep) -> ReadyView:
    """Check a write transaction, an artifact write, a child's heartbeat, free space, draining."""
    readiness = engine.readiness()
    checks = {
        name: CheckView(ok=check.ok, detail=check.detail)
        for name, check in readiness.checks.items()
    }
    if not readiness.ready:
        failed = [(name, check) for name, check in checks.items() if not check.ok]
        raise Problem(
            "not_ready",
            "; ".join(f"{name}: {check.detail}" for name, check in failed),
            errors=[
                {"pointer": "", "code": name, "message": check.detail} for name, check in failed
            ],
            headers={"Retry-After": "5"},
            checks={name: check.model_dump() for name, check in checks.items()},
        )
    return ReadyView(ready=True, checks=checks)


@router.get("/v1/status")
def status(engine: EngineDep) -> dict[str, object]:
    """Show children, queue, disk and counters."""
    return engine.status()
