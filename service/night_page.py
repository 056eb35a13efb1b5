"""A comparison of nights as one HTML page that needs no server, script or network."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any

from matiere.service import night_text
from matiere.service.night_text import name_of

Report = Mapping[str, Any]
# Blue, white, red, as in the pictures of `mt.compare`: told apart by colour-blind readers too.
STOPS = ((5, 48, 97), (66, 148, 194), (247, 247, 247), (214, 97, 77), (102, 0, 31))
MAX_ROWS = 2000
TILE = 34  # pixels of a tile in its map
STYLE = """
body{font:15px/1.45 system-ui,sans-serif;color:#1b1f24;max-width:1080px;margin:28px auto;
padding:0 18px}
h1{font-size:24px;margin:0 0 4px}h2{font-size:18px;margin:30px 0 8px}
.verdict{font-size:17px;padding:10px 14px;border-left:6px solid;background:#f4f6f8;margin:14px 0}
.ok{border-color:#2b7a4b}.bad{border-color:#b3261e}.gap{border-color:#b7791f}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:3px 14px 3px 0;border-bottom:1px solid #e3e7eb;vertical-align:top}
td.n,th.n{text-align:right}small,.dim{color:#5b6570}
.change{display:flex;gap:24px;flex-wrap:wrap;border-top:1px solid #d5dbe1;padding:14px 0;
align-items:flex-start}
.change h3{font-size:16px;margin:0 0 4px}.change div.words{flex:1 1 400px}
.change img{width:470px;max-width:100%;border:1px solid #d5dbe1}
.dot{display:inline-block;border-width:5px;border-style:solid;border-radius:5px}
details{margin:10px 0}summary{cursor:pointer}
"""


def page(report: Report, pictures: Mapping[int, Path] | None = None) -> str:
    """Return the page; `pictures` are difference images (PNG) by number of the cell."""
    a, b = report["a"], report["b"]
    title = f"{b['name'] or 'night b'} against {a['name'] or 'night a'}"
    parts = [
        "<!doctype html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<style>{STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
        *body(report, pictures),
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


def body(report: Report, pictures: Mapping[int, Path] | None = None) -> Iterator[str]:
    """Yield what stands below the title: verdict, figures, changes, tables."""
    yield f'<p class="verdict {_mood(report)}">{escape(report["statement"])}</p>'
    yield from _facts(report)
    yield from _changes(report, pictures or {})
    yield from _others(report)
    yield from _drift(report)
    yield from _table(report)


def index(nights: Mapping[str, Sequence[Report]]) -> str:
    """Return the page of all nights: the verdicts of every sweep, the newest first."""
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Nights</title>',
        f"<style>{STYLE}</style></head><body><h1>Nights</h1>",
    ]
    for sweep, verdicts in nights.items():
        parts.append(f"<h2>{escape(sweep)}</h2><table>")
        parts.append("<tr><th>night</th><th>compared with</th><th>result</th></tr>")
        for verdict in reversed(verdicts):
            name = escape(verdict["night"])
            link = f'<a href="{escape(sweep)}/{name}/report.html">{name}</a>'
            words = escape(verdict["statement"]) + (" (accepted)" if verdict["accepted"] else "")
            mood = {0: "ok", 1: "bad"}.get(verdict["exit_code"], "gap")
            parts.append(
                f"<tr><td>{link if verdict['against'] else name}</td>"
                f"<td>{escape(verdict['against'] or '')}</td>"
                f'<td><span class="dot {mood}"></span> {words}</td></tr>'
            )
        parts.append("</table>")
    return "\n".join([*parts, "</body></html>"]) + "\n"


def _mood(report: Report) -> str:
    return {0: "ok", 1: "bad"}.get(report["exit_code"], "gap")


def _facts(report: Report) -> Iterator[str]:
    yield "<table><tr><th></th><th>earlier (a)</th><th>later (b)</th></tr>"
    heads = ("night", "begun", "cells", "samples per pixel")
    for words, *values in zip(heads, _about(report["a"]), _about(report["b"]), strict=True):
        cells = "".join(f"<td>{escape(value)}</td>" for value in values)
        yield f"<tr><th>{words}</th>{cells}</tr>"
    yield "</table>"
    for line in night_text.detectable_lines(report):
        yield f"<p>{escape(line)}</p>"
    for note in report["notes"]:
        yield f'<p class="dim">Note: {escape(note)}.</p>'


def _about(night: Report) -> tuple[str, str, str, str]:
    cells = f"{night['cells']:,} ({night['succeeded']:,} succeeded)"
    return str(night["name"]), _time(night["created"]), cells, _range(night["spp"])


def _changes(report: Report, pictures: Mapping[int, Path]) -> Iterator[str]:
    if not report["changes"]:
        return
    yield f"<h2>Changed cells ({report['cells']['changed']:,})</h2>"
    yield (
        "<p><small>Percent of the earlier night's mean. Intervals are widened for having been "
        "selected: on average at most "
        f"{100 * report['significance']:g} % of those on this page miss. Tiles: difference of "
        "luminance, blue darker, red brighter; framed tiles changed by more than noise."
        "</small></p>"
    )
    for change in report["changes"]:
        yield '<section class="change"><div class="words">'
        yield f"<h3>{escape(name_of(change))}</h3>"
        yield f'<p class="dim">{escape(_parameters(change["parameters"]))}</p>'
        yield "<table><tr><th>image</th><th class=n>change</th><th class=n>interval</th>"
        yield "<th class=n>corrected p</th></tr>"
        for effect in change["image"]:
            yield _effect_row(effect["channel"], effect)
        if change["surest"]["region"] is not None:
            box = "tile {x0}-{x1}, {y0}-{y1}".format(**change["surest"]["region"])
            yield _effect_row(f"{box}, {change['surest']['channel']}", change["surest"])
        yield "</table>"
        yield f"<p>{_tile_map(change)}</p></div>"
        if picture := pictures.get(change["cell"]):
            data = base64.b64encode(picture.read_bytes()).decode()
            alt = escape(f"difference image of {name_of(change)}", quote=True)
            yield f'<img alt="{alt}" src="data:image/png;base64,{data}">'
        yield "</section>"
    if (left := report["cells"]["changed"] - len(report["changes"])) > 0:
        yield f"<p>and {left:,} more; cells.csv has them all.</p>"


def _effect_row(name: str, effect: Report) -> str:
    if effect["percent"] is None:
        shown = f"{effect['difference']:+.3g} W/m²/sr"
        between = f"{effect['lower']:+.3g} to {effect['upper']:+.3g}"
    else:
        shown = f"{effect['percent']:+.3g} %"
        between = f"{effect['lower_percent']:+.3g} to {effect['upper_percent']:+.3g} %"
    p = effect["p_corrected"]
    chance = "unknown" if p is None else night_text.chance(p).removeprefix("p ")
    strong = ("<b>", "</b>") if effect["significant"] else ("", "")
    return (
        f"<tr><td>{escape(name)}</td><td class=n>{strong[0]}{shown}{strong[1]}</td>"
        f"<td class=n>{between}</td><td class=n>{chance}</td></tr>"
    )


def _tile_map(change: Report) -> str:
    """Draw the tiles as an SVG: colour by percent of luminance, framed where significant.

    An image that was black has no percent: its tiles show the difference itself.
    """
    tiles = change["tiles"]
    black = change["percent"] is None
    shown, unit = (tiles["difference"], "W/m²/sr") if black else (tiles["percent"], "%")
    values = [x for x in shown if x is not None]
    limit = max((abs(x) for x in values), default=0.0) or 1.0
    width, height = tiles["columns"] * TILE, tiles["rows"] * TILE
    parts = [
        f'<svg width="{width + 136}" height="{height + 26}" font-size="11" '
        f'font-family="system-ui,sans-serif" role="img" aria-label="change of every tile">'
    ]
    framed = []
    for number, (value, hit) in enumerate(zip(shown, tiles["significant"], strict=True)):
        y, x = (TILE * k for k in divmod(number, tiles["columns"]))
        fill = "#ddd" if value is None else _colour(value / limit)
        title = "no light before" if value is None else f"{value:+.3g} {unit}"
        parts.append(
            f'<rect x="{x}" y="{y}" width="{TILE}" height="{TILE}" fill="{fill}">'
            f"<title>{title}</title></rect>"
        )
        if hit:
            framed.append(
                f'<rect x="{x + 1}" y="{y + 1}" width="{TILE - 2}" height="{TILE - 2}" '
                'fill="none" stroke="#000" stroke-width="2"/>'
            )
    parts += framed
    for share in range(0, height, 2):
        colour = _colour(1.0 - 2.0 * share / max(height - 2, 1))
        parts.append(f'<rect x="{width + 10}" y="{share}" width="12" height="2" fill="{colour}"/>')
    for end, place in ((1.0, 10.0), (0.0, height / 2 + 4), (-1.0, height - 1.0)):
        text = f"{end * limit:+.3g} {unit}" if end else "0"
        parts.append(f'<text x="{width + 27}" y="{place:g}">{text}</text>')
    parts.append(
        f'<text x="0" y="{height + 18}" fill="#5b6570">{change["width"]} x {change["height"]} '
        "pixels</text></svg>"
    )
    return "".join(parts)


def _colour(value: float) -> str:
    at = (min(max(value, -1.0), 1.0) + 1.0) / 2.0 * (len(STOPS) - 1)
    low = min(int(at), len(STOPS) - 2)
    mixed = (
        round(a + (b - a) * (at - low)) for a, b in zip(STOPS[low], STOPS[low + 1], strict=True)
    )
    return "#{:02x}{:02x}{:02x}".format(*mixed)


def _others(report: Report) -> Iterator[str]:
    for kind, words in (
        ("failed", "Failed cells"),
        ("missing", "Missing cells: only in the earlier night"),
        ("not_comparable", "Cells that cannot be compared"),
        ("new", "New cells: only in the later night"),
    ):
        if not (count := report["cells"][kind]):
            continue
        yield f"<h2>{words} ({count:,})</h2><table>"
        for cell in report[kind]:
            why = cell.get("why") or cell.get("state") or ""
            if error := cell.get("error"):
                why = f"{error['code']}: {error['message']}"
            yield f"<tr><td>{escape(name_of(cell))}</td><td>{escape(why)}</td></tr>"
        yield "</table>"
        if count > len(report[kind]):
            yield f"<p>and {count - len(report[kind]):,} more</p>"


def _drift(report: Report) -> Iterator[str]:
    rows = [
        (words, report[key])
        for key, words in (
            ("speed", "render seconds"), ("error", "relMSE at equal samples"),
            ("efficiency", "efficiency, 1 / (relMSE x seconds)"),
        )
        if report[key]["median_ratio"] is not None
    ]  # fmt: skip
    if not rows:
        return
    yield "<h2>Speed and error</h2><table><tr><th>later / earlier</th><th class=n>median</th>"
    yield "<th class=n>95 % interval of the median</th><th class=n>cells</th></tr>"
    for words, found in rows:
        between = "" if found["lower"] is None else f"{found['lower']:.3g} to {found['upper']:.3g}"
        yield (
            f"<tr><td>{words}</td><td class=n>x {found['median_ratio']:.3g}</td>"
            f"<td class=n>{between}</td><td class=n>{found['cells']:,}</td></tr>"
        )
    yield "</table>"


def _table(report: Report) -> Iterator[str]:
    rows = report["table"]
    if not rows:
        return
    yield f"<details><summary>All {len(rows):,} compared cells</summary><table>"
    yield "<tr><th>cell</th><th class=n>change of luminance</th><th class=n>corrected p</th>"
    yield "<th class=n>smallest detectable</th><th class=n>spp</th><th class=n>seconds</th></tr>"
    for row in rows[:MAX_ROWS]:
        change = "equal bits" if row["identical"] else _percent(row["percent"], "+")
        p = "unknown" if row["p_corrected"] is None else f"{row['p_corrected']:.2g}"
        yield (
            f"<tr><td>{escape(name_of(row))}</td><td class=n>{change}</td><td class=n>{p}</td>"
            f"<td class=n>{_percent(row['detectable_percent'])}</td><td class=n>{row['spp']}</td>"
            f"<td class=n>{row['seconds']:.3g}</td></tr>"
        )
    yield "</table>"
    if len(rows) > MAX_ROWS:
        yield f"<p>and {len(rows) - MAX_ROWS:,} more in cells.csv</p>"
    yield "</details>"


def _percent(value: float | None, sign: str = "") -> str:
    return "" if value is None else f"{value:{sign}.3g} %"


def _parameters(parameters: Mapping[str, Any]) -> str:
    texts = (f"{key} {json.dumps(value)}" for key, value in parameters.items())
    return ", ".join(texts)[:400]


def _time(seconds: float | None) -> str:
    if seconds is None:
        return ""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _range(spp: list[int] | None) -> str:
    if spp is None:
        return ""
    return str(spp[0]) if spp[0] == spp[1] else f"{spp[0]} to {spp[1]}"
