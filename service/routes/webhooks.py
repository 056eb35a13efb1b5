"""Webhooks: who is told of which events. Administration, and off unless a setting allows it."""

from __future__ import annotations

from datetime import datetime
from typing import cast

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from matiere.errors import SceneValidationError
from matiere.jobs.webhooks import ENDS, KINDS, Webhook, WebhookNotFound
from matiere.service.deps import EngineDep, SettingsDep
from matiere.service.errors import Problem, problem_of
from matiere.service.jsonbody import StrictRoute
from matiere.service.schemas import time_of
from matiere.service.webhook_guard import MAX_URL, Guard

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"], route_class=StrictRoute)


class WebhookRequest(BaseModel):
    """Who is to be told of what."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        json_schema_extra={"examples": [{"url": "https://example.org/matiere"}]},
    )

    url: str = Field(min_length=1, max_length=MAX_URL, description="where messages are POSTed")
    kinds: list[str] = Field(
        list(ENDS), min_length=1, max_length=len(KINDS), description=f"of {', '.join(KINDS)}"
    )
    cells: bool = Field(False, description="also what happens to single cells of sweeps")


class WebhookView(BaseModel):
    """A webhook, without its secret."""

    id: str
    url: str
    kinds: list[str]
    cells: bool
    created: datetime
    delivered: int = Field(description="messages that were taken")
    waiting: int = Field(description="messages that are still to be sent, or sent again")
    given_up: int = Field(description="messages that were not taken in any attempt")
    error: str | None = Field(description="of the newest attempt; null once one succeeded")
    disabled: str | None = Field(description="why nothing is sent any more")

    @classmethod
    def of(cls, webhook: Webhook) -> WebhookView:
        """Show `webhook`."""
        facts = vars(webhook) | {"kinds": list(webhook.kinds), "created": time_of(webhook.created)}
        return cls(**facts)


class NewWebhook(WebhookView):
    """A webhook just made."""

    secret: str = Field(description="signs the messages; it is shown this once")


class WebhookList(BaseModel):
    """All webhooks."""

    webhooks: list[WebhookView]


@router.get("", response_model=WebhookList)
def list_webhooks(engine: EngineDep) -> WebhookList:
    """List all webhooks and how they fare."""
    return WebhookList(webhooks=[WebhookView.of(one) for one in engine.webhooks.list()])


@router.post("", status_code=201, response_model=NewWebhook)
def create_webhook(
    wanted: WebhookRequest,
    request: Request,
    response: Response,
    engine: EngineDep,
    settings: SettingsDep,
) -> NewWebhook:
    """Tell an address of events from now on."""
    if not settings.webhooks:
        raise Problem("webhooks_off", "The setting `webhooks` of this service is false.")
    try:
        cast(Guard, request.app.state.guard).check(wanted.url)
        made, secret = engine.webhooks.create(wanted.url, wanted.kinds, cells=wanted.cells)
    except SceneValidationError as error:
        raise problem_of(error) from None
    response.headers["Location"] = f"/v1/webhooks/{made.id}"
    response.headers["Cache-Control"] = "no-store"
    return NewWebhook(**WebhookView.of(made).model_dump(), secret=secret)


@router.delete("/{webhook_id}", status_code=204)
def delete_webhook(webhook_id: str, engine: EngineDep) -> None:
    """Tell it nothing any more; what waits for it is dropped."""
    try:
        engine.webhooks.remove(webhook_id)
    except WebhookNotFound:
        raise Problem("webhook_not_found", f"No webhook has the id {webhook_id[:80]!r}.") from None
