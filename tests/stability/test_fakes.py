"""The stability report catches what is wrong, and nothing else."""

from __future__ import annotations

import fake_bsdf as fake
import pytest
from scipy.stats import chi2, kstest

from matiere.stability.estimates import look_at_estimate
from matiere.stability.measures import direction
from matiere.stability.report import Promises, Report, check_bsdf
from matiere.stability.statistics import chi_square_tail
from matiere.stability.views import Effort, look


def report(
    double: object, single: object | None = None, promises: Promises | None = None
) -> Report:
    return check_bsdf(double, single or double, promises or Promises())


def verdicts(found: Report) -> dict[str, str]:
    return {f.name: f.verdict for f in found.findings if f.verdict != "pass"}


def test_a_right_material_passes() -> None:
    found = report(fake.Fake())
    assert found.verdict == "pass" and not verdicts(found), str(found)
    assert found.reason == "nothing wrong was found"


CASES = [
    (fake.GainsEnergy, {"energy"}, "gains energy"),
    (fake.PdfTooLarge, {"pdf_integral", "weight"}, "integrate to 1"),
    (fake.PdfOfAnotherShape, {"chi_square", "weight"}, "do not follow"),
    (fake.NotReciprocal, {"reciprocity"}, "not reciprocal"),
    (fake.NotANumber, {"non_finite"}, "NaN"),
    (fake.Negative, {"non_finite"}, "negative"),
    (fake.HasALobeThatIsNeverSampled, {"eval_against_sampling", "weight"}, "disagree"),
    (fake.WeightsThatDrift, {"weight"}, "differ from eval / pdf"),
]


@pytest.mark.parametrize(
    ("kind", "names", "words"), CASES, ids=lambda x: getattr(x, "__name__", "")
)
def test_one_broken_promise_fails(kind: type[fake.Fake], names: set[str], words: str) -> None:
    found = report(kind())
    assert found.verdict == "fail", str(found)
    failed = {name for name, verdict in verdicts(found).items() if verdict == "fail"}
    assert failed == names, str(found)
    assert words in found.reason


def test_gained_energy_is_told_with_its_angle() -> None:
    found = report(fake.GainsEnergy())
    worst = next(f for f in found.findings if f.name == "energy")
    assert worst.value == pytest.approx(1.15 * (0.95 + 0.4 / 30), abs=2e-3)
    assert worst.degrees is not None and worst.degrees > 84


def test_large_weights_warn() -> None:
    found = report(fake.Specks())
    assert found.verdict == "warn" and verdicts(found) == {"largest_weight": "warn"}, str(found)
    assert "specks" in found.reason


def test_reciprocity_is_not_held_against_those_who_do_not_promise_it() -> None:
    found = report(fake.NotReciprocal(), promises=Promises(reciprocal=False))
    assert found.verdict == "pass", str(found)
    assert any("does not promise" in f.text for f in found.findings)


def test_float_is_held_against_double() -> None:
    rough = report(fake.Fake(), fake.RoughInFloat())
    assert verdicts(rough) == {"float": "warn"}, str(rough)
    stray = report(fake.Fake(), fake.StrayInFloat())
    assert verdicts(stray) == {"float": "fail"} and "do not follow" in stray.reason, str(stray)
    lossy = report(fake.Fake(), fake.LosesInFloat())
    assert verdicts(lossy) == {"float": "fail"}, str(lossy)


def test_the_same_seed_gives_the_same_report() -> None:
    a, b = (report(fake.PdfOfAnotherShape()).as_dict() for _ in range(2))
    assert {**a, "seconds": 0} == {**b, "seconds": 0}


def test_the_p_values_of_a_right_material_are_even() -> None:
    effort = Effort(samples=4000)
    wo = direction(60)
    p = [look(fake.Fake(), wo, seed, effort).p_value for seed in range(60)]
    assert kstest(p, "uniform").pvalue > 1e-3, sorted(p)


@pytest.mark.parametrize("degrees", [1, 2, 5, 30, 120])
def test_the_tail_of_chi_square_is_scipys(degrees: int) -> None:
    for x in (0.1, 1.0, degrees, 2.0 * degrees + 3, 5.0 * degrees + 50):
        assert chi_square_tail(x, degrees) == pytest.approx(chi2.sf(x, degrees), rel=1e-9)


def test_estimates_are_held_to_their_expectations() -> None:
    found = report(fake.Estimate())
    assert found.verdict == "pass", str(found)
    names = [f.name for f in found.findings]
    assert "expectation" in names and not {"chi_square", "weight", "pdf_integral"} & set(names)
    assert found.views[0]["weight_gap"] is None


def test_few_samples_raise_no_suspicion() -> None:
    found = report(fake.MostlyAbsorbed())
    assert found.verdict == "pass", str(found)


def test_a_biased_estimate_is_caught() -> None:
    assert verdicts(report(fake.BiasedEstimate())) == {"expectation": "fail"}


def test_an_estimate_that_gains_is_caught() -> None:
    assert verdicts(report(fake.EstimateThatGains())) == {"energy": "fail"}


def test_the_p_values_of_a_right_estimate_are_not_too_small() -> None:
    effort = Effort(samples=8000)
    p = [look_at_estimate(fake.Estimate(), direction(60), k, effort).p_value for k in range(60)]
    assert kstest(p, "uniform", alternative="greater").pvalue > 1e-3, sorted(p)
