"""Malformed scenes that every way in must refuse alike: Python, command line, HTTP.

Each case is one mistake in an otherwise good scene, with the JSON pointer and the code of the one
error it must give. `text` is what a client would send, byte for byte.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

GOOD: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "pinhole", "origin": [0, 1, 5], "target": [0, 1, 0], "vfov_deg": 35},
    "film": {"width": 16, "height": 16},
    "render": {"spp": 4},
    "materials": {
        "ball": {"type": "conductor", "metal": "Au", "alpha": 0.1},
        "floor": {"type": "lambert", "albedo": [0.5, 0.5, 0.5]},
    },
    "shapes": [
        {"type": "sphere", "center": [0, 1, 0], "radius": 1, "material": "ball"},
        {
            "type": "mesh",
            "positions": [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]],
            "triangles": [[0, 2, 1], [0, 3, 2]],
            "material": "floor",
        },
    ],
    "lights": [
        {
            "type": "rectangle",
            "corner": [-1, 4, -1],
            "edge_u": [2, 0, 0],
            "edge_v": [0, 0, 2],
            "radiance": [10, 10, 10],
        }
    ],
    "environment": {"radiance": [1, 1, 1]},
    "textures": {},
}


@dataclass(frozen=True, slots=True)
class Case:
    """One malformed scene and the one error it must give."""

    name: str
    text: str
    pointer: str
    code: str
    suggestion: str | None = None


def good() -> dict[str, Any]:
    """Return a copy of the good scene, for changing."""
    return copy.deepcopy(GOOD)


def _case(
    name: str,
    change: Callable[[dict[str, Any]], object],
    pointer: str,
    code: str,
    suggestion: str | None = None,
) -> Case:
    scene = good()
    change(scene)
    return Case(name, json.dumps(scene), pointer, code, suggestion)


def _mesh(**keys: Any) -> Callable[[dict[str, Any]], object]:
    """Return a change that replaces the inline mesh by one with other keys."""
    return lambda s: s["shapes"].__setitem__(1, {"type": "mesh", "material": "floor", **keys})


def _nested(depth: int) -> str:
    return json.dumps(good())[:-1] + ', "deep": ' + "[" * depth + "]" * depth + "}"


CASES: tuple[Case, ...] = (
    Case("not_json", '{"version": 1,', "", "invalid_json"),
    Case("not_an_object", "[1, 2, 3]", "", "wrong_type"),
    Case("deep_nesting", _nested(100), "/deep" + "/0" * 63, "too_deep"),
    Case(
        "duplicate_key",
        json.dumps(good()).replace('"vfov_deg": 35', '"vfov_deg": 35, "vfov_deg": 36'),
        "/camera/vfov_deg",
        "duplicate_key",
    ),
    _case("other_version", lambda s: s.update(version=2), "/version", "wrong_version"),
    _case("no_camera", lambda s: s.pop("camera"), "/camera", "missing_key"),
    _case(
        "string_for_number",
        lambda s: s["camera"].update(vfov_deg="35"),
        "/camera/vfov_deg",
        "wrong_type",
    ),
    _case(
        "misspelt_key",
        lambda s: s["materials"]["floor"].update(albdo=s["materials"]["floor"].pop("albedo")),
        "/materials/floor/albdo",
        "unknown_key",
        "albedo",
    ),
    _case(
        "unknown_material_type",
        lambda s: s["materials"]["floor"].update(type="lambertian"),
        "/materials/floor/type",
        "unknown_type",
        "lambert",
    ),
    _case(
        "unknown_metal",
        lambda s: s["materials"]["ball"].update(metal="Gold"),
        "/materials/ball/metal",
        "unknown_metal",
    ),
    _case(
        "unknown_material_name",
        lambda s: s["shapes"][0].update(material="bal"),
        "/shapes/0/material",
        "unknown_material",
        "ball",
    ),
    _case(
        "unknown_texture_name",
        lambda s: s["materials"]["floor"].update(albedo={"texture": "wood"}),
        "/materials/floor/albedo/texture",
        "unknown_texture",
    ),
    _case(
        "nan",
        lambda s: s["materials"]["ball"].update(alpha=math.nan),
        "/materials/ball/alpha",
        "not_finite",
    ),
    _case(
        "infinity",
        lambda s: s["lights"][0]["radiance"].__setitem__(2, math.inf),
        "/lights/0/radiance/2",
        "not_finite",
    ),
    _case(
        "negative_roughness",
        lambda s: s["materials"]["ball"].update(alpha=-0.1),
        "/materials/ball/alpha",
        "out_of_range",
    ),
    _case(
        "albedo_above_one",
        lambda s: s["materials"]["floor"].update(albedo=[0.5, 1.5, 0.5]),
        "/materials/floor/albedo/1",
        "out_of_range",
    ),
    _case(
        "alpha_and_roughness",
        lambda s: s["materials"]["ball"].update(roughness=0.3),
        "/materials/ball/roughness",
        "exclusive_keys",
    ),
    _case(
        "negative_radius",
        lambda s: s["shapes"][0].update(radius=-1),
        "/shapes/0/radius",
        "out_of_range",
    ),
    _case(
        "huge_film",
        lambda s: s["film"].update(width=200_000, height=200_000),
        "/film",
        "film_too_large",
    ),
    _case(
        "index_out_of_range",
        lambda s: s["shapes"][1]["triangles"][1].__setitem__(2, 4),
        "/shapes/1/triangles/1/2",
        "index_out_of_range",
    ),
    _case("missing_mesh", _mesh(file="no_such.ply"), "/shapes/1/file", "asset_missing"),
    _case("path_climbs_out", _mesh(file="../ball.ply"), "/shapes/1/file", "asset_outside_root"),
    _case("absolute_path", _mesh(file="/etc/passwd"), "/shapes/1/file", "asset_outside_root"),
    _case(
        "url",
        lambda s: s.update(environment={"file": "https://example.org/sky.hdr"}),
        "/environment/file",
        "asset_outside_root",
    ),
    _case(
        "flat_scale",
        lambda s: s["shapes"][1].update(transform=[{"scale": [1, 0, 1]}]),
        "/shapes/1/transform/0/scale",
        "degenerate",
    ),
    _case(
        "camera_looks_nowhere",
        lambda s: s["camera"].update(target=[0, 1, 5]),
        "/camera/target",
        "degenerate",
    ),
    _case(
        "unknown_view",
        lambda s: s.update(output={"view": "ACES"}),
        "/output/view",
        "unknown_view",
    ),
)
