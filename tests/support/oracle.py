"""Models written down a second time, straight from their papers, in 50 digits (mpmath).

They take the engine's own float inputs; directions are normalised here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

from mpmath import beta, erf, exp, expm1, gamma, log, mp, mpc, mpf, pi, quad, sqrt, workdps

mp.dps = 50
Vector = Sequence[Any]


def vector(w: Sequence[float]) -> list[Any]:
    """Return the direction, normalised."""
    v = [x if isinstance(x, mpf) else mpf(float(x)) for x in w]
    n = sqrt(sum(x * x for x in v))
    return [x / n for x in v]


def dot(a: Vector, b: Vector) -> Any:
    return sum(x * y for x, y in zip(a, b, strict=True))


def fresnel_dielectric(c: Any, eta: Any) -> Any:
    """Unpolarised reflectance by Snell's law and the amplitudes of each polarisation."""
    c, eta = mpf(c), mpf(eta)
    if eta == 1:
        return mpf(0)
    sin2_t = (1 - c * c) / (eta * eta)
    if sin2_t >= 1:
        return mpf(1)
    t = sqrt(1 - sin2_t)
    r_s = (c - eta * t) / (c + eta * t)
    r_p = (eta * c - t) / (eta * c + t)
    return (r_s * r_s + r_p * r_p) / 2


def fresnel_conductor(c: Any, eta: Any, k: Any) -> Any:
    """The same with a complex index, no real-valued expansion."""
    c, n = mpf(c), mpc(mpf(eta), mpf(k))
    t = sqrt(1 - (1 - c * c) / (n * n))
    r_s = (c - n * t) / (c + n * t)
    r_p = (n * c - t) / (n * c + t)
    return (abs(r_s) ** 2 + abs(r_p) ** 2) / 2


def fresnel_schlick(c: Any, F0: Any) -> Any:
    return F0 + (1 - mpf(F0)) * (1 - c) ** 5


def fresnel_f82(c: Any, F0: Any, tint: Any) -> Any:
    """Schlick's law, lowered so that cos = 1/7 is `tint` times as bright (Kutz et al. 2021)."""
    edge = mpf(1) / 7
    dip = fresnel_schlick(edge, F0) * (1 - mpf(tint)) / (edge * (1 - edge) ** 6)
    return min(max(fresnel_schlick(c, F0) - dip * c * (1 - c) ** 6, mpf(0)), mpf(1))


def distribution(name: str, h: Vector, ax: Any, ay: Any) -> Any:
    x, y, z = h
    ax, ay = mpf(ax), mpf(ay)
    slope = (x / ax) ** 2 + (y / ay) ** 2
    if name == "ggx":
        return 1 / (pi * ax * ay * (slope + z * z) ** 2)
    if name == "blinn_phong":
        m = 2 / (ax * ax) - 2
        return (m + 2) / (2 * pi) * (z / sqrt(x * x + y * y + z * z)) ** m
    return exp(-slope / (z * z)) / (pi * ax * ay * z**4)


def big_lambda(name: str, w: Vector, ax: Any, ay: Any) -> Any:
    x, y, z = w
    s = sqrt((mpf(ax) * x) ** 2 + (mpf(ay) * y) ** 2)
    z = abs(z)
    if s == 0:
        return mpf(0)
    if name == "ggx":
        return (sqrt(1 + (s / z) ** 2) - 1) / 2
    a = z / s
    if name == "blinn_phong":
        return phong_lambda(z / sqrt(x * x + y * y), 2 / mpf(ax) ** 2)
    return (exp(-a * a) / (a * sqrt(pi)) - 1 + erf(a)) / 2


@lru_cache(maxsize=64)
def phong_lambda(cot: Any, nu: Any) -> Any:
    """Return Lambda for slopes of density K (1 + x^2)^(-(nu+1)/2): the integral of (x / cot - 1)
    times it beyond cot."""
    K = gamma((nu + 1) / 2) / (sqrt(pi) * gamma(nu / 2)) if nu < 1e3 else phong_norm(nu)
    s2 = 1 / (1 + cot * cot)
    peak = K * exp(nu / 2 * log(s2))  # K s^nu
    if peak < mpf(10) ** -40:
        return mpf(0)
    # The tail K int sin^(nu-1) from 0 to the viewer's angle, by sin = s exp(-u^2 / nu).
    edge = cot * sqrt(nu / 2)
    cuts = sorted({mpf(0), min(edge, mpf(1)), min(edge * 4, mpf(2)), mpf(2), mpf(4), mpf(9)})

    def part(u: Any) -> Any:
        return u * exp(-u * u) / sqrt(-expm1(-2 * u * u / nu + log(s2)))

    with workdps(26):  # enough for the differences that `condition` takes
        beyond = 2 * peak / nu * quad(part, cuts)
    rise = peak / sqrt(s2) / (nu - 1)
    return rise / cot - beyond


def phong_norm(nu: Any) -> Any:
    """Return Gamma((nu+1)/2) / (sqrt(pi) Gamma(nu/2)) for large nu by Stirling's series."""
    r = 1 / nu
    c = (1, -1 / mpf(4), 1 / mpf(32), 5 / mpf(128), -21 / mpf(2048), -399 / mpf(8192))
    return sqrt(nu / (2 * pi)) * sum(a * r**k for k, a in enumerate(c))


def masking(kind: str, name: str, o: Vector, i: Vector, h: Vector, ax: Any, ay: Any) -> Any:
    """G2 of a pair of directions, on one side or on both."""
    transmitted = i[2] * o[2] < 0
    if kind == "v_cavity":
        g_o = min(mpf(1), 2 * h[2] * abs(o[2] / dot(o, h)))
        g_i = min(mpf(1), 2 * h[2] * abs(i[2] / dot(i, h)))
        return max(mpf(0), g_o + g_i - 1) if transmitted else min(g_o, g_i)
    lo, li = big_lambda(name, o, ax, ay), big_lambda(name, i, ax, ay)
    if kind == "smith_separable":
        return 1 / ((1 + lo) * (1 + li))
    return beta(1 + lo, 1 + li) if transmitted else 1 / (1 + lo + li)


def reflection(
    o: Sequence[float], i: Sequence[float], p: dict[str, Any], fresnel: Callable[[Any], Any]
) -> Any:
    """f cos of a microfacet reflection with parameters alpha_x, alpha_y, distribution, masking."""
    vo, vi = vector(o), vector(i)
    h = vector_sum(vo, vi, 1)
    D = distribution(p["distribution"], h, p["alpha_x"], p["alpha_y"])
    G = masking(p["masking"], p["distribution"], vo, vi, h, p["alpha_x"], p["alpha_y"])
    return fresnel(dot(vo, h)) * D * G / (4 * vo[2])


def transmission(o: Sequence[float], i: Sequence[float], p: dict[str, Any], eta: Any) -> Any:
    """f |cos| of Walter et al. 2007, eq. 21, times 1 / eta^2; eta is relative to o's side."""
    vo, vi, eta = vector(o), vector(i), mpf(eta)
    h = vector_sum(vo, vi, eta)
    if h[2] < 0:
        h = [-x for x in h]
    oh, ih = dot(vo, h), dot(vi, h)
    if oh <= 0 or ih >= 0:
        return mpf(0)
    D = distribution(p["distribution"], h, p["alpha_x"], p["alpha_y"])
    G = masking(p["masking"], p["distribution"], vo, vi, h, p["alpha_x"], p["alpha_y"])
    T = 1 - fresnel_dielectric(oh, eta)
    return abs(ih) * oh / vo[2] * T * G * D / (oh + eta * ih) ** 2


def vector_sum(o: Vector, i: Vector, eta: Any) -> list[Any]:
    h = [a + eta * b for a, b in zip(o, i, strict=True)]
    n = sqrt(dot(h, h))
    return [x / n for x in h]


def conditions(f: Callable[..., Any], inputs: Sequence[float]) -> tuple[list[Any], list[Any]]:
    """Return the values of f and the condition number of each: its relative change per relative
    change of the inputs, summed over the inputs."""
    base = list(f(*inputs))
    step = mpf(10) ** -12
    totals = [mpf(0)] * len(base)
    for k in range(len(inputs)):
        moved = [mpf(x) * (1 + step) if j == k else mpf(x) for j, x in enumerate(inputs)]
        for n, there in enumerate(f(*moved)):
            if base[n] != 0:
                totals[n] += abs(there - base[n]) / (abs(base[n]) * step)
    return base, totals


#: Told (error, allowed, part) of every comparison of a model with its oracle: see oracle_log.py.
listeners: list[Callable[[float, float, str], None]] = []


def never(error: float) -> bool:
    return False


#: Whether they care how much of its allowance an error below ALWAYS takes.
curious: Callable[[float], bool] = never


def note(error: float, allowed: float, part: str = "") -> None:
    """Tell the listeners of a comparison; `allowed` is infinite where it is only known to be
    enough."""
    for listener in listeners:
        listener(error, allowed, part)


ALWAYS = 1e-5  # relative error that is allowed at any condition


def allowance(condition: Any) -> float:
    """The relative error a float path may have: 1e-5, or 8 roundings of its inputs."""
    return float(max(mpf(ALWAYS), 8 * mpf(2) ** -24 * condition))


def bound(f: Callable[..., Any], inputs: Sequence[float]) -> float:
    """The allowance of one function at its inputs."""
    return allowance(conditions(lambda *x: (f(*x),), inputs)[1][0])
