"""The OpenAPI document: FastAPI's, with the whole schema of scenes inside, and examples.

FastAPI knows the envelopes; what lies in them (`scene`, `base`, `material`) is checked by
`matiere.scene`, whose JSON Schema is put in here. docs/openapi.json is this document, committed: a
test tells every difference, and which of them break clients.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

from fastapi import FastAPI

from matiere.jobs.engine import Engine
from matiere.service.access import ADMIN, PUBLIC, RULES
from matiere.service.errors import CODES, MEDIA_TYPE, TYPE_PREFIX
from matiere.service.openapi_examples import BODIES, PARAMETERS, SCHEMAS

SCENE, MATERIAL = "Scene", "Material"
#: Properties of envelopes that hold what the schema of scenes describes.
PLACES = {
    ("JobSubmission", "scene"): SCENE,
    ("SweepSubmission", "base"): SCENE,
    ("CheckSubmission", "material"): MATERIAL,
}
_LOCAL, _SHARED = "#/$defs/", "#/components/schemas/"

_FAULT = {
    "type": "object",
    "required": ["pointer", "code", "message"],
    "properties": {
        "pointer": {"type": "string", "description": "RFC 6901 pointer into the body"},
        "code": {"type": "string"},
        "message": {"type": "string"},
    },
}
PROBLEM: dict[str, Any] = {
    "type": "object",
    "description": "An error, as RFC 9457 has it; some codes add members of their own",
    "required": ["type", "code", "title", "status", "detail", "remedy", "errors"],
    "properties": {
        "type": {"type": "string", "description": f"{TYPE_PREFIX} and the code"},
        "code": {"enum": sorted(CODES), "description": "what a program should switch on"},
        "title": {"type": "string", "description": "the same for every problem of this code"},
        "status": {"type": "integer", "description": "the HTTP status"},
        "detail": {"type": "string", "description": "what happened this time"},
        "remedy": {"type": "string", "description": "what to do about it"},
        "errors": {"type": "array", "items": _FAULT, "description": "one entry for each bad value"},
    },
}


SECURITY: dict[str, Any] = {
    "key": {
        "type": "http",
        "scheme": "bearer",
        "description": "An API key (`matiere key create`); each route names the scope it needs: "
        "`read`, `submit` (reads too) or `admin` (all)",
    },
    "password": {
        "type": "http",
        "scheme": "basic",
        "description": "For browsers: any user name, the API key as the password",
    },
}


class Application(FastAPI):
    """FastAPI with the document of this module."""

    def openapi(self) -> dict[str, Any]:
        """Return the document; it is made once."""
        if self.openapi_schema is None:
            self.openapi_schema = complete(super().openapi())
        return self.openapi_schema


def complete(document: dict[str, Any]) -> dict[str, Any]:
    """Add scenes, problems and examples to what FastAPI says."""
    import matiere

    schemas: dict[str, Any] = document["components"]["schemas"]
    _add_scene(schemas, json.loads(json.dumps(matiere.schema())))
    schemas["Problem"] = PROBLEM
    document["paths"] = _hoisted(document["paths"], schemas)
    document["components"]["securitySchemes"] = SECURITY
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            _add_examples(operation, f"{method.upper()} {path}")
            operation["security"] = _security(RULES[f"{method.upper()} {path}"])
            for status, answer in operation["responses"].items():
                if status[0] in "45":
                    answer.setdefault("content", {MEDIA_TYPE: {}})
                    answer["content"] = {MEDIA_TYPE: {"schema": {"$ref": f"{_SHARED}Problem"}}}
    for name, examples in SCHEMAS.items():
        schemas[name]["examples"] = examples
    document["components"]["schemas"] = dict(sorted(schemas.items()))
    return document


def _security(scope: str) -> list[dict[str, list[str]]]:
    """Return which keys a route takes; without any key it may be open to all who reach it."""
    if scope == PUBLIC:
        return []
    keys: list[dict[str, list[str]]] = [{name: [scope]} for name in SECURITY]
    return keys if scope == ADMIN else [*keys, {}]


def _add_scene(schemas: dict[str, Any], scene: dict[str, Any]) -> None:
    definitions: dict[str, Any] = scene.pop("$defs")
    scene.pop("$schema", None)
    names = {name: f"{SCENE}{name}" if name in schemas else name for name in definitions}
    for name, definition in {**definitions, SCENE: scene}.items():
        schemas[names.get(name, name)] = _moved(definition, names)
    for (envelope, key), name in PLACES.items():
        said = schemas[envelope]["properties"][key].get("description", "")
        schemas[envelope]["properties"][key] = {"$ref": _SHARED + name, "description": said}


def _hoisted(value: Any, schemas: dict[str, Any]) -> Any:
    """Return a part of the document whose local definitions are among all schemas instead."""
    if isinstance(value, list):
        return [_hoisted(item, schemas) for item in value]
    if not isinstance(value, dict):
        return value
    kept = {key: _hoisted(item, schemas) for key, item in value.items() if key != "$defs"}
    if "$defs" not in value:
        return kept
    names = {name: name for name in value["$defs"]}
    for name, definition in value["$defs"].items():
        schemas.setdefault(name, _moved(definition, names))
    return _moved(kept, names)


def _moved(value: Any, names: dict[str, str]) -> Any:
    """Return a part of the schema of scenes with its references as OpenAPI writes them."""
    if isinstance(value, dict):
        return {key: _moved(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_moved(item, names) for item in value]
    if isinstance(value, str) and value.startswith(_LOCAL):
        return _SHARED + names[value.removeprefix(_LOCAL)]
    return value


def _add_examples(operation: dict[str, Any], route: str) -> None:
    for parameter in operation.get("parameters", ()):
        if parameter["name"] in PARAMETERS:
            parameter["example"] = PARAMETERS[parameter["name"]]
    for content in operation.get("requestBody", {}).get("content", {}).values():
        if route in BODIES:
            content["examples"] = BODIES[route]


def document() -> dict[str, Any]:
    """Return the document without a queue: what GET /v1/openapi.json answers."""
    from matiere.service.app import create_app
    from matiere.service.settings import Settings

    app = create_app(cast(Engine, None), Settings(data=Path("/nowhere")))
    return app.openapi()


def document_text() -> str:
    """Return the text committed as docs/openapi.json."""
    return json.dumps(document(), indent=1, sort_keys=True, ensure_ascii=False) + "\n"
