"""A night: one run of a sweep, as the signatures of its cells and what is known of each.

In the store a night is a list of pages, packed files of up to `PAGE` cells that the utility child
writes when the sweep has ended; they stay when films and images go. In a folder it is

    night.json       name, sweep, engine, number of cells
    cells.jsonl      one cell a line: parameters, state, samples, seconds, error, place in the
                     next file
    signatures.bin   the signatures, one after the other

Both are read by `Night`: `rows()` for all cells and `signature(row)` for one of them.
"""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from matiere.errors import MatiereError
from matiere.jobs.artifacts import Artifacts, DamagedFile, fsync_folder, pack, unpack
from matiere.jobs.job import JsonDict

if TYPE_CHECKING:
    from matiere.signature import Signature

VERSION = 1
PAGE = 1000  # cells of a page
HEAD, CELLS, SIGNATURES = "night.json", "cells.jsonl", "signatures.bin"


class NightError(MatiereError):
    """A folder or file is not a night, is damaged, or was written by a newer matiere."""

    default_code = "not_a_night"


class Night(ABC):
    """The cells of one night. Use `open_folder` or `StoredNight`."""

    def __init__(self, head: Mapping[str, Any], rows: Sequence[JsonDict]) -> None:
        """Hold what is known of the night and of each cell."""
        self.head, self._rows = dict(head), list(rows)

    @property
    def name(self) -> str:
        """What the night is called in reports."""
        return str(self.head.get("name") or self.head.get("sweep_id") or "")

    def rows(self) -> Sequence[JsonDict]:
        """Return what is known of every cell, in the order of the sweep."""
        return self._rows

    def keys(self) -> dict[str, JsonDict]:
        """Return the rows by what names a cell in any night: its parameters."""
        found: dict[str, JsonDict] = {}
        for row in self._rows:
            name = cell_key(row["parameters"])
            count = 0
            while (key := f"{name}#{count}") in found:
                count += 1  # the same parameters again: told apart by their order
            found[key] = row
        return found

    @abstractmethod
    def data(self, row: JsonDict) -> bytes | None:
        """Return the bytes of a cell's signature, or None if it has none."""

    def signature(self, row: JsonDict) -> Signature | None:
        """Return a cell's signature, or None if it has none. Raises FilmError if damaged."""
        from matiere.signature import Signature

        data = self.data(row)
        return None if data is None else Signature.from_bytes(data)


class FolderNight(Night):
    """A night in a folder."""

    def __init__(self, folder: Path, head: Mapping[str, Any], rows: Sequence[JsonDict]) -> None:
        """Use `open_folder`."""
        super().__init__(head, rows)
        self.folder = folder
        self._size = (folder / SIGNATURES).stat().st_size

    def data(self, row: JsonDict) -> bytes | None:
        """Read a cell's signature."""
        if row.get("at") is None:
            return None
        offset, size = row["at"]
        if offset + size > self._size:
            raise NightError(f"{self.folder / SIGNATURES} is cut short", code="damaged_night")
        with (self.folder / SIGNATURES).open("rb") as file:
            file.seek(offset)
            return file.read(size)


class StoredNight(Night):
    """A night whose pages lie in the store."""

    def __init__(self, head: Mapping[str, Any], folder: Artifacts, pages: Sequence[str]) -> None:
        """Read the rows of all pages (digests, in order)."""
        rows = list[JsonDict]()
        self._read = lru_cache(maxsize=2)(lambda digest: unpack(folder.read(digest)))
        engines = dict[str, Any]()
        for digest in pages:
            header, records = self._read(digest)
            engines |= header.get("engines", {})
            found = read_rows(bytes(records[0]))
            rows += [row | {"page": digest} for row in found]
        super().__init__({"engines": engines, **head}, rows)

    def data(self, row: JsonDict) -> bytes | None:
        """Read a cell's signature."""
        if row.get("at") is None:
            return None
        _, records = self._read(row["page"])
        offset, size = row["at"]
        return bytes(records[1][offset : offset + size])


def cell_key(parameters: Mapping[str, Any]) -> str:
    """Return parameters as text that is equal for equal values."""
    return json.dumps(parameters, sort_keys=True, separators=(",", ":"))


def read_rows(text: bytes) -> list[JsonDict]:
    """Return the rows of `cells.jsonl` or of a page."""
    return [json.loads(line) for line in text.splitlines() if line]


def write_page(
    folder: Artifacts, cells: Iterable[tuple[JsonDict, bytes | None]], engines: JsonDict
) -> tuple[str, int]:
    """Store one page of a night and return (digest, size)."""
    lines, blobs, offset = list[str](), list[bytes](), 0
    for row, data in cells:
        at = None if data is None else [offset, len(data)]
        lines.append(json.dumps(row | {"at": at}, allow_nan=False, separators=(",", ":")))
        if data is not None:
            blobs.append(data)
            offset += len(data)
    header = {"night": VERSION, "engines": engines}
    return folder.write(pack(header, ["\n".join(lines).encode(), b"".join(blobs)]))


class FolderWriter:
    """Writes the folder of a night; it counts as one only when `close` has written its head."""

    def __init__(self, folder: str | Path) -> None:
        """Make the folder; what another night left there is replaced."""
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / HEAD).unlink(missing_ok=True)
        self._cells = (self.folder / CELLS).open("w", encoding="utf-8")
        self._blobs = (self.folder / SIGNATURES).open("wb")
        self._count, self._offset = 0, 0
        self._engines = dict[str, Any]()

    def __enter__(self) -> FolderWriter:
        """Return self; leaving without `close` leaves no night."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the files."""
        self._cells.close()
        self._blobs.close()

    def add(self, row: JsonDict, data: bytes | None) -> None:
        """Append a cell."""
        at = None if data is None else [self._offset, len(data)]
        line = {key: value for key, value in row.items() if key != "page"} | {"at": at}
        self._cells.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")
        if data is not None:
            self._blobs.write(data)
            self._offset += len(data)
        self._count += 1

    def add_page(self, page: bytes) -> None:
        """Append the cells of a stored page. Raises NightError if it is damaged."""
        try:
            header, records = unpack(page)
        except (DamagedFile, ValueError, KeyError) as error:
            raise NightError(f"a page of the night is damaged: {error}") from None
        if header.get("night", 0) > VERSION:
            raise NightError("the night was written by a newer matiere; update matiere to read it")
        self._engines |= header.get("engines", {})
        for row in read_rows(bytes(records[0])):
            at = row.get("at")
            self.add(row, None if at is None else bytes(records[1][at[0] : at[0] + at[1]]))

    def close(self, head: Mapping[str, Any]) -> Path:
        """Finish: write the head last, so that half a night is never taken for one."""
        for file in (self._cells, self._blobs):
            file.flush()
            os.fsync(file.fileno())
            file.close()
        engines = self._engines | dict(head.get("engines", {}))
        full = {"night": VERSION, **head, "engines": engines, "cells": self._count}
        part = self.folder / f".{HEAD}.part"
        part.write_text(json.dumps(full, indent=1) + "\n", encoding="utf-8")
        part.replace(self.folder / HEAD)
        fsync_folder(self.folder)
        return self.folder


def is_folder(path: str | Path) -> bool:
    """Tell whether a folder holds a night."""
    return (Path(path) / HEAD).is_file()


def may_replace(path: Path) -> bool:
    """Tell whether a night may be written here: nothing is there, or a night, whole or cut."""
    if not path.exists():
        return True
    return path.is_dir() and {p.name for p in path.iterdir()} <= {HEAD, CELLS, SIGNATURES}


def open_folder(path: str | Path) -> FolderNight:
    """Open the night in a folder. Raises NightError, saying what is wrong with it."""
    folder = Path(path)
    try:
        head = json.loads((folder / HEAD).read_text(encoding="utf-8"))
        version, count = int(head["night"]), int(head["cells"])
    except FileNotFoundError:
        raise NightError(
            f"{folder} holds no night: there is no {HEAD}; write one with `matiere night SWEEP "
            "FOLDER`"
        ) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise NightError(f"{folder / HEAD} cannot be read: {error}", code="damaged_night") from None
    if version > VERSION:
        raise NightError(
            f"{folder} was written by a newer matiere (version {version}, this one reads up to "
            f"{VERSION}); update matiere to read it",
            code="newer_night",
        )
    try:
        rows = read_rows((folder / CELLS).read_bytes())
        night = FolderNight(folder, head, rows)
    except (OSError, ValueError) as error:
        raise NightError(f"{folder} is damaged: {error}", code="damaged_night") from None
    if len(rows) != count:
        raise NightError(
            f"{folder / CELLS} has {len(rows)} cells, its head says {count}", code="damaged_night"
        )
    return night


def iterate(night: Night) -> Iterator[tuple[JsonDict, bytes | None]]:
    """Yield every cell with the bytes of its signature."""
    for row in night.rows():
        yield row, night.data(row)
