"""The picture of a comparison: signed difference, colour bar with units, tiles that differ."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from matiere.compare import LUMINANCE

if TYPE_CHECKING:
    from matiere.compare import Comparison

Picture = NDArray[np.float32]

# Blue, white, red: told apart by colour-blind readers too; white is no difference.
STOPS = np.array([[0.02, 0.19, 0.38], [0.26, 0.58, 0.76], [0.97, 0.97, 0.97],
                  [0.84, 0.38, 0.30], [0.40, 0.00, 0.12]])  # fmt: skip
SHOWN = 480  # pixels the longer edge is enlarged to at least
MARGIN, BAR, TOP, BOTTOM, RIGHT = 24, 22, 86, 24, 132
QUANTILE = 0.995  # of |difference| at the ends of the bar: a few specks do not hide the rest
BLACK = (0.0, 0.0, 0.0)
# Pixels within so many standard errors of no change (about 95 % for one pixel; channels are taken
# to err alike, so the luminance errs at most so much) are drawn nearly grey.
NOISE_SE, GREY = 2.0, 0.6
NOTE = "greyed: within 2 standard errors (95 % for one pixel)"


def colours(values: NDArray[np.float64]) -> Picture:
    """Map -1 .. 1 to display colours, blue to white to red; beyond is clipped, NaN is grey."""
    at = np.clip(np.nan_to_num(values), -1.0, 1.0)
    grid = np.linspace(-1.0, 1.0, len(STOPS))
    shown = np.stack([np.interp(at, grid, STOPS[:, c]) for c in range(3)], axis=-1)
    shown[~np.isfinite(values)] = 0.5
    return shown.astype(np.float32)


def draw(found: Comparison) -> Picture:
    """Return the picture, display-encoded RGB (H, W, 3)."""
    from matiere.drawtext import TextMark, draw_text

    light = found.difference @ LUMINANCE
    limit = _limit(light)
    scale = max(1, -(-SHOWN // max(light.shape)))
    shown = colours(light / limit)
    noise = np.abs(light) < NOISE_SE * (found.standard_error @ LUMINANCE)
    shown[noise] = 0.25 * shown[noise] + 0.75 * GREY
    image = np.kron(shown, np.ones((scale, scale, 1), np.float32))
    tiles = found.report["tiles"]
    differ = [t for t in tiles if t["significant"]]
    _outline(image, differ if len(differ) < len(tiles) else [], scale)
    height, width = image.shape[:2]
    page_height = max(height + TOP + BOTTOM, 220)
    page = np.ones((page_height, max(width + 2 * MARGIN + BAR + RIGHT, 760), 3), np.float32)
    page[TOP : TOP + height, MARGIN : MARGIN + width] = image
    left = 2 * MARGIN + width
    ramp = colours(np.linspace(1.0, -1.0, height))[:, None, :]
    page[TOP : TOP + height, left : left + BAR] = ramp
    marks = [
        TextMark((MARGIN, 30), "difference of luminance, b - a", 20, BLACK),
        TextMark((MARGIN + 330, 30), NOTE, 14, BLACK),
        *(
            TextMark((MARGIN, 52 + 18 * k), line, 14, BLACK)
            for k, line in enumerate(_lines(found.report["statement"], page.shape[1]))
        ),
    ]
    for share in (1.0, 0.5, 0.0, -0.5, -1.0):
        y = TOP + round((1.0 - share) / 2 * (height - 1))
        page[y, left + BAR : left + BAR + 6] = 0.0
        text = f"{share * limit:+.2g}" if share else "0"
        marks.append(TextMark((left + BAR + 10, y + 5), text, 14, BLACK))
    marks.append(TextMark((left + BAR + 56, TOP + height // 2 + 5), "W/m\u00b2/sr", 14, BLACK))
    return draw_text(page, marks)


def _limit(light: NDArray[np.float64]) -> float:
    """Return the end of the bar: 1, 2 or 5 times a power of ten."""
    most = float(np.quantile(np.abs(light), QUANTILE)) or float(np.abs(light).max())
    if not most > 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(most))
    return next(digit * power for digit in (1.0, 2.0, 5.0, 10.0) if digit * power >= most * 0.999)


def _outline(image: Picture, tiles: Sequence[dict[str, int]], scale: int) -> None:
    """Frame tiles in black."""
    for tile in tiles:
        y0, y1 = tile["y0"] * scale, tile["y1"] * scale - 1
        x0, x1 = tile["x0"] * scale, tile["x1"] * scale - 1
        image[[y0, y1], x0 : x1 + 1] = 0.0
        image[y0 : y1 + 1, [x0, x1]] = 0.0


def _lines(text: str, width: int) -> list[str]:
    """Break a statement into two lines that fit."""
    import textwrap

    return textwrap.wrap(text, max(width // 7 - 4, 40))[:2]


def save(found: Comparison, folder: str | Path) -> list[Path]:
    """Write difference.png, difference.exr and report.json; make the folder if it is missing."""
    from matiere.imageio import Stored, atomic_file, write_image, write_stored

    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    picture, data, report = (
        place / name for name in ("difference.png", "difference.exr", "report.json")
    )
    statement = {"matiere:comparison": found.report["statement"]}
    write_image(picture, draw(found), metadata=statement)
    names = ["R", "G", "B", *(f"standard_error.{c}" for c in "RGB")]
    pixels = np.concatenate([found.difference, found.standard_error], axis=2).astype(np.float32)
    write_stored(data, Stored(pixels, names, statement), "float")
    with atomic_file(report) as temporary:
        text = json.dumps(found.report, indent=1, allow_nan=False) + "\n"
        temporary.write_text(text, encoding="utf-8")
    return [picture, data, report]
