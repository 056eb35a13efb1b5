"""The committed JSON Schema is the one of the code, and agrees with the loader."""

from __future__ import annotations

import json
from pathlib import Path

from jsonschema import Draft202012Validator
from malformed import CASES, good

import matiere as mt
from matiere.scene.schema import schema_text


def test_committed_schema_is_current(root: Path) -> None:
    committed = (root / "docs" / "scene.schema.json").read_text(encoding="utf-8")
    assert committed == schema_text(), "run: matiere schema -o docs/scene.schema.json"


def test_every_node_refuses_unknown_keys_and_has_docs() -> None:
    for name, node in mt.schema()["$defs"].items():
        if "properties" not in node:
            continue
        assert node["additionalProperties"] is False, name
        for key, field in node["properties"].items():
            assert field.get("description"), f"{name}.{key} has no description"


def test_every_material_and_parameter_is_in_the_schema() -> None:
    definitions = mt.schema()["$defs"]
    chosen = definitions["Material"]["discriminator"]["mapping"]
    assert list(chosen) == sorted(row["type"] for row in mt.materials())
    for row in mt.materials():
        node = definitions[chosen[row["type"]].rsplit("/", 1)[-1]]
        assert node["properties"]["type"]["const"] == row["type"]
        for param in row["params"]:
            field = json.dumps(node["properties"][param["name"]])
            for bound in ("min", "max"):
                if param[bound] is not None:
                    assert "inimum" in field if bound == "min" else "aximum" in field


def test_schema_is_itself_valid_and_accepts_what_the_loader_accepts() -> None:
    Draft202012Validator.check_schema(mt.schema())
    one = Draft202012Validator(mt.schema())
    assert list(one.iter_errors(good())) == []
    structural = {"wrong_type", "unknown_key", "missing_key", "unknown_type", "unknown_metal"}
    for case in CASES:
        if case.code in structural and case.pointer:
            assert list(one.iter_errors(json.loads(case.text))), case.name
