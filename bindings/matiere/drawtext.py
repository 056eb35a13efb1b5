"""Lines of text on images, rendered by OpenImageIO with the fonts its wheel carries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from matiere.errors import ImageError
from matiere.imageio import Image, load_oiio


@dataclass(frozen=True)
class TextMark:
    """One line of text on an image.

    Attributes:
        spot: x, y in pixels: left end (or middle) of the baseline.
        text: the words; characters the font lacks are replaced.
        size: height in pixels.
        color: display-encoded RGB, 0 to 1.
        bold: use the bold face.
        align: "left" or "center".
    """

    spot: tuple[int, int]
    text: str
    size: int
    color: tuple[float, float, float]
    bold: bool = False
    align: str = "left"


_SPELLED = str.maketrans(
    {"α": "alpha", "σ": "sigma", "η": "eta", "…": "...", "≤": "<=", "≥": ">=", "−": "-"}
)


def _printable(text: str) -> str:
    """Spell out or replace what the wheel's fonts (Latin-1 and a few dashes) lack."""
    spelled = text.translate(_SPELLED)
    return "".join(c if (" " <= c <= "ÿ" and c != "\x7f") or c in "–—" else "?" for c in spelled)


def _font(bold: bool) -> str:
    return "DroidSans-Bold" if bold else "DroidSans"


def text_width(text: str, size: int, bold: bool = False) -> int:
    """Return how many pixels wide draw_text draws a text."""
    oiio = load_oiio()
    roi = oiio.ImageBufAlgo.text_size(_printable(text), size, _font(bold))
    return int(roi.xend - min(roi.xbegin, 0)) if roi.defined else 0


def draw_text(image: Image, marks: Sequence[TextMark]) -> Image:
    """Return a copy of a display-encoded image (H, W, 3) with lines of text drawn on it.

    Raises:
        ImageError: if the text cannot be rendered.
    """
    oiio = load_oiio()
    buffer = oiio.ImageBuf(np.ascontiguousarray(image, dtype=np.float32))
    for mark in marks:
        text = _printable(mark.text)
        where = (*mark.spot, text, mark.size, _font(mark.bold))
        done = not text.strip() or oiio.ImageBufAlgo.render_text(
            buffer, *where, mark.color, mark.align
        )
        if not done:
            raise ImageError(f"cannot draw text: {buffer.geterror()}")
    drawn: Image = buffer.get_pixels(oiio.FLOAT)
    return drawn
