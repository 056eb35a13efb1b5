"""Fit RGB optical constants of metals to their spectral reflectance and write `metals.json`.

    python examples/metals/fit_metals.py --assets ../shared/assets

A conductor in an RGB renderer has one (eta, k) pair per channel.  Averaging eta(lambda) and
k(lambda) gives the wrong colour, because the Fresnel equations are not linear in them.  This
script asks for the right colour instead, at two angles:

1.  F(lambda, theta), unpolarised and exact, from tabulated eta(lambda), k(lambda) (linear
    interpolation in wavelength, 1 nm steps, 360 to 780 nm) at theta = 0 and theta = 82 degrees.
2.  F_c(theta) = sum_lambda W_c(lambda) F(lambda, theta): CIE 1931 2-degree observer and
    illuminant D65, then linear Rec.709.  W sums to one per channel, so a perfect reflector is
    (1, 1, 1).
3.  Per channel the pairs with F(0) = F0 lie on the arc k^2 = (eta - a)(1/a - eta), a =
    (1 - sqrt F0) / (1 + sqrt F0) (Gulbrandsen, 2014, "Artist Friendly Metallic Fresnel",
    JCGT 3(4)).  Walking along the arc finds every pair that also has the wanted F(82); the one
    nearest the spectral mean (weights |W_c|) in (ln eta, ln k) is kept.

Channels outside [0, F_MAX] are clipped and listed; where no pair on the arc reaches F(82), a
close one near the spectral mean is kept and the miss is listed too.  The observer and the
illuminant come from the package `colour-science` (CIE 15 tables); the optical constants from the
refractiveindex.info database (public domain, CC0 1.0).  Two runs write the same bytes.
"""

from __future__ import annotations

import argparse
import html
import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
DEFAULT_OUTPUT = ROOT / "bindings" / "matiere" / "data" / "metals.json"
DEFAULT_ASSETS = ROOT.parent / "shared" / "assets"
COS_82 = float(np.cos(np.deg2rad(82.0)))
F_MAX = 0.9995  # a channel that reflects more than light gives needs eta <= 0: clip just below
WAVELENGTHS_NM: Array = np.arange(360.0, 781.0)
UNREACHED_PULL = 1e-3  # reflectance traded per unit of log distance where F(82) is out of reach
DIGITS = 7  # significant digits written; float holds 7.2


@dataclass(frozen=True)
class Metal:
    """One entry: JSON key, plain name, file stem in the database folder."""

    key: str
    name: str
    stem: str


# Zinc is left out: the one record at hand (Querry 1985) gives eta near 13 in the visible, where
# other measurements find about 1, and a grazing reflectance far below theirs.
METALS = (
    Metal("Ag", "silver", "main_Ag__Johnson"),
    Metal("Al", "aluminium", "main_Al__Rakic"),
    Metal("Au", "gold", "main_Au__Johnson"),
    Metal("Co", "cobalt", "main_Co__Johnson"),
    Metal("Cr", "chromium", "main_Cr__Johnson"),
    Metal("Cu", "copper", "main_Cu__Johnson"),
    Metal("CuZn", "brass (70 % copper, 30 % zinc)", "other_alloys_Cu-Zn__Querry-Cu70Zn30"),
    Metal("Fe", "iron", "main_Fe__Johnson"),
    Metal("Hg", "mercury (liquid)", "main_Hg__Inagaki"),
    Metal("Ni", "nickel", "main_Ni__Johnson"),
    Metal("Pd", "palladium", "main_Pd__Johnson"),
    Metal("Pt", "platinum", "main_Pt__Rakic-BB"),
    Metal("Si", "silicon (crystal)", "main_Si__Aspnes"),
    Metal("Ti", "titanium", "main_Ti__Johnson"),
    Metal("TiN", "titanium nitride", "main_TiN__Pfluger"),
    Metal("W", "tungsten", "main_W__Weaver"),
    Metal(
        "stainless_steel",
        "stainless steel (austenitic, near SS316)",
        "other_alloys_stainless-steel__Karlsson-austenitic",
    ),
)


def conductor_fresnel(cos_theta: float, eta: Array, k: Array) -> Array:
    """Unpolarised reflectance of a smooth conductor in air at one angle (Born & Wolf, 14.2)."""
    m = eta.astype(np.complex128) + 1j * k
    sin2 = 1.0 - cos_theta * cos_theta
    root = np.sqrt(m * m - sin2)
    r_s = (cos_theta - root) / (cos_theta + root)
    r_p = (m * m * cos_theta - root) / (m * m * cos_theta + root)
    return 0.5 * (np.abs(r_s) ** 2 + np.abs(r_p) ** 2)


def channel_weights() -> Array:
    """Return W, shape (3, 421): reflectance spectrum to linear Rec.709 under D65."""
    import colour  # BSD-3-Clause; the CIE tables

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    illuminant = colour.SDS_ILLUMINANTS["D65"]
    cmf = np.stack(
        [np.interp(WAVELENGTHS_NM, observer.wavelengths, observer.values[:, i]) for i in range(3)]
    )
    light = np.interp(WAVELENGTHS_NM, illuminant.wavelengths, illuminant.values)
    xyz = cmf * light
    xyz /= xyz[1].sum()
    weights: Array = xyz_to_rec709(xyz.sum(axis=1)) @ xyz
    return weights


def xyz_to_rec709(white: Array) -> Array:
    """Return the matrix to linear Rec.709 (ITU-R BT.709-6 primaries) that sends white to ones."""
    xy = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
    primaries = np.stack([xy[:, 0], xy[:, 1], 1.0 - xy.sum(axis=1)])
    scale = np.linalg.solve(primaries, white)
    inverse: Array = np.linalg.inv(primaries * scale)
    return inverse


def read_record(path: Path) -> tuple[Array, str, str]:
    """Read one database file: rows (wavelength in um, eta, k), the citation, the comment."""
    text = path.read_text(encoding="utf-8")
    rows = re.findall(r"^ {8}(\S+) (\S+) (\S+)$", text, flags=re.MULTILINE)
    table = np.array([[float(v) for v in row] for row in rows])
    if "tabulated nk" not in text or table.shape[0] < 2:
        raise SystemExit(f"{path}: no `tabulated nk` record")
    return table, section(text, "REFERENCES"), section(text, "COMMENTS")


def section(text: str, heading: str) -> str:
    """Return a folded block of the record as one line of plain text, or ''."""
    match = re.search(rf"^{heading}: \|\n((?:    .*\n)+)", text, flags=re.MULTILINE)
    if match is None:
        return ""
    plain = re.sub(r'<a href="([^"]*)">(.*?)</a>', r"\2, \1", match.group(1), flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", "", plain)).split()).strip('\\" ')


def on_arc(f0: float, t: Array) -> tuple[Array, Array]:
    """Return (eta, k) with normal reflectance f0; t in [0, 1] runs along the arc in ln eta."""
    root = np.sqrt(f0)
    low = (1.0 - root) / (1.0 + root)
    eta = low ** (1.0 - 2.0 * t)
    k = np.sqrt(np.maximum((eta - low) * (1.0 / low - eta), 0.0))
    return eta, k


def fit_channel(f0: float, f82: float, near: tuple[float, float]) -> tuple[float, float]:
    """Return the (eta, k) with exactly f0, and f82 if any pair on the arc has it."""
    t = np.linspace(0.0, 1.0, 20001)
    miss = conductor_fresnel(COS_82, *on_arc(f0, t)) - f82
    crossings = np.flatnonzero(np.sign(miss[:-1]) * np.sign(miss[1:]) <= 0)
    if crossings.size == 0:
        eta, k = on_arc(f0, t)
        distance = np.array([log_distance(pair, near) for pair in zip(eta, k, strict=True)])
        best = int(np.argmin(np.abs(miss) + UNREACHED_PULL * distance))
        return float(eta[best]), float(k[best])
    candidates = [bisect(f0, f82, float(t[i]), float(t[i + 1])) for i in crossings]
    return min(candidates, key=lambda pair: log_distance(pair, near))


def bisect(f0: float, f82: float, low: float, high: float) -> tuple[float, float]:
    """Close in on one crossing of F(82) along the arc to the last bit."""

    def miss(t: float) -> float:
        return float(conductor_fresnel(COS_82, *on_arc(f0, np.array([t])))[0]) - f82

    sign_low = np.sign(miss(low))
    for _ in range(60):
        middle = 0.5 * (low + high)
        if np.sign(miss(middle)) == sign_low:
            low = middle
        else:
            high = middle
    eta, k = on_arc(f0, np.array([0.5 * (low + high)]))
    return float(eta[0]), float(k[0])


def log_distance(pair: tuple[float, float], near: tuple[float, float]) -> float:
    """Distance in (0.1 ln eta, ln k); k below 1e-3 counts as 1e-3.

    The arc fixes eta to within its two ends once k is chosen, so k decides and eta tells the ends
    apart.
    """
    a = np.log([pair[0], max(pair[1], 1e-3)])
    b = np.log([near[0], max(near[1], 1e-3)])
    return float(np.hypot(0.1 * (a[0] - b[0]), a[1] - b[1]))


def fit_metal(metal: Metal, folder: Path, weights: Array) -> dict[str, Any]:
    """Return the JSON entry of one metal."""
    table, citation, comment = read_record(folder / f"{metal.stem}.yml")
    um = WAVELENGTHS_NM * 1e-3
    if table[0, 0] > um[0] + 1e-9 or table[-1, 0] < um[-1] - 1e-9:
        raise SystemExit(f"{metal.stem}: covers {table[0, 0]}..{table[-1, 0]} um only")
    eta_spectrum = np.interp(um, table[:, 0], table[:, 1])
    k_spectrum = np.interp(um, table[:, 0], table[:, 2])
    spectral = np.stack(
        [weights @ conductor_fresnel(c, eta_spectrum, k_spectrum) for c in (1.0, COS_82)]
    )
    target = np.clip(spectral, 0.0, F_MAX)
    pairs = np.zeros((2, 3))
    for channel in range(3):
        mean = np.abs(weights[channel]) / np.abs(weights[channel]).sum()
        near = (float(mean @ eta_spectrum), float(mean @ k_spectrum))
        pairs[:, channel] = fit_channel(target[0, channel], target[1, channel], near)
    pairs = np.array([[rounded(v) for v in row] for row in pairs])
    fitted = np.stack([conductor_fresnel(c, pairs[0], pairs[1]) for c in (1.0, COS_82)])
    return {
        "name": metal.name,
        "eta": pairs[0].tolist(),
        "k": pairs[1].tolist(),
        "f0": [rounded(v) for v in target[0]],
        "f82": [rounded(v) for v in target[1]],
        "clipped": clipped_channels(spectral),
        "missed": missed_channels(fitted - target),
        "source": f"refractiveindex.info database, {metal.stem}.yml",
        "citation": citation,
        "comment": comment,
        "licence": "CC0-1.0",
    }


def clipped_channels(spectral: Array) -> list[dict[str, Any]]:
    """List the reflectances that Rec.709 cannot hold, with the value before the clip."""
    return [
        {"angle_deg": angle, "channel": "RGB"[c], "spectral": rounded(spectral[row, c])}
        for row, angle in enumerate((0, 82))
        for c in range(3)
        if not 0.0 <= spectral[row, c] <= F_MAX
    ]


def missed_channels(error: Array) -> list[dict[str, Any]]:
    """List fits that miss their target by more than rounding: no real (eta, k) reaches it."""
    return [
        {"angle_deg": angle, "channel": "RGB"[c], "error": rounded(error[row, c])}
        for row, angle in enumerate((0, 82))
        for c in range(3)
        if abs(error[row, c]) > 1e-5
    ]


def rounded(value: float) -> float:
    """Round to DIGITS significant digits."""
    return float(f"{value:.{DIGITS}g}")


def build_table(assets: Path) -> dict[str, Any]:
    """Return the whole JSON document."""
    weights = channel_weights()
    folder = assets / "optical" / "refractiveindex"
    return {
        "version": 1,
        "about": "RGB (eta, k) of metals, fitted per channel by examples/metals/fit_metals.py so "
        "that unpolarised F at 0 and 82 degrees equals the spectral reflectance under CIE 1931 "
        "2-degree and D65 in linear Rec.709 (f0, f82 after the clip to [0, 0.9995]).",
        "licence": "Derived numbers: Apache-2.0. Optical constants: CC0-1.0 "
        "(refractiveindex.info database, M. N. Polyanskiy, Sci. Data 11, 94 (2024)).",
        "metals": {metal.key: fit_metal(metal, folder, weights) for metal in METALS},
    }


def to_text(table: dict[str, Any]) -> str:
    """Return the JSON text: indented, short arrays on one line."""
    text = json.dumps(table, indent=1, ensure_ascii=False)
    joined = re.sub(
        r"\[\s+([^\[\]{}]*?)\s+\]", lambda m: "[" + " ".join(m.group(1).split()) + "]", text
    )
    return joined + "\n"


def main() -> int:
    """Write the table, or with --check compare it with the file."""
    parser = argparse.ArgumentParser(description="Fit RGB optical constants of metals.")
    parser.add_argument("--assets", type=Path, default=DEFAULT_ASSETS)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    parser.add_argument("--check", action="store_true", help="compare only, exit 1 if different")
    options = parser.parse_args()
    table = build_table(options.assets)
    text = to_text(table)
    for key, metal in table["metals"].items():
        print(f"{key:16} eta {metal['eta']}  k {metal['k']}  F0 {metal['f0']}")
        for note in [*metal["clipped"], *metal["missed"]]:
            print(f"{'':16} {note}")
    if options.check:
        same = options.output.read_text(encoding="utf-8") == text
        print("identical" if same else f"{options.output} differs from the fit")
        return 0 if same else 1
    options.output.write_text(text, encoding="utf-8")
    print(f"wrote {options.output}: {len(table['metals'])} metals")
    return 0


if __name__ == "__main__":
    sys.exit(main())
