"""Materials that are wrong on purpose, to test what tests materials. Each breaks one promise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
DIFFUSE_REFLECTION, GLOSSY_REFLECTION = 1 | 8, 2 | 8


class Sample(NamedTuple):
    wi: Floats
    weight: Floats
    pdf: Floats
    lobe: NDArray[np.uint32]
    eta: Floats


class Fake:
    """A reflecting material of albedo 0.5 that is right; subclasses are not."""

    lobes = DIFFUSE_REFLECTION
    power = 1.0  # of the cosine that directions are drawn by

    def value(self, wo: Floats, wi: Floats) -> Floats:
        """Return f, (N,), for directions above."""
        return np.full(len(wi), 0.5 / np.pi)

    def density(self, wo: Floats, wi: Floats) -> Floats:
        """Return what `pdf` says, (N,), for directions above."""
        return (self.power + 1) / (2 * np.pi) * wi[:, 2] ** self.power

    def weight(self, wo: Floats, wi: Floats) -> Floats:
        true = Fake.density(self, wo, wi)
        return self.value(wo, wi) * wi[:, 2] / np.maximum(true, 1e-300)

    def _above(self, f: Callable[[Floats, Floats], Floats], wo: Any, wi: Any) -> Floats:
        o, i = np.broadcast_arrays(np.atleast_2d(wo).astype(float), np.atleast_2d(wi).astype(float))
        flip = np.where(o[:, 2:] < 0, -1.0, 1.0) * np.array([0, 0, 1]) + np.array([1, 1, 0])
        o, i = o * flip, i * flip
        return np.where((o[:, 2] > 0) & (i[:, 2] > 0), f(o, i), 0.0)

    def eval(self, wo: Any, wi: Any) -> Floats:
        f = self._above(lambda o, i: self.value(o, i) * i[:, 2], wo, wi)
        return np.repeat(f[:, None], 3, axis=1)

    def pdf(self, wo: Any, wi: Any) -> Floats:
        return self._above(self.density, wo, wi)

    def sample(self, wo: Any, u: Any) -> Sample:
        u = np.asarray(u, dtype=float)
        z = (1 - u[:, 1]) ** (1 / (self.power + 1))
        r, phi = np.sqrt(np.maximum(0, 1 - z * z)), 2 * np.pi * u[:, 2]
        wi = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
        o = np.broadcast_to(np.atleast_2d(wo).astype(float), wi.shape)
        below = o[:, 2] < 0
        up = o * np.where(below[:, None], [1, 1, -1], [1, 1, 1])
        weight, pdf = self.weight(up, wi), self.density(up, wi)
        wi = np.where(below[:, None], wi * [1, 1, -1], wi)
        good = (np.abs(o[:, 2]) > 0) & (z > 0)
        lobe = np.where(good, self.lobes, 0).astype(np.uint32)
        three = np.repeat((weight * good)[:, None], 3, axis=1)
        return Sample(wi, three, pdf * good, lobe, np.ones(len(u)))

    def albedo(self, wo: Any, n: int = 4096) -> Floats:
        u = np.random.default_rng(5).random((n, 3))
        return np.array([self.sample(w, u).weight.mean(axis=0) for w in np.atleast_2d(wo)])


class GainsEnergy(Fake):
    """Scatters a tenth more than it gets, at grazing only."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return (0.95 + 0.2 * (1 - wo[:, 2]) ** 4) * (0.95 + 0.2 * (1 - wi[:, 2]) ** 4) / np.pi


class PdfTooLarge(Fake):
    """Says a pdf whose integral is 1.05."""

    def density(self, wo: Floats, wi: Floats) -> Floats:
        return 1.05 * Fake.density(self, wo, wi)


class PdfOfAnotherShape(Fake):
    """Draws by the cosine and says a uniform pdf."""

    def density(self, wo: Floats, wi: Floats) -> Floats:
        return np.full(len(wi), 0.5 / np.pi)


class NotReciprocal(Fake):
    """Scatters more for a viewer above than at grazing, whatever the light does."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return (0.3 + 0.3 * wo[:, 2]) / np.pi


class NotANumber(Fake):
    """Divides by a cosine that may be zero."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore"):
            good = np.full(len(wi), 0.5 / np.pi)
            return np.where(wo[:, 2] < 1e-3, good * (wo[:, 2] * 0 / np.zeros(len(wi))), good)


class Negative(Fake):
    """Takes light away at grazing."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return (wi[:, 2] - 0.1) / np.pi


class HasALobeThatIsNeverSampled(Fake):
    """Evaluates a narrow second lobe that `sample` does not know."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        mirrored = wo * [-1, -1, 1]
        c = np.clip(np.sum(mirrored * wi, axis=1), 0, 1)
        return 0.5 / np.pi + 2 * c**200

    def weight(self, wo: Floats, wi: Floats) -> Floats:
        return np.full(len(wi), 0.5)


class WeightsThatDrift(Fake):
    """Has weights a little off eval / pdf, right in the mean."""

    def weight(self, wo: Floats, wi: Floats) -> Floats:
        return 0.5 * (1 + 0.05 * np.sign(wi[:, 0]))


class Specks(Fake):
    """Draws a narrow lobe by the cosine: right, but with very large weights."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return 40.0 / np.pi * wi[:, 2] ** 120 * wo[:, 2] ** 120


class RoughInFloat(Fake):
    """What a float path with a bad formula would answer."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return 0.5 / np.pi * (1 + 0.01 * np.sin(1e4 * wi[:, 0]))


class StrayInFloat(Fake):
    """What a float path that shifts its samples would answer."""

    def sample(self, wo: Any, u: Any) -> Sample:
        s = super().sample(wo, u)
        wi = s.wi + np.array([0.05, 0.0, 0.0])
        return s._replace(wi=wi / np.linalg.norm(wi, axis=1, keepdims=True))


class LosesInFloat(Fake):
    """What a float path that drops samples would answer."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return np.where(wo[:, 2] < 0.5, 0.4, 0.5) / np.pi


class Estimate(Fake):
    """A right material whose eval is a noisy estimate, and whose pdf is a stand-in."""

    stochastic = True

    def noise(self, wo: Floats, wi: Floats) -> Floats:
        """Return numbers of mean 1 that directions decide."""
        key = np.modf(np.abs(np.sin(wi @ [127.1, 311.7, 74.7] + wo @ [9.1, 3.3, 5.7]) * 43758.5))[0]
        return 2 * key

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return 0.5 / np.pi * self.noise(wo, wi)

    def density(self, wo: Floats, wi: Floats) -> Floats:
        return np.full(len(wi), 0.5 / np.pi)

    def weight(self, wo: Floats, wi: Floats) -> Floats:
        return 0.5 * self.noise(wi, wo)


class MostlyAbsorbed(Estimate):
    """Scatters one sample in three hundred: cells of which nearly nothing is known."""

    def sample(self, wo: Any, u: Any) -> Sample:
        s = super().sample(wo, u)
        kept = np.asarray(u)[:, 0] < 1 / 300
        return Sample(s.wi, s.weight * kept[:, None], s.pdf * kept, s.lobe * kept, s.eta)

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return super().value(wo, wi) / 300


class BiasedEstimate(Estimate):
    """Samples what eval has, but a quarter more to one side."""

    def weight(self, wo: Floats, wi: Floats) -> Floats:
        return 0.5 * self.noise(wi, wo) * (1 + 0.25 * np.sign(wi[:, 0]))


class EstimateThatGains(Estimate):
    """Has a mean albedo of 1.05."""

    def value(self, wo: Floats, wi: Floats) -> Floats:
        return 1.05 / np.pi * self.noise(wo, wi)

    def weight(self, wo: Floats, wi: Floats) -> Floats:
        return 1.05 * self.noise(wi, wo)
