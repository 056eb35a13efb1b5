"""Render every sweep of examples/materials and make docs/gallery.md of the contact sheets.

    python examples/gallery.py                    all that changed, into ./gallery-out
    python examples/gallery.py plastic ward       these sheets only; the page shows all there are

Sweeps are rendered by `matiere sweep`: run it again and finished cells are not rendered again. The
sheets go to docs/images/gallery as JPEG of at most 60 kB, the page to docs/gallery.md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import make_material_stage
import make_measured
import numpy as np

import matiere as mt
from matiere import imageio

ROOT = Path(__file__).resolve().parent.parent
SWEEPS = ROOT / "examples" / "materials"
DOCS = ROOT / "docs"
MAX_BYTES = 60_000
QUALITIES = range(92, 40, -6)
INTRO = """# Gallery: every material

![{alt}](images/gallery/{first}.jpg)

```sh
python examples/make_material_stage.py
matiere sweep examples/materials/{first}.json -o out
```

One sweep per model on the same ball under the same light: the file of each is in
`examples/materials`, and `python examples/gallery.py` renders them all and writes this page. Below
each picture stand the error estimate, the samples per pixel and the render time of its cell. What
the parameters mean is in [scene.md](scene.md#materials); whether a material is safe at its exact
parameters tells [`matiere check`](check.md).
"""


def sweeps(names: Sequence[str] = ()) -> list[Path]:
    """Return the sweep files, in the order of the list of models, then by name."""
    order = [row["type"] for row in mt.materials()]
    found = sorted(SWEEPS.glob("*.json"), key=lambda p: (_place(p.stem, order), p.stem))
    unknown = set(names) - {path.stem for path in found}
    if unknown:
        raise SystemExit(f"no sweep {', '.join(sorted(unknown))} in {SWEEPS}")
    return [path for path in found if not names or path.stem in names]


def _place(stem: str, order: list[str]) -> int:
    """A sheet `plastic_white` stands after the model `plastic`."""
    return next((k for k, kind in enumerate(order) if stem.startswith(kind)), len(order))


def render(sweep: Path, out: Path) -> Path:
    """Render one sweep with the command line; return its contact sheet."""
    folder = out / sweep.stem
    command = [sys.executable, "-m", "matiere.service", "sweep", str(sweep), "-o", str(folder)]
    subprocess.run([*command, "--data", str(out / "data")], check=True, env=os.environ)
    return folder / "contact-sheet.png"


def shrink(sheet: Path, target: Path) -> int:
    """Write a sheet as JPEG, at the best quality that fits; return its size in bytes."""
    pixels = imageio.quantise(np.clip(imageio.read_image(sheet).pixels[:, :, :3], 0, 1), 8)
    data = b""
    for quality in QUALITIES:
        stored = imageio.Stored(pixels, ("R", "G", "B"), {}, quality=quality)
        data = imageio.encode(stored, ".jpg", "uint8")
        if len(data) <= MAX_BYTES:
            break
    target.parent.mkdir(parents=True, exist_ok=True)
    with imageio.atomic_file(target) as temporary:
        temporary.write_bytes(data)
    return len(data)


def page(found: Sequence[Path]) -> str:
    """Return the gallery page of the sheets that exist."""
    rows = {row["type"]: row for row in mt.materials()}
    first = next((p for p in found if p.stem == "conductor"), found[0])
    alt = json.loads(first.read_text(encoding="utf-8")).get("label", first.stem)
    parts = [INTRO.format(alt=alt, first=first.stem)]
    parts += ["\n".join(section(path, rows)) for path in found]
    return "\n".join(parts) + "\n"


def section(path: Path, rows: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yield the lines about one sheet."""
    sweep = json.loads(path.read_text(encoding="utf-8"))
    row = rows.get(path.stem) or next((r for t, r in rows.items() if path.stem.startswith(t)), None)
    yield f"## {path.stem}"
    yield ""
    if row is not None:
        yield f"{row['doc']} Source: {row['source']}."
        yield ""
    yield f"![{sweep.get('label', path.stem)}](images/gallery/{path.stem}.jpg)"
    yield ""
    yield f"[examples/materials/{path.name}](../examples/materials/{path.name})"
    yield ""


def main() -> None:
    """Render, shrink, write the page."""
    parser = argparse.ArgumentParser(description="Make the gallery of materials.")
    parser.add_argument("names", nargs="*", help="sweeps of examples/materials (default: all)")
    parser.add_argument("--out", type=Path, default=ROOT / "gallery-out")
    parser.add_argument("--size", type=int, default=make_material_stage.SIZE, help="pixels across")
    parser.add_argument("--spp", type=int, default=make_material_stage.SPP)
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder of the page")
    arguments = parser.parse_args()
    chosen = sweeps(arguments.names)
    arguments.out.mkdir(parents=True, exist_ok=True)
    make_material_stage.write(make_material_stage.STAGE, arguments.size, arguments.spp)
    if any(sweep.stem == "measured" for sweep in chosen):
        make_measured.write()
    images = arguments.docs / "images" / "gallery"
    for count, sweep in enumerate(chosen, 1):
        started = time.monotonic()
        size = shrink(render(sweep, arguments.out), images / f"{sweep.stem}.jpg")
        seconds = time.monotonic() - started
        print(f"[{count}/{len(chosen)}] {sweep.stem}: {size / 1000:.0f} kB, {seconds:.0f} s")
    shown = [path for path in sweeps() if (images / f"{path.stem}.jpg").exists()]
    (arguments.docs / "gallery.md").write_text(page(shown), encoding="utf-8")
    print(f"wrote {arguments.docs / 'gallery.md'}: {len(shown)} sheets")


if __name__ == "__main__":
    main()
