"""The OpenAPI document: committed, with scenes and examples inside, and no break unseen."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import openapi_snapshot
import pytest
from jsonschema import Draft202012Validator
from openapi_diff import compare

import matiere as mt
from matiere.jobs.sweep import parse_sweep
from matiere.service.openapi import BODIES, PLACES, document
from matiere.service.schemas import JobSubmission, SweepSubmission

Json = dict[str, Any]


@pytest.fixture(scope="module")
def made() -> Json:
    """Return the document as it is now."""
    return json.loads(json.dumps(document()))


def test_the_committed_document_is_current(made: Json) -> None:
    found = openapi_snapshot.differences(made)
    told = "\n".join(map(str, found))
    breaks = any(one.breaking for one in found)
    how = " (breaking ones need a line in README's Changes)" if breaks else ""
    assert not found, f"docs/openapi.json is old; run {openapi_snapshot.REFRESH}{how}\n{told}"


def test_the_served_document_is_the_committed_one(client: httpx.Client, root: Path) -> None:
    committed = json.loads((root / "docs" / "openapi.json").read_text(encoding="utf-8"))
    assert client.get("/v1/openapi.json").json() == committed


def references(value: Any) -> set[str]:
    """Return every reference inside."""
    if isinstance(value, list):
        return set().union(*map(references, value))
    if not isinstance(value, dict):
        return set()
    own = {value["$ref"]} if isinstance(value.get("$ref"), str) else set()
    mapped = set(value.get("discriminator", {}).get("mapping", {}).values())
    return own.union(mapped, *map(references, value.values()))


def test_references_lead_somewhere_and_scenes_are_whole(made: Json) -> None:
    schemas = made["components"]["schemas"]
    found = references(made)
    assert found <= {f"#/components/schemas/{name}" for name in schemas}
    assert set(mt.schema()["$defs"]) - {"DisplayTarget"} < set(schemas)
    for (envelope, key), name in PLACES.items():
        place = schemas[envelope]["properties"][key]
        assert place["$ref"] == f"#/components/schemas/{name}" and place["description"]


def test_everything_that_is_sent_has_an_example_that_is_right(made: Json) -> None:
    """Each body by its schema, by the envelope's model and, for scenes, by the loader."""
    seen = set()
    for path, methods in made["paths"].items():
        for method, operation in methods.items():
            for parameter in operation.get("parameters", ()):
                required = parameter.get("required") or parameter["name"] == "Idempotency-Key"
                assert not required or "example" in parameter, (method, path, parameter["name"])
            for content in operation.get("requestBody", {}).get("content", {}).values():
                route = f"{method.upper()} {path}"
                assert content.get("examples"), f"{route}: no example"
                seen.add(route)
                whole = {**content["schema"], "components": made["components"]}
                for example in content["examples"].values():
                    Draft202012Validator(whole).validate(example["value"])
    assert seen == set(BODIES)
    for name, schema in made["components"]["schemas"].items():
        for example in schema.get("examples", ()):
            whole = {"$ref": f"#/components/schemas/{name}", "components": made["components"]}
            Draft202012Validator(whole).validate(example)


def test_examples_are_accepted_submissions() -> None:
    for example in BODIES["POST /v1/jobs"].values():
        mt.load(JobSubmission.model_validate(example["value"]).scene)
    for example in BODIES["POST /v1/sweeps"].values():
        sweep = SweepSubmission.model_validate(example["value"])
        raw = {"mode": sweep.mode, **sweep.language()}
        plan = parse_sweep(raw, sweep.base)
        assert len(plan) > 1
        for cell in range(len(plan)):
            mt.load(plan.scene(cell))
    for example in BODIES["POST /v1/checks"].values():
        assert mt.check(example["value"]["material"]).verdict == "pass"


def schema(document: Json, name: str) -> Json:
    """Return a component."""
    found: Json = document["components"]["schemas"][name]
    return found


def drop_route(d: Json) -> None:
    """Change."""
    del d["paths"]["/v1/jobs/{job_id}:cancel"]


def drop_answer_field(d: Json) -> None:
    """Change."""
    del schema(d, "JobView")["properties"]["relmse"]


def drop_sent_field(d: Json) -> None:
    """Change."""
    del schema(d, "JobSubmission")["properties"]["label"]


def drop_value(d: Json) -> None:
    """Change."""
    schema(d, "SweepSubmission")["properties"]["mode"]["enum"].remove("zip")


def require_field(d: Json) -> None:
    """Change."""
    schema(d, "Axis")["properties"]["unit"] = {"type": "string"}
    schema(d, "Axis")["required"].append("unit")


def narrow_bound(d: Json) -> None:
    """Change."""
    schema(d, "Film")["properties"]["width"]["maximum"] = 100


def narrow_type(d: Json) -> None:
    """Change."""
    schema(d, "ConductorMaterial")["properties"]["type"]["const"] = "metal"


def drop_alternative(d: Json) -> None:
    """Change."""
    schema(d, "Material")["oneOf"].pop()


def widen_answer(d: Json) -> None:
    """Change."""
    field = schema(d, "JobView")["properties"]["width"]
    schema(d, "JobView")["properties"]["width"] = {"anyOf": [field, {"type": "null"}]}


def require_parameter(d: Json) -> None:
    """Change."""
    new = {"name": "who", "in": "query", "required": True, "schema": {"type": "string"}}
    d["paths"]["/v1/jobs"]["get"]["parameters"].append(new)


def other_status(d: Json) -> None:
    """Change."""
    answers = d["paths"]["/v1/jobs"]["post"]["responses"]
    answers["200"] = answers.pop("202")


def add_route(d: Json) -> None:
    """Change."""
    d["paths"]["/v1/new"] = {"get": d["paths"]["/healthz"]["get"]}


def add_fields(d: Json) -> None:
    """Change."""
    schema(d, "Axis")["properties"]["unit"] = {"type": "string"}
    schema(d, "JobView")["properties"]["colour"] = {"type": "string"}
    schema(d, "JobView")["required"].append("colour")


def widen_sent(d: Json) -> None:
    """Change."""
    schema(d, "JobSubmission")["properties"]["priority"]["maximum"] = 1000
    schema(d, "SweepSubmission")["properties"]["mode"]["enum"].append("spiral")


def other_words(d: Json) -> None:
    """Change."""
    schema(d, "JobView")["properties"]["relmse"]["description"] = "other"


BREAKING: list[tuple[Callable[[Json], None], str]] = [
    (drop_route, "POST /v1/jobs/{job_id}:cancel"),
    (drop_answer_field, "JobView.relmse"),
    (drop_sent_field, "JobSubmission.label"),
    (drop_value, "SweepSubmission.mode"),
    (require_field, "Axis.unit"),
    (narrow_bound, "Film.width"),
    (narrow_type, "ConductorMaterial.type"),
    (drop_alternative, "Material"),
    (widen_answer, "JobView.width"),
    (require_parameter, "GET /v1/jobs who"),
    (other_status, "POST /v1/jobs"),
]


@pytest.mark.parametrize(("change", "name"), BREAKING, ids=lambda one: getattr(one, "__name__", ""))
def test_a_break_is_told_by_name_and_needs_a_line_in_the_changes(
    made: Json, change: Callable[[Json], None], name: str
) -> None:
    new = copy.deepcopy(made)
    change(new)
    found = compare(made, new)
    assert name in {one.name for one in found if one.breaking}, list(map(str, found))
    readme = "# x\n\n## Changes\n\n- Next: else.\n- Next: breaking: {}.\n\n## More\n"
    assert openapi_snapshot.untold(found, readme.format("something"))
    names = ", ".join(f"`{one.name}`" for one in found if one.breaking)
    assert not openapi_snapshot.untold(found, readme.format(names))


@pytest.mark.parametrize("change", [add_route, add_fields, widen_sent, other_words])
def test_what_breaks_nobody_is_told_as_such(made: Json, change: Callable[[Json], None]) -> None:
    new = copy.deepcopy(made)
    change(new)
    found = compare(made, new)
    assert found and not any(one.breaking for one in found), list(map(str, found))
    assert not compare(made, copy.deepcopy(made))
