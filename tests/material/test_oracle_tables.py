"""Models that look up directional albedos: eval against quadrature, to 1e-3."""

from __future__ import annotations

from typing import Any

import facet_quadrature
import numpy as np
import oracle
import pytest
from oracle_check import DEGREES, OTHERS, directions, judge_table

from matiere import _core

Widths = tuple[float, float]


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


class Lost:
    """1 - E of single scattering at an interface from one side, by quadrature."""

    def __init__(self, shape: dict[str, Any], side: int) -> None:
        self.lobe, self.side = _core.Bsdf("dielectric", shape, "double"), side
        x, w = np.polynomial.legendre.leggauss(48)
        mu = ((x + 1) / 2) ** 2  # gathers nodes at grazing
        self.average = float(np.sum(2 * mu * np.sqrt(mu) * w * self.at(mu, 1 << 17)))

    def at(self, mu: np.ndarray, n: int) -> np.ndarray:
        w = np.stack([np.sqrt(1 - mu * mu), 0 * mu, self.side * mu], -1)
        return 1 - self.lobe.albedo(w, n=n)[:, 0].astype(float)


def let_through(eta: float) -> float:
    """Return 1 - F_avg of light from everywhere that meets an interface of relative index eta."""
    x, w = np.polynomial.legendre.leggauss(64)
    reflected = [float(oracle.fresnel_dielectric(mu, max(eta, 1 / eta))) for mu in (x + 1) / 2]
    return float(1 - np.sum(w * (x + 1) / 2 * reflected)) * min(1.0, eta**2)


@pytest.mark.parametrize("alpha", [pytest.param(0.1, marks=SLOW), 0.5, pytest.param(1, marks=SLOW)])
@pytest.mark.parametrize("eta", [1.5, pytest.param(0.7, marks=SLOW), pytest.param(2.4, marks=SLOW)])
@pytest.mark.parametrize("masking", ["smith", pytest.param("v_cavity", marks=SLOW)])
def test_multiple_scattering_of_an_interface(alpha: float, eta: float, masking: str) -> None:
    shape = {"eta": eta, "alpha": alpha, "masking": masking}
    b = _core.Bsdf("dielectric", {**shape, "multiscatter": True})
    mu = np.cos(np.radians(sorted({*DEGREES, *OTHERS})))
    sides = {side: Lost(shape, side) for side in (1, -1)}
    n = 1 << 22 if alpha < 0.5 else 1 << 18  # so that what is lost has its digits too
    lost = {side: dict(zip(np.round(mu, 4), sides[side].at(mu, n), strict=True)) for side in sides}
    for side in (1, -1):
        here, there, relative = sides[side], sides[-side], eta**side
        crossing = let_through(relative) * min(1, there.average / here.average)
        for o, i in directions():
            for across in (1, -1):
                wo, wi = o * np.float32([1, 1, side]), i * np.float32([1, 1, side * across])
                out = sides[side * across]
                share = 1 - crossing if across > 0 else crossing / relative**2
                white = i[2] / np.pi * (1 if across > 0 else relative**-2)
                leaves = lost[side * across][round(float(i[2]), 4)] / out.average
                more = share * lost[side][round(float(o[2]), 4)] * leaves * i[2] / np.pi
                exact = here.lobe.eval(wo, wi)[0, 0] + more
                judge_table(b.eval(wo, wi)[0, 0], exact, white, (shape, side, o, i, across))
