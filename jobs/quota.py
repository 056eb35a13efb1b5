"""What a request needs on the disk, told when it is submitted.

A film of W x H pixels and R replicates takes W H R x 56 bytes at most. While it is merged there are
the old prefix, one pass of chunk files and the new prefix; then the images. Films of cells that
ended may be evicted, results may not: a sweep needs its largest film and all its results.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.errors import JobsError
from matiere.jobs.limits import BYTES_PER_SAMPLE_SUM

FILM_COPIES = 3  # old prefix, one pass of chunk files, new prefix
RESULT_BYTES_PER_PIXEL = 40  # EXR: eight floats; PNG: two bytes a channel at most
RESULT_BYTES = 20_000  # report and plot


class OverQuota(JobsError):
    """There is no room for the request beside what is kept now; later there may be."""

    default_code = "over_quota"


def disk_need(films: Iterable[tuple[int, int, int]], times: float = 1.0) -> int:
    """Return the bytes that jobs of films (width, height, replicates) take at most at once.

    `times`: so many times the results, where the films are a sample of all.
    """
    largest = results = 0
    for width, height, replicates in films:
        largest = max(largest, width * height * replicates * BYTES_PER_SAMPLE_SUM)
        results += width * height * RESULT_BYTES_PER_PIXEL + RESULT_BYTES
    return FILM_COPIES * largest + int(times * results)


def check_disk(root: Path, need: int, evictable: Callable[[], int]) -> None:
    """Raise SceneValidationError (`disk_limit`) if `need` never fits, OverQuota if not now.

    `evictable` tells how many bytes of stored films would make room; it is asked only when needed.
    """
    disk = shutil.disk_usage(root)
    if need <= disk.free:
        return
    if need > disk.total:
        why = (
            f"this needs {_size(need)} on the disk at once, which has {_size(disk.total)} in all; "
            "ask for fewer pixels, fewer replicates or fewer cells"
        )
        raise SceneValidationError([Fault("/film", "disk_limit", why)])
    if need > disk.free + (spare := evictable()):
        raise OverQuota(
            f"this needs {_size(need)} on the disk, where {_size(disk.free)} are free and "
            f"{_size(spare)} can be made free; wait for other jobs, or free space"
        )


def _size(size: int) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 10**8 else f"{size / 1e6:.1f} MB"
