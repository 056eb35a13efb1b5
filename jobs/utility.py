"""What the utility child does beside merging: checks, images of a job, contact sheets."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from typing import Any

from matiere.jobs.artifacts import Artifacts, DamagedFile, local_file, unpack
from matiere.jobs.job import JsonDict
from matiere.jobs.night import StoredNight, write_page


def check(work: Any, request: JsonDict) -> JsonDict:
    """Read what a scene refers to before it is queued; raises what is wrong with it."""
    work.check_files(request["scene"], request["assets"])
    return {}


def check_material(work: Any, request: JsonDict) -> JsonDict:
    """Make the stability report of a material: `{"report": ...}`."""
    asked = (request["material"], request["seed"], request["plots"], request["root"])
    return {"report": work.check_material(*asked)}


def make_images(work: Any, request: JsonDict, folder: Artifacts) -> JsonDict:
    """Develop a merged film and store its files; `{"files": {kind: [digest, size]}}`."""
    header, records = unpack(folder.read(request["film"]))
    files = work.make_images(records[0], header, request)
    return {"files": {kind: list(folder.write([data])) for kind, data in files.items()}}


def make_night(work: Any, request: JsonDict, folder: Artifacts) -> JsonDict:
    """Write one page of a sweep's night: its cells and their signatures."""
    digest, size = write_page(folder, _signed(request["cells"], folder), work.engines())
    return {"digest": digest, "size": size}


def _signed(
    cells: Sequence[JsonDict], folder: Artifacts
) -> Iterator[tuple[JsonDict, bytes | None]]:
    for cell in cells:
        digest = cell.pop("signature")
        try:
            yield cell, None if digest is None else folder.read(digest)
        except DamagedFile:  # the night says that it has none
            yield cell, None


def compare(request: JsonDict, folder: Artifacts) -> JsonDict:
    """Compare the nights of two sweeps."""
    from matiere.jobs.compare_nights import compare_nights
    from matiere.jobs.night_options import Options

    a, b = (StoredNight(n["head"], folder, n["pages"]) for n in (request["a"], request["b"]))
    return {"report": compare_nights(a, b, Options(**request["options"]))}


def make_sheet(work: Any, request: JsonDict, folder: Artifacts) -> JsonDict:
    """Draw the contact sheet of a sweep and store it."""
    with tempfile.TemporaryDirectory() as scratch:
        cells = [
            cell | {"image": cell["image"] and str(local_file(folder, cell["image"], scratch))}
            for cell in request["cells"]
        ]
        data: bytes = work.make_sheet(cells, request)
    digest, size = folder.write([data])
    return {"digest": digest, "size": size}
