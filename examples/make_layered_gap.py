"""Compare the methods of `layered` and write docs/layered-gap.md with its map.

    python examples/make_layered_gap.py                 # docs/layered-gap.md and its picture
    python examples/make_layered_gap.py material.json   # one layered material: a table on stdout

The gap is that of the directional albedo: one corrected pass (`weidlich_wilkie`) against the random
walk (`walk`), which counts every bounce. Each figure is the largest over the viewing angles.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import matiere as mt

ROOT = Path(__file__).resolve().parents[1]
GOAL = 0.01  # relative standard error of an albedo, where MOST_MORE times the samples reach it
MOST_MORE = 40
DEGREES = (0.0, 30.0, 60.0, 75.0)
ETAS = (1.1, 1.3, 1.5, 2.0)
ALPHAS = (0.0, 0.1, 0.3, 0.6, 1.0)
TAUS = (0.0, 0.1, 0.5, 1.0, 3.0)
BASES: dict[str, dict[str, Any]] = {
    "white Lambert": {"type": "lambert", "albedo": 1.0},
    "grey Lambert, albedo 0.2": {"type": "lambert", "albedo": 0.2},
    "metal, F0 0.9, alpha 0.2": {"type": "cook_torrance", "F0": 0.9, "alpha": 0.2},
}
# Upper bound of the gap, colour and words of each class.
CLASSES = (
    (0.01, "#1a7f4b", "within 1 %"), (0.05, "#8cc665", "within 5 %"),
    (0.20, "#f4c95d", "within 20 %"), (np.inf, "#c8553d", "beyond 20 %"),
)  # fmt: skip


@dataclass(frozen=True)
class View:
    """The albedo at one angle by both methods (first channel), and the walk's standard error."""

    degrees: float
    walk: float
    error: float
    one_pass: float

    @property
    def gap(self) -> float:
        """Relative difference of the cheap method."""
        return self.one_pass / self.walk - 1 if self.walk > 0 else 0.0


def compare(material: Mapping[str, Any], n: int = 40_000, seed: int = 1) -> list[View]:
    """Return both albedos of a layered material at every angle, from n samples each."""
    walk = mt.bsdf({**material, "method": "walk"})
    one_pass = mt.bsdf({**material, "method": "weidlich_wilkie"})
    views = []
    for degrees in DEGREES:
        t = np.radians(degrees)
        wo = (np.sin(t), 0.0, np.cos(t))
        view = _view(walk, one_pass, degrees, wo, np.random.default_rng(seed).random((n, 3)))
        if view.error > GOAL * view.walk > 0:  # dark: few samples come back
            more = min(MOST_MORE, (view.error / (GOAL * view.walk)) ** 2)
            u = np.random.default_rng(seed + 1).random((int(n * more), 3))
            view = _view(walk, one_pass, degrees, wo, u)
        views.append(view)
    return views


def _view(walk: mt.Bsdf, one_pass: mt.Bsdf, degrees: float, wo: Any, u: Any) -> View:
    weight = walk.sample(wo, u).weight[:, 0].astype(float)
    cheap = one_pass.sample(wo, u).weight[:, 0].astype(float).mean()
    error = weight.std(ddof=1) / np.sqrt(len(u))
    return View(degrees, float(weight.mean()), float(error), float(cheap))


def coat(base: Mapping[str, Any], eta: float, alpha: float, tau: float) -> dict[str, Any]:
    """Return a layered material whose coat has the optical depth tau."""
    return {
        "type": "layered", "base": dict(base), "eta": eta, "alpha": alpha, "sigma_a": tau * 1000,
        "thickness": 1e-3,
    }  # fmt: skip


def worst(views: list[View]) -> View:
    """Return the view with the largest gap."""
    return max(views, key=lambda view: abs(view.gap))


Map = dict[tuple[str, float, float, float], View]


def measure(n: int) -> Map:
    """Return the worst view of every cell of the map."""
    found: Map = {}
    for name, base in BASES.items():
        for eta in ETAS:
            for tau in TAUS:
                for alpha in ALPHAS:
                    views = compare(coat(base, eta, alpha, tau), n)
                    found[name, eta, alpha, tau] = worst(views)
            print(f"{name}, eta {eta}", file=sys.stderr, flush=True)
    return found


def class_of(gap: float) -> tuple[float, str, str]:
    """Return the first class that holds the gap."""
    return next(c for c in CLASSES if abs(gap) <= c[0])


def svg(found: Map) -> str:
    """Draw one panel per base and index: alpha to the right, optical depth upwards."""
    cell, gap, left, top = 34, 30, 70, 52
    panel = cell * len(ALPHAS)
    width = left + len(ETAS) * (panel + gap)
    height = top + len(BASES) * (panel + gap + 34) + 30
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" font-family="sans-serif" font-size="11">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<text x="{left}" y="18" font-size="14">Albedo of weidlich_wilkie against walk, in '
        "percent (worst of 0, 30, 60, 75 degrees)</text>",
    ]
    for k, (_, color, words) in enumerate(CLASSES):
        x = left + 130 * k
        out.append(f'<rect x="{x}" y="26" width="12" height="12" fill="{color}"/>')
        out.append(f'<text x="{x + 17}" y="36">{words}</text>')
    for row, name in enumerate(BASES):
        y0 = top + row * (panel + gap + 34) + 22
        out.append(f'<text x="{left}" y="{y0 - 6}" font-weight="bold">{name}</text>')
        for column, eta in enumerate(ETAS):
            x0 = left + column * (panel + gap)
            out += _panel(found, name, eta, (x0, y0, cell))
            if column == 0:
                middle = y0 + panel / 2
                out.append(
                    f'<text x="18" y="{middle}" transform="rotate(-90 18 {middle})" '
                    'text-anchor="middle">optical depth sigma_a x thickness</text>'
                )
    return "\n".join([*out, "</svg>"]) + "\n"


def _panel(found: Map, name: str, eta: float, place: tuple[int, int, int]) -> list[str]:
    x0, y0, cell = place
    size = cell * len(ALPHAS)
    out = []
    for j, tau in enumerate(reversed(TAUS)):
        y = y0 + j * cell
        out.append(f'<text x="{x0 - 4}" y="{y + cell / 2 + 4}" text-anchor="end">{tau:g}</text>')
        for i, alpha in enumerate(ALPHAS):
            gap = found[name, eta, alpha, tau].gap
            x = x0 + i * cell
            color = class_of(gap)[1]
            out.append(
                f'<rect x="{x}" y="{y}" width="{cell - 1}" height="{cell - 1}" fill="{color}"/>'
                f'<text x="{x + cell / 2 - 0.5}" y="{y + cell / 2 + 4}" text-anchor="middle" '
                f'font-size="10">{100 * gap:+.0f}</text>'
            )
    for i, alpha in enumerate(ALPHAS):
        x = x0 + (i + 0.5) * cell
        out.append(f'<text x="{x}" y="{y0 + size + 12}" text-anchor="middle">{alpha:g}</text>')
    out.append(
        f'<text x="{x0 + size / 2}" y="{y0 + size + 26}" text-anchor="middle">alpha of the coat, '
        f"eta {eta:g}</text>"
    )
    return out


def page(found: Map, n: int) -> str:
    """Return the page: what was compared, the map, what it says, and the figures."""
    lines = [
        "# How far the cheap coat is from the exact one", "",
        "![map of the gap](images/layered-gap.svg)", "",
        "```sh", "python examples/make_layered_gap.py material.json   # the same for your coat",
        "```", "",
        "`layered` with `method: weidlich_wilkie` follows light once down to the base and once up",
        "again; `method: walk` follows it until it leaves. The map shows by how much the",
        "directional albedo of the first differs from that of the second, at the worst of 0, 30,",
        f"60 and 75 degrees, from {n:,} samples a view, up to {MOST_MORE} times as many where it",
        "is dark (standard error of a figure: mostly 1 %, more for albedos below 0.01).",
        "Negative: the one pass is too dark. Where its colour says 1 or 5 %, use it; elsewhere use",
        "`walk`, or `exact` for a smooth coat over Lambert, which equals the walk.", "",
        "The one pass counts no light that is reflected down again from below the surface, which",
        "makes it too dark over bright bases; it refracts at the mean surface, and its rough",
        "surface scatters once per facet. At great depth only the surface is seen: what is left",
        "there is the light that meets several facets, which the walk counts.",
        "",
        "| base | coats compared | within 1 % | within 5 % | within 20 % | worst |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for name in BASES:
        gaps = [v.gap for key, v in found.items() if key[0] == name]
        shares = [f"{sum(abs(g) <= c for g in gaps)}" for c, *_ in CLASSES[:3]]
        most = max(gaps, key=abs)
        lines.append(f"| {name} | {len(gaps)} | {' | '.join(shares)} | {100 * most:+.0f} % |")
    lines += ["", *said(found), "", "## Figures", ""]
    for name in BASES:
        lines += [f"### {name}", "", "Gap in percent, with the walk's albedo at that angle.", ""]
        head = " | ".join(f"alpha {a:g}" for a in ALPHAS)
        lines += [f"| eta | depth | {head} |", "|---|---|" + "---|" * len(ALPHAS)]
        for eta in ETAS:
            for tau in TAUS:
                cells = []
                for alpha in ALPHAS:
                    v = found[name, eta, alpha, tau]
                    cells.append(f"{100 * v.gap:+.1f} ({v.walk:.3f})")
                lines.append(f"| {eta:g} | {tau:g} | {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def said(found: Map) -> list[str]:
    """Return where the cheap method is good, as sentences made from the figures."""
    out = ["Where it holds:", ""]
    for name in BASES:
        for bound, _, words in CLASSES[:3]:
            for most in (0.1, 1.0):
                where = _coats(found, name, bound, most)
                if where:
                    out.append(f"- {name}, {words} at alpha up to {most:g}: {'; '.join(where)}.")
    return out


def _coats(found: Map, name: str, bound: float, most: float) -> list[str]:
    """Return the indices and depths at which no coat up to an alpha goes beyond the bound."""
    where = []
    for eta in ETAS:
        depths = [
            f"{tau:g}"
            for tau in TAUS
            if all(abs(found[name, eta, a, tau].gap) <= bound for a in ALPHAS if a <= most)
        ]
        if depths:
            where.append(f"eta {eta:g} at depth {', '.join(depths)}")
    return where


def table(views: list[View]) -> str:
    """Return the comparison of one material as text."""
    lines = ["degrees    walk      +-   one pass     gap"]
    lines += [
        f"{v.degrees:7g} {v.walk:7.4f} {v.error:7.4f} {v.one_pass:10.4f} {100 * v.gap:+6.1f} %"
        for v in views
    ]
    return "\n".join([*lines, class_of(worst(views).gap)[2]])


def main() -> None:
    """Write the page, or print the table of one material."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("material", nargs="?", type=Path, help="JSON of one layered material")
    parser.add_argument("-n", type=int, default=40_000, help="samples a view")
    arguments = parser.parse_args()
    if arguments.material:
        material = json.loads(arguments.material.read_text(encoding="utf-8"))
        print(table(compare(material, arguments.n)))
        return
    found = measure(arguments.n)
    (ROOT / "docs" / "images" / "layered-gap.svg").write_text(svg(found), encoding="utf-8")
    (ROOT / "docs" / "layered-gap.md").write_text(page(found, arguments.n), encoding="utf-8")


if __name__ == "__main__":
    main()
