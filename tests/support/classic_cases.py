"""Hand-picked cases of the classic models: rough diffuse, Phong, Ward and Schlick lobes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

HALF_VECTOR_TYPES = ("blinn_phong", "ashikhmin_shirley", "ward", "schlick")
COURSE = {"normalization": "course"}
OLD = {"variant": "schlick94"}
CLASSIC: tuple[tuple[str, dict[str, Any]], ...] = (
    ("oren_nayar", {"albedo": 1.0, "roughness": 0.0}),
    ("oren_nayar", {"albedo": 1.0, "roughness": 1e-6}),
    ("oren_nayar", {"albedo": 1.0, "roughness": 0.3}),
    ("oren_nayar", {"albedo": [1.0, 0.5, 0.01], "roughness": 1.0}),
    ("blinn_phong", {"diffuse": 0.0, "specular": 1.0, "exponent": 0}),
    ("blinn_phong", {"diffuse": 0.0, "specular": 1.0, "exponent": 1}),
    ("blinn_phong", {"diffuse": 1.0, "specular": [0.9, 0.5, 0.1], "exponent": 10}),
    ("blinn_phong", {"diffuse": 1.0, "specular": 1.0, "exponent": 1e3}),
    ("blinn_phong", {"diffuse": 0.5, "specular": 0.5, "exponent": 1e5, "coupling": "add"}),
    ("blinn_phong", {"diffuse": 0.0, "specular": 1.0, "exponent": 1e7}),
    ("blinn_phong", {"diffuse": 0.2, "specular": 1.0, "exponent": 1e8}),
    ("blinn_phong", {"diffuse": 0.5, "specular": 0.5, "exponent": 30, **COURSE}),
    ("ashikhmin_shirley", {"diffuse": 0.0, "F0": 1.0, "nu": 0, "nv": 0}),
    ("ashikhmin_shirley", {"diffuse": 1.0, "F0": 0.04, "nu": 1, "nv": 1}),
    ("ashikhmin_shirley", {"diffuse": 1.0, "F0": [0.9, 0.5, 0.1], "nu": 10, "nv": 1000}),
    ("ashikhmin_shirley", {"diffuse": 0.0, "F0": 1.0, "nu": 1e5, "nv": 0}),
    ("ashikhmin_shirley", {"diffuse": 0.0, "F0": 0.5, "nu": 1e7, "nv": 1e7}),
    ("ashikhmin_shirley", {"diffuse": 1.0, "F0": 0.5, "nu": 1e8, "nv": 1e8}),
    (
        "ashikhmin_shirley",
        {"diffuse": 1.0, "F0": 0.05, "nu": 10, "nv": 200, "coupling": "paper", "rotation_deg": 30},
    ),
    ("ashikhmin_shirley", {"diffuse": 0.3, "F0": 0.1, "nu": 50, "nv": 50, "coupling": "add"}),
    ("ashikhmin_shirley", {"diffuse": 0.5, "F0": 0.5, "nu": 10, "nv": 100, **COURSE}),
    ("ward", {"diffuse": 0.0, "specular": 1.0, "alpha": 0.0}),
    ("ward", {"diffuse": 1.0, "specular": 0.3, "alpha": 0.0}),
    ("ward", {"diffuse": 0.0, "specular": 1.0, "alpha": 1e-5}),
    ("ward", {"diffuse": 0.0, "specular": 1.0, "alpha": 1e-3}),
    ("ward", {"diffuse": 1.0, "specular": [0.9, 0.5, 0.1], "alpha": 0.1}),
    ("ward", {"diffuse": 0.0, "specular": 1.0, "alpha": 1.0}),
    ("ward", {"diffuse": 1.0, "specular": 1.0, "alpha_x": 0.1, "alpha_y": 0.5}),
    ("ward", {"diffuse": 0.0, "specular": 1.0, "alpha_x": 1e-3, "alpha_y": 0.3}),
    ("ward", {"diffuse": 0.4, "specular": 0.6, "alpha": 0.2, "coupling": "add"}),
    ("ward", {"diffuse": 0.5, "specular": 0.5, "alpha": 0.3, "variant": "duer"}),
    ("ward", {"diffuse": 0.5, "specular": 0.5, "alpha": 0.5, "variant": "ward"}),
    ("schlick", {"layers": [{"C": 0.3, "r": 0.0}]}),
    ("schlick", {"layers": [{"C": 1.0, "r": 1e-12}]}),
    ("schlick", {"layers": [{"C": 1.0, "r": 1e-6}]}),
    ("schlick", {"layers": [{"C": 0.0, "r": 0.3, "p": 0.2}]}),
    ("schlick", {"layers": [{"C": [1.0, 0.5, 0.0], "r": 0.5, "p": 1e-3}]}),
    ("schlick", {"layers": [{"C": 1.0, "r": 0.8}]}),
    ("schlick", {"layers": [{"C": 0.04, "r": 0.0}, {"C": 1.0, "r": 1.0}]}),
    ("schlick", {"layers": [{"C": 0.04, "r": 0.05, "p": 0.1}, {"C": 1.0, "r": 0.6}]}),
    ("schlick", {"layers": [{"C": 0.5, "r": 0.9}, {"C": 1.0, "r": 0.1, "p": 0.3}]}),
    ("schlick", {"layers": [{"C": 1.0, "r": 0.1, "p": 0.5}], **OLD}),
    ("schlick", {"layers": [{"C": 1.0, "r": 1e-3, "p": 0.05}], **OLD}),
    ("schlick", {"layers": [{"C": 0.04, "r": 0.1}, {"C": 1.0, "r": 1.0}], **OLD}),
)


def gains(kind: str, params: Mapping[str, Any]) -> bool:
    """Say whether a case is one of the named variants that do not conserve energy."""
    if kind == "schlick":
        return params.get("variant") == "schlick94" and len(params.get("layers", ())) == 2
    ward = kind == "ward" and params.get("variant", "gmd") != "gmd"
    return ward or params.get("normalization") == "course"


def width(params: Mapping[str, Any]) -> float:
    """Return the width of the narrowest lobe of exponents or layers; 1 where there are none."""
    exponents = [float(params[k]) for k in ("exponent", "nu", "nv") if k in params]
    widths = [(2 / (n + 2)) ** 0.5 for n in exponents]
    widths += [(float(x["r"]) * x.get("p", 1.0)) ** 0.5 for x in params.get("layers", ())]
    return min((w for w in widths if w > 0), default=1.0)


def is_slanting(params: Mapping[str, Any]) -> bool:
    """Say whether the lobe is not round."""
    layers = params.get("layers", ())
    return params.get("nu") != params.get("nv") or any(x.get("p", 1.0) != 1.0 for x in layers)
