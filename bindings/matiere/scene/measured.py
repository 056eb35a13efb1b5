"""Read files of measured reflection: MERL's `.binary` tables and RGL's `.bsdf` tensors.

MERL: Matusik et al. 2003. RGL: Dupuy & Jakob 2018; spectra become linear Rec.709 here, under CIE
D65, with the 1931 2-degree observer in the multi-lobe fit of Wyman, Sloan & Shirley 2013 (eq. 4),
scaled so that a spectrum of ones is white.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matiere.errors import Fault, SceneValidationError
from matiere.scene.assets import AssetRoot

Arrays = dict[str, NDArray[np.float32]]

MERL_SHAPE = (90, 90, 180)  # theta_h, theta_d, phi_d
MERL_SCALE = (1.0 / 1500, 1.15 / 1500, 1.66 / 1500)
MAGIC = b"tensor_file\0"
MAX_FIELDS = 64
# Type codes of a tensor file's fields.
TYPES = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2",
         10: "<f4", 11: "<f8"}  # fmt: skip
RGL_FIELDS = ("theta_i", "phi_i", "ndf", "sigma", "vndf", "luminance")

# Relative power of CIE D65 at 380, 390, ... 780 nm (CIE 15).
D65 = (
    49.9755, 54.6482, 82.7549, 91.486, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861,
    115.923, 108.811, 109.354, 107.802, 104.79, 107.689, 104.405, 104.046, 100.0, 96.3342,
    95.788, 88.6856, 90.0062, 89.5991, 87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778,
    78.2842, 69.7213, 71.6091, 74.349, 61.604, 69.8856, 75.087, 63.5927, 46.4182, 66.8054,
    63.3828,
)  # fmt: skip
XYZ_TO_REC709 = np.array([
    [3.2404542, -1.5371385, -0.4985314],
    [-0.9692660, 1.8760108, 0.0415560],
    [0.0556434, -0.2040259, 1.0572252],
])  # fmt: skip


def load_measured(name: str, assets: AssetRoot) -> Arrays:
    """Return the arrays of a file as the core takes them; raise SceneValidationError without place.

    MERL: `merl` (3, 90, 90, 180), scaled to 1/sr. RGL: `theta_i`, `phi_i` in radians, `ndf`,
    `sigma`, `vndf`, `luminance`, and `rgb` (phi_i, theta_i, 3, h, w) in linear Rec.709.
    """
    data = assets.read(name)
    try:
        arrays = read_rgl(data) if data.startswith(MAGIC) else read_merl(data)
    except ValueError as error:
        raise SceneValidationError([Fault("", "asset_format", f"{name!r}: {error}")]) from None
    return arrays


def read_merl(data: bytes) -> Arrays:
    """Return the table of a MERL file; ValueError says what is wrong with it."""
    if len(data) < 12:
        raise ValueError("is neither a MERL nor an RGL file: it has fewer than 12 bytes")
    shape = struct.unpack_from("<3i", data)
    if shape != MERL_SHAPE:
        raise ValueError(
            f"is neither an RGL file nor a MERL table: its size reads {shape}, not {MERL_SHAPE}"
        )
    count = int(np.prod(MERL_SHAPE)) * 3
    if len(data) != 12 + 8 * count:
        raise ValueError(f"a MERL table has {12 + 8 * count} bytes, this file {len(data)}")
    table = np.frombuffer(data, "<f8", count, 12).reshape(3, *MERL_SHAPE)
    if not np.isfinite(table).all():
        raise ValueError("holds values that are not finite")
    return {"merl": (table * np.reshape(MERL_SCALE, (3, 1, 1, 1))).astype(np.float32)}


def read_rgl(data: bytes) -> Arrays:
    """Return the arrays of an RGL file; ValueError says what is wrong with it."""
    fields = tensors(data)
    missing = [name for name in RGL_FIELDS if name not in fields]
    if missing:
        raise ValueError(f"lacks the fields {', '.join(missing)} of an RGL measurement")
    arrays = {name: _real(name, fields[name]) for name in RGL_FIELDS}
    if "rgb" in fields:
        arrays["rgb"] = _real("rgb", fields["rgb"])
    elif "spectra" in fields and "wavelengths" in fields:
        arrays["rgb"] = rec709(_real("spectra", fields["spectra"]), fields["wavelengths"])
    else:
        raise ValueError("has neither the field rgb nor spectra with wavelengths")
    return arrays


def tensors(data: bytes) -> dict[str, NDArray[Any]]:
    """Return the fields of a tensor file; ValueError where it is cut short or makes no sense."""
    try:
        major, _, count = struct.unpack_from("<BBI", data, 12)
        if major != 1:
            raise ValueError(f"is a tensor file of version {major}; 1 can be read")
        if count > MAX_FIELDS:
            raise ValueError(f"claims {count} fields; at most {MAX_FIELDS} make sense")
        place, fields = 18, {}
        for _ in range(count):
            name, array, place = _field(data, place)
            fields[name] = array
    except struct.error:
        raise ValueError("ends within its header: it was cut short") from None
    return fields


def _field(data: bytes, place: int) -> tuple[str, NDArray[Any], int]:
    (length,) = struct.unpack_from("<H", data, place)
    name = data[place + 2 : place + 2 + length].decode("utf-8", "replace")
    place += 2 + length
    dimensions, code, offset = struct.unpack_from("<HBQ", data, place)
    if code not in TYPES:
        raise ValueError(f"field {name!r} has the unknown type {code}")
    if not 1 <= dimensions <= 8:
        raise ValueError(f"field {name!r} has {dimensions} dimensions; 1 to 8 make sense")
    shape = struct.unpack_from(f"<{dimensions}Q", data, place + 11)
    kind = np.dtype(TYPES[code])
    count = 1
    for size in shape:  # whole numbers of Python: they do not overflow
        count *= size
    if offset + count * kind.itemsize > len(data):
        raise ValueError(f"field {name!r} reaches beyond the end: the file was cut short")
    array = np.frombuffer(data, kind, count, offset).reshape(shape)
    return name, array, place + 11 + 8 * dimensions


def _real(name: str, array: NDArray[Any]) -> NDArray[np.float32]:
    if array.dtype.kind != "f":
        raise ValueError(f"field {name!r} holds no floating-point numbers")
    if not np.isfinite(array).all():
        raise ValueError(f"field {name!r} holds values that are not finite")
    return np.asarray(array, np.float32)


def rec709(spectra: NDArray[np.float32], wavelengths: NDArray[Any]) -> NDArray[np.float32]:
    """Return (..., 3, h, w) linear Rec.709 of (..., wavelength, h, w); wavelengths in nm.

    Colours outside the gamut get a channel below zero; the core takes it as zero.
    """
    nodes = np.asarray(wavelengths, np.float64).ravel()
    if spectra.ndim != 5 or spectra.shape[2] != len(nodes):
        raise ValueError("fields spectra and wavelengths do not fit each other")
    if len(nodes) < 2 or not (np.diff(nodes) > 0).all() or not np.isfinite(nodes).all():
        raise ValueError("wavelengths must be at least two and increase")
    rgb = np.einsum("cl,ptlhw->ptchw", channel_weights(nodes), spectra)
    return np.asarray(rgb, np.float32)


def channel_weights(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return W (3, wavelengths) with rgb = W @ reflectance, every row adding up to 1.

    Between its nodes a spectrum is linear, beyond them constant.
    """
    lam = np.arange(380.0, 781.0)
    light = np.interp(lam, np.arange(380.0, 781.0, 10.0), D65)
    channels = XYZ_TO_REC709 @ (observer(lam) * light)
    hats = np.stack([np.interp(lam, nodes, row) for row in np.eye(len(nodes))])
    weights = channels @ hats.T
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def observer(lam: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x, y, z (3, N) of the CIE 1931 observer, Wyman et al. 2013, equation 4."""

    def lobe(height: float, mean: float, left: float, right: float) -> NDArray[np.float64]:
        t = (lam - mean) / np.where(lam < mean, left, right)
        return np.asarray(height * np.exp(-0.5 * t * t))

    x = lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7)
    x = x + lobe(-0.065, 501.1, 20.4, 26.2)
    y = lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1)
    z = lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8)
    return np.stack([x, y, z])
