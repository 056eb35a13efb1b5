"""Signatures of films: what they keep, their bytes, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import matiere as mt
from matiere.errors import FilmError
from matiere.signature import MAGIC, VERSION, engine_digest


def film(width: int = 24, height: int = 20, replicates: int = 4, **render: int) -> mt.Film:
    """Return a small film of a ball under a grey sky."""
    document = {
        "version": 1,
        "film": {"width": width, "height": height},
        "camera": {"type": "pinhole", "origin": [0, 0, 4], "target": [0, 0, 0], "vfov_deg": 40},
        "materials": {"ball": {"type": "lambert", "albedo": [0.7, 0.4, 0.2]}},
        "shapes": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "ball"}],
        "environment": {"radiance": [0.6, 0.63, 0.7]},
        "render": {"replicates": replicates},
    }
    return mt.render(mt.load(document), **{"spp": 2 * replicates, "seed": 3, **render})


def image_mean(of: mt.Signature) -> NDArray[np.float64]:
    """Return the mean of every replicate and channel."""
    weights = of.pixels[..., None] / of.pixels.sum()
    return np.asarray((of.means.astype(float) * weights).sum((1, 2)))


@pytest.mark.parametrize(
    ("width", "height", "replicates", "tiles", "groups"),
    [(24, 20, 4, 16, 8), (64, 64, 16, 16, 2), (8, 8, 4, 16, 4), (2, 3, 4, 6, 1), (1, 1, 2, 1, 1),
     (5, 7, 3, 16, 4), (4, 64, 4, 16, 8)],
)  # fmt: skip
def test_the_means_are_those_of_the_film(
    width: int, height: int, replicates: int, tiles: int, groups: int
) -> None:
    made = film(width, height, replicates)
    found = mt.signature(made)
    assert found.means.shape == (replicates, tiles, groups, 3)
    assert found.pixels.sum() == width * height
    np.testing.assert_allclose(
        image_mean(found), made.replicate_means.mean((1, 2)), rtol=2e-7, atol=1e-9
    )
    weights = found.pixels[..., None] / np.maximum(found.pixels.sum(1)[:, None, None], 1)
    for number, (x0, y0, x1, y1) in enumerate(found.boxes()):
        tile = made.replicate_means[:, y0:y1, x0:x1].mean((1, 2))
        mine = (found.means.astype(float) * weights).sum(2)[:, number]
        np.testing.assert_allclose(mine, tile, rtol=3e-7, atol=1e-9)


def test_the_groups_divide_a_tile_evenly_and_reach_all_over_it() -> None:
    found = mt.signature(film(64, 64))
    assert found.pixels.min() == found.pixels.max() == 64 * 64 / 16 / 8


def test_bytes_come_back_the_same() -> None:
    made = film()
    found = mt.Signature.from_bytes(mt.signature(made).to_bytes())
    assert found.digest == mt.signature(made).digest and found.seeds == (3,)
    assert found.film_key == made.info.film_key and found.spp == 8 and not found.shared
    assert found.engine == engine_digest(made.info.versions)
    np.testing.assert_array_equal(found.means, mt.signature(made).means)


def test_the_core_film_is_enough_with_what_it_does_not_know() -> None:
    made = film()
    bare = mt.signature(made.core, seeds=[3], film_key=made.info.film_key, engine="e")
    whole = mt.signature(made)
    assert bare.engine == "e" and (bare.seeds, bare.digest) == (whole.seeds, whole.digest)


def test_the_digest_tells_the_last_bit() -> None:
    assert mt.signature(film()).digest == mt.signature(film()).digest
    assert mt.signature(film()).digest != mt.signature(film(seed=4)).digest


@pytest.mark.parametrize("cut", [0, 3, 8, 40, 400])
def test_cut_bytes_are_refused(cut: int) -> None:
    data = mt.signature(film()).to_bytes()
    with pytest.raises(FilmError):
        mt.Signature.from_bytes(data[:cut])
    with pytest.raises(FilmError):
        mt.Signature.from_bytes(data[:-4])


def test_a_newer_version_is_refused_in_words() -> None:
    data = bytearray(mt.signature(film()).to_bytes())
    data[len(MAGIC)] = VERSION + 1
    with pytest.raises(FilmError, match="newer matiere"):
        mt.Signature.from_bytes(bytes(data))


def test_other_bytes_are_no_signature() -> None:
    with pytest.raises(FilmError, match="not the signature"):
        mt.Signature.from_bytes(b"PNG" * 100)
