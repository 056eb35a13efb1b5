"""Nights at the command line: from folders, from a service, or from a data directory nobody holds.

A night is named by its folder or by the id of its sweep.
"""

from __future__ import annotations

import contextlib
import csv
import json
import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from matiere.jobs import night
from matiere.jobs.night import FolderWriter, NightError
from matiere.jobs.night_options import Options
from matiere.service.client import Client, ServiceError

Report = dict[str, Any]
REPORT, PAGE, TABLE = "report.json", "report.html", "cells.csv"
PICTURES = 12  # changes that get a difference image
_SWEEP_ID = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}")


def is_sweep_id(text: str) -> bool:
    """Tell whether a word is the id of a sweep."""
    return _SWEEP_ID.fullmatch(text) is not None


def find_folder(text: str) -> Path | None:
    """Return the folder of a night: the one named, or `night` inside it (`matiere sweep -o`)."""
    for folder in (Path(text), Path(text) / "night"):
        if night.is_folder(folder):
            return folder
    return None


def export(client: Client, sweep_id: str, folder: Path, name: str = "") -> Path:
    """Write the night of a stored sweep into a folder and return it."""
    head = client.night(sweep_id)
    with FolderWriter(folder) as writer:
        for url in head.pop("pages"):
            writer.add_page(client.night_page(url))
        return writer.close(head | ({"name": name} if name else {}))


@contextlib.contextmanager
def client_for(url: str | None, data: Path | None) -> Iterator[Client]:
    """Give a client of the service that the options name, or of the data directory itself."""
    from matiere.service.settings import resolve
    from matiere.service.sweep_run import open_client

    with open_client(url, resolve({"data": data}).settings) as (client, _):
        yield client


def compare(
    a: str, b: str, options: Options, *, url: str | None = None, data: Path | None = None,
    output: Path | None = None,
) -> Report:  # fmt: skip
    """Compare two nights, each a folder or a sweep; write the report into `output` if given."""
    folders = [find_folder(name) for name in (a, b)]
    for name, folder in zip((a, b), folders, strict=True):
        if folder is None and not is_sweep_id(name):
            raise NightError(
                f"{name!r} is neither a night's folder (with {night.HEAD}) nor the id of a sweep"
            )
    with contextlib.ExitStack() as stack:
        client = None
        if None in folders:
            client = stack.enter_context(client_for(url, data))
        if client is not None and folders == [None, None]:
            report = client.compare_sweeps(a, b, **asdict(options))
        else:
            report = _compare_here((a, b), folders, options, client, stack)
        if output is not None:
            pictures = difference_pictures(client, report, output) if client else {}
            write(report, output, pictures)
    return report


def _compare_here(
    names: tuple[str, str], folders: list[Path | None], options: Options, client: Client | None,
    stack: contextlib.ExitStack,
) -> Report:  # fmt: skip
    from matiere.jobs.compare_nights import compare_nights

    opened = []
    for name, folder in zip(names, folders, strict=True):
        if folder is None:
            assert client is not None
            here = stack.enter_context(tempfile.TemporaryDirectory(prefix="matiere-night-"))
            folder = export(client, name, Path(here))
        opened.append(night.open_folder(folder))
    return compare_nights(opened[0], opened[1], options)


def write(report: Report, folder: Path, pictures: Mapping[int, Path]) -> list[Path]:
    """Write report.json, report.html and cells.csv."""
    from matiere.service.night_page import page

    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / REPORT, folder / PAGE]
    _replace(files[0], json.dumps(report, indent=1, allow_nan=False) + "\n")
    _replace(files[1], page(report, pictures))
    if report["table"]:
        files.append(folder / TABLE)
        part = folder / f".{TABLE}.part"
        with part.open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, list(report["table"][0]), lineterminator="\n")
            table.writeheader()
            table.writerows(report["table"])
        part.replace(files[-1])
    return files


def _replace(path: Path, text: str) -> None:
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def difference_pictures(client: Client, report: Report, folder: Path) -> dict[int, Path]:
    """Draw the changes whose linear images the service still has, into folder/differences."""
    found: dict[int, Path] = {}
    for change in report["changes"][:PICTURES]:
        if not (change["job_a"] and change["job_b"]):
            continue
        place = folder / "differences"
        folder_of_images = tempfile.TemporaryDirectory(prefix="matiere-night-")
        with folder_of_images as here, contextlib.suppress(ServiceError):
            images = [
                client.fetch(change[f"job_{name}"], "image.exr", Path(here) / f"{name}.exr")
                for name in "ab"
            ]
            path = place / f"{change['cell']:04}.png"
            draw_difference(images, change, path)
            found[change["cell"]] = path
    return found


def draw_difference(images: list[Path], change: Mapping[str, Any], path: Path) -> None:
    """Draw the signed difference of two linear images, the tiles that changed framed."""
    import numpy as np

    from matiere.compare import Comparison
    from matiere.imageio import read_image, write_image
    from matiere.service.night_text import change_line

    a, b = (np.asarray(read_image(image).pixels[..., :3], np.float64) for image in images)
    tiles = change["tiles"]
    framed = [
        dict(zip(("x0", "y0", "x1", "y1"), box, strict=True)) | {"significant": hit}
        for box, hit in zip(tiles["boxes"], tiles["significant"], strict=True)
    ]
    report = {"tiles": framed, "statement": change_line(change)}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, Comparison(b - a, np.zeros_like(a), report).picture())
