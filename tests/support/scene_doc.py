"""The material tables of docs/scene.md, made from the core's own. Run this file to rewrite them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scene.md"
BEGIN = "<!-- materials: made by tests/support/scene_doc.py, do not edit -->"
END = "<!-- /materials -->"


def number(value: float) -> str:
    """Return a number without a needless fraction."""
    return f"{value:g}"


def allowed(row: dict[str, Any]) -> str:
    """Return in words what a parameter takes."""
    if row["choices"]:
        return ", ".join(f"`{choice}`" for choice in row["choices"])
    if row["kind"] == "material":
        return "material"
    if row["kind"] == "file":
        return "name of a file"
    if row["kind"] == "list":
        return f"list of {number(row['min'])} to {number(row['max'])} objects"
    if row["kind"] == "metal":
        return "name of a metal"
    if row["kind"] == "bool":
        return "true or false"
    words = {"scalar": "number", "color": "colour", "int": "whole number"}[row["kind"]]
    if row["min"] is not None:
        words += f" {'>' if row['min_exclusive'] else '>='} {number(row['min'])}"
    if row["max"] is not None:
        words += f", <= {number(row['max'])}"
    if row["unit"]:
        words += f", {row['unit']}"
    return words + (", texture" if row["texture"] else "")


def default(row: dict[str, Any]) -> str:
    """Return the default of a parameter as it is written in JSON."""
    if row["required"]:
        return "required"
    value = row["implied"]
    if value is None:
        return ""
    if row["kind"] == "list":
        return "one"
    return f"`{value}`" if isinstance(value, str) else number(value)


def rules(model: dict[str, Any]) -> str:
    """Return in one sentence which parameters go together and which do not."""
    found = [" or ".join(f"`{n}`" for n in names) for names in model["exclusive"]]
    said = [f"only one of {words}" for words in found]
    said += [" or ".join(f"`{n}`" for n in names) + " is needed" for names in model["one_of"]]
    said += [" and ".join(f"`{n}`" for n in names) + " go together" for names in model["together"]]
    said += [f"`{a}` needs `{b}`" for a, b in model["requires"]]
    return "; ".join(said)


def every_row(model: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a model, those of a list's objects after it."""
    for row in model["params"]:
        yield row
        for item in row.get("items", ()):
            yield {**item, "name": f"{row['name']}[].{item['name']}"}


def tables() -> str:
    """Return the Markdown of all materials."""
    import matiere as mt

    blocks = []
    for model in mt.materials():
        lines = [f"### `{model['type']}`", "", f"{model['doc']} ({model['source']})", ""]
        lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
        for row in every_row(model):
            cells = (f"`{row['name']}`", allowed(row), default(row), row["doc"])
            lines.append("| " + " | ".join(cells) + " |")
        if text := rules(model):
            lines += ["", text[0].upper() + text[1:] + "."]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks)


def page(text: str) -> str:
    """Return the page with its tables made anew."""
    pattern = re.escape(BEGIN) + ".*?" + re.escape(END)
    return re.sub(pattern, lambda _: f"{BEGIN}\n\n{tables()}\n\n{END}", text, flags=re.DOTALL)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
