"""Strict JSON: what a well-meaning client never sends is refused before anything looks at it.

Python's parser takes NaN, Infinity, 1e999, duplicate keys and lone surrogates; each of them would
surface later as a strange number, a lost value or an encoding error deep inside. Here each gives
one error with a JSON pointer. Nesting is measured on the bytes, before parsing.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Coroutine, Iterable
from typing import Any

from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from matiere.service.errors import Problem, pointer

MAX_DEPTH = 64
MAX_INTEGER_DIGITS = 20  # 2**64 has 20 digits; nothing in a scene or a request needs more
MAX_ERRORS = 20  # a hostile body may hold a million; the first few say it all

# An unterminated string runs to the end of the text: one match, not one try per quote.
_STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+(?:"|\Z|\\\Z)', re.DOTALL)
_TO_ONE_KIND = bytes.maketrans(b"{}", b"[]")
_NOT_A_BRACKET = bytes(set(range(256)) - set(b"[]{}"))
_SURROGATE = re.compile("[\ud800-\udfff]")
_SURROGATE_ESCAPE = re.compile(rb"\\u[dD][89a-fA-F]")


class _Refused:
    """Stands in the parsed tree where a value was refused, until its pointer is known."""

    def __init__(self, code: str, message: str) -> None:
        self.code, self.message = code, message


class _Duplicate(dict[str, Any]):
    """An object in which a key came twice."""

    key = ""


def too_deep(body: bytes, limit: int = MAX_DEPTH) -> bool:
    """Tell whether arrays and objects nest more than `limit` levels."""
    brackets = _STRING.sub(b"", body).translate(_TO_ONE_KIND, _NOT_A_BRACKET)
    for _ in range(limit):  # each round strips the innermost level everywhere, at C speed
        stripped = brackets.replace(b"[]", b"")
        if len(stripped) == len(brackets):  # empty, or unbalanced: "]]][[["
            return brackets.count(b"[") > limit
        brackets = stripped
    return b"[]" in brackets or brackets.count(b"[") > limit


def loads(body: bytes) -> Any:
    """Parse one JSON value; raise `Problem` with a pointer for each value refused."""
    try:
        text = body.decode("utf-8")
    except UnicodeDecodeError as error:
        raise Problem("invalid_json", f"Byte {error.start} is not valid UTF-8.") from None
    if too_deep(body):
        raise _depth_problem(text)
    suspicious = _SURROGATE_ESCAPE.search(body) is not None
    refused: list[_Refused] = []

    def refuse(code: str, message: str) -> _Refused:
        nonlocal suspicious
        suspicious = True
        if len(refused) < MAX_ERRORS:  # a million of them share the last one
            refused.append(_Refused(code, message))
        return refused[-1]

    def on_float(token: str) -> float | _Refused:
        value = float(token)
        if math.isfinite(value):
            return value
        return refuse("not_finite", f"{token[:40]} is larger than any 64-bit float")

    def on_integer(token: str) -> int | _Refused:
        if len(token) <= MAX_INTEGER_DIGITS:
            return int(token)
        return refuse("out_of_range", f"{token[:40]}... has more than 20 digits")

    def on_constant(token: str) -> _Refused:
        return refuse("not_finite", f"{token} is not JSON; numbers must be finite")

    def on_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        nonlocal suspicious
        plain = dict(pairs)
        if len(plain) == len(pairs):
            return plain
        suspicious = True
        marked, seen = _Duplicate(plain), set[str]()
        for key, _ in pairs:
            if key in seen:
                marked.key = key
            seen.add(key)
        return marked

    try:
        value = json.loads(
            text,
            parse_float=on_float,
            parse_int=on_integer,
            parse_constant=on_constant,
            object_pairs_hook=on_object,
        )
    except json.JSONDecodeError as error:
        message = f"{error.msg} at line {error.lineno}, column {error.colno}"
        raise Problem(
            "invalid_json",
            message,
            errors=[{"pointer": "", "code": "invalid_json", "message": message}],
            line=error.lineno,
            column=error.colno,
        ) from None
    except RecursionError:  # unbalanced brackets can hide depth from `too_deep`
        raise _depth_problem("") from None
    if suspicious and (errors := _refusals(value)):
        first = errors[0]
        raise Problem(
            "invalid_request",
            f"{first['pointer'] or 'the whole document'}: {first['message']}",
            errors=errors,
        )
    return value


def _depth_problem(text: str) -> Problem:
    message = f"nested deeper than {MAX_DEPTH} levels"
    where = pointer(_deep_place(text)[:MAX_DEPTH])
    return Problem(
        "json_too_deep",
        f"{where or 'The JSON'}: {message}",
        errors=[{"pointer": where, "code": "too_deep", "message": message}],
    )


def _deep_place(text: str) -> list[str | int]:
    """Return the path to the first value that lies too deep; empty if it cannot be parsed."""
    try:
        root = json.loads(text)
    except (ValueError, RecursionError):
        return []
    path: list[str | int] = []

    def search(value: Any) -> bool:
        if not isinstance(value, dict | list):
            return False
        if len(path) >= MAX_DEPTH:
            return True
        for key, item in _items(value):
            path.append(key)
            if search(item):
                return True
            path.pop()
        return False

    search(root)
    return path


def _refusals(root: Any) -> list[dict[str, str]]:
    """Return one error per refused value, with its pointer, up to MAX_ERRORS."""
    found: list[dict[str, str]] = []
    path: list[str | int] = []

    def add(code: str, message: str, *more: str) -> None:
        shown = _SURROGATE.sub("\N{REPLACEMENT CHARACTER}", pointer((*path, *more)))
        found.append({"pointer": shown, "code": code, "message": message})

    def visit(value: Any) -> None:
        if isinstance(value, _Refused):
            add(value.code, value.message)
        elif isinstance(value, str):
            if _SURROGATE.search(value):
                add("text_not_unicode", "half of a surrogate pair is no character")
        elif isinstance(value, dict | list):
            if isinstance(value, _Duplicate):
                add("duplicate_key", "this key comes twice; keep one", value.key)
            for key, item in _items(value):
                if len(found) >= MAX_ERRORS:
                    return
                if isinstance(key, str) and _SURROGATE.search(key):
                    add("text_not_unicode", "a key holds half of a surrogate pair", key)
                path.append(key)
                visit(item)
                path.pop()

    visit(root)  # at most MAX_DEPTH levels: `too_deep` was asked before
    return found


def _items(value: dict[str, Any] | list[Any]) -> Iterable[tuple[str | int, Any]]:
    return value.items() if isinstance(value, dict) else enumerate(value)


class _StrictRequest(Request):
    async def json(self) -> Any:
        """Return the body, parsed by `loads` away from the event loop."""
        return await run_in_threadpool(loads, await self.body())


class StrictRoute(APIRoute):
    """A route whose JSON body is read by `loads`."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Wrap FastAPI's handler so that it sees a strict request."""
        handler = super().get_route_handler()

        async def strict(request: Request) -> Response:
            return await handler(_StrictRequest(request.scope, request.receive))

        return strict
