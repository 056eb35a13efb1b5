"""The report of a sweep as one HTML page that opens from the file system, without a server.

Everything it shows lies beside it in the folder. Sorting and filtering are a few lines of script;
without script the page is the same, in the order of the cells.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any
from urllib.parse import quote

from matiere.jobs.job import RENDERED
from matiere.service.budget_status import BudgetStatus
from matiere.service.sweep_table import FIXED, Row
from matiere.target import in_words

MOST_ROWS = 2000  # a page with more opens slowly; table.csv holds all
LARGEST_ERRORS = 1900  # of those, when there are more cells

STYLE = """
:root { color-scheme: light dark; --bg: #fbfbfa; --panel: #ffffff; --text: #1d2023; --soft: #666b70;
  --line: #e3e3df; --accent: #0a5f9e; --warn: #a8410a; --mark: #fdf6e3; }
@media (prefers-color-scheme: dark) { :root { --bg: #16181b; --panel: #1d2024; --text: #e4e4e0;
  --soft: #9a9fa5; --line: #2e3237; --accent: #7ab8e6; --warn: #f0975f; --mark: #2b2718; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1280px; padding: 2rem 1.5rem 4rem; background: var(--bg);
  color: var(--text); font: 15px/1.5 system-ui, "Noto Sans", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.5rem; font-weight: 600; margin: 0 0 .25rem; }
h2 { font-size: 1.05rem; font-weight: 600; margin: 2.2rem 0 .6rem; }
p { margin: .3rem 0; max-width: 75ch; } .soft { color: var(--soft); } a { color: var(--accent); }
dl { display: flex; flex-wrap: wrap; gap: .4rem 2.2rem; margin: 1rem 0 0; }
dt { color: var(--soft); font-size: .85rem; } dd { margin: 0; font-variant-numeric: tabular-nums; }
.pictures { display: flex; flex-wrap: wrap; gap: 1rem; align-items: flex-start; }
.pictures img { border: 1px solid var(--line); border-radius: 4px; max-width: 100%; height: auto;
  max-height: 420px; background: #fff; display: block; }
.wide { overflow-x: auto; background: var(--panel); border: 1px solid var(--line);
  border-radius: 6px; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .7rem; text-align: left; border-bottom: 1px solid var(--line);
  white-space: nowrap; vertical-align: middle; }
thead th { position: sticky; top: 0; background: var(--panel); font-weight: 600; }
tbody tr:last-child td { border-bottom: 0; } td.n, th.n { text-align: right; }
td img { display: block; height: 64px; width: auto; max-width: 128px; object-fit: contain;
  border-radius: 3px; }
tr.baseline td { background: var(--mark); } .bad { color: var(--warn); white-space: normal; }
th button { all: unset; cursor: pointer; }
th button:focus-visible { outline: 2px solid var(--accent); }
th[aria-sort=ascending] button::after { content: " \\2191"; }
th[aria-sort=descending] button::after { content: " \\2193"; }
input { font: inherit; color: inherit; background: var(--panel); border: 1px solid var(--line);
  border-radius: 4px; padding: .3rem .6rem; width: 22rem; max-width: 100%;
  margin: 0 .8rem .6rem 0; }
.script { display: none; }
@media print { .script { display: none !important; } body { max-width: none; } }
"""

SCRIPT = """
(() => {
  const table = document.querySelector("table"), body = table.tBodies[0];
  const rows = [...body.rows], heads = [...table.tHead.rows[0].cells];
  const shown = document.getElementById("shown"), filter = document.getElementById("filter");
  document.querySelectorAll(".script").forEach(e => { e.style.display = "block"; });
  const value = (row, i) => {
    const cell = row.cells[i], text = cell.dataset.v ?? cell.textContent;
    return text === "" || isNaN(text) ? text : Number(text);
  };
  const order = (a, b) => {
    if (a === "" || b === "") return (a === "") - (b === "");
    if (typeof a === "number" && typeof b === "number") return a - b;
    return String(a).localeCompare(String(b));
  };
  heads.forEach((head, i) => {
    if (head.dataset.fixed !== undefined) return;
    const button = document.createElement("button");
    button.textContent = head.textContent;
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      heads.forEach(other => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const known = rows.map(row => [value(row, i), row]);
      known.sort((a, b) => {
        const empty = (a[0] === "") - (b[0] === "");
        return empty || (down ? order(b[0], a[0]) : order(a[0], b[0]));
      });
      body.append(...known.map(pair => pair[1]));
    });
  });
  filter.addEventListener("input", () => {
    const words = filter.value.toLowerCase().split(/\\s+/).filter(Boolean);
    let count = 0;
    rows.forEach(row => {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every(word => text.includes(word));
      count += !row.hidden;
    });
    shown.textContent = count + " of " + rows.length + " shown";
  });
})();
"""


@dataclass(frozen=True)
class Page:
    """What a report shows beside its rows; names are of files in the folder."""

    title: str
    cells: int
    baseline: int | None = None
    sheets: Sequence[str] = ()
    plot: str | None = None
    tables: Sequence[str] = ("table.csv",)
    budget: BudgetStatus | None = None
    files: Mapping[int, Mapping[str, str]] = field(default_factory=dict)  # cell -> ending -> name
    made: float = field(default_factory=time.time)


def html_of(page: Page, rows: Sequence[Row]) -> str:
    """Return the report of a sweep as an HTML document."""
    chosen = choose(rows, page.baseline)
    title = escape(page.title)
    parts = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{title}</title><style>{STYLE}</style></head><body>",
        f"<h1>{title}</h1>",
        _summary(page, rows),
        _pictures(page),
        "<h2>Cells</h2>",
        _how_many(len(chosen), rows, page),
        '<p class="script"><input id="filter" type="search" placeholder="Filter: Au 0.1 ..." '
        'aria-label="Filter the cells"><span id="shown" class="soft"></span></p>',
        _table(page, chosen),
        f"<script>{SCRIPT}</script></body></html>\n",
    ]
    return "\n".join(part for part in parts if part)


def choose(rows: Sequence[Row], baseline: int | None) -> list[Row]:
    """Return the rows to show, in order: all, or those that most want to be seen.

    These are the baseline, cells that did not succeed, cells with an image in the folder, and the
    largest errors.
    """
    if len(rows) <= MOST_ROWS:
        return list(rows)
    first = [r for r in rows if r["cell"] == baseline or r["state"] != "succeeded" or r["image"]]
    known = sorted(rows, key=lambda r: -(r["relmse"] or 0.0))[:LARGEST_ERRORS]
    picked = {r["cell"]: r for r in [*first, *known][:MOST_ROWS]}
    return [r for r in rows if r["cell"] in picked]


def _summary(page: Page, rows: Sequence[Row]) -> str:
    done = [r for r in rows if r["state"] in RENDERED]
    unfinished = sum(r["state"] == "unfinished" for r in rows)
    errors = sorted(r["relmse"] for r in done if r["relmse"] is not None)
    seconds = sum(r["seconds"] for r in rows)
    good = sum(r["state"] == "succeeded" for r in rows)
    facts = [("cells", f"{page.cells:,}"), ("succeeded", f"{good:,}")]
    if unfinished:
        facts.append(("unfinished", f"{unfinished:,}"))
    if good + unfinished < len(rows):
        facts.append(("not succeeded", f"{len(rows) - good - unfinished:,}"))
    if page.budget is not None:
        facts.append(("target", in_words(page.budget.target_error)))
        facts.append(("budget", f"{page.budget.spent_s:,.1f} of {page.budget.seconds:,g} s"))
    if page.baseline is not None:
        facts.append(("baseline", f"cell {page.baseline}"))
    facts.append(("render time", f"{seconds:,.1f} s"))
    if errors:
        facts += [("median relMSE", number(errors[len(errors) // 2])),
                  ("largest relMSE", number(errors[-1]))]  # fmt: skip
    facts.append(("written", time.strftime("%Y-%m-%d %H:%M", time.localtime(page.made))))
    items = "".join(f"<div><dt>{k}</dt><dd>{escape(v)}</dd></div>" for k, v in facts)
    links = ", ".join(f'<a href="{quote(name)}">{escape(name)}</a>' for name in page.tables)
    return f'<dl>{items}</dl><p class="soft">All figures: {links}</p>'


def _pictures(page: Page) -> str:
    shown = []
    if page.plot:
        shown.append((page.plot, "Error against render time"))
    shown += [(name, "Contact sheet") for name in page.sheets[:1]]
    if not shown:
        return ""
    images = "".join(
        f'<a href="{quote(name)}"><img src="{quote(name)}" alt="{alt}"></a>' for name, alt in shown
    )
    more = ""
    if len(page.sheets) > 1:
        links = " ".join(
            f'<a href="{quote(name)}">{n}</a>' for n, name in enumerate(page.sheets, 1)
        )
        more = f"<p>Contact sheet, pages {links}</p>"
    heads = ["Error against time" if page.plot else "", "contact sheet" if page.sheets else ""]
    head = " and ".join(filter(None, heads)).capitalize()
    return f'<h2>{head}</h2><div class="pictures">{images}</div>{more}'


def _how_many(shown: int, rows: Sequence[Row], page: Page) -> str:
    words = ""
    if shown < len(rows):
        words = (
            f"{shown:,} of {len(rows):,} cells: baseline, those that did not succeed, those with "
            "an image in this folder and the largest errors. All are in the table. "
        )
    words += "relMSE: estimated relative mean squared error with its 95 % interval."
    if any(row["state"] == "unfinished" for row in rows):
        words += " unfinished: the budget ended before this cell reached the target."
    if any(row["versus_baseline"] is not None for row in rows):
        words += (
            " vs baseline: change of the mean luminance with its 95 % interval, bold where that"
            " leaves out no change; one cell in twenty is bold by chance."
        )
    return f'<p class="soft">{words}</p>'


def _table(page: Page, rows: Sequence[Row]) -> str:
    axes = [key for key in (rows[0] if rows else {}) if key not in FIXED]
    stable = any(row["stability"] for row in rows)
    compared = any(row["versus_baseline"] is not None for row in rows)
    compared |= any(".difference.png" in mine for mine in page.files.values())
    heads = ["<th data-fixed>image</th>" if page.files else "", '<th class="n">cell</th>']
    numeric = {axis: all(_is_number(row[axis]) for row in rows) for axis in axes}
    heads += [f"<th{_n(numeric[axis])}>{escape(axis)}</th>" for axis in axes]
    heads.append('<th>state</th><th class="n">relMSE</th><th data-fixed>95 % interval</th>'
                 '<th class="n">seconds</th><th class="n">spp</th>')  # fmt: skip
    heads.append('<th class="n">vs baseline</th>' if compared else "")
    heads.append("<th>stability</th>" if stable else "")
    heads.append("<th data-fixed>files</th>" if page.files else "")
    body = "\n".join(_row(page, row, axes, numeric, (compared, stable)) for row in rows)
    return (
        f'<div class="wide"><table><thead><tr>{"".join(heads)}</tr></thead>\n'
        f"<tbody>{body}</tbody></table></div>"
    )


def _row(
    page: Page,
    row: Row,
    axes: Sequence[str],
    numeric: Mapping[str, bool],
    more: tuple[bool, bool],
) -> str:
    files = page.files.get(row["cell"], {})
    image = files.get(".png")
    picture = ""
    if image:
        name = quote(image)
        alt = escape(str(row["label"] or row["cell"]), quote=True)
        picture = f'<a href="{name}"><img src="{name}" alt="{alt}" loading="lazy"></a>'
    mine = row["cell"] == page.baseline
    about = "<br><small>baseline</small>" if mine else ""
    number_of = f'<td class="n" data-v="{row["cell"]}">{row["cell"]}{about}</td>'
    cells = [f"<td>{picture}</td>" if page.files else "", number_of]
    cells += [_cell(row[axis], numeric[axis]) for axis in axes]
    state = escape(str(row["state"]))
    if row["state"] == "unfinished":
        state = f'<span class="bad">{state}</span>'
    if row["error"]:
        state = f'<span class="bad">{state}: {escape(str(row["error"]))}</span>'
    span = ""
    if row["relmse_low"] is not None:
        span = f"{number(row['relmse_low'])} to {number(row['relmse_high'])}"
    cells += [f"<td>{state}</td>", _cell(row["relmse"]), f"<td>{span}</td>",
              _cell(row["seconds"]), _cell(row["spp"])]  # fmt: skip
    compared, stable = more
    if compared:
        cells.append(_versus(row, files.get(".difference.png")))
    if stable:
        cells.append(f"<td>{escape(row['stability'] or '')}</td>")
    links = " ".join(f'<a href="{quote(name)}">{ending[1:]}</a>' for ending, name in files.items())
    cells.append(f"<td>{links}</td>" if page.files else "")
    mark = ' class="baseline"' if mine else ""
    return f"<tr{mark}>{''.join(cells)}</tr>"


def _versus(row: Row, picture: str | None) -> str:
    """Return the change against the baseline, bold if its interval leaves out no change."""
    shown = ""
    if picture:
        name = quote(picture)
        alt = "difference from the baseline"
        shown = f'<a href="{name}"><img src="{name}" alt="{alt}" loading="lazy"></a>'
    change, low, high = (row[f"versus_baseline{end}"] for end in ("", "_low", "_high"))
    if change is None:
        return f"<td>{shown}</td>"
    text = f"{change:+.3g} % &plusmn; {(high - low) / 2:.2g}"
    text = f"<b>{text}</b>" if low > 0 or high < 0 else text
    return f'<td class="n" data-v="{change!r}">{shown}{text}</td>'


def _cell(value: Any, numeric: bool = True) -> str:
    if _is_number(value):
        return f'<td{_n(numeric)} data-v="{value!r}">{number(value)}</td>'
    return f"<td>{escape('' if value is None else str(value))}</td>"


def _n(numeric: bool) -> str:
    return ' class="n"' if numeric else ""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def number(value: float) -> str:
    """Return a number as a table shows it: whole, or four digits."""
    return str(value) if isinstance(value, int) else f"{value:.4g}"
