"""The signature of a film: what is kept of it so that two nights can be compared.

    signature = mt.signature(film)
    data = signature.to_bytes()                  # a few kilobytes, float32
    mt.Signature.from_bytes(data)

The image is divided into 4 x 4 tiles, each tile's pixels into a few interleaved groups. Kept are
the mean radiance of every group in every replicate. Pixels are sampled independently of each other,
so groups are independent: they give the variance of a tile's mean more degrees of freedom than the
few replicates have. (Films with a light layer are the exception: `shared` says so, and then only
replicates tell the error.)

Bytes: magic "MTSG", version (1), length of the header (4 bytes, little-endian), header (UTF-8
JSON), means (float32 little-endian, replicates x tiles x groups x R, G, B).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import FilmError

if TYPE_CHECKING:
    from matiere import _core
    from matiere.film import Film

MAGIC, VERSION = b"MTSG", 1
TILES = 4  # per edge
STREAMS = 32  # groups x replicates aimed at: about this many figures carry a variance
SKEW = 3  # pixels that a row's groups are shifted by, so that no group is a column
_FIXED = len(MAGIC) + 1 + 4


@dataclass(frozen=True)
class Signature:
    """Means of one film by replicate, tile and group of pixels, with what made them.

    `means` is float32 (replicates, tiles, groups, 3), linear Rec.709 in W/m^2/sr; tiles run row by
    row. `digest` is of all pixels of all replicates: equal digests mean equal bits.
    """

    width: int
    height: int
    spp: int
    means: NDArray[np.float32]
    shared: bool  # pixels share light paths: only replicates are independent
    digest: str
    seeds: tuple[int, ...] = ()
    film_key: str = ""
    engine: str = ""  # `engine_digest` of the fingerprint

    @property
    def replicates(self) -> int:
        """Independently scrambled sample sets."""
        return len(self.means)

    @property
    def pixels(self) -> NDArray[np.int64]:
        """Pixels of every tile and group, (tiles, groups)."""
        return _pixels(self.width, self.height, self.replicates)

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return min(TILES, self.height), min(TILES, self.width)

    def boxes(self) -> list[tuple[int, int, int, int]]:
        """Return the pixels x0 <= x < x1, y0 <= y < y1 of every tile as (x0, y0, x1, y1)."""
        rows, columns = (_edges(n) for n in (self.height, self.width))
        return [
            (int(columns[i]), int(rows[j]), int(columns[i + 1]), int(rows[j + 1]))
            for j in range(len(rows) - 1)
            for i in range(len(columns) - 1)
        ]

    def to_bytes(self) -> bytes:
        """Return the signature as it is stored."""
        header = {
            "width": self.width, "height": self.height, "spp": self.spp,
            "shape": list(self.means.shape), "shared": self.shared, "digest": self.digest,
            "seeds": list(self.seeds), "film_key": self.film_key, "engine": self.engine,
        }  # fmt: skip
        text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
        start = MAGIC + bytes([VERSION]) + len(text).to_bytes(4, "little")
        return start + text + self.means.astype("<f4").tobytes()

    @classmethod
    def from_bytes(cls, data: bytes | memoryview) -> Signature:
        """Read what `to_bytes` wrote. Raises FilmError if it is damaged or from the future."""
        view = memoryview(data)
        if bytes(view[: len(MAGIC)]) != MAGIC or len(view) < _FIXED:
            raise FilmError("these bytes are not the signature of a film", code="not_a_signature")
        if (version := view[len(MAGIC)]) > VERSION:
            raise FilmError(
                f"a signature was written by a newer matiere (version {version}, this one reads "
                f"up to {VERSION}); update matiere to read it",
                code="newer_signature",
            )
        end = _FIXED + int.from_bytes(view[len(MAGIC) + 1 : _FIXED], "little")
        try:
            header: dict[str, Any] = json.loads(bytes(view[_FIXED:end]))
            shape = tuple(map(int, header.pop("shape")))
            means = np.frombuffer(view[end:], "<f4").reshape(shape)
            header["seeds"] = tuple(header["seeds"])
            found = cls(means=means, **header)
            fits = shape[1:] == (*found.pixels.shape, 3)
        except (ValueError, KeyError, TypeError) as error:
            raise FilmError(f"a signature is damaged: {error}", code="damaged_signature") from None
        if not fits:
            raise FilmError("a signature has another shape than its film", code="damaged_signature")
        return found


def signature(
    film: Film | _core.Film,
    *,
    seeds: Sequence[int] = (),
    film_key: str = "",
    engine: str = "",
) -> Signature:
    """Return the signature of a film.

    A film of the core does not know its `seeds`, `film_key` and `engine` (`engine_digest`): give
    them. Raises FilmError for a film without samples.
    """
    from matiere.film import Film

    core = film
    if isinstance(core, Film):
        seeds, film_key = core.info.seeds, core.info.film_key
        engine, core = engine_digest(core.info.versions), core.core
    if core.spp == 0:
        raise FilmError("a film without samples has no signature")
    means = core.replicate_means()[..., :3]
    return Signature(
        width=core.width,
        height=core.height,
        spp=core.spp,
        means=_grouped(means),
        shared=bool(core.has_light_layer),
        digest=hashlib.blake2b(means.tobytes(), digest_size=12).hexdigest(),
        seeds=tuple(seeds),
        film_key=film_key,
        engine=engine,
    )


def engine_digest(fingerprint: Any) -> str:
    """Return 16 hexadecimal digits that two engines share only if they make the same samples."""
    text = json.dumps(fingerprint, sort_keys=True, default=str).encode()
    return hashlib.sha256(text).hexdigest()[:16]


def _grouped(means: NDArray[np.float64]) -> NDArray[np.float32]:
    """Average (R, H, W, 3) over the pixels of every tile and group."""
    replicates, height, width = means.shape[:3]
    labels, tiles, groups = _labels(width, height, replicates)
    order = np.argsort(labels, axis=None, kind="stable")
    counts = np.bincount(labels.ravel(), minlength=tiles * groups)
    filled = np.flatnonzero(counts)
    starts = (np.cumsum(counts) - counts)[filled]
    sums = np.zeros((replicates, tiles * groups, 3))
    flat = means.reshape(replicates, -1, 3)[:, order]
    sums[:, filled] = np.add.reduceat(flat, starts, axis=1)
    sums /= np.maximum(counts, 1)[:, None]
    return sums.reshape(replicates, tiles, groups, 3).astype(np.float32)


@lru_cache(maxsize=64)
def _pixels(width: int, height: int, replicates: int) -> NDArray[np.int64]:
    labels, tiles, groups = _labels(width, height, replicates)
    counts = np.bincount(labels.ravel(), minlength=tiles * groups).reshape(tiles, groups)
    counts.flags.writeable = False
    return counts


def _labels(width: int, height: int, replicates: int) -> tuple[NDArray[np.int64], int, int]:
    """Return tile x groups + group of every pixel, the number of tiles and of groups."""
    rows, columns = _edges(height), _edges(width)
    most = int(np.diff(rows).max() * np.diff(columns).max())
    groups = max(1, min(-(-STREAMS // replicates), most))
    y, x = np.arange(height)[:, None], np.arange(width)[None, :]
    row = np.searchsorted(rows, y, side="right") - 1
    column = np.searchsorted(columns, x, side="right") - 1
    tile = row * (len(columns) - 1) + column
    wide = columns[column + 1] - columns[column]
    inside = (y - rows[row]) * wide + (x - columns[column])  # number of the pixel in its tile
    skew = SKEW if most > STREAMS else 0  # by the size alone: any two groupings have a coarser one
    group = (inside + skew * (y - rows[row])) % groups
    return tile * groups + group, (len(rows) - 1) * (len(columns) - 1), groups


def _edges(length: int) -> NDArray[np.int64]:
    """Divide `length` pixels into up to 4 nearly equal parts."""
    parts = min(TILES, length)
    return np.arange(parts + 1) * length // parts
