"""How large a job may be, and how many may wait: the limits of a service, judged at submission.

What the scene says (pixels, samples, depth, time, the film's memory) is judged at once, what its
files hold (triangles, texels) by the utility child, from the headers of images before any is
decoded. A request above a limit never fits (SceneValidationError, `limit_exceeded` or
`memory_limit`); a full queue has room later (QueueFull).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from matiere.errors import Fault, ImageError, SceneValidationError, pointer
from matiere.jobs.errors import JobsError
from matiere.jobs.job import JsonDict

if TYPE_CHECKING:
    from matiere.scene.assets import AssetRoot
    from matiere.scene.scene import Scene

BYTES_PER_SAMPLE_SUM = 56  # at most: 4 doubles per pixel and replicate, 3 of the light layer
BYTES_PER_TRIANGLE = 300  # three corners of their own with normals and uv, and the tree over them
GIB = 2**30


class QueueFull(JobsError):
    """As many jobs wait as the service takes; later there is room."""

    default_code = "queue_full"


class KeyLimit(JobsError):
    """As much of one API key waits as the service takes from it; later there is room."""

    default_code = "key_limit"


@dataclass(frozen=True)
class Limits:
    """What one job may ask for, and how much may be live: in all, and of one API key."""

    film_bytes: int = 0  # 0: an eighth of the memory
    job_bytes: int = 0  # 0: half of the memory
    pixels: int = 2**26
    spp: int = 2**24
    depth: int = 10_000
    seconds: float = 7 * 86_400.0
    triangles: int = 50_000_000
    texture_bytes: int = 4 * GIB
    queued: int = 1_000_000
    key_queued: int = 1_000_000
    key_samples: float | None = None  # pixels x samples per pixel; None: no limit

    def to_dict(self) -> JsonDict:
        """Return a dict for JSON."""
        return asdict(self)

    @classmethod
    def of(cls, request: JsonDict) -> Limits:
        """Return the limits that a sweep was accepted under; older ones kept the film's alone."""
        kept = request.get("limits") or {"film_bytes": request["max_film_bytes"]}
        return cls(**kept)

    def check(self, facts: JsonDict) -> None:
        """Raise SceneValidationError for each limit that what `work.inspect` says is above."""
        if faults := list(self._faults(facts)):
            raise SceneValidationError(faults)

    def _faults(self, facts: JsonDict) -> Iterator[Fault]:
        width, height, replicates = facts["width"], facts["height"], facts["replicates"]
        stop, render = facts["stop"], facts["scene"].get("render", {})
        if width * height > self.pixels:
            yield _above("/film", f"{width} x {height} pixels", f"{self.pixels:,}")
        if (spp := stop.get("spp")) and spp > self.spp:
            yield _above("/render/spp", f"{spp:,} samples per pixel", f"{self.spp:,}")
        if (seconds := stop.get("seconds")) and seconds > self.seconds:
            yield _above("/render/seconds", f"{seconds:g} s", f"{self.seconds:g} s")
        if (depth := render.get("max_depth")) and depth > self.depth:
            yield _above("/render/max_depth", f"a depth of {depth:,}", f"{self.depth:,}")
        size = film_bytes(facts)
        if size > self.film_bytes:
            why = (
                f"a film of {width} x {height} pixels with {replicates} replicates needs "
                f"{size / GIB:.1f} GiB; this service allows {self.film_bytes / GIB:.1f} GiB"
            )
            yield Fault("/film", "memory_limit", why)


def film_bytes(facts: JsonDict) -> int:
    """Return the most that the film of a job takes."""
    size: int = facts["width"] * facts["height"] * facts["replicates"] * BYTES_PER_SAMPLE_SUM
    return size


def _above(at: str, asked: str, allowed: str) -> Fault:
    return Fault(at, "limit_exceeded", f"{asked}; this service allows {allowed}")


def check_queue(live: int, new: int, limits: Limits) -> None:
    """Raise for `new` jobs beside `live` ones: QueueFull, or what never fits."""
    if new > limits.queued:
        why = (
            f"{new:,} cells at once; this service holds {limits.queued:,} jobs that have not ended"
        )
        raise SceneValidationError([Fault("/axes", "limit_exceeded", why)])
    if live + new > limits.queued:
        raise QueueFull(
            f"{live:,} jobs have not ended, and this service holds {limits.queued:,}; "
            "send this again when some have"
        )


def check_key(live: tuple[int, float], new: tuple[int, float], limits: Limits) -> None:
    """Raise for `new` (jobs, samples) beside the `live` ones of a key: KeyLimit, or never fits."""
    most = (limits.key_queued, limits.key_samples)
    units = (("jobs", 1.0), ("megasamples", 1e6))
    for there, asked, allowed, (name, unit) in zip(live, new, most, units, strict=True):
        if allowed is None or there + asked <= allowed:
            continue
        what, limit = f"{asked / unit:,.10g} {name}", f"{allowed / unit:,.10g}"
        if asked > allowed:
            why = f"{what} at once; this service takes {limit} from one API key"
            raise SceneValidationError([Fault("", "limit_exceeded", why)])
        raise KeyLimit(
            f"this asks for {what}, {there / unit:,.10g} of this API key have not ended, and this "
            f"service takes {limit} from one key; send it again when some have"
        )


def check_files(scene: Scene, files: AssetRoot, limits: Mapping[str, Any]) -> None:
    """Raise for files that hold too much; images are judged by their headers. In a child.

    `limits` is `Limits.to_dict()` with the bytes of the `film`.
    """
    texels = _images(scene, files, limits["texture_bytes"])
    triangles = _triangles(scene, files, limits["triangles"])
    size = limits["film"] + texels + triangles * BYTES_PER_TRIANGLE
    if size > limits["job_bytes"]:
        why = (
            f"film, {triangles:,} triangles and {texels / GIB:.1f} GiB of textures need about "
            f"{size / GIB:.1f} GiB; this service allows {limits['job_bytes'] / GIB:.1f} GiB"
        )
        raise SceneValidationError([Fault("", "memory_limit", why)])


def _images(scene: Scene, files: AssetRoot, most: int) -> int:
    from matiere.imageio import decoded_bytes
    from matiere.scene import references

    total = 0
    sizes: dict[str, int] = {}
    for place, name, suffixes in references.files(scene.to_dict()):
        if suffixes is not references.IMAGE_SUFFIXES or name in sizes:
            continue
        try:
            sizes[name] = decoded_bytes(files.unchanged(name))
        except ImageError:  # told in full when it is read
            continue
        total += sizes[name]
        if total > most:
            asked = f"{total / GIB:.2f} GiB of texels up to here"
            allowed = f"{most / GIB:.2f} GiB in all"
            raise SceneValidationError([_above(pointer(*place), asked, allowed)])
    return total


def _triangles(scene: Scene, files: AssetRoot, most: int) -> int:
    from matiere.scene.meshes import Files, count_triangles
    from matiere.scene.shapes import MeshShape

    total = 0
    read: Files = {}
    for index, shape in enumerate(scene.model.shapes):
        if not isinstance(shape, MeshShape):
            continue
        try:
            total += count_triangles(shape, files, read)
        except SceneValidationError:  # told in full when it is placed
            continue
        if total > most:
            asked, allowed = f"{total:,} triangles up to here", f"{most:,} in all"
            raise SceneValidationError([_above(pointer("shapes", index), asked, allowed)])
    return total
