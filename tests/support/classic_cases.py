"""Hand-picked cases of the classic models: rough diffuse, Phong, Ward and Schlick lobes."""

from __future__ import annotations

from typing import Any

CLASSIC: tuple[tuple[str, dict[str, Any]], ...] = (
    ("oren_nayar", {"albedo": 1.0, "roughness": 0.0}),
    ("oren_nayar", {"albedo": 1.0, "roughness": 1e-6}),
    ("oren_nayar", {"albedo": 1.0, "roughness": 0.3}),
    ("oren_nayar", {"albedo": [1.0, 0.5, 0.01], "roughness": 1.0}),
)
