"""Pictures that somebody waits for, drawn by the utility child: nothing of them is stored.

`{"what": "film", "film": ..., "shown": {...}, "suffix": ".png", "longest": None}` shows the samples
so far through a view, `"image"` the linear image (EXR) of an ended job, `"difference"` two films
`a` and `b`, `"ball"` a material.
"""

from __future__ import annotations

import tempfile
from base64 import b64encode
from typing import Any

from matiere.jobs.artifacts import Artifacts, local_file
from matiere.jobs.cells import Sweeps
from matiere.jobs.job import JsonDict
from matiere.jobs.utility import opened


def draw(work: Any, sweeps: Sweeps, request: JsonDict, folder: Artifacts) -> JsonDict:
    """Draw what is asked for: `{"picture": base64, ...}`."""
    what = request["what"]
    if what == "ball":
        return _answer(work.draw_ball(request["material"], request["root"]))
    if what == "image":
        with tempfile.TemporaryDirectory(prefix="matiere-") as scratch:
            path = local_file(folder, request["image"], scratch)
            return _answer(work.draw_image(str(path), request))
    if what == "film":
        asked = {key: request[key] for key in ("shown", "suffix", "longest")}
        return _answer(work.draw_film(*opened(sweeps, request["film"] | asked, folder)))
    if what == "difference":
        a, b = (opened(sweeps, request[name], folder) for name in ("a", "b"))
        picture, report = work.draw_difference(a, b)
        return _answer(picture) | {"report": report}
    raise ValueError(f"unknown picture {what!r}")


def _answer(picture: bytes) -> JsonDict:
    return {"picture": b64encode(picture).decode()}
