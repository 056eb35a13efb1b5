"""What the utility child does beside merging: checks, images of a job, contact sheets."""

from __future__ import annotations

from typing import Any

from matiere.jobs.artifacts import ArtifactFolder, unpack
from matiere.jobs.job import JsonDict


def check(work: Any, request: JsonDict) -> JsonDict:
    """Read what a scene refers to before it is queued; raises what is wrong with it."""
    work.check_files(request["scene"], request["assets"])
    return {}


def check_material(work: Any, request: JsonDict) -> JsonDict:
    """Make the stability report of a material: `{"report": ...}`."""
    asked = (request["material"], request["seed"], request["plots"], request["root"])
    return {"report": work.check_material(*asked)}


def make_images(work: Any, request: JsonDict, folder: ArtifactFolder) -> JsonDict:
    """Develop a merged film and store its files; `{"files": {kind: [digest, size]}}`."""
    header, records = unpack(folder.read(request["film"]))
    files = work.make_images(records[0], header, request)
    return {"files": {kind: list(folder.write([data])) for kind, data in files.items()}}


def make_sheet(work: Any, request: JsonDict, folder: ArtifactFolder) -> JsonDict:
    """Draw the contact sheet of a sweep and store it."""
    cells = [
        cell | {"image": str(folder.path(cell["image"])) if cell["image"] else None}
        for cell in request["cells"]
    ]
    data: bytes = work.make_sheet(cells, request)
    digest, size = folder.write([data])
    return {"digest": digest, "size": size}
