"""Models that look up directional albedos: eval against quadrature, to 1e-3."""

from __future__ import annotations

from typing import Any

import facet_quadrature
import numpy as np
import pytest
from oracle_check import judge_table, views

from matiere import _core

DEGREES = (0.0, 45.0, 85.0, 89.9)
OTHERS = (0.0, 30.0, 70.0, 85.0, 89.9)
Widths = tuple[float, float]


def directions() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return pairs far from each other's mirror image, and each other's mirror image."""
    found = []
    for o in views(DEGREES):
        for i in views(OTHERS):
            turned = np.array([-i[1], i[0], i[2]], np.float32)
            found += [(o, turned), (o, i * np.float32([-1, -1, 1]))]
    return found


class Albedos:
    """Quadratures of one lobe, each done once."""

    def __init__(self, lobe: Any, widths: Widths, azimuths: int = 1) -> None:
        self.lobe, self.widths = lobe, widths
        self.average = facet_quadrature.average(lobe, *widths, azimuths=azimuths)
        self._known: dict[tuple[float, ...], float] = {}

    def __call__(self, w: np.ndarray) -> float:
        v = w.astype(float) / np.linalg.norm(w.astype(float))
        # Lobes of one width are alike from all azimuths, and all from behind.
        key = (v[2],) if self.widths[0] == self.widths[1] else tuple(np.abs(v))
        if key not in self._known:
            self._known[key] = facet_quadrature.albedo(self.lobe, v, *self.widths)
        return self._known[key]


def check_body(kind: str, coat: dict[str, Any], rho: float, eta2: float, widths: Widths) -> None:
    """A lobe over a diffuse body: f = f_coat + rho (1 - E(o)) (1 - E(i)) cos / (pi (...))."""
    colour = "albedo" if kind == "plastic" else "diffuse"
    lobe = _core.Bsdf(kind, {**coat, colour: 0.0}, "double")
    E = Albedos(lobe, widths, azimuths=1 if widths[0] == widths[1] else 4)
    b = _core.Bsdf(kind, {**coat, colour: rho})
    scale = rho / (eta2 * (1 - rho) + rho * (1 - E.average))
    for o, i in directions():
        exact = lobe.eval(o, i)[0, 0] + scale * (1 - E(o)) * (1 - E(i)) * i[2] / np.pi
        judge_table(b.eval(o, i)[0, 0], exact, i[2] / np.pi, (kind, coat, rho, o, i))


SLOW = pytest.mark.slow
ALPHAS = [pytest.param(0.03, marks=SLOW), 0.3, pytest.param(1.0, marks=SLOW)]


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("eta", [1.2, pytest.param(2.4, marks=SLOW)])
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_rough_plastic(alpha: float, eta: float, distribution: str) -> None:
    coat = {"alpha": alpha, "eta": eta, "distribution": distribution}
    check_body("plastic", coat, 0.8, eta * eta, (alpha, alpha))


BODIES: list[tuple[str, dict[str, Any], Widths]] = [
    ("cook_torrance", {"F0": 0.3, "alpha": 0.4}, (0.4, 0.4)),
    ("cook_torrance", {"F0": 0.04, "alpha": 0.1, "masking": "v_cavity"}, (0.1, 0.1)),
    ("cook_torrance", {"eta": 1.5, "alpha": 0.3, "distribution": "blinn_phong"}, (0.3, 0.3)),
    ("cook_torrance", {"F0": 0.9, "F82_tint": 0.3, "alpha_x": 0.1, "alpha_y": 0.5}, (0.1, 0.5)),
    ("blinn_phong", {"specular": 0.5, "exponent": 0.0}, (1.0, 1.0)),
    ("blinn_phong", {"specular": 0.9, "exponent": 200.0}, (0.1, 0.1)),
    ("ashikhmin_shirley", {"F0": 0.1, "nu": 200.0, "nv": 200.0}, (0.1, 0.1)),
    ("ashikhmin_shirley", {"F0": 0.5, "nu": 20.0, "nv": 500.0}, (0.3, 0.06)),
    ("ward", {"specular": 0.5, "alpha": 0.2}, (0.2, 0.2)),
    ("ward", {"specular": 0.9, "alpha_x": 0.1, "alpha_y": 0.5}, (0.1, 0.5)),
]


def bodies() -> list[Any]:
    """Return them; two widths take many times as long."""
    return [
        pytest.param(*body, id=f"{body[0]}-{k}", marks=[SLOW] if body[2][0] != body[2][1] else [])
        for k, body in enumerate(BODIES)
    ]


@pytest.mark.parametrize(("kind", "coat", "widths"), bodies())
def test_bodies_coupled_by_energy(kind: str, coat: dict[str, Any], widths: Widths) -> None:
    check_body(kind, coat, 0.8, 1.0, widths)


@pytest.mark.parametrize("kind", ["cook_torrance", "conductor"])
@pytest.mark.parametrize("alpha", [pytest.param(0.1, marks=SLOW), 0.3, 1.0])
@pytest.mark.parametrize("masking", ["smith", "v_cavity"])
def test_multiple_scattering(kind: str, alpha: float, masking: str) -> None:
    shape = {"alpha": alpha, "masking": masking}
    white = _core.Bsdf("cook_torrance", {"F0": 1.0, **shape}, "double")
    colour = {"F0": 0.6} if kind == "cook_torrance" else {"eta": 0.4, "k": 2.5}
    lobe = _core.Bsdf(kind, {**colour, **shape}, "double")
    b = _core.Bsdf(kind, {**colour, **shape, "multiscatter": True})
    E = Albedos(white, (alpha, alpha))
    F = _core.Bsdf(kind, {**colour, "alpha": 0.0}, "double")
    x, w = np.polynomial.legendre.leggauss(64)
    mu = (x + 1) / 2
    wo = np.stack([np.sqrt(1 - mu * mu), 0 * mu, mu], 1)
    F_avg = float(np.sum(w * mu * F.sample(wo, np.full((64, 3), 0.5)).weight[:, 0]))
    share = F_avg**2 * E.average / (1 - F_avg * (1 - E.average))
    for o, i in directions():
        lost = (1 - E(o)) * (1 - E(i)) / (1 - E.average)
        exact = lobe.eval(o, i)[0, 0] + share * lost * i[2] / np.pi
        judge_table(b.eval(o, i)[0, 0], exact, i[2] / np.pi, (kind, shape, o, i))
