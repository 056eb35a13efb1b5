"""The committed metals: fit residuals everywhere, the fit itself where the data are."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

TEXT = (files("matiere") / "data" / "metals.json").read_text(encoding="utf-8")
METALS: dict[str, dict[str, Any]] = json.loads(TEXT)["metals"]


def reflectance(cos_theta: float, eta: float, k: float) -> float:
    """Fresnel's equations for a conductor in the real form of Born & Wolf (14.2.22 and on)."""
    sin2 = 1.0 - cos_theta**2
    t0 = eta**2 - k**2 - sin2
    a2b2 = np.sqrt(t0**2 + 4.0 * eta**2 * k**2)
    t1 = a2b2 + cos_theta**2
    a = np.sqrt(max(0.5 * (a2b2 + t0), 0.0))
    t2 = 2.0 * a * cos_theta
    r_s = (t1 - t2) / (t1 + t2)
    t3 = cos_theta**2 * a2b2 + sin2**2
    t4 = t2 * sin2
    return float(0.5 * (r_s + r_s * (t3 - t4) / (t3 + t4)))


def test_there_are_at_least_ten_metals_with_source_and_licence() -> None:
    assert len(METALS) >= 10
    for key, metal in METALS.items():
        assert metal["licence"] == "CC0-1.0" and metal["citation"] and metal["source"], key


@pytest.mark.parametrize("key", sorted(METALS))
def test_fit_has_the_wanted_reflectance_at_0_and_82_degrees(key: str) -> None:
    metal = METALS[key]
    missed = {(m["angle_deg"], m["channel"]) for m in metal["missed"]}
    for angle, wanted in ((0, metal["f0"]), (82, metal["f82"])):
        for channel in range(3):
            eta, k = metal["eta"][channel], metal["k"][channel]
            assert eta > 0.0 and k >= 0.0
            found = reflectance(float(np.cos(np.deg2rad(angle))), eta, k)
            tolerance = 0.01 if (angle, "RGB"[channel]) in missed else 1e-5
            assert abs(found - wanted[channel]) < tolerance, (
                f"{key} {'RGB'[channel]} at {angle} deg: {found} for {wanted[channel]}"
            )


@pytest.mark.parametrize("key", sorted(METALS))
def test_clips_are_listed_and_bounded(key: str) -> None:
    metal = METALS[key]
    for note in metal["clipped"]:
        assert not 0.0 <= note["spectral"] <= 0.9995
        held = metal["f0" if note["angle_deg"] == 0 else "f82"]["RGB".index(note["channel"])]
        assert held in (0.0, 0.9995)
    assert all(0.0 <= v <= 0.9995 for v in metal["f0"] + metal["f82"])


def test_only_gold_is_out_of_gamut() -> None:
    assert [key for key, metal in METALS.items() if metal["clipped"]] == ["Au"]


def test_colours_are_the_ones_people_know() -> None:
    for key in ("Au", "Cu", "CuZn", "TiN"):
        red, green, blue = METALS[key]["f0"]
        assert red > green > blue and red / blue > 1.5, (key, METALS[key]["f0"])
    for key in ("Ag", "Al", "Cr", "Hg"):
        assert max(METALS[key]["f0"]) / min(METALS[key]["f0"]) < 1.05, (key, METALS[key]["f0"])


def test_white_point_is_d65_and_a_perfect_mirror_is_one(fit_metals: ModuleType) -> None:
    colour = pytest.importorskip("colour", reason="colour-science holds the CIE tables")
    weights = fit_metals.channel_weights()
    assert np.abs(weights.sum(axis=1) - 1.0).max() < 1e-12
    to_xyz = np.linalg.inv(fit_metals.xyz_to_rec709(np.array([0.95047, 1.0, 1.08883])))
    white = to_xyz @ weights.sum(axis=1)
    xy = white[:2] / white.sum()
    assert np.abs(xy - [0.3127, 0.3290]).max() < 1e-3, xy
    assert colour.__version__


def test_committed_numbers_are_the_fit(fit_metals: ModuleType, assets: Path) -> None:
    pytest.importorskip("colour", reason="colour-science holds the CIE tables")
    assert fit_metals.to_text(fit_metals.build_table(assets)) == TEXT


def wyman_sloan_shirley(nm: Any) -> Any:
    """Multi-lobe fit to the CIE 1931 observer (Wyman, Sloan & Shirley 2013, JCGT 2(2), eq 4)."""

    def lobe(mean: float, below: float, above: float) -> Any:
        return np.exp(-0.5 * ((nm - mean) * np.where(nm < mean, below, above)) ** 2)

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323)
    x -= 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    return np.stack([x, y, z])


@pytest.mark.parametrize("key", ["Ag", "Au", "Cu", "Ni", "TiN"])
def test_an_independent_observer_gives_the_same_colour(
    fit_metals: ModuleType, assets: Path, key: str
) -> None:
    """Equal-energy light and an analytic observer, white balanced, come within 0.03."""
    metal = next(m for m in fit_metals.METALS if m.key == key)
    path = assets / "optical" / "refractiveindex" / f"{metal.stem}.yml"
    table, _citation, _comment = fit_metals.read_record(path)
    nm = fit_metals.WAVELENGTHS_NM
    spectrum = [
        reflectance(1.0, float(n), float(k))
        for n, k in zip(
            np.interp(nm * 1e-3, table[:, 0], table[:, 1]),
            np.interp(nm * 1e-3, table[:, 0], table[:, 2]),
            strict=True,
        )
    ]
    observer = wyman_sloan_shirley(nm)
    rgb = fit_metals.xyz_to_rec709(observer.sum(axis=1)) @ (observer @ np.asarray(spectrum))
    found = np.clip(rgb, 0.0, 0.9995)
    assert np.abs(found - METALS[key]["f0"]).max() < 0.03, (found, METALS[key]["f0"])
