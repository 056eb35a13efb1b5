"""Draw a labelled contact sheet: a grid of developed images with headers, labels and a legend.

The drawing is plain numpy; text is rendered by OpenImageIO with the fonts its wheel carries, so a
bare machine draws the same sheet.  Cells without an image (queued, failed, cancelled) are drawn as
hatched squares that say so: a sheet never hides a cell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt

from matiere import imageio
from matiere.drawtext import TextMark, draw_text, text_width

Pixels = npt.NDArray[np.float32]
Color = tuple[float, float, float]

BACKGROUND: Color = (0.105, 0.11, 0.12)
PANEL: Color = (0.16, 0.165, 0.18)
HATCH: Color = (0.21, 0.215, 0.23)
BRIGHT: Color = (0.93, 0.93, 0.91)
SOFT: Color = (0.66, 0.67, 0.68)
WARN: Color = (0.95, 0.60, 0.40)

MAX_EDGE = 5120  # pixels, 0.3 GB while drawing; larger grids get smaller thumbnails
SURROUNDINGS = 300  # pixels kept for titles, row headers and the legend
MIN_THUMB = 16
MIN_CAPTION = 168  # small images get a cell this wide, so that a caption fits
MIN_LABELLED = 56  # below this width a caption says nothing: leave it out
SMALLEST_TEXT = 8  # pixels; only then is a text cut


@dataclass(frozen=True)
class Layout:
    """Sizes of one sheet in pixels, all derived from the thumbnail edge and the texts."""

    columns: int
    rows: int
    thumb_width: int
    thumb_height: int
    label_size: int
    left: int
    top: int
    gap: int
    caption: int
    bottom: int

    @property
    def width(self) -> int:
        """Return the sheet's width."""
        return self.left + self.columns * (self.thumb_width + self.gap) + self.gap

    @property
    def height(self) -> int:
        """Return the sheet's height."""
        return self.top + self.rows * (self.thumb_height + self.caption + self.gap) + self.bottom

    def corner(self, index: int) -> tuple[int, int]:
        """Return x, y of the top left pixel of a cell's thumbnail."""
        row, column = divmod(index, self.columns)
        x = self.left + column * (self.thumb_width + self.gap)
        return x, self.top + row * (self.thumb_height + self.caption + self.gap)


def make(
    cells: Sequence[Mapping[str, Any]],
    columns: int,
    title: str,
    *,
    subtitle: str = "",
    column_headers: Sequence[str] = (),
    row_headers: Sequence[str] = (),
    legend: str = "",
    cell_width: int = 192,
) -> bytes:
    """Return the contact sheet as PNG bytes (8 bits, sRGB).

    Args:
        cells: row-major; each has `image` (path of a developed image, or None when there is none),
            `label` (one line) and `sublabel` (one or more lines split at newlines, such as the
            error with its interval and the seconds).  Missing texts count as empty.
        columns: cells in a row, at least 1.
        title: first line, larger.
        subtitle: second line: what all cells share.
        column_headers: one text over each column, or none.
        row_headers: one text left of each row, or none.
        legend: lines below the grid; says what the numbers mean.
        cell_width: thumbnail width in pixels; made smaller where the sheet would pass 5120.

    Raises:
        ValueError: if columns < 1, cells is empty, or headers do not match the grid.
        ImageError: if an image cannot be read.
    """
    rows = _check(cells, columns, column_headers, row_headers)
    thumbs = _first_size(cells, cell_width, columns, rows)
    layout = _layout(cells, columns, rows, thumbs, (row_headers, column_headers, subtitle, legend))
    sheet = np.empty((layout.height, layout.width, 3), dtype=np.float32)
    sheet[:] = BACKGROUND
    marks: list[TextMark] = []
    for index, cell in enumerate(cells):
        _draw_thumb(sheet, layout.corner(index), layout, cell.get("image"), marks)
        if layout.caption:
            _caption(layout, index, cell, marks)
    _headers(layout, column_headers, row_headers, marks)
    _titles(layout, title, subtitle, legend, marks)
    return _png(draw_text(sheet, marks))


def _png(sheet: Pixels) -> bytes:
    """Encode display values as an 8-bit PNG."""
    with TemporaryDirectory(prefix="matiere-sheet-") as folder:
        path = Path(folder) / "sheet.png"
        pixels = imageio.quantise(sheet, 8)
        imageio.write_stored(path, imageio.Stored(pixels, ("R", "G", "B"), {}), "uint8")
        return path.read_bytes()


def _check(
    cells: Sequence[Mapping[str, Any]],
    columns: int,
    column_headers: Sequence[str],
    row_headers: Sequence[str],
) -> int:
    """Return the number of rows, or refuse a grid that does not fit together."""
    if columns < 1 or not cells:
        raise ValueError(f"a contact sheet needs cells and columns, got {len(cells)}, {columns}")
    rows = ceil(len(cells) / columns)
    if column_headers and len(column_headers) != columns:
        raise ValueError(f"{len(column_headers)} column headers for {columns} columns")
    if row_headers and len(row_headers) != rows:
        raise ValueError(f"{len(row_headers)} row headers for {rows} rows")
    return rows


def _first_size(
    cells: Sequence[Mapping[str, Any]], cell_width: int, columns: int, rows: int
) -> tuple[int, int]:
    """Return the thumbnail size: the aspect of the first image, inside MAX_EDGE."""
    image = next((cell["image"] for cell in cells if cell.get("image")), None)
    shape = imageio.read_image(image).pixels.shape if image else (cell_width, cell_width)
    aspect = shape[0] / shape[1]
    lines = max(_caption_lines(cell) for cell in cells)
    wanted = min(cell_width, max(shape[1], MIN_CAPTION))
    fit = _fitting(wanted, columns, rows, aspect, 24 * lines)
    if fit < MIN_LABELLED:  # too small for words: all room to the images
        fit = min(_fitting(wanted, columns, rows, aspect, 0), MIN_LABELLED - 1)
    fit = max(fit, MIN_THUMB)
    return fit, max(1, round(fit * aspect))


def _fitting(wanted: int, columns: int, rows: int, aspect: float, caption: int) -> int:
    """Return the thumbnail width, at most `wanted`, with which the grid stays inside MAX_EDGE."""
    room = MAX_EDGE - SURROUNDINGS
    gap = 10 if caption else 4
    return min(wanted, room // columns - gap, int((room / rows - caption - gap) / aspect))


def _layout(
    cells: Sequence[Mapping[str, Any]],
    columns: int,
    rows: int,
    thumb: tuple[int, int],
    texts: tuple[Sequence[str], Sequence[str], str, str],
) -> Layout:
    """Measure the texts and place the grid."""
    row_headers, column_headers, subtitle, legend = texts
    size = max(10, min(20, round(thumb[0] / 15)))
    line = round(size * 1.4)
    lines = max(_caption_lines(cell) for cell in cells) if thumb[0] >= MIN_LABELLED else 0
    widest = max((text_width(t, size) for t in row_headers), default=0)
    top = round(size * 2.2) + (line if subtitle else 0) + line
    return Layout(
        columns=columns,
        rows=rows,
        thumb_width=thumb[0],
        thumb_height=thumb[1],
        label_size=size,
        left=size + (widest + size if row_headers else 0),
        top=top + (line if column_headers else 0),
        gap=max(4, size // 2) if thumb[0] >= MIN_LABELLED else 4,
        caption=lines * line + (size // 3 if lines else 0),
        bottom=2 * size + (len(legend.splitlines()) * line if legend else 0),
    )


def _caption_lines(cell: Mapping[str, Any]) -> int:
    """Count the text lines under a cell."""
    label = 1 if cell.get("label") else 0
    return label + len(str(cell.get("sublabel") or "").splitlines())


def _draw_thumb(
    sheet: Pixels,
    corner: tuple[int, int],
    layout: Layout,
    image: str | Path | None,
    marks: list[TextMark],
) -> None:
    """Draw one thumbnail, or the hatched square of a cell that has none."""
    x, y = corner
    width, height = layout.thumb_width, layout.thumb_height
    target = sheet[y : y + height, x : x + width]
    if image is None:
        stripes = (np.arange(height)[:, None] + np.arange(width)[None, :]) // 6 % 2 == 0
        target[:] = np.where(stripes[..., None], PANEL, HATCH)
        middle = (x + width // 2, y + height // 2)
        marks.append(TextMark(middle, "no image", layout.label_size, WARN, align="center"))
        return
    target[:] = PANEL
    thumb = fit_inside(_opaque(imageio.read_image(image).pixels), width, height)
    top, left = (height - thumb.shape[0]) // 2, (width - thumb.shape[1]) // 2
    target[top : top + thumb.shape[0], left : left + thumb.shape[1]] = thumb


def _opaque(image: Pixels) -> Pixels:
    """Return three channels; a transparent image is laid over the panel colour."""
    if image.shape[2] in (1, 2):
        gray = np.repeat(image[..., :1], 3, axis=2)
        image = gray if image.shape[2] == 1 else np.concatenate([gray, image[..., 1:]], axis=2)
    if image.shape[2] == 3:
        return image
    alpha = image[..., 3:4]
    over: Pixels = image[..., :3] * alpha + np.asarray(PANEL, np.float32) * (1.0 - alpha)
    return over


def fit_inside(image: Pixels, width: int, height: int) -> Pixels:
    """Shrink an image (H, W, 3) by area averages until it fits; a smaller one stays as it is."""
    scale = min(width / image.shape[1], height / image.shape[0])
    if scale >= 1.0:
        return image
    rows = _area_weights(image.shape[0], max(1, round(image.shape[0] * scale)))
    columns = _area_weights(image.shape[1], max(1, round(image.shape[1] * scale)))
    linear = np.square(np.clip(image, 0.0, 1.0))  # averages belong in light, about the square
    halfway = np.tensordot(rows, linear, axes=(1, 0))
    small: Pixels = np.sqrt(np.tensordot(halfway, columns, axes=(1, 1)).transpose(0, 2, 1))
    return small


def _area_weights(source: int, target: int) -> Pixels:
    """Return (target, source) weights, each row the share of every source pixel in one target."""
    edge = np.linspace(0.0, source, target + 1)
    pixel = np.arange(source)
    overlap = np.minimum(edge[1:, None], pixel + 1.0) - np.maximum(edge[:-1, None], pixel)
    weights: Pixels = (np.maximum(overlap, 0.0) * (target / source)).astype(np.float32)
    return weights


def _caption(layout: Layout, index: int, cell: Mapping[str, Any], marks: list[TextMark]) -> None:
    """Write label and sublabel under a thumbnail."""
    x, y = layout.corner(index)
    size = layout.label_size
    lines = [(str(cell["label"]), BRIGHT)] if cell.get("label") else []
    lines += [(line, SOFT) for line in str(cell.get("sublabel") or "").splitlines()]
    for number, (text, color) in enumerate(lines):
        baseline = y + layout.thumb_height + round(size * (1.4 * number + 1.25))
        small = legible(text, layout.thumb_width, size if number == 0 else size - 1)
        short = shorten(text, layout.thumb_width, small)
        marks.append(TextMark((x, baseline), short, small, color))


def legible(text: str, width: int, size: int) -> int:
    """Return the largest text size, at most `size`, that fits, but not below SMALLEST_TEXT."""
    while size > SMALLEST_TEXT and text_width(text, size) > width:
        size -= 1
    return size


def shorten(text: str, width: int, size: int) -> str:
    """Cut a text with three dots until it is at most width pixels wide."""
    if text_width(text, size) <= width:
        return text
    low, high = 0, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        if text_width(text[:middle].rstrip() + "...", size) <= width:
            low = middle
        else:
            high = middle - 1
    return text[:low].rstrip() + "..."


def _headers(
    layout: Layout, columns: Sequence[str], rows: Sequence[str], marks: list[TextMark]
) -> None:
    """Write the texts over the columns and left of the rows."""
    size = layout.label_size
    for number, text in enumerate(columns):
        x = layout.corner(number)[0] + layout.thumb_width // 2
        short = shorten(text, layout.thumb_width, size)
        spot = (x, layout.top - size // 2)
        marks.append(TextMark(spot, short, size, BRIGHT, bold=True, align="center"))
    for number, text in enumerate(rows):
        y = layout.corner(number * layout.columns)[1] + layout.thumb_height // 2
        marks.append(TextMark((size, y), text, size, BRIGHT, bold=True))


def _titles(layout: Layout, title: str, subtitle: str, legend: str, marks: list[TextMark]) -> None:
    """Write title, subtitle and legend."""
    size, room = layout.label_size, layout.width - 2 * layout.label_size
    large = round(size * 1.5)
    marks.append(
        TextMark((size, round(size * 2.0)), shorten(title, room, large), large, BRIGHT, bold=True)
    )
    if subtitle:
        spot = (size, round(size * 3.5))
        marks.append(TextMark(spot, shorten(subtitle, room, size), size, SOFT))
    first = layout.height - layout.bottom + round(size * 1.4)
    for number, line in enumerate(legend.splitlines()):
        spot = (size, first + round(size * 1.4 * number))
        marks.append(TextMark(spot, shorten(line, room, size), size, SOFT))
