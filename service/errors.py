"""The one error shape of the HTTP API: RFC 9457 problem documents.

Every answer of status 4xx or 5xx is `application/problem+json` with

    type    stable URN, `urn:matiere:problem:<code>`
    code    the last part of `type`: what a program should switch on
    title   one line, the same for every problem of this code
    status  the HTTP status again
    detail  what happened this time
    remedy  what to do about it
    errors  list of {pointer, code, message}; pointers are RFC 6901 pointers into the request body

The table `CODES` is the list of all of them; docs/http.md repeats it and a test compares the two.
"""

from __future__ import annotations

import json
import logging
import uuid
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response

from matiere.errors import MatiereError

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:matiere:problem:"

log = logging.getLogger("matiere.service")


class Kind(NamedTuple):
    """Status, title and remedy shared by every problem of one code."""

    status: int
    title: str
    remedy: str


CODES: dict[str, Kind] = {
    "bad_request": Kind(400, "The request cannot be understood", "Correct the request."),
    "invalid_json": Kind(
        400, "The body is not valid JSON", "Send one JSON value, encoded as UTF-8."
    ),
    "invalid_idempotency_key": Kind(
        400, "The Idempotency-Key is not usable", "Send 1 to 200 printable ASCII characters."
    ),
    "invalid_cursor": Kind(
        400,
        "The cursor is not one this service gave out",
        "Use `next_cursor` of the last page unchanged, or start again without a cursor.",
    ),
    "key_missing": Kind(
        401,
        "An API key is needed",
        "Send `Authorization: Bearer <key>`; an administrator makes one with `matiere key create`.",
    ),
    "key_invalid": Kind(
        401,
        "The API key is not valid",
        "Ask an administrator for a new key (`matiere key rotate`).",
    ),
    "scope_missing": Kind(
        403, "The API key does not allow this", "Use a key of the scope that `detail` names."
    ),
    "origin_not_allowed": Kind(
        403,
        "Writes from another web origin are refused",
        "Call the API from a program, or from a page served by this same host and port.",
    ),
    "not_found": Kind(
        404, "There is nothing at this address", "See /v1/openapi.json for all routes."
    ),
    "job_not_found": Kind(
        404, "There is no such job", "List the jobs with GET /v1/jobs; ids are given at submission."
    ),
    "sweep_not_found": Kind(
        404, "There is no such sweep", "Use the id that POST /v1/sweeps answered."
    ),
    "key_not_found": Kind(404, "There is no such key", "List the keys with GET /v1/keys."),
    "webhook_not_found": Kind(
        404, "There is no such webhook", "List the webhooks with GET /v1/webhooks."
    ),
    "artifact_not_found": Kind(
        404,
        "This job has no such file",
        "GET the job: `links` lists the files it has.",
    ),
    "method_not_allowed": Kind(
        405, "This address does not take this method", "The `Allow` header lists the methods."
    ),
    "request_timeout": Kind(408, "The body came too slowly", "Send the body without long pauses."),
    "job_not_finished": Kind(
        409,
        "The job has no result yet",
        "GET the job until `state` is `succeeded`, then ask again; `links` lead to what there is"
        " already: its events, and once it has samples a preview.",
    ),
    "job_not_succeeded": Kind(
        409,
        "The job ended without a result",
        "GET the job: `error` says why; correct the cause and submit again.",
    ),
    "illegal_transition": Kind(
        409,
        "The job is in a state that does not allow this",
        "GET the job: `links` lists what can be asked of it.",
    ),
    "sweep_not_finished": Kind(
        409,
        "The sweep has no result yet",
        "GET the sweep until `state` is `succeeded`, then ask again.",
    ),
    "part_of_sweep": Kind(
        409,
        "The job is a cell of a sweep",
        "DELETE the sweep, or POST :cancel to stop this cell alone.",
    ),
    "pinned": Kind(
        409,
        "What is pinned cannot be deleted",
        "POST :unpin first, to the job or sweep that is pinned.",
    ),
    "waited_for": Kind(
        409,
        "Another job waits for this one",
        "Cancel or delete what waits (`after`) first, or let it end.",
    ),
    "webhooks_off": Kind(
        409,
        "This service tells no webhooks",
        "Have the operator set `webhooks = true`, or follow GET /v1/events.",
    ),
    "idempotency_in_flight": Kind(
        409,
        "The first request with this Idempotency-Key is still being accepted",
        "Wait a second and send the same request again.",
    ),
    "wrong_offset": Kind(
        409,
        "The upload does not go on where it ended",
        "Send the bytes from `Upload-Offset` on; HEAD tells it too.",
    ),
    "upload_busy": Kind(
        409,
        "Another request is uploading this asset",
        "Wait as `Retry-After` says, then ask HEAD whether it is there.",
    ),
    "asset_mismatch": Kind(
        422,
        "The bytes received do not have the digest in the address",
        "Compute SHA-256 over the file as sent, and upload again.",
    ),
    "body_too_large": Kind(
        413,
        "The body is too large",
        "Upload meshes and textures with PUT /v1/assets/{sha256} and refer to them by name.",
    ),
    "content_type_not_supported": Kind(
        415,
        "The Content-Type is not the one this address takes",
        "Send application/json, or application/octet-stream for assets.",
    ),
    "range_not_satisfiable": Kind(
        416, "The file ends before the range begins", "`Content-Range` tells how long it is."
    ),
    "host_not_allowed": Kind(
        421,
        "The Host header names a host this service does not answer for",
        "Use the URL that `matiere serve` printed, or add the name to the setting allowed_hosts.",
    ),
    "invalid_request": Kind(
        422, "The request does not have the right shape", "See `errors` for each field."
    ),
    "json_too_deep": Kind(422, "The JSON is nested too deeply", "Nest at most 64 levels."),
    "invalid_scene": Kind(
        422,
        "The scene has errors",
        "See `errors` for each value; `matiere schema` prints the JSON Schema.",
    ),
    "asset_missing": Kind(
        422,
        "The server lacks files that the scene uses",
        "PUT each file of `missing` to /v1/assets/{sha256}, then send the same request again;"
        " `matiere submit` does so.",
    ),
    "idempotency_conflict": Kind(
        422,
        "This Idempotency-Key was used with another body",
        "Use a new key for a new request.",
    ),
    "memory_limit": Kind(
        422, "The image would need more memory than one job may use", "Ask for a smaller film."
    ),
    "limit_exceeded": Kind(
        422,
        "The request is larger than this service takes",
        "Ask for less, or have the operator raise the limit (`matiere config` lists the settings).",
    ),
    "disk_limit": Kind(
        422,
        "The request would need more disk than there is",
        "Ask for fewer pixels, fewer replicates or fewer cells.",
    ),
    "not_comparable": Kind(
        422,
        "The two films cannot be compared",
        "Compare films of one size with the same number of replicates.",
    ),
    "unknown_view": Kind(
        422,
        "The colour configuration, display or view is not known",
        "`matiere info` lists the configuration used by default; see docs/scene.md.",
    ),
    "image_error": Kind(422, "An image file cannot be read", "Convert it and upload it again."),
    "too_many_checks": Kind(
        429,
        "There is no time for this check now",
        "Send it again in a few seconds; `matiere check` does the same on your own machine.",
    ),
    "too_many_pictures": Kind(
        429, "There is no time to draw this picture now", "Ask again in a few seconds."
    ),
    "too_many_comparisons": Kind(
        429,
        "There is no time for this comparison now",
        "Send it again in a few seconds; `matiere compare` does the same on your own machine.",
    ),
    "queue_full": Kind(
        429,
        "As many jobs wait as this service takes",
        "Send it again when some have ended, as `Retry-After` says.",
    ),
    "key_limit": Kind(
        429,
        "As much of this API key waits as the service takes from one",
        "Send it again when some of its jobs have ended, as `Retry-After` says.",
    ),
    "over_quota": Kind(
        429,
        "There is no room for this on the disk now",
        "Wait until other jobs have ended, or free space (`matiere du`, `matiere gc`).",
    ),
    "internal_error": Kind(
        500,
        "The service made a mistake",
        "Nothing was accepted. Report the incident number together with the service log.",
    ),
    "disk_full": Kind(
        507, "There is no room to store this", "Free disk space in the data directory."
    ),
    "draining": Kind(
        503,
        "The service is stopping",
        "Accepted jobs are kept and go on after the restart. Send this again then.",
    ),
    "not_ready": Kind(503, "The service is not ready", "See `errors`; ask again in a few seconds."),
    "busy": Kind(503, "The service cannot take this now", "Wait as `Retry-After` says."),
}

# codes of the package that HTTP tells more precisely
ALIASES = {"not_ready": "job_not_finished"}

# what a scene may be alone, told as the code of the whole problem
TOO_LARGE = {"limit_exceeded", "memory_limit", "disk_limit"}

_STATUS_CODES = {
    400: "bad_request",
    404: "not_found",
    405: "method_not_allowed",
    413: "body_too_large",
    415: "content_type_not_supported",
    503: "busy",
}


class Problem(HTTPException):
    """An answer to refuse a request with; `code` must be a key of `CODES`."""

    def __init__(
        self,
        code: str,
        detail: str,
        *,
        errors: Iterable[Mapping[str, str]] = (),
        headers: Mapping[str, str] | None = None,
        remedy: str | None = None,
        **extra: Any,
    ) -> None:
        self.kind = CODES[code]
        self.code = code
        self.errors = [dict(error) for error in errors]
        self.remedy = remedy or self.kind.remedy
        self.extra = extra
        super().__init__(self.kind.status, detail, dict(headers) if headers else None)

    def document(self) -> dict[str, Any]:
        """Return the problem document as a dict ready for JSON."""
        return {
            "type": TYPE_PREFIX + self.code,
            "code": self.code,
            "title": self.kind.title,
            "status": self.kind.status,
            "detail": self.detail,
            "remedy": self.remedy,
            "errors": self.errors,
            **self.extra,
        }

    def response(self) -> Response:
        """Return the HTTP response."""
        body = json.dumps(self.document(), ensure_ascii=True, allow_nan=False).encode()
        headers = {"Cache-Control": "no-store", **(self.headers or {})}
        return Response(body, self.status_code, headers, MEDIA_TYPE)


def pointer(parts: Iterable[str | int]) -> str:
    """Return the RFC 6901 pointer made of `parts`."""
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in parts)


def problem_of(error: MatiereError, prefix: str = "", own: tuple[str, ...] = ()) -> Problem:
    """Translate an error of the package.

    `prefix` is put before its JSON pointers, except before those that start in one of `own`: a
    submission holds the scene below "/scene", its stop rule beside it. A code of `CODES` keeps
    its status; another with a pointer is a mistake in the request; what is left is ours.
    """

    def place(at: str) -> str:
        return at if at.split("/")[1:2] and at.split("/")[1] in own else prefix + at

    errors = [
        {**item, "pointer": place(str(item.get("pointer") or ""))}
        for item in getattr(error, "errors", None) or []
    ]
    code = ALIASES.get(error.code, error.code)
    if not errors and error.pointer:
        errors = [{"pointer": place(error.pointer), "code": code, "message": error.message}]
    if code == "invalid_scene" and len(kinds := {error["code"] for error in errors}) == 1:
        code = next(iter(kinds & TOO_LARGE), code)
    if code not in CODES:
        code = "invalid_scene" if errors else "internal_error"
    detail = _summary(errors) if errors else error.message
    retry = {"Retry-After": "5"} if CODES[code].status in (429, 503) else None
    return Problem(code, detail, errors=errors, headers=retry)


def _summary(errors: list[dict[str, str]]) -> str:
    first = f"{errors[0]['pointer'] or 'the whole document'}: {errors[0]['message']}"
    if len(errors) == 1:
        return first
    return f"{len(errors)} errors; the first is {first}"


def incident(error: Exception, method: str, path: str) -> Problem:
    """Log an unexpected error under a number, and return the answer that tells only the number."""
    number = uuid.uuid4().hex[:12]
    log.error("incident %s at %s %s", number, method, path, exc_info=error)
    return Problem("internal_error", f"An unexpected error; incident {number}.", incident=number)


def install(app: FastAPI) -> None:
    """Make every foreseen error of `app` a problem document; `security.py` does the others."""

    def on_http(request: Request, error: Exception) -> Response:
        if isinstance(error, Problem):
            return error.response()
        assert isinstance(error, HTTPException)
        code = _STATUS_CODES.get(error.status_code, "bad_request")
        path = request.url.path
        detail = {
            "not_found": f"Nothing is served at {path}.",
            "method_not_allowed": f"{path} does not take {request.method}.",
        }.get(code, str(error.detail))
        return Problem(code, detail, headers=error.headers).response()

    def on_validation(_request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        return _validation_problem(error).response()

    def on_matiere(request: Request, error: Exception) -> Response:
        assert isinstance(error, MatiereError)
        problem = problem_of(error)
        if problem.code == "internal_error":
            problem = incident(error, request.method, request.url.path)
        return problem.response()

    app.add_exception_handler(HTTPException, on_http)
    app.add_exception_handler(RequestValidationError, on_validation)
    app.add_exception_handler(MatiereError, on_matiere)


def _validation_problem(error: RequestValidationError) -> Problem:
    errors = []
    for item in error.errors():
        where, *path = item["loc"]
        if where == "body":
            at = pointer(path)
            message = item["msg"]
        else:  # query parameters and headers have no place in the body: name them in words
            at = ""
            message = f"{where} parameter {'.'.join(map(str, path))}: {item['msg']}"
        errors.append({"pointer": at, "code": item["type"], "message": message})
    return Problem("invalid_request", _summary(errors), errors=errors)
