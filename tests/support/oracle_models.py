"""Models in 50 digits: functions of (*wo, *wi) that return f |cos_i| and the density of samples."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import oracle
from mpmath import exp, mpf, pi, quad, sqrt, workdps

Model = Callable[..., tuple[Any, Any]]
Fresnel = Callable[[Any], Any]


def split(x: tuple[Any, ...]) -> tuple[list[Any], list[Any]]:
    return oracle.vector(x[:3]), oracle.vector(x[3:])


def lambert(rho: Any) -> Model:
    def model(*x: Any) -> tuple[Any, Any]:
        _, i = split(x)
        return mpf(rho) * i[2] / pi, i[2] / pi

    return model


def seen(p: dict[str, Any], o: Any, h: Any, bounded: bool) -> Any:
    """Density over D(h) of the reflections of visible normals (Heitz & d'Eon 2014), for GGX
    those of the bounded cap (Eto & Tokuyoshi 2023, eqs 1 and 5)."""
    ax, ay = mpf(p["alpha_x"]), mpf(p["alpha_y"])
    if p["masking"] == "v_cavity":
        return min(mpf(1), 2 * h[2] * o[2] / oracle.dot(o, h)) / (4 * o[2])
    if p["distribution"] != "ggx" or not bounded:
        return 1 / (4 * o[2] * (1 + oracle.big_lambda(p["distribution"], o, ax, ay)))
    a2 = min(ax, ay, mpf(1)) ** 2
    s2 = (1 + sqrt(o[0] ** 2 + o[1] ** 2)) ** 2
    k = (1 - a2) * s2 / (s2 + a2 * o[2] ** 2)
    length = sqrt((ax * o[0]) ** 2 + (ay * o[1]) ** 2 + o[2] ** 2)
    return 1 / (2 * (k * o[2] + length))


def facets(p: dict[str, Any], fresnel: Fresnel) -> Model:
    """A reflecting microfacet surface of parameters alpha_x, alpha_y, distribution, masking."""

    def model(*x: Any) -> tuple[Any, Any]:
        o, i = split(x)
        h = oracle.vector_sum(o, i, 1)
        D = oracle.distribution(p["distribution"], h, p["alpha_x"], p["alpha_y"])
        return oracle.reflection(o, i, p, fresnel), D * seen(p, o, h, True)

    return model


def interface(p: dict[str, Any], eta: Any) -> Model:
    """Walter et al. 2007: reflected or refracted, as the two directions are."""
    ax, ay, eta = mpf(p["alpha_x"]), mpf(p["alpha_y"]), mpf(eta)

    def fresnel(c: Any) -> Any:
        return oracle.fresnel_dielectric(c, eta)

    def model(*x: Any) -> tuple[Any, Any]:
        o, i = split(x)
        crosses = i[2] < 0
        h = oracle.vector_sum(o, i, eta if crosses else 1)
        h = h if h[2] > 0 else [-c for c in h]
        oh, ih = oracle.dot(o, h), oracle.dot(i, h)
        D = oracle.distribution(p["distribution"], h, ax, ay)
        visible = D * seen(p, o, h, False)
        if not crosses:
            return oracle.reflection(o, i, p, fresnel), visible * fresnel(oh)
        if oh <= 0 or ih >= 0:
            return mpf(0), mpf(0)
        jacobian = 4 * oh * eta**2 * abs(ih) / (oh + eta * ih) ** 2
        return oracle.transmission(o, i, p, eta), visible * jacobian * (1 - fresnel(oh))

    return model


def added(weights: tuple[Any, Any], a: Model, b: Model) -> Model:
    """Two models side by side."""

    def model(*x: Any) -> tuple[Any, Any]:
        one, two = a(*x), b(*x)
        return (
            weights[0] * one[0] + weights[1] * two[0],
            weights[0] * one[1] + weights[1] * two[1],
        )

    return model


@lru_cache
def mean_fresnel(eta: Any, tau: Any = 0) -> Any:
    """2 int F(c) exp(-2 tau / c) c dc: the cosine-weighted average."""
    eta, tau = mpf(eta), mpf(tau)
    edge = sqrt(abs(1 - eta**2))
    cuts = sorted({mpf(0), min(edge, mpf(1)), min(edge * 4, mpf(1)), mpf(1)})
    with workdps(30):
        return quad(
            lambda c: 2 * c * oracle.fresnel_dielectric(c, eta) * (exp(-2 * tau / c) if c else 0),
            cuts,
        )


def smooth_plastic(rho: Any, eta: Any) -> Model:
    """Specification, section 4: all reflections between the body and the surface."""
    rho, eta = mpf(rho), mpf(eta)
    inner = 1 - (1 - mean_fresnel(eta)) / eta**2
    body = rho / (eta**2 * (1 - rho * inner))

    def model(*x: Any) -> tuple[Any, Any]:
        o, i = split(x)
        F_o, F_i = (oracle.fresnel_dielectric(w[2], eta) for w in (o, i))
        below = (1 - F_o) * body * (1 - mean_fresnel(eta))
        surface = min(F_o / (F_o + below), mpf("0.99")) if below > 0 else mpf(1)
        return (1 - F_o) * (1 - F_i) * body * i[2] / pi, (1 - surface) * i[2] / pi

    return model


def coated(base: Model, surface: Model | None, eta: Any, tau: Any, exact_rho: Any = None) -> Model:
    """A coat over `base`: one pass (Weidlich & Wilkie 2007), or over Lambert of albedo exact_rho
    all passes. `surface` is None where the coat is smooth."""
    eta, tau = mpf(eta), mpf(tau)
    returned = mean_fresnel(1 / eta, tau) if exact_rho is not None else mpf(0)

    def model(*x: Any) -> tuple[Any, Any]:
        o, i = split(x)
        above = surface(*x) if surface else (mpf(0), mpf(0))
        T_o, T_i = (1 - oracle.fresnel_dielectric(w[2], eta) for w in (o, i))
        if T_o == 0:  # total reflection by a coat thinner than its surroundings
            return above
        inner = [[w[0] / eta, w[1] / eta, sqrt(1 - (1 - w[2] ** 2) / eta**2)] for w in (o, i)]
        a_o, a_i = (exp(-tau / w[2]) for w in inner)
        below = T_o * a_o * a_o
        q = below / (1 - T_o + below)
        if T_i == 0:
            return above[0], (1 - q) * above[1]
        # The base sees the cosine inside; the solid angle shrinks by cos / (eta^2 cos inside).
        f, pdf = (v * i[2] / (inner[1][2] * eta**2) for v in base(*inner[0], *inner[1]))
        f *= T_o * T_i * a_o * a_i
        if exact_rho is not None:
            f /= 1 - mpf(exact_rho) * returned
            pdf = i[2] / pi
        return above[0] + f, (1 - q) * above[1] + q * pdf

    return model


def sheet(eta: Any, straight: Any) -> Callable[..., tuple[Any, Any]]:
    """Shares of *wo that a thin sheet reflects and lets pass (Stokes 1862)."""

    def shares(*wo: Any) -> tuple[Any, Any]:
        c = oracle.vector(wo)[2]
        F = oracle.fresnel_dielectric(c, eta)
        if F == 1:
            return mpf(1), mpf(0)
        t = mpf(straight) ** (1 / sqrt(1 - (1 - c * c) / mpf(eta) ** 2)) if straight else mpf(0)
        rest = 1 - (F * t) ** 2
        return F + (1 - F) ** 2 * F * t * t / rest, (1 - F) ** 2 * t / rest

    return shares
