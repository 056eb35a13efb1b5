"""What the utility child does beside merging: checks, images of a job, contact sheets."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from matiere.jobs.artifacts import Artifacts, DamagedFile, local_file
from matiere.jobs.cells import Sweeps, film_scene
from matiere.jobs.job import JsonDict
from matiere.jobs.merge import PackCache, open_film
from matiere.jobs.night import StoredNight, write_page

Opened = tuple[memoryview, JsonDict, JsonDict]


def check(work: Any, request: JsonDict) -> JsonDict:
    """Read what a scene refers to before it is queued; raises what is wrong with it."""
    work.check_files(request["scene"], request["assets"])
    return {}


def check_material(work: Any, request: JsonDict) -> JsonDict:
    """Make the stability report of a material: `{"report": ...}`."""
    asked = (request["material"], request["seed"], request["plots"], request["root"])
    return {"report": work.check_material(*asked)}


def make_images(work: Any, sweeps: Sweeps, request: JsonDict, folder: Artifacts) -> JsonDict:
    """Develop a merged film and store its files; `{"files": {kind: [digest, size]}}`."""
    files = work.make_images(*opened(sweeps, request, folder))
    return {"files": {kind: list(folder.write([data])) for kind, data in files.items()}}


def make_night(work: Any, request: JsonDict, folder: Artifacts) -> JsonDict:
    """Write one page of a sweep's night: its cells and their signatures."""
    digest, size = write_page(folder, _signed(request["cells"], folder), work.engines())
    return {"digest": digest, "size": size}


def _signed(
    cells: Sequence[JsonDict], folder: Artifacts
) -> Iterator[tuple[JsonDict, bytes | None]]:
    files = PackCache(folder)
    for cell in cells:
        digest, film = cell.pop("signature"), cell.pop("film")
        try:
            if digest is not None:
                yield cell, folder.read(digest)
            else:
                yield cell, files.signature(*film) if film else None
        except DamagedFile:  # the night says that it has none
            yield cell, None


def compare(request: JsonDict, folder: Artifacts) -> JsonDict:
    """Compare the nights of two sweeps."""
    from matiere.jobs.compare_nights import compare_nights
    from matiere.jobs.night_options import Options

    a, b = (StoredNight(n["head"], folder, n["pages"]) for n in (request["a"], request["b"]))
    return {"report": compare_nights(a, b, Options(**request["options"]))}


def make_sheet(work: Any, sweeps: Sweeps, request: JsonDict, folder: Artifacts) -> JsonDict:
    """Draw the contact sheet of a sweep and store it."""
    with tempfile.TemporaryDirectory(prefix="matiere-") as scratch:
        cells = []
        for number, cell in enumerate(request["cells"]):
            image = cell["image"] and str(local_file(folder, cell["image"], scratch))
            if cell["film"] is not None:
                path = Path(scratch) / f"{number}.png"
                path.write_bytes(work.make_picture(*opened(sweeps, cell["film"], folder)))
                image = str(path)
            cells.append(cell | {"image": image})
        data: bytes = work.make_sheet(cells, request)
    digest, size = folder.write([data])
    return {"digest": digest, "size": size}


def opened(sweeps: Sweeps, film: JsonDict, folder: Artifacts) -> Opened:
    """Return a stored film, its header, and what is asked of it with its scene and its files."""
    header, stored = open_film(folder, film["film"], film["record"])
    scene = film.get("scene")  # of a cell: the sweep has it
    if scene is None:  # without output and stop rule
        scene = film_scene(sweeps.get(film["plan"], film["assets"]).scene(film["cell"]))
    return stored, header, film | {"scene": scene, "assets": sweeps.located(film["assets"])}
