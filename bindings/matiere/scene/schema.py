"""The JSON Schema of scene JSON v1, made from the models and the core's material tables."""

from __future__ import annotations

import json
from typing import Any

from matiere.scene.materials import material_models
from matiere.scene.model import SceneModel

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a scene, material parameters included."""
    made = SceneModel.model_json_schema()
    definitions: dict[str, Any] = made.setdefault("$defs", {})
    names = []
    for kind, model in sorted(material_models().items()):
        single = model.model_json_schema()
        definitions |= single.pop("$defs", {})
        definitions[model.__name__] = single
        single["required"] = ["type", *(n for n in single.get("required", []) if n != "type")]
        for row in model.ROW["params"]:
            if row["kind"] == "material":
                single["properties"][row["name"]] |= {"$ref": "#/$defs/Material"}
        names.append((kind, f"#/$defs/{model.__name__}"))
    definitions["Material"] = {
        "oneOf": [{"$ref": reference} for _, reference in names],
        "discriminator": {"propertyName": "type", "mapping": dict(names)},
    }
    made["properties"]["materials"]["additionalProperties"] = {"$ref": "#/$defs/Material"}
    made["properties"]["$schema"] = {"type": "string", "description": "for editors; not read"}
    made["$defs"] = dict(sorted(definitions.items()))
    return {"$schema": DIALECT, "title": "matiere scene, version 1", **made}


def schema_text() -> str:
    """Return the schema as the text committed in docs/scene.schema.json."""
    return json.dumps(schema(), indent=1, sort_keys=True, ensure_ascii=False) + "\n"
