"""Photometric files: what LM-63 says, symmetric halves and quadrants, and files that are wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import matiere as mt
from matiere.scene.ies import parse_ies

HEAD = "IESNA:LM-63-2002\n[TEST] by hand\n[MANUFAC] none\n"


def ies(
    vertical: list[float],
    horizontal: list[float],
    rows: list[list[float]],
    *,
    lamps: str = "1 1000",
    multiplier: float = 1,
    kind: int = 1,
    tilt: str = "TILT=NONE\n",
    ballast: str = "1 1 50",
) -> str:
    """Return the text of a file, one row of candela for each horizontal angle."""
    lines = [
        f"{lamps} {multiplier:g} {len(vertical)} {len(horizontal)} {kind} 2 0.1 0.1 0",
        ballast,
        " ".join(map(str, vertical)),
        " ".join(map(str, horizontal)),
        *(" ".join(map(str, row)) for row in rows),
    ]
    return HEAD + tilt + "\n".join(lines) + "\n"


EVEN = ies([0, 90, 180], [0], [[100, 100, 100]])


def test_an_even_lamp_has_four_pi_times_its_candela() -> None:
    profile = parse_ies(EVEN)
    assert profile.flux == pytest.approx(400 * np.pi)
    assert profile.lumens == 1000
    assert profile.horizontal_deg.tolist() == [0] and profile.candela.shape == (1, 3)


def test_a_half_sphere_of_cosines_has_pi() -> None:
    angles = np.linspace(0, 90, 181)
    profile = parse_ies(ies(angles.tolist(), [0], [np.cos(np.radians(angles)).round(9).tolist()]))
    assert profile.flux == pytest.approx(np.pi, rel=1e-4)


def test_factors_multiply_and_absolute_photometry_has_no_lamp_lumens() -> None:
    text = ies([0, 180], [0], [[1, 1]], lamps="2 -1", multiplier=3, ballast="0.5 1 20")
    profile = parse_ies(text)
    assert profile.candela.tolist() == [[1.5, 1.5]]
    assert profile.lumens is None
    assert parse_ies(ies([0, 180], [0], [[1, 1]], lamps="2 700")).lumens == 1400


# The whole circle of each, one value for each angle (two vertical angles, all alike).
SYMMETRIES: dict[str, tuple[list[float], list[float], list[float], list[float]]] = {
    "quadrant": ([0, 45, 90], [1, 2, 3], [0, 45, 90, 135, 180, 225, 270, 315, 360],
                 [1, 2, 3, 2, 1, 2, 3, 2, 1]),
    "half": ([0, 90, 180], [1, 2, 3], [0, 90, 180, 270, 360], [1, 2, 3, 2, 1]),
    "other half": ([90, 180, 270], [1, 2, 3], [0, 90, 180, 270, 360], [2, 1, 2, 3, 2]),
    "whole": ([0, 120, 240, 360], [1, 2, 3, 1], [0, 120, 240, 360], [1, 2, 3, 1]),
    "other half, uneven": ([90, 150, 210, 270], [1, 2, 3, 4], [0, 30, 90, 150, 210, 270, 330, 360],
                           [2.5, 2, 1, 2, 3, 4, 3, 2.5]),
}  # fmt: skip


@pytest.mark.parametrize("name", SYMMETRIES)
def test_symmetric_parts_become_the_whole_circle(name: str) -> None:
    angles, values, circle, expected = SYMMETRIES[name]
    profile = parse_ies(ies([0, 180], angles, [[v, v] for v in values]))
    assert profile.horizontal_deg == pytest.approx(circle)
    assert profile.candela[:, 0] == pytest.approx(expected)
    mean = np.interp(np.arange(0.5, 360), circle, expected).mean()
    assert profile.flux == pytest.approx(4 * np.pi * mean, rel=1e-3)


def test_lines_break_anywhere_and_commas_part_numbers() -> None:
    plain = ies([0, 90], [0], [[5, 6]])
    head, body = plain.split("TILT=NONE\n")
    broken = head + "TILT = NONE\r\n" + body.replace(" ", "\r\n").replace("5\r\n6", "5,6")
    assert parse_ies(broken).candela.tolist() == parse_ies(plain).candela.tolist()


def test_an_included_tilt_table_is_stepped_over() -> None:
    tilted = ies([0, 90], [0], [[5, 6]], tilt="TILT=INCLUDE\n1\n3\n0 45 90\n1 0.9 0.8\n")
    assert parse_ies(tilted).candela.tolist() == [[5, 6]]


BAD = {
    "no line TILT=": "IESNA:LM-63-2002\n1 2 3\n",
    "from another file": ies([0, 90], [0], [[1, 1]], tilt="TILT=lamp.tlt\n"),
    "type A": ies([0, 90], [0], [[1, 1]], kind=3),
    "type B": ies([0, 90], [0], [[1, 1]], kind=2),
    "not a whole number from 1 to 3": ies([0, 90], [0], [[1, 1]], kind=7),
    "ends within the candela values: 4 numbers are due, 3": ies([0, 90], [0, 90], [[1, 1], [1]]),
    "'bright' on line": ies([0, 90], [0], [[1, 1]]).replace("1 1\n", "1 bright\n"),
    "is not a number": ies([0, 90], [0], [[1, float("nan")]]),
    "the vertical angles do not ascend": ies([0, 90, 45], [0], [[1, 1, 1]]),
    "vertical angles run from 10": ies([10, 90], [0], [[1, 1]]),
    "horizontal angles run from 0 to 120": ies([0, 90], [0, 120], [[1, 1], [1, 1]]),
    "negative candela": ies([0, 90], [0], [[1, -1]]),
    "is dark": ies([0, 90], [0], [[0, 0]]),
    "number of vertical angles is 1e+09": HEAD + "TILT=NONE\n1 1 1 1000000000 1 1 1 0 0 0\n1 1 1\n",
}


@pytest.mark.parametrize("why", BAD)
def test_wrong_files_are_told_in_words(why: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError) as caught:
        parse_ies(BAD[why])
    assert why in str(caught.value)
    (tmp_path / "lamp.ies").write_text(BAD[why])
    scene = mt.load(document(), asset_root=tmp_path)
    with pytest.raises(mt.SceneValidationError) as error:
        scene.build()
    assert error.value.errors[0]["pointer"] == "/lights/0/ies"
    assert "lamp.ies" in error.value.errors[0]["message"]


def document(**light: Any) -> dict[str, Any]:
    """A lamp over a floor that is looked at from the side."""
    lamp = {"type": "point", "position": [0, 2, 0], "intensity": 8, "ies": "lamp.ies", **light}
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 1, 6], "target": [0, 0, 0]},
        "film": {"width": 8, "height": 8},
        "render": {"spp": 8},
        "materials": {"floor": {"type": "lambert", "albedo": 0.5}},
        "shapes": [{"type": "mesh", "positions": [[-9, 0, 9], [9, 0, 9], [9, 0, -9], [-9, 0, -9]],
                    "triangles": [[0, 1, 2], [0, 2, 3]], "material": "floor"}],
        "lights": [lamp],
    }  # fmt: skip


def test_a_missing_file_and_stray_keys_are_named(tmp_path: Path) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(document(), asset_root=tmp_path)
    assert caught.value.errors[0]["pointer"] == "/lights/0/ies"
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(document(ies=None, rotation_deg=10), asset_root=tmp_path)
    assert caught.value.errors[0]["pointer"] == "/lights/0/rotation_deg"


def test_the_content_of_the_file_makes_the_digest(tmp_path: Path) -> None:
    keys = []
    for text in (EVEN, EVEN, ies([0, 90, 180], [0], [[100, 100, 50]])):
        (tmp_path / "lamp.ies").write_text(text)
        keys.append(mt.film_key(mt.load(document(), asset_root=tmp_path)))
    assert keys[0] == keys[1] != keys[2]


def test_an_even_profile_is_a_point_light(tmp_path: Path) -> None:
    (tmp_path / "lamp.ies").write_text(EVEN)
    ours = mt.render(mt.load(document(), asset_root=tmp_path))
    theirs = mt.render(mt.load(document(ies=None)))
    assert np.array_equal(ours.mean, theirs.mean)
