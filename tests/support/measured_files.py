"""Files of measured reflection made for tests: no measurement, closed forms and random tables."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

REAL = Path(__file__).resolve().parents[3] / "shared" / "assets" / "measured" / "rgl"
SCALE = np.array([1.0, 1.15, 1.66]) / 1500
CODES = {"u1": 1, "u2": 3, "f4": 10, "f8": 11}


def real_files() -> list[Path]:
    """Return RGL's own files where they are at hand (../shared/assets), else none."""
    return sorted(REAL.glob("*.bsdf"))


ALBEDO = np.array([0.9, 0.5, 0.1])


def lambert(h: Any, d: Any, p: Any) -> Any:
    """Return a constant value, as a function of Rusinkiewicz's angles."""
    return [a / np.pi + 0 * (h + d + p) for a in ALBEDO]


def glossy(h: Any, d: Any, p: Any) -> Any:
    """Return a lobe that depends on all three angles and keeps reciprocity."""
    lobe = 0.4 * np.cos(h) ** 40 * (1 + 0.3 * np.cos(2 * p) * np.sin(d))
    return [0.2 / np.pi + lobe * c for c in (1.0, 0.7, 0.4)]


def made() -> dict[str, Any]:
    """Return the arrays of every kind of file, by name, as the readers give them."""
    from matiere.scene.measured import read_merl, read_rgl

    return {
        "merl-lambert": read_merl(merl_bytes(merl_table(lambert))),
        "merl-glossy": read_merl(merl_bytes(merl_table(glossy))),
        "rgl-isotropic": read_rgl(tensor_bytes(rgl_fields())),
        "rgl-whole-circle": read_rgl(tensor_bytes(rgl_fields(5))),
        "rgl-half-circle": read_rgl(tensor_bytes(rgl_fields(5, np.pi))),
        "rgl-quarter-circle": read_rgl(tensor_bytes(rgl_fields(4, np.pi / 2))),
    }


def merl_table(f: Any) -> np.ndarray:
    """Return (3, 90, 90, 180) values of f(theta_h, theta_d, phi_d) at the centres of the cells."""
    h = (np.pi / 2 * ((np.arange(90) + 0.5) / 90) ** 2)[:, None, None]
    d = ((np.arange(90) + 0.5) / 90 * np.pi / 2)[None, :, None]
    p = ((np.arange(180) + 0.5) / 180 * np.pi)[None, None, :]
    return np.stack([np.broadcast_to(channel, (90, 90, 180)) for channel in f(h, d, p)])


def merl_bytes(table: np.ndarray) -> bytes:
    """Return the file of a table in 1/sr."""
    return struct.pack("<3i", 90, 90, 180) + (table / SCALE[:, None, None, None]).tobytes()


def tensor_bytes(fields: dict[str, np.ndarray]) -> bytes:
    """Return a tensor file with these fields."""
    head = b"tensor_file\0" + struct.pack("<BBI", 1, 0, len(fields))
    size = len(head) + sum(13 + len(n) + 8 * a.ndim for n, a in fields.items())
    table, body = b"", b""
    for name, a in fields.items():
        table += struct.pack("<H", len(name)) + name.encode()
        table += struct.pack("<HBQ", a.ndim, CODES[a.dtype.str[1:]], size + len(body))
        table += struct.pack(f"<{a.ndim}Q", *a.shape)
        body += a.tobytes()
    return head + table + body


def rgl_fields(azimuths: int = 1, span: float = 2 * np.pi, seed: int = 1) -> dict[str, Any]:
    """Return an RGL measurement with random tables; the azimuths cover `span` from -pi on."""
    rng = np.random.default_rng(seed)
    start = -np.pi if azimuths > 1 else 0.0

    def table(*shape: int) -> np.ndarray:
        return (0.2 + rng.random(shape)).astype("f4")

    return {
        "description": np.frombuffer(b"random tables for a test", "u1"),
        "theta_i": np.linspace(0, np.pi / 2, 4).astype("f4"),
        "phi_i": np.linspace(start, start + span, azimuths).astype("f4"),
        "sigma": table(5, 6) if azimuths > 1 else np.repeat(table(1, 6), 2, axis=0),
        "ndf": table(7, 8),
        # As in real files: a density of half-vectors times the Jacobian of u^2, 0 at the pole.
        "vndf": table(azimuths, 4, 9, 8) * (np.linspace(0, 1, 8) ** 3).astype("f4"),
        "luminance": table(azimuths, 4, 6, 5),
        "rgb": 0.3 * table(azimuths, 4, 3, 6, 5),
        "jacobian": np.ones(1, "u1"),
    }
