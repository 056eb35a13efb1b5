"""Materials for the contract tests: made from the core's tables, so that a new model is covered the
moment it is in the list, and a hand-picked list of combinations that matter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import measured_files
from classic_cases import CLASSIC, HALF_VECTOR_TYPES, gains, is_slanting, width

from matiere import _core

ROWS: dict[str, dict[str, Any]] = {row["type"]: row for row in _core.materials()}


@dataclass(frozen=True)
class Case:
    """One material and what is promised of it."""

    type: str
    params: dict[str, Any] = field(default_factory=dict)
    name: str = ""  # instead of parameters too long to be written
    reciprocal: bool = True

    @property
    def id(self) -> str:
        if self.name:
            return f"{self.type}-{self.name}"
        words = [f"{k}={v}" for k, v in self.params.items()]
        return "-".join([self.type, *words]).replace(" ", "")

    def bsdf(self, precision: str = "float") -> Any:
        return _core.Bsdf(self.type, self.params, precision)

    @property
    def anisotropic(self) -> bool:
        return "alpha_x" in self.params or is_slanting(self.params)

    @property
    def wasteful(self) -> bool:
        """Lobes sampled through half vectors lose samples: their means need more of them."""
        return self.type in HALF_VECTOR_TYPES

    @property
    def conserving(self) -> bool:
        """False for the named legacy variants, whose gain is printed."""
        return not gains(self.type, self.params)

    @property
    def interface(self) -> bool:
        own = bool(ROWS[self.type]["features"]["transmission"])
        return own or any(part.interface for part in self.parts)

    @property
    def parts(self) -> list[Case]:
        """The materials nested in this one."""
        nested = [v for v in self.params.values() if isinstance(v, dict)]
        return [Case(v["type"], {k: x for k, x in v.items() if k != "type"}) for v in nested]

    @property
    def eta(self) -> float:
        """Index of the inside over the outside; 1 for opaque materials."""
        if self.parts:
            return max((part.eta for part in self.parts), key=lambda eta: abs(eta - 1))
        implied = {p["name"]: p["implied"] for p in ROWS[self.type]["params"]}
        if not self.interface or "eta" not in implied:
            return 1.0
        eta = self.params.get("eta", implied["eta"])
        return float(eta[1] if isinstance(eta, tuple | list) else eta)  # a probe sees green

    def scaled(self, factor: float) -> Case:
        """Return the material with the index of its interface changed."""

        def change(kind: str, params: dict[str, Any]) -> dict[str, Any]:
            made = {
                k: {"type": v["type"], **change(v["type"], {**v})} if isinstance(v, dict) else v
                for k, v in params.items()
            }
            one = Case(kind, params)
            return made if one.parts or one.eta == 1 else {**made, "eta": one.eta * factor}

        return Case(self.type, change(self.type, self.params))

    @property
    def alpha(self) -> float:
        """Smallest width of the facet slopes; 1 for models that have none."""
        p = self.params
        if self.parts:
            return min(part.alpha for part in self.parts)
        if "roughness" in p:
            return float(p["roughness"]) ** 2
        alphas = (p.get("alpha_x", 1.0), p.get("alpha_y", 1.0), p.get("alpha", 1.0))
        return float(min(*alphas, width(p)))

    def lobe_width(self, cos_theta: float) -> float:
        """Return the angle [rad] of the narrowest lobe seen at a cosine, 1 where none is narrow."""
        if self.parts:
            return min(part.lobe_width(cos_theta) for part in self.parts)
        width = self.alpha * max(cos_theta, 1e-9)
        if self.interface:
            width = min(width, abs(self.eta - 1) * self.alpha)
        return width if width > 0 else 1.0


GOLD = {"eta": [0.14, 0.37, 1.44], "k": [3.98, 2.39, 1.60]}

WHITE = {"type": "lambert", "albedo": 1.0}
TINT = {"sigma_a": [10.0, 500.0, 1e4], "thickness": 1e-3}
PLASTIC = {"type": "plastic", "albedo": 1.0, "alpha": 0.2}
ROUGH_MIRROR = {"type": "cook_torrance", "F0": 1.0, "alpha": 0.05}
ROUGH_GLASS = {"type": "dielectric", "eta": 1.5, "alpha": 0.3}

PICKED = (
    Case("lambert", {"albedo": 1.0}),
    Case("mirror", {"eta": 1.5}),
    Case("mirror", {"F0": 1.0}),
    Case("conductor", {**GOLD, "alpha": 0.0}),
    Case("conductor", {**GOLD, "alpha": 1e-4}),
    Case("conductor", {**GOLD, "alpha": 0.3, "masking": "v_cavity"}),
    Case("conductor", {**GOLD, "alpha": 0.3, "distribution": "beckmann"}),
    Case("conductor", {**GOLD, "alpha_x": 0.05, "alpha_y": 0.5}),
    Case("cook_torrance", {"F0": 1.0, "alpha": 1.0}),
    Case("cook_torrance", {"F0": 0.04, "alpha": 0.4, "diffuse": 0.4, "coupling": "add"}),
    Case("cook_torrance", {"F0": 1.0, "alpha": 0.5, "masking": "smith_separable"}),
    Case("cook_torrance", {"F0": 1.0, "alpha": 1e-5}),
    Case("cook_torrance", {"F0": 1.0, "alpha": 0.01, "distribution": "beckmann"}),
    Case("cook_torrance", {"F0": 1.0, "alpha": 1.0, "distribution": "beckmann"}),
    Case(
        "cook_torrance",
        {"F0": 1.0, "alpha": 0.6, "distribution": "beckmann", "masking": "v_cavity"},
    ),
    Case(
        "cook_torrance",
        {"F0": 1.0, "alpha": 0.2, "distribution": "beckmann", "masking": "smith_separable"},
    ),
    Case("cook_torrance", {"F0": 0.9, "alpha_x": 0.01, "alpha_y": 1.0}),
    Case("cook_torrance", {"F0": 0.9, "alpha_x": 1e-3, "alpha_y": 0.1}),
    Case(
        "cook_torrance",
        {"F0": 0.9, "alpha_x": 0.5, "alpha_y": 0.05, "distribution": "beckmann"},
    ),
    Case("cook_torrance", {"F0": 0.3, "diffuse": 1.0, "alpha_x": 0.1, "alpha_y": 0.5}),
    Case("cook_torrance", {"F0": 0.04, "diffuse": [0.9, 0.5, 0.1], "alpha": 0.02}),
    Case("cook_torrance", {"F0": 0.5, "F82_tint": 0.2, "diffuse": 1.0, "alpha": 0.4}),
    Case("cook_torrance", {"eta": 1.5, "diffuse": 1.0, "alpha": 0.3, "masking": "v_cavity"}),
    Case("cook_torrance", {"F0": 1.0, "diffuse": 1.0, "alpha": 0.0}),
    Case("cook_torrance", {"F0": 1.0, "alpha": 1.0, "distribution": "blinn_phong"}),
    Case("cook_torrance", {"F0": 1.0, "alpha": 0.3, "distribution": "blinn_phong"}),
    Case("cook_torrance", {"F0": 1.0, "exponent": 1e6, "distribution": "blinn_phong"}),
    Case(
        "cook_torrance",
        {"F0": 1.0, "alpha": 0.6, "distribution": "blinn_phong", "masking": "v_cavity"},
    ),
    Case("cook_torrance", {"F0": 1.0, "alpha_x": 0.2, "alpha_y": 0.6, "distribution": "ward"}),
    Case(
        "dielectric",
        {"eta": 1.5, "alpha": 0.4, "distribution": "blinn_phong", "masking": "smith_separable"},
    ),
    Case("cook_torrance", {"F0": 1.0, "alpha": 1.0, "multiscatter": True}),
    Case("cook_torrance", {"F0": 0.6, "alpha": 0.01, "multiscatter": True}),
    Case("cook_torrance", {"F0": 0.4, "diffuse": 1.0, "alpha": 0.7, "multiscatter": True}),
    Case("conductor", {**GOLD, "alpha_x": 0.1, "alpha_y": 0.9, "multiscatter": True}),
    Case("dielectric", {"eta": 1.5, "alpha": 1.0, "multiscatter": True}),
    Case("dielectric", {"eta": 1.5, "alpha": 0.02, "multiscatter": True}),
    Case("dielectric", {"eta": 0.7, "alpha": 0.5, "masking": "v_cavity", "multiscatter": True}),
    Case("microfacet_generator", {"F0": 1.0, "sigma": 0.3}),
    Case("microfacet_generator", {"F0": 1.0, "distribution": "satin"}),
    Case("microfacet_generator", {"F0": 1.0, "distribution": "velvet", "tilt_deg": 30.0}),
    Case("microfacet_generator", {"F0": 1.0, "distribution": "two_color", "sigma": 0.3}),
    Case("plastic", {"albedo": 1.0, "alpha": 0.0}),
    Case("plastic", {"albedo": 1.0, "alpha": 0.3}),
    Case("plastic", {"albedo": 1.0, "alpha": 1.0, "distribution": "beckmann"}),
    Case("plastic", {"albedo": [0.8, 0.2, 0.05], "eta": 2.4, "alpha": 0.05}),
    Case("plastic", {"albedo": 0.0, "alpha": 0.1}),
    Case("dielectric", {"eta": 1.5, "alpha": 0.0}),
    Case("dielectric", {"eta": 1.5, "alpha": 0.1}),
    Case("dielectric", {"eta": 1.5, "alpha": 0.5}),
    Case("dielectric", {"eta": 1.5, "alpha": 1.0, "masking": "smith_separable"}),
    Case("dielectric", {"eta": 2.4, "alpha": 0.3, "distribution": "beckmann"}),
    Case(
        "dielectric",
        {"eta": 1.33, "alpha": 0.5, "distribution": "beckmann", "masking": "v_cavity"},
    ),
    Case("dielectric", {"eta": 1.5, "alpha_x": 0.1, "alpha_y": 0.6}),
    Case("dielectric", {"eta": 0.7, "alpha": 0.2}),
    Case("dielectric", {"eta": 1.0 + 1e-4, "alpha": 0.3}),
    Case("dielectric", {"eta": 1.0, "alpha": 0.3}),
    *(Case(kind, params) for kind, params in CLASSIC),
    *(
        Case("measured", {"file": ("data", arrays)}, name, reciprocal=name.startswith("merl"))
        for name, arrays in measured_files.made().items()
    ),
    Case("layered", {"base": WHITE, "method": "exact"}),
    Case("layered", {"base": WHITE, "method": "exact", "eta": 2.4, "sigma_a": 0.3, "thickness": 1}),
    Case("layered", {"base": WHITE, "method": "weidlich_wilkie", "alpha": 0.3}),
    Case("layered", {"base": ROUGH_MIRROR, "method": "weidlich_wilkie"}),
    Case("layered", {"base": ROUGH_MIRROR, "method": "weidlich_wilkie", "alpha": 0.01, **TINT}),
    Case("layered", {"base": PLASTIC, "method": "weidlich_wilkie", "alpha": 1.0, "eta": 1.001}),
    Case("layered", {"base": PLASTIC, "method": "weidlich_wilkie", "alpha": 0.2, "eta": 0.8}),
    Case(
        "layered",
        {
            "base": {"type": "layered", "base": PLASTIC, "method": "weidlich_wilkie"},
            "method": "weidlich_wilkie",
            "alpha_x": 0.1,
            "alpha_y": 0.4,
        },
    ),
    Case("null"),
    Case("mix", {"a": PLASTIC, "b": {"type": "conductor", **GOLD, "alpha": 0.1}, "weight": 0.3}),
    Case("mix", {"a": {"type": "mirror", "F0": 1.0}, "b": ROUGH_MIRROR, "weight": 0.7}),
    Case("mix", {"a": {"type": "null"}, "b": PLASTIC, "weight": 0.25}),
    Case("mix", {"a": ROUGH_GLASS, "b": {"type": "lambert", "albedo": 1.0}, "weight": 0.4}),
    Case(
        "mix",
        {"a": {"type": "mix", "a": ROUGH_MIRROR, "b": PLASTIC}, "b": {"type": "null"}},
    ),
)


def _needed(row: dict[str, Any]) -> dict[str, Any]:
    """Return values for what the model insists on."""
    usual = {"material": {"type": "lambert"}}
    params = {p["name"]: usual.get(p["kind"], 1.0) for p in row["params"] if p["required"]}
    for names in row["one_of"]:
        numeric = [p["name"] for p in row["params"] if p["name"] in names and p["kind"] != "metal"]
        params[numeric[0]] = 0.5
    for names in row["together"]:
        if set(names) & set(params):
            params.update({name: 2.0 for name in names if name not in params})
    return params


def _tried(p: dict[str, Any]) -> Iterator[Any]:
    """Yield a few values of one parameter, its bounds among them."""
    if p["kind"] == "enum":
        yield from p["choices"]
    elif p["kind"] == "bool":
        yield from (False, True)
    elif p["kind"] in ("scalar", "color"):
        low, high = p["min"], p["max"]
        if low is not None:
            yield low + 0.25 if p["min_exclusive"] else low
        yield high if high is not None and high <= 1 else 2.0


def _allowed(row: dict[str, Any], params: dict[str, Any]) -> bool:
    given = set(params)
    together = all(not (given & set(g)) or set(g) <= given for g in row["together"])
    required = all(b in given for a, b in row["requires"] if a in given)
    return together and required and all(len(given & set(g)) < 2 for g in row["exclusive"])


def generated() -> Iterator[Case]:
    """Yield every model with one parameter at a time moved to its bounds."""
    for row in ROWS.values():
        if any(p["kind"] == "file" and p["required"] for p in row["params"]):
            continue  # test_measured.py brings the files
        if row["type"] == "layered":
            continue  # its default is an estimate: test_layered.py
        base = _needed(row)
        yield Case(row["type"], base)
        for p in row["params"]:
            for value in _tried(p):
                params = {**base, p["name"]: value}
                if _allowed(row, params):
                    yield Case(row["type"], params)


def all_cases() -> list[Case]:
    """Return the picked and the generated cases, each once."""
    return list({case.id: case for case in (*PICKED, *generated())}.values())
