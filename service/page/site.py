"""Templates, style and script of the page, and the answer that carries them.

Nothing is inline and nothing comes from elsewhere: the Content-Security-Policy allows this origin
alone. Style and script lie at addresses that name the digest of all of them, so a browser keeps
them for good and a new version is seen at once.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Coroutine
from functools import cache
from pathlib import Path
from typing import Any

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.responses import FileResponse, HTMLResponse

import matiere
from matiere.errors import MatiereError
from matiere.service.errors import Problem, problem_of
from matiere.service.page import words

HERE = Path(__file__).resolve().parent
STATIC = HERE / "static"
POLICY = (
    "default-src 'none'; img-src 'self'; style-src 'self'; script-src 'self'; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
TYPES = {
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
    ".jpg": "image/jpeg",
}
VIEWS = (
    ("/", "Jobs"), ("/sweeps", "Sweeps"), ("/nights", "Nights"), ("/materials", "Materials"),
    ("/workers", "Workers"), ("/submit", "Submit"),
)  # fmt: skip


@cache
def digest() -> str:
    """Return a digest of all style and script."""
    hasher = hashlib.sha256()
    for path in sorted(STATIC.rglob("*")):
        if path.is_file():
            hasher.update(path.name.encode() + b"\0" + path.read_bytes())
    return hasher.hexdigest()[:12]


def asset(name: str) -> str:
    """Return the address of a file of style or script."""
    return f"/static/{digest()}/{name}"


def static_file(name: str) -> Response | None:
    """Return a file of style or script, None for a name that is not one."""
    path = STATIC / name
    if path.suffix not in TYPES or not path.is_file() or STATIC not in path.resolve().parents:
        return None
    headers = {"Cache-Control": "public, max-age=31536000, immutable"}
    return FileResponse(path, media_type=TYPES[path.suffix], headers=headers)


@cache
def environment() -> Environment:
    """Return the templates with their filters."""
    loader = PackageLoader("matiere.service.page")
    made = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals |= {"asset": asset, "views": VIEWS, "words": words}
    made.globals |= {"version": matiere.__version__}
    for name in ("number", "interval", "seconds", "size", "moment", "ago", "short", "name_of"):
        made.filters[name] = getattr(words, name)
    made.filters["pretty"] = lambda value: json.dumps(value, indent=1, ensure_ascii=False)
    return made


def html(template: str, view: str, http_status: int = 200, **context: Any) -> HTMLResponse:
    """Return a view of the page; `view` is the address that the navigation marks."""
    text = environment().get_template(template).render(view=view, **context)
    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-store"}
    return HTMLResponse(text, status_code=http_status, headers=headers)


def failure(problem: Problem) -> HTMLResponse:
    """Return a problem as a view of the page."""
    return html("problem.html", "", problem.status_code, problem=problem.document())


class PageRoute(APIRoute):
    """A route of the page: what goes wrong is told in HTML."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Answer problems as a view."""
        inner = super().get_route_handler()

        async def handler(request: Request) -> Response:
            try:
                return await inner(request)
            except Problem as problem:
                return failure(problem)
            except RequestValidationError:
                return failure(Problem("bad_request", "A part of the address is not understood."))
            except MatiereError as error:
                return failure(problem_of(error))

        return handler
