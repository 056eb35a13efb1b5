"""Two OpenAPI documents compared: every difference, and whether it breaks clients that work today.

What a client sends may only be taken more widely, what it gets only be told more narrowly:

              sent (parameters, bodies)                    received (answers)
breaking      removed, newly required, narrowed            removed, no longer promised, widened
not breaking  new and optional, widened                    new, narrowed
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

SCHEMAS = "#/components/schemas/"
LOWER = ("minimum", "exclusiveMinimum", "minLength", "minItems", "minProperties")
UPPER = ("maximum", "exclusiveMaximum", "maxLength", "maxItems", "maxProperties")
SAID = ("description", "title", "summary", "example", "examples", "default", "tags")
UNION = ("anyOf", "oneOf", "allOf")
Json = dict[str, Any]


@dataclass(frozen=True)
class Difference:
    """One difference: `name` is what a line of README's Changes says in backquotes."""

    name: str
    what: str
    breaking: bool

    def __str__(self) -> str:
        """Return one line."""
        return f"{'BREAKING  ' if self.breaking else 'compatible'}  {self.name}: {self.what}"


def compare(old: Json, new: Json) -> list[Difference]:
    """Return every difference, the breaking ones first."""
    found = list(dict.fromkeys(_Comparison(old, new).all()))
    if not found and old != new:
        found = [Difference("the document", "other words or examples", False)]
    return sorted(found, key=lambda one: (not one.breaking, one.name, one.what))


class _Comparison:
    def __init__(self, old: Json, new: Json) -> None:
        self.old, self.new = old, new
        self.seen: set[tuple[str, str, bool]] = set()

    def all(self) -> Iterator[Difference]:
        for route, operation in (before := _operations(self.old)).items():
            now = _operations(self.new).get(route)
            if now is None:
                yield Difference(route, "the route is gone", True)
            else:
                yield from self.operation(route, operation, now)
        for route in _operations(self.new).keys() - before.keys():
            yield Difference(route, "new route", False)

    def operation(self, route: str, old: Json, new: Json) -> Iterator[Difference]:
        if old.get("operationId") != new.get("operationId"):  # the names of generated clients
            yield Difference(route, "another operationId", True)
        yield from self.parameters(route, old, new)
        yield from self.body(route, old.get("requestBody"), new.get("requestBody"))
        for status, answer in old["responses"].items():
            if status not in new["responses"]:
                yield Difference(route, f"no answer {status} any more", True)
                continue
            content = answer.get("content", {})
            now = new["responses"][status].get("content", {})
            yield from self.contents(route, f"the answer {status}", content, now, sent=False)
        for status in new["responses"].keys() - old["responses"].keys():
            yield Difference(route, f"new answer {status}", False)

    def parameters(self, route: str, old: Json, new: Json) -> Iterator[Difference]:
        before = {(p["in"], p["name"]): p for p in old.get("parameters", ())}
        now = {(p["in"], p["name"]): p for p in new.get("parameters", ())}
        for place, name in before.keys() - now.keys():
            yield Difference(f"{route} {name}", f"the {place} parameter is gone", True)
        for place, name in now.keys() - before.keys():
            required = bool(now[place, name].get("required"))
            kind = "required" if required else "optional"
            yield Difference(f"{route} {name}", f"new {kind} {place} parameter", required)
        for key in before.keys() & now.keys():
            at = f"{route} {key[1]}"
            if now[key].get("required") and not before[key].get("required"):
                yield Difference(at, "now required", True)
            yield from self.schema(at, before[key].get("schema", {}), now[key].get("schema", {}),
                                   sent=True)  # fmt: skip

    def body(self, route: str, old: Json | None, new: Json | None) -> Iterator[Difference]:
        if new is None:
            if old is not None:
                yield Difference(route, "takes no body any more", True)
            return
        required = bool(new.get("required"))
        if required and not (old or {}).get("required"):
            yield Difference(route, "a body is now required", True)
        elif old is None:
            yield Difference(route, "takes a body", False)
        content = (old or {}).get("content", {})
        yield from self.contents(route, "the body", content, new["content"], sent=True)

    def contents(
        self, route: str, what: str, old: Json, new: Json, *, sent: bool
    ) -> Iterator[Difference]:
        for kind in old:
            if kind not in new:
                yield Difference(route, f"{what} is no {kind} any more", True)
                continue
            before, now = old[kind].get("schema", {}), new[kind].get("schema", {})
            yield from self.schema(route, before, now, sent=sent)

    def schema(self, name: str, old: Any, new: Any, *, sent: bool) -> Iterator[Difference]:
        """Compare two schemas, named by the component they are part of."""
        if isinstance(old, bool) or isinstance(new, bool):
            if old != new:
                narrower = old is True or new is False
                what = "limited" if narrower else "less limited"
                yield Difference(name, what, narrower == sent)
            return
        references = str(old.get("$ref", "")), str(new.get("$ref", ""))
        if any(references):
            key = (references[0] or name, references[1] or name, sent)
            if key in self.seen:
                return
            self.seen.add(key)
            name = (references[0] or references[1]).removeprefix(SCHEMAS)
            old, new = _resolved(self.old, old), _resolved(self.new, new)
        yield from self.values(name, old, new, sent=sent)
        yield from self.members(name, old, new, sent=sent)
        for key in ("items", "additionalProperties", "propertyNames"):
            before, now = old.get(key, True), new.get(key, True)
            yield from self.schema(f"{name}.{key}", before, now, sent=sent)
        for key in UNION:
            yield from self.union(name, old.get(key, []), new.get(key, []), sent=sent)
        if old.get("prefixItems") != new.get("prefixItems"):
            yield Difference(name, "other items", True)

    def values(self, name: str, old: Json, new: Json, *, sent: bool) -> Iterator[Difference]:
        before, now = _choices(old), _choices(new)
        if before is not None or now is not None:
            yield from _sets(name, "value", before, now, sent=sent)
        kinds = _types(old), _types(new)
        if kinds[0] != kinds[1]:
            yield from _sets(name, "type", *kinds, sent=sent)
        for key in (*LOWER, *UPPER):
            one, other = old.get(key), new.get(key)
            if one == other:
                continue
            tighter = one is None or (
                other is not None and (other > one) == (key in LOWER) and other != one
            )
            what = f"{key} {'none' if one is None else one} -> {'none' if other is None else other}"
            yield Difference(name, what, tighter == sent)
        for key in ("pattern", "format"):
            if old.get(key) != new.get(key):
                narrower, wider = key not in old, key not in new
                what = f"{key} {old.get(key)} -> {new.get(key)}"
                fine = wider if sent else narrower
                yield Difference(name, what, not fine and key == "pattern")

    def members(self, name: str, old: Json, new: Json, *, sent: bool) -> Iterator[Difference]:
        before, now = old.get("properties", {}), new.get("properties", {})
        must, will = set(old.get("required", ())), set(new.get("required", ()))
        for key in before.keys() - now.keys():
            yield Difference(f"{name}.{key}", "the field is gone", True)
        for key in now.keys() - before.keys():
            required = sent and key in will
            yield Difference(f"{name}.{key}", f"new{' required' * required} field", required)
        for key in before.keys() & now.keys():
            if (key in must) != (key in will):
                what = "now required" if key in will else "not required any more"
                yield Difference(f"{name}.{key}", what, (key in will) == sent)
            yield from self.schema(f"{name}.{key}", before[key], now[key], sent=sent)

    def union(self, name: str, old: list[Any], new: list[Any], *, sent: bool) -> Iterator[Any]:
        before, now = {_mark(one): one for one in old}, {_mark(one): one for one in new}
        gone, come = before.keys() - now.keys(), now.keys() - before.keys()
        if len(old) == len(new) == 1 or (len(gone) == 1 and gone and len(come) == 1):
            pairs = [(before.get(a), now.get(b)) for a, b in zip(gone, come, strict=True)]
            for one, other in pairs:
                yield from self.schema(name, one, other, sent=sent)
        else:
            for mark in sorted(gone):
                yield Difference(name, f"the alternative {mark} is gone", sent or not now)
            for mark in sorted(come):
                yield Difference(name, f"new alternative {mark}", not sent or not before)
        for mark in before.keys() & now.keys():
            yield from self.schema(name, before[mark], now[mark], sent=sent)


def _operations(document: Json) -> dict[str, Json]:
    return {
        f"{method.upper()} {path}": operation
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    }


def _resolved(document: Json, schema: Json) -> Json:
    reference = schema.get("$ref")
    if reference is None:
        return schema
    found: Json = document["components"]["schemas"][reference.removeprefix(SCHEMAS)]
    return _resolved(document, found)


def _choices(schema: Json) -> set[str] | None:
    if "const" in schema:
        return {repr(schema["const"])}
    return {repr(value) for value in schema["enum"]} if "enum" in schema else None


def _types(schema: Json) -> set[str] | None:
    given = schema.get("type")
    if given is None:
        return None
    kinds = {given} if isinstance(given, str) else set(given)
    return kinds | ({"integer"} if "number" in kinds else set())


def _sets(
    name: str, what: str, old: set[str] | None, new: set[str] | None, *, sent: bool
) -> Iterator[Difference]:
    """Compare what is allowed; None allows everything."""
    if old is None or new is None:
        yield Difference(name, f"{what}s {'limited' if old is None else 'free'}",
                         (old is None) == sent)  # fmt: skip
        return
    for value in sorted(old - new):
        yield Difference(name, f"the {what} {value} is gone", sent)
    for value in sorted(new - old):
        yield Difference(name, f"new {what} {value}", not sent and what == "type")


def _mark(schema: Json) -> str:
    """Return what tells an alternative of a union from the others."""
    if "$ref" in schema:
        return str(schema["$ref"]).removeprefix(SCHEMAS)
    facts = {key: value for key, value in schema.items() if key not in SAID}
    return str(facts.get("type") or sorted(facts))
