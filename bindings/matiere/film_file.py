"""The film container: magic, version, JSON header, replicate sums, SHA-256 of all of it.

16 bytes  magic "\\x89matiere film\\r\\n\\x1a"
 4 bytes  container version, little-endian as all numbers
 8 bytes  length of the header
          header: UTF-8 JSON, the fields of FilmInfo and the layers
 8 bytes  length of the sums
          sums: what `_core.Film.to_bytes` makes (size, counters, counts, float64 sums, CRC)
32 bytes  SHA-256 of everything above
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from matiere.errors import FilmError

if TYPE_CHECKING:
    from matiere.film import Film

MAGIC = b"\x89matiere film\r\n\x1a"
VERSION = 1
_BLOCK = 1 << 22


def write_film(film: Film, path: str | os.PathLike[str]) -> None:
    """Write a film; the bytes are on disk before the name appears."""
    from matiere.imageio import atomic_file

    digest = hashlib.sha256()
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        for piece in _pieces(film):
            digest.update(piece)
            file.write(piece)
        file.write(digest.digest())


def _pieces(film: Film) -> Iterator[bytes]:
    header = json.dumps(_header(film), allow_nan=False).encode()
    yield MAGIC + VERSION.to_bytes(4, "little")
    yield len(header).to_bytes(8, "little")
    yield header
    sums = film.core.to_bytes()
    yield len(sums).to_bytes(8, "little")
    yield sums


def _header(film: Film) -> dict[str, Any]:
    info = {f.name: getattr(film.info, f.name) for f in fields(film.info)}
    return {
        "layers": ["camera", "light"] if film.core.has_light_layer else ["camera"],
        "width": film.width,
        "height": film.height,
        "replicates": film.replicates,
        "spp": film.spp,
        "info": info,
    }


def read_film(path: str | os.PathLike[str]) -> Film:
    """Read a film; FilmError says in words what is wrong with the file."""
    from matiere import _core
    from matiere.film import Film, FilmInfo

    name = os.fspath(path)
    try:
        with Path(name).open("rb") as file:
            header, sums = _read(file, name)
    except OSError as error:
        raise FilmError(f"cannot read {name!r}: {error.strerror}", code="unreadable") from None
    if header.get("layers") not in (["camera"], ["camera", "light"]):
        raise FilmError(f"{name!r} has layers this matiere does not know", code="newer_film")
    try:
        core = _core.Film.from_bytes(sums)
        info: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in header["info"].items()
        }
        return Film(core, FilmInfo(**{"light_tracing": False, **info}))  # older: had no choice
    except _core.SceneError as error:
        raise FilmError(f"{name!r}: {error}", code=error.code) from None
    except (KeyError, TypeError, AttributeError) as error:
        raise FilmError(f"{name!r} has a header this matiere cannot read: {error}") from None


def _read(file: BinaryIO, name: str) -> tuple[dict[str, Any], bytes]:
    """Return header and sums after the digest was checked."""
    if file.read(len(MAGIC)) != MAGIC:
        raise FilmError(f"{name!r} is not a matiere film", code="not_a_film")
    version = int.from_bytes(file.read(4), "little")
    if version > VERSION:
        raise FilmError(
            f"{name!r} was written by a newer matiere (container version {version}, this one reads "
            f"up to {VERSION}); update matiere to read it",
            code="newer_film",
        )
    _check_digest(file, name)
    header: dict[str, Any] = json.loads(_read_counted(file, name))
    return header, _read_counted(file, name)


def _check_digest(file: BinaryIO, name: str) -> None:
    size = file.seek(0, os.SEEK_END)
    left = size - hashlib.sha256().digest_size
    digest = hashlib.sha256()
    file.seek(0)
    while left > 0 and (block := file.read(min(left, _BLOCK))):
        digest.update(block)
        left -= len(block)
    if file.read() != digest.digest():
        raise FilmError(
            f"{name!r} is damaged: its checksum does not match (cut short or changed); render it "
            "again or take a copy",
            code="damaged_film",
        )
    file.seek(len(MAGIC) + 4)


def _read_counted(file: BinaryIO, name: str) -> bytes:
    length = int.from_bytes(file.read(8), "little")
    data = file.read(length)
    if len(data) != length:
        raise FilmError(f"{name!r} is damaged: it is cut short", code="damaged_film")
    return data
