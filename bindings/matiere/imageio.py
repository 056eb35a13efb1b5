"""Read and write image files through OpenImageIO (imported only when a file is touched)."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from matiere.errors import ImageError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matiere.film import Film

Image = NDArray[np.float32]
MAX_READ_VALUES = 2**29  # pixels x channels: 2 GiB of floats
_INTEGER_KINDS = ("uint8", "int8", "uint16", "int16", "uint32", "int32")


@dataclass(frozen=True, slots=True)
class Decoded:
    """An image file as it is stored: (H, W, C) float32, whole-number formats scaled to [0, 1]."""

    pixels: Image
    channels: tuple[str, ...]
    integer: bool
    metadata: Mapping[str, Any]


def load_oiio() -> Any:
    import OpenImageIO

    return OpenImageIO


@contextmanager
def _opened(name: str) -> Iterator[Any]:
    """Open an image that is not too large to read."""
    oiio = load_oiio()
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(name, config)
    if source is None:
        raise ImageError(_reason(f"cannot read the image {name!r}", oiio.geterror()))
    try:
        spec = source.spec()
        if spec.width * spec.height * spec.depth * spec.nchannels > MAX_READ_VALUES:
            size = f"{spec.width} x {spec.height} pixels with {spec.nchannels} channels"
            raise ImageError(f"the image {name!r} is too large ({size})")
        yield source
    finally:
        source.close()


def read_image(path: str | os.PathLike[str]) -> Decoded:
    """Read an image file as stored, without any colour conversion.

    Returns float32 pixels; 8- and 16-bit whole numbers become [0, 1], half and float stay. Alpha is
    left as it is in the file. Raises ImageError with the reason if the file cannot be decoded.
    """
    name = os.fspath(path)
    with _opened(name) as source:
        spec = source.spec()
        raw = source.read_image(0, 0, 0, spec.nchannels, "float")
        if raw is None:
            raise ImageError(_reason(f"cannot decode the image {name!r}", source.geterror()))
        array = np.ascontiguousarray(raw, np.float32)
        return Decoded(
            array.reshape(spec.height, spec.width, spec.nchannels),
            tuple(spec.channelnames),
            str(spec.format) in _INTEGER_KINDS,
            {item.name: item.value for item in spec.extra_attribs},
        )


def decoded_bytes(path: str | os.PathLike[str]) -> int:
    """Return the size of an image once it is decoded, from its header alone.

    Raises ImageError if there is no header, or it tells of more than can be read.
    """
    with _opened(os.fspath(path)) as source:
        return int(source.spec().image_bytes())


class ColorImage(NamedTuple):
    """An image as (H, W, 3) colour, as stored."""

    pixels: Image
    integer: bool  # whole numbers in the file, scaled to [0, 1]
    chromaticities: tuple[float, ...] | None  # xy of red, green, blue, white, if the file says so


def read_color(path: str | os.PathLike[str]) -> ColorImage:
    """Read an image as colour: grey is repeated, alpha and further channels left out."""
    decoded = read_image(path)
    names = [name.upper() for name in decoded.channels]
    if all(c in names for c in "RGB"):
        wanted = [names.index(c) for c in "RGB"]
    else:
        wanted = [0, 0, 0] if decoded.pixels.shape[2] < 3 else [0, 1, 2]
    said = decoded.metadata.get("chromaticities")
    chromaticities = tuple(map(float, said)) if said is not None and len(said) == 8 else None
    pixels = np.ascontiguousarray(decoded.pixels[:, :, wanted])
    return ColorImage(pixels, decoded.integer, chromaticities)


class TextureImage(NamedTuple):
    """An image as (H, W, 1) or (H, W, 3) texels, in the number format of its file."""

    pixels: NDArray[Any]  # uint8, uint16, float16 or float32
    integer: bool
    chromaticities: tuple[float, ...] | None


_KEPT = {"uint8": np.uint8, "uint16": np.uint16, "half": np.float16, "float": np.float32}


def read_texture(path: str | os.PathLike[str], channel: str | None = None) -> TextureImage:
    """Read an image without widening its texels; `channel` (r, g, b or a) takes one of them.

    Without `channel` grey stays one channel, and alpha is left out. Formats other than 8 and 16
    bit, half and float become float. Raises ImageError if the file cannot be decoded or lacks the
    channel.
    """
    name = os.fspath(path)
    with _opened(name) as source:
        spec = source.spec()
        wanted = _wanted(list(spec.channelnames), channel, name)
        kind = str(spec.format) if str(spec.format) in _KEPT else "float"
        first, last = min(wanted), max(wanted) + 1
        raw = source.read_image(0, 0, first, last, kind)
        if raw is None:
            raise ImageError(_reason(f"cannot decode the image {name!r}", source.geterror()))
        array = np.asarray(raw).view(_KEPT[kind]).reshape(spec.height, spec.width, last - first)
        if [i - first for i in wanted] != list(range(last - first)):
            array = array[:, :, [i - first for i in wanted]]
        said = spec.getattribute("chromaticities")
        colours = tuple(map(float, said)) if said is not None and len(said) == 8 else None
        integer = str(spec.format) in _INTEGER_KINDS
        return TextureImage(np.ascontiguousarray(array), integer, colours)


def _wanted(names: list[str], channel: str | None, file: str) -> list[int]:
    """Return the indices of the channels that a texture takes."""
    known = [name.upper() for name in names]
    grey = len(names) < 3 and not all(c in known for c in "RGB")
    if channel is None:
        if all(c in known for c in "RGB"):
            return [known.index(c) for c in "RGB"]
        return [0] if grey else [0, 1, 2]
    if channel.upper() in known:
        return [known.index(channel.upper())]
    if grey and channel != "a":
        return [0]
    have = ", ".join(names)
    raise ImageError(f"the image {file!r} has no channel {channel!r}; it has {have}")


def srgb_to_linear(encoded: NDArray[Any]) -> Image:
    """Decode sRGB values in [0, 1] to linear light (IEC 61966-2-1)."""
    x = np.asarray(encoded, np.float64)
    linear = np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.0) + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


def quantise(values: NDArray[Any], bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Round values in [0, 1] to the nearest of 2^bits steps, without dithering; NaN becomes 0."""
    top = (1 << bits) - 1
    clipped = np.clip(np.nan_to_num(np.asarray(values, np.float64), nan=0.0), 0.0, 1.0)
    rounded = np.floor(clipped * top + 0.5)
    return rounded.astype(np.uint8) if bits == 8 else rounded.astype(np.uint16)


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it replaces `path`, else it disappears.

    The bytes are on disk (fsync) before the name appears, so a full disk or a killed process leaves
    either the old file or the new one, never half of it.
    """
    final = Path(path)
    suffix = final.suffix
    try:
        handle, name = tempfile.mkstemp(prefix=".matiere-", suffix=suffix, dir=final.parent)
    except OSError as error:
        raise ImageError(f"cannot write {str(final)!r}: {error.strerror}") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        _sync(temporary)
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(final)
        _sync(final.parent)
    except OSError as error:
        raise ImageError(f"cannot write {str(final)!r}: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("Umask:"):
            return int(line.split()[1], 8)
    return 0o022


@dataclass(frozen=True, slots=True)
class Stored:
    """What one file is to hold: (H, W, C) pixels, the channels' names, and notes about them."""

    pixels: NDArray[Any]
    channels: Sequence[str]
    metadata: Mapping[str, str | int | float | tuple[float, ...]]
    color_space: str = ""  # Color Interop Forum ID; empty: linear Rec.709 in EXR, else sRGB
    quality: int = 95  # of a JPEG, 1 to 100; below 90 colour has half the resolution
    full: int = 0  # so many of the last channels are float in a half EXR


def write_stored(path: str | os.PathLike[str], stored: Stored, pixel_type: str) -> None:
    """Write pixels as they are: `pixel_type` is uint8, uint16, half or float.

    Whole, or not at all. Raises ImageError with the reason.
    """
    data = encode(stored, Path(path).suffix.lower(), pixel_type)
    with atomic_file(path) as temporary:
        temporary.write_bytes(data)


def encode(stored: Stored, suffix: str, pixel_type: str) -> bytes:
    """Return the bytes of an image file of the format that `suffix` (".png", ...) names.

    Encoded in memory: on a full disk some encoders write on in silence and libjpeg ends the
    process. Raises ImageError with the reason.
    """
    oiio = load_oiio()
    height, width, count = stored.pixels.shape
    spec = oiio.ImageSpec(width, height, count, pixel_type)
    spec.channelnames = tuple(stored.channels)
    if stored.full and pixel_type == "half":
        kinds = [oiio.TypeHalf] * (count - stored.full) + [oiio.TypeFloat] * stored.full
        spec.channelformats = tuple(kinds)
    _describe(spec, stored, suffix)
    target = oiio.ImageOutput.create(suffix.removeprefix("."))
    if target is None:
        raise ImageError(_reason(f"cannot make {suffix} files", oiio.geterror()))
    with os.fdopen(os.memfd_create(f"matiere{suffix}", os.MFD_CLOEXEC), "rb") as memory:
        name = f"/proc/self/fd/{memory.fileno()}"
        done = target.open(name, spec)
        done = done and target.write_image(np.ascontiguousarray(stored.pixels))
        why = target.geterror() if not done else ""
        closed = target.close()
        if not done or not closed:
            raise ImageError(_reason(f"cannot encode as {suffix}", why or target.geterror()))
        if not _complete(name, stored, suffix, pixel_type):
            why = "it came out incomplete (a file size limit?)"
            raise ImageError(f"cannot encode as {suffix}: {why}")
        return memory.read()


def _complete(name: str, stored: Stored, suffix: str, pixel_type: str) -> bool:
    """Read an image back: OpenImageIO does not notice every write that failed."""
    if suffix in (".jpg", ".jpeg"):  # lossy: look for the end marker
        return Path(name).read_bytes()[-2:] == b"\xff\xd9"
    oiio = load_oiio()
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(name, config)
    if source is None:
        return False
    try:
        wanted = np.float16 if pixel_type == "half" else np.dtype(pixel_type)
        as_type = pixel_type if wanted != np.float16 else "float"
        read = source.read_image(0, 0, 0, source.spec().nchannels, as_type)
        if read is None:
            return False
        with np.errstate(over="ignore"):
            kept = stored.pixels.astype(wanted).astype(read.dtype)
        if stored.full:
            kept[:, :, -stored.full :] = stored.pixels[:, :, -stored.full :]
        held = list(source.spec().channelnames)  # EXR puts R, G, B, A first
        order = [held.index(c) for c in stored.channels] if suffix == ".exr" else slice(None)
        read = read.reshape(kept.shape)[:, :, order]
        if suffix == ".hdr":  # the channels of a pixel share an exponent
            step = kept.max(axis=2, keepdims=True) / 128
            return bool((np.abs(read - kept) <= step).all())
        return bool(np.array_equal(read, kept, equal_nan=as_type == "float"))
    finally:
        source.close()


def _describe(spec: Any, stored: Stored, suffix: str) -> None:
    names = list(stored.channels)
    spec.alpha_channel = names.index("A") if "A" in names else -1
    if suffix == ".png":
        spec.attribute("oiio:UnassociatedAlpha", 1)
        spec.attribute("png:compressionLevel", 6)
    elif suffix in (".jpg", ".jpeg"):
        spec.attribute("Compression", f"jpeg:{stored.quality}")
        spec.attribute("jpeg:subsampling", "4:4:4" if stored.quality >= 90 else "4:2:0")
    elif suffix == ".exr":
        spec.attribute("compression", "zip")
    usual = LINEAR_REC709 if suffix in (".exr", ".hdr") else SRGB_DISPLAY
    spec.attribute("oiio:ColorSpace", stored.color_space or usual)
    if suffix in (".jpg", ".jpeg"):  # JPEG has one free text and no named attributes
        lines = [f"{key}={value}" for key, value in stored.metadata.items()]
        spec.attribute("ImageDescription", "; ".join(lines))
        return
    for key, value in stored.metadata.items():
        if key == "chromaticities":
            spec.attribute(key, "float[8]", value)
        elif suffix == ".png":  # PNG keeps text only
            spec.attribute(key, str(value))
        else:
            spec.attribute(key, value)


def _reason(what: str, why: str) -> str:
    lines = [line.strip() for line in why.splitlines() if line.strip()]
    return f"{what}: {lines[0]}" if lines else what


# Films and arrays -> files

LINEAR_REC709 = "lin_rec709_scene"
SRGB_DISPLAY = "srgb_rec709_display"
_DEPTHS = {".png": (8, 16), ".jpg": (8,), ".jpeg": (8,), ".exr": (32, 16)}
_TYPES = {8: "uint8", 16: "uint16"}
_FLOATS = {16: "half", 32: "float"}


def write_image(
    path: str | os.PathLike[str],
    film: Film | NDArray[Any],
    *,
    view: str | None = None,
    display: str | None = None,
    config: str | os.PathLike[str] | None = None,
    exposure: float = 0.0,
    despeckle: bool = False,
    bit_depth: int | None = None,
    metadata: Mapping[str, str | int | float] | None = None,
) -> None:
    """Write a film or an array as PNG, JPEG or EXR; the file appears whole or not at all.

    PNG and JPEG show a film through an OpenColorIO view (the default one unless named); an array
    is written as it is, clipped to [0, 1], unless `view`, `display` or `config` asks for one. EXR
    is scene-linear and holds R, G, B (A) and, for a film, the channels `standard_error.R/G/B`;
    with a view asked for it holds display values. `exposure` is in stops. `despeckle` leaves
    specks of single samples out of PNG, JPEG or a view, never out of scene-linear values.
    `bit_depth`: PNG 8 (default) or 16, JPEG 8, EXR 32 (float, default) or 16 (half). `metadata`
    adds to what a film says of itself (scene digest, spp, seconds, relMSE, versions, view).

    Raises ImageError for an unknown file type, bit depth, or a failing write, and ColourError for
    an unknown view.
    """
    suffix = Path(path).suffix.lower()
    depth = _depth(suffix, bit_depth)
    is_film = not isinstance(film, np.ndarray)
    asked = view is not None or display is not None or config is not None
    notes: dict[str, str | int | float] = film_metadata(film) if is_film else {}
    space = ""
    if asked or (is_film and suffix != ".exr"):
        shown = _shown(config, display, view, exposure, despeckle)
        pixels: NDArray[Any]
        pixels, space = _develop(film, shown)
        notes |= {f"matiere:{key}": value for key, value in shown.items() if key != "despeckle"}
        if not isinstance(film, np.ndarray) and despeckle:
            notes["matiere:held_back"] = film.despeckled.energy
    else:
        pixels = scene_linear(film) * np.float32(2.0**exposure)
    notes |= metadata or {}
    names = ["R", "G", "B", "A"][: pixels.shape[2]]
    if suffix != ".exr":
        if suffix != ".png":
            pixels, names = pixels[:, :, :3], names[:3]
        write_stored(path, Stored(quantise(pixels, depth), names, notes, space), _TYPES[depth])
        return
    full = 0
    if not isinstance(film, np.ndarray) and not asked:
        from matiere.aovs import exr_layers

        error = np.asarray(film.standard_error, np.float32) * np.float32(2.0**exposure)
        pixels = np.concatenate([pixels, error], axis=2)
        names += [f"standard_error.{c}" for c in "RGB"]
        layers, called = exr_layers(film)
        pixels = np.concatenate([pixels, *layers], axis=2)
        names += called
        full = len(called)
    stored = Stored(pixels.astype(np.float32), names, notes, space, full=full)
    write_stored(path, stored, _FLOATS[depth])


def _depth(suffix: str, bit_depth: int | None) -> int:
    if suffix not in _DEPTHS:
        raise ImageError(
            f"cannot write {suffix or 'a file without ending'}; use .png, .jpg or .exr"
        )
    allowed = _DEPTHS[suffix]
    if bit_depth is None:
        return allowed[0]
    if bit_depth not in allowed:
        words = " or ".join(map(str, sorted(allowed)))
        raise ImageError(f"{suffix[1:]} files have {words} bits per channel, not {bit_depth}")
    return bit_depth


def _shown(
    config: str | os.PathLike[str] | None,
    display: str | None,
    view: str | None,
    exposure: float,
    despeckle: bool,
) -> dict[str, Any]:
    from matiere.scene.model import DEFAULT_CONFIG, DEFAULT_DISPLAY, DEFAULT_VIEW

    return {
        "config": os.fspath(config or DEFAULT_CONFIG),
        "display": display or DEFAULT_DISPLAY,
        "view": view or DEFAULT_VIEW,
        "exposure": exposure,
        "despeckle": despeckle,
    }


def _develop(film: Any, shown: Mapping[str, Any]) -> tuple[Image, str]:
    from matiere.develop import develop, display_space

    pixels = develop(film, **shown)
    return pixels, display_space(shown["config"], shown["display"], shown["view"])


def scene_linear(film: Film | NDArray[Any], *, despeckle: bool = False) -> Image:
    """Return a film or array as float32 (H, W, 3) or (H, W, 4); ValueError for other shapes.

    A film has a fourth channel, alpha, when it was rendered with a transparent background.
    `despeckle` takes `film.despeckled` for the mean; ImageError for an array.
    """
    if isinstance(film, np.ndarray):
        if despeckle:
            raise ImageError("only a film can be despeckled: an array has no replicates")
        array = np.asarray(film, np.float32)
    else:
        array = np.asarray(film.despeckled.mean if despeckle else film.mean, np.float32)
        if film.transparent:
            alpha = np.asarray(film.alpha, np.float32)[:, :, None]
            array = np.concatenate([array, alpha], axis=2)
    if array.ndim != 3 or array.shape[2] not in (3, 4):
        raise ValueError(f"expected an image of shape (H, W, 3) or (H, W, 4), got {array.shape}")
    return array


def film_metadata(film: Any) -> dict[str, str | int | float]:
    """Return what a film says of itself, as attributes of an image file (`matiere:...`)."""
    report: Mapping[str, Any] = film.report
    error, certificate = report.get("error") or {}, report.get("certificate") or {}
    found = {
        "scene": report.get("scene_digest"),
        "film_key": report.get("film_key"),
        "spp": film.spp,
        "replicates": film.replicates,
        "seconds": report.get("wall_s"),
        "relmse": error.get("relmse"),
        "relmse_lower": error.get("lower"),
        "relmse_upper": error.get("upper"),
        "relmse_any_time_upper": error.get("any_time_upper"),
        "rmse_percent": error.get("rmse_percent"),
        "rmse_percent_upper": error.get("rmse_percent_upper"),
        "look": error.get("look"),
        "certificate": certificate.get("statement"),
        "outside_certificate": " ".join(f"{line}." for line in certificate.get("outside") or ()),
        "reason": report.get("reason"),
        **{key: str(value) for key, value in (report.get("versions") or {}).items()},
    }
    return {
        f"matiere:{key}": value
        for key, value in found.items()
        if isinstance(value, str | int | float)
    }
