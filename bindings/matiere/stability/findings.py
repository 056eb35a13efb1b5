"""From measures to words: what is promised, what was found, and whether that is good enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from matiere.stability.measures import Finiteness, FloatGap, Viewer
from matiere.stability.statistics import sidak
from matiere.stability.views import View

PASS, WARN, FAIL = "pass", "warn", "fail"
GAIN = 1e-3  # albedo above 1 by more than this is energy from nowhere
PDF_GAP = 2e-3  # of the integral of the pdf, beyond 5 standard errors of the rejected share
EVAL_GAP = 3e-3  # between albedo by eval and by sampling, beyond 6 standard errors
WEIGHT_GAP = 1e-3  # mean |eval / pdf - weight| over the mean weight
RECIPROCITY_GAP = 1e-3
FLOAT_GAP = 1e-3
FLOAT_LOSS = 1e-2  # of the energy, by sampling in float
LARGE_WEIGHT = 10.0
UNCERTAIN = 5e-3
ESTIMATE_LEVEL = 1e-5  # of estimates, whose noise has heavier tails than a normal law
LEVEL = 0.01  # of all chi-square tests of a report together


@dataclass(frozen=True)
class Finding:
    """One line of a report.

    Attributes:
        name: what was measured, a word for programs.
        verdict: "pass", "warn" or "fail".
        value: the worst value met.
        limit: what it was held against; None where nothing is promised.
        degrees: angle of the viewer where it was met, None if it has none.
        side: 1 outside, -1 inside an interface.
        text: the finding in words.
    """

    name: str
    verdict: str
    value: float
    limit: float | None
    text: str
    degrees: float | None = None
    side: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the finding as JSON holds it."""
        return dict(vars(self))


@dataclass(frozen=True)
class Look:
    """All that was measured from one viewer."""

    viewer: Viewer
    view: View
    again: View  # a second run with other samples where the first was suspicious
    reciprocity: float
    float_gap: FloatGap


def _p(look: Look) -> float:
    """Return the larger p-value of the two runs."""
    return max(look.view.p_value, look.again.p_value)


def _p_float(look: Look) -> float:
    return float(np.maximum(look.view.p_value_float, look.again.p_value_float))  # NaN: either


def where(viewer: Viewer) -> str:
    """Return the viewer in words."""
    inside = " from inside" if viewer[1] < 0 else ""
    return f"at {viewer[0]:g} degrees{inside}"


def _finding(
    name: str, verdict: str, value: float, limit: float | None, text: str, viewer: Viewer
) -> Finding:
    return Finding(name, verdict, float(value), limit, text, *viewer)


def energy(looks: Sequence[Look], curve: Sequence[tuple[Viewer, float]]) -> Finding:
    """Judge the furnace: no viewer may see more light come back than went in."""
    found = [(float(look.view.albedo.max()) - look.view.uncertain, look.viewer) for look in looks]
    found += [(value, viewer) for viewer, value in curve]
    value, viewer = max(found)
    if value > 1 + GAIN:
        text = f"gains energy: albedo {value:.4g} {where(viewer)}"
        return _finding("energy", FAIL, value, 1 + GAIN, text, viewer)
    text = f"no energy is gained: albedo at most {value:.4g}, {where(viewer)}"
    return _finding("energy", PASS, value, 1 + GAIN, text, viewer)


def pdf_integral(looks: Sequence[Look]) -> Finding:
    """Judge whether pdf, delta events and rejected samples make 1."""

    def excess(look: Look) -> float:
        return abs(look.view.gap) - 5 * look.view.gap_error - look.view.uncertain

    worst = max(looks, key=excess)
    gap, viewer = worst.view.gap, worst.viewer
    if excess(worst) > PDF_GAP:
        text = (
            f"the pdf does not integrate to 1: {1 + gap:.4g} with delta events and rejected"
            f" samples, {where(viewer)}"
        )
        return _finding("pdf_integral", FAIL, gap, PDF_GAP, text, viewer)
    if worst.view.uncertain > UNCERTAIN:
        text = f"the pdf is too rough to integrate: known to {worst.view.uncertain:.1g} only"
        return _finding("pdf_integral", WARN, worst.view.uncertain, UNCERTAIN, text, viewer)
    text = f"the pdf integrates to 1 within {abs(gap):.1g}"
    return _finding("pdf_integral", PASS, gap, PDF_GAP, text, viewer)


def chi_square(looks: Sequence[Look]) -> Finding:
    """Judge whether samples follow the pdf; two runs must doubt it."""
    level = sidak(LEVEL, len(looks))
    worst = min(looks, key=_p)
    p = _p(worst)
    if p < level:
        text = f"samples do not follow the pdf {where(worst.viewer)} (chi-square p = {p:.1g})"
        return _finding("chi_square", FAIL, p, level, text, worst.viewer)
    text = f"samples follow the pdf (smallest chi-square p of {len(looks)} views {p:.2g})"
    return _finding("chi_square", PASS, p, level, text, worst.viewer)


def sampling(looks: Sequence[Look]) -> Finding:
    """Judge whether `eval` and the sample weights scatter the same energy."""

    def gap(look: Look) -> float:
        return float(abs(look.view.albedo - look.view.albedo_sampled).max())

    def excess(look: Look) -> float:
        return gap(look) - 6 * float(look.view.albedo_error.max()) - look.view.uncertain

    worst = max(looks, key=excess)
    value = gap(worst)
    if excess(worst) > EVAL_GAP:
        view = worst.view
        text = (
            f"eval and sampling disagree {where(worst.viewer)}: albedo {view.albedo.max():.4g} by"
            f" eval, {view.albedo_sampled.max():.4g} by sampling"
        )
        return _finding("eval_against_sampling", FAIL, value, EVAL_GAP, text, worst.viewer)
    text = f"eval and sampling scatter the same energy within {value:.1g}"
    return _finding("eval_against_sampling", PASS, value, EVAL_GAP, text, worst.viewer)


def expectation(looks: Sequence[Look]) -> Finding:
    """Judge whether eval, an estimate, and sampling agree in the mean in every cell."""
    level = sidak(ESTIMATE_LEVEL, len(looks))
    worst = min(looks, key=_p)
    p = _p(worst)
    text = f"in the mean eval and sampling agree cell by cell (smallest p of {len(looks)} {p:.2g})"
    if p < level:
        text = f"the means of eval and sampling differ {where(worst.viewer)} (p = {p:.1g})"
    return _finding("expectation", FAIL if p < level else PASS, p, level, text, worst.viewer)


def weights(looks: Sequence[Look]) -> Finding:
    """Judge whether each weight is eval / pdf."""
    worst = max(looks, key=lambda look: look.view.weight_gap)
    value = worst.view.weight_gap
    bad = value > WEIGHT_GAP
    words = "differ from" if bad else "are"
    text = f"sample weights {words} eval / pdf (mean difference {value:.1g} of the mean weight)"
    verdict = FAIL if bad else PASS
    return _finding("weight", verdict, value, WEIGHT_GAP, text, worst.viewer)


def reciprocal(looks: Sequence[Look], promised: bool, one_index: bool) -> Finding:
    """Judge f(o, i) against f(i, o), where the model promises it."""
    worst = max(looks, key=lambda look: look.reciprocity)
    value = worst.reciprocity
    if not promised or not one_index:
        why = "the model does not promise it" if not promised else "it has no single index"
        text = f"reciprocity is not held against it ({why}); mean difference {value:.1g}"
        return _finding("reciprocity", PASS, value, None, text, worst.viewer)
    bad = value > RECIPROCITY_GAP
    words = "not reciprocal" if bad else "reciprocal"
    text = f"{words}: f(o, i) and f(i, o) differ by {value:.1g} of f in the mean"
    verdict = FAIL if bad else PASS
    return _finding("reciprocity", verdict, value, RECIPROCITY_GAP, text, worst.viewer)


def largest_weight(looks: Sequence[Look]) -> Finding:
    """Warn of weights that make single bright pixels."""
    worst = max(looks, key=lambda look: look.view.largest_weight)
    value = worst.view.largest_weight
    high = value > LARGE_WEIGHT
    text = f"largest sample weight {value:.3g}, {where(worst.viewer)}"
    text += ": expect bright specks that need many samples" if high else ""
    return _finding(
        "largest_weight", WARN if high else PASS, value, LARGE_WEIGHT, text, worst.viewer
    )


def finite(found: Sequence[Finiteness]) -> Finding:
    """Judge the answers that are no numbers."""
    asked, bad = sum(f.asked for f in found), sum(f.bad for f in found)
    if bad:
        example = next(f.example for f in found if f.bad)
        text = f"{bad} of {asked} extreme questions have NaN, infinite or negative answers: "
        return Finding("non_finite", FAIL, bad / asked, 0.0, text + example)
    text = f"all answers to {asked} extreme questions are finite and not negative"
    return Finding("non_finite", PASS, 0.0, 0.0, text)


def precision(looks: Sequence[Look]) -> Finding:
    """Compare float, which renders use, with double."""
    lossy = max(looks, key=lambda look: look.float_gap.sample)
    if lossy.float_gap.sample > FLOAT_LOSS:
        value = lossy.float_gap.sample
        text = f"sampling in float scatters other energy than in double: {value:.1g} of it"
        text += f", {where(lossy.viewer)}"
        return _finding("float", FAIL, value, FLOAT_LOSS, text, lossy.viewer)
    astray = [look for look in looks if _p_float(look) < sidak(LEVEL, len(looks)) <= _p(look)]
    if astray:
        worst, p = astray[0], _p_float(astray[0])
        text = f"samples in float do not follow the pdf {where(worst.viewer)} (p = {p:.1g})"
        return _finding("float", FAIL, p, sidak(LEVEL, len(looks)), text, worst.viewer)
    worst = max(looks, key=lambda look: look.float_gap.eval)
    value = worst.float_gap.eval
    if value > FLOAT_GAP:
        text = (
            f"eval in float is off by {value:.1g} of the energy {where(worst.viewer)}: the lobe is"
            " near what float directions can tell apart"
        )
        return _finding("float", WARN, value, FLOAT_GAP, text, worst.viewer)
    text = f"float and double agree: {value:.1g} of the energy at most"
    return _finding("float", PASS, value, FLOAT_GAP, text, worst.viewer)
