"""The printed interval on rendered scenes: a small part of tests/prove/error_interval.py."""

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt


@pytest.mark.slow
def test_the_interval_holds_the_realised_error_of_scenes() -> None:
    """6 seeds on 4 scenes: at most 4 of 24 outside (P < 0.8 % for a true 95 % interval)."""
    rows: list[tuple[str, int, float, float, float]] = []
    for name, document in scenes(32).items():
        scene = mt.load(document)
        reference = mt.render(scene, spp=2048, seed=4711)
        for seed in range(6):
            film = mt.render(scene, spp=32, seed=seed)
            e = film.error
            rows.append((name, seed, e["lower"], film.realised_relmse(reference), e["upper"]))
    outside = [row for row in rows if not row[2] <= row[3] <= row[4]]
    assert len(outside) <= 4, outside
    ratios = {name: np.median([r[4] / r[2] for r in rows if r[0] == name]) for name in scenes()}
    assert ratios["glass"] < 4 and max(r for n, r in ratios.items() if n != "glass") < 2, ratios


def test_a_caustic_of_a_tiny_lamp_is_admitted_to_be_unknown() -> None:
    """One sample in many thousands carries the light: the interval spans orders of magnitude."""
    document = scenes(32)["glass"]
    document["lights"][0] |= {
        "corner": [0.5, 4, 0.5], "edge_u": [0.1, 0, 0], "edge_v": [0, 0, 0.1],
        "radiance": [4000, 3600, 3200],
    }  # fmt: skip
    document["environment"] = {"radiance": [0.02, 0.024, 0.03]}
    document["render"] = {**document.get("render", {}), "light_tracing": False}
    scene = mt.load(document)
    ratios = []
    for seed in range(5):
        error = mt.render(scene, spp=64, seed=seed).error
        assert 0 < error["lower"] <= error["relmse"] <= error["upper"] < float("inf")
        ratios.append(error["upper"] / error["lower"])
    assert np.median(ratios) > 5, ratios
