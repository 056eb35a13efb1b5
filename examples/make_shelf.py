"""Render the pictures of the examples that the page offers: python examples/make_shelf.py.

They are kept in service/page/static/examples; make them anew when a scene changes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import matiere as mt
from matiere.service.page import examples

HERE = Path(__file__).resolve().parent
FOLDER = HERE.parent / "service" / "page" / "static" / "examples"
SIZE = (240, 180)
SPP = 256


def picture(scene: dict[str, Any], size: tuple[int, int], spp: int = SPP) -> np.ndarray:
    """Return a scene as the page would show it: rows of three 8-bit values."""
    scene["film"] = {**scene.get("film", {}), "width": size[0], "height": size[1]}
    scene["render"] = {**scene.get("render", {}), "spp": spp}
    output = scene.get("output", {})
    film = mt.render(mt.load(scene, asset_root=HERE / "scenes"), spp=spp)
    view = {key: output[key] for key in ("display", "view", "exposure") if key in output}
    return mt.develop(film, **view)


def sweep_picture(sweep: dict[str, Any]) -> np.ndarray:
    """Return the cells of the sweep example beside each other."""
    base, metals = sweep["base"], sweep["axes"][0]["values"]
    alphas = np.geomspace(*sweep["axes"][1]["logspace"])
    size = SIZE[0] // len(alphas), SIZE[1] // len(metals)
    rows = []
    for metal in metals:
        cells = []
        for alpha in alphas:
            base["materials"]["ball"] |= {"metal": metal, "alpha": float(alpha)}
            cells.append(picture(base, size))
        rows.append(np.concatenate(cells, axis=1))
    return np.concatenate(rows, axis=0)


def main() -> None:
    """Write a JPEG for each example."""
    FOLDER.mkdir(exist_ok=True)
    for example in examples.shelf().values():
        document = json.loads(example.text)
        image = sweep_picture(document) if "axes" in document else picture(document, SIZE)
        mt.write_image(FOLDER / f"{example.name}.jpg", image)


if __name__ == "__main__":
    main()
