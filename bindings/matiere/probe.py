"""One material outside any scene: vectorised eval, pdf, sample and albedo.

import matiere as mt
b = mt.bsdf({"type": "conductor", "metal": "Au", "alpha": 0.2})
s = b.sample([0, 0, 1], u)                 # u: (N, 3) in [0, 1)
s.wi[s.lobe & mt.Lobe.TRANSMISSION != 0]   # the directions that went through
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntFlag
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from matiere.errors import Fault, ProbeError, SceneValidationError, pointer

if TYPE_CHECKING:
    from matiere import _core
    from matiere.scene.materials import MaterialModel

UNIT_TOLERANCE = 1e-4  # of a direction's length; rounding to half precision passes
MAX_ALBEDO_SAMPLES = 1 << 28


class Lobe(IntFlag):
    """What a scattering event was; a material's `lobes` are all that may occur."""

    DIFFUSE = 1
    GLOSSY = 2
    SPECULAR = 4  # a delta: never evaluates, only samples
    REFLECTION = 8
    TRANSMISSION = 16
    NULL = 32  # passes straight through as if nothing were there


class BsdfSample(NamedTuple):
    """N sampled directions; a row whose `lobe` is 0 was absorbed or rejected and is all zero.

    Attributes:
        wi: (N, 3) unit directions to the light.
        weight: (N, 3) f |cos theta_i| / pdf; a transmission carries the radiance factor 1 / eta^2.
        pdf: (N,) density per solid angle [1/sr]; of a delta lobe, the probability of choosing it.
        lobe: (N,) uint32, `Lobe` flags of each event.
        eta: (N,) index of the transmitted over the incident side; 1 for a reflection.
    """

    wi: NDArray[Any]
    weight: NDArray[Any]
    pdf: NDArray[Any]
    lobe: NDArray[np.uint32]
    eta: NDArray[Any]


class Bsdf:
    """The scattering of one material at a point, in the local frame; made by `matiere.bsdf`.

    Directions are (N, 3) arrays of unit vectors, the normal at +z (x along the tangent), and both
    leave the surface: `wo` to the viewer, `wi` to the light. One direction, as (3,) or (1, 3), goes
    with any number of others. A viewer below the surface sees its other side: interfaces with the
    inverse index, opaque materials as from above (they are two-sided). Answers have the precision
    of the probe: float32 or float64.

    Conventions are those of Veach 1997, chapter 3, and Walter et al. 2007.
    """

    def __init__(
        self,
        material: MaterialModel,
        precision: str = "float",
        asset_root: str | PathLike[str] = ".",
    ) -> None:
        """Use `matiere.bsdf`."""
        from matiere import _core
        from matiere.scene.flatten import core_params

        params = core_params(material, {}, _measured(material, asset_root))
        try:
            self._core: _core.Bsdf = _core.Bsdf(material.type, params, precision)
        except _core.SceneError as error:
            code, where = str(getattr(error, "code", "")), str(getattr(error, "pointer", ""))
            raise SceneValidationError([Fault(where, code, str(error))]) from None
        self._material = material
        self._real = np.float32 if precision == "float" else np.float64

    def __repr__(self) -> str:
        """Return type, precision and parameters."""
        return f"<matiere.Bsdf {self.type} ({self.precision}): {self._material.params()}>"

    @property
    def type(self) -> str:
        """The material type of the JSON."""
        return self._material.type

    @property
    def params(self) -> dict[str, Any]:
        """Every parameter that has a value: given, by default, or implied by what is absent."""
        names = {row["name"] for row in self._material.ROW["params"]}
        return {k: v for k, v in self._material.filled().items() if k in names}

    @property
    def features(self) -> dict[str, bool]:
        """What holds for the model at every parameter: reflection, transmission, interior, ..."""
        return dict(self._material.ROW["features"])

    @property
    def stochastic(self) -> bool:
        """Whether `eval` is an unbiased estimate (then `pdf` is a stand-in for weighting only)."""
        return bool(getattr(self._core, "stochastic", False))

    @property
    def reciprocal(self) -> bool:
        """Whether f(o, i) = f(i, o) is promised, by the model and by those nested in it."""
        return _reciprocal(self._material)

    @property
    def precision(self) -> str:
        """What the formulas were evaluated in: "float" or "double"."""
        return "float" if self._real is np.float32 else "double"

    @property
    def lobes(self) -> Lobe:
        """All kinds of events that `sample` may answer with, at these parameters."""
        return Lobe(self._core.lobes)

    def eval(self, wo: ArrayLike, wi: ArrayLike) -> NDArray[Any]:
        """Return f |cos theta_i| in 1/sr, (N, 3), not negative; zero for impossible pairs.

        A delta lobe evaluates to zero: only `sample` finds it. Transmission carries the radiance
        factor 1 / eta^2. Raises ProbeError for directions that are not finite unit vectors.
        """
        o, i = self._pair(wo, wi, "wi")
        return self._core.eval(o, i)

    def pdf(self, wo: ArrayLike, wi: ArrayLike) -> NDArray[Any]:
        """Return the density of `sample(wo)` at `wi` per solid angle in 1/sr, (N,).

        Its integral over the sphere is 1 less the shares of rejected samples and delta events.
        Raises ProbeError for directions that are not finite unit vectors.
        """
        o, i = self._pair(wo, wi, "wi")
        return self._core.pdf(o, i)

    def sample(self, wo: ArrayLike, u: ArrayLike) -> BsdfSample:
        """Draw a direction for each row of `u`, (N, 3) in [0, 1), the lobe choice first.

        Raises ProbeError for directions that are not finite unit vectors and for random numbers
        outside [0, 1).
        """
        o, numbers = directions(wo, "wo"), rows(u, "u")
        _check_rows(numbers, (numbers >= 0) & (numbers < 1), "u", "numbers must lie in [0, 1)")
        _check_sizes(o, numbers, "u")
        most = 1 - np.finfo(self._real).epsneg  # rounding must not make 1 of what is less
        return BsdfSample(*self._core.sample(self._rounded(o), np.minimum(numbers, most)))

    def albedo(self, wo: ArrayLike, n: int = 4096) -> NDArray[Any]:
        """Return the share of the light arriving from `wo` that is scattered on, (N, 3).

        The mean of n sample weights, taken as energy (without 1 / eta^2), over a Hammersley set:
        1 for a white furnace that loses nothing. Its error falls almost as 1 / n. Raises
        ProbeError for directions that are not finite unit vectors, and for n below 1.
        """
        if not 1 <= n <= MAX_ALBEDO_SAMPLES:
            raise ProbeError(f"n must be 1 to {MAX_ALBEDO_SAMPLES}, got {n}", pointer="/n")
        return self._core.albedo(self._rounded(directions(wo, "wo")), n)

    def _pair(self, wo: ArrayLike, wi: ArrayLike, name: str) -> tuple[NDArray[Any], NDArray[Any]]:
        o, i = directions(wo, "wo"), directions(wi, name)
        _check_sizes(o, i, name)
        return self._rounded(o), self._rounded(i)

    def _rounded(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values, dtype=self._real)


def bsdf(
    description: Mapping[str, Any],
    *,
    precision: str = "float",
    asset_root: str | PathLike[str] = ".",
) -> Bsdf:
    """Return the probe of a material given as in scene JSON, without textures.

    `precision` is "float" (as renders use) or "double": the same formulas in either. `asset_root`
    is the folder of the files that the material names. See `Bsdf` for
    `eval`, `pdf`, `sample` and `albedo`. Raises SceneValidationError, with pointers into
    `description`, for a material that a scene would refuse too, and ValueError for another
    precision.
    """
    if precision not in ("float", "double"):
        raise ValueError(f"precision must be 'float' or 'double', got {precision!r}")
    return Bsdf(validated(description), precision, asset_root)


def _reciprocal(material: MaterialModel) -> bool:
    inner = [v for v in material.params().values() if hasattr(v, "ROW")]
    return bool(material.ROW["features"]["reciprocal"]) and all(map(_reciprocal, inner))


def _measured(material: MaterialModel, asset_root: str | PathLike[str]) -> dict[str, Any]:
    """Return the arrays of the files that a material names."""
    found = material.files()
    if not found:
        return {}
    from matiere.errors import pointed
    from matiere.scene.assets import AssetRoot
    from matiere.scene.measured import load_measured

    assets, arrays = AssetRoot(Path(asset_root)), {}
    for place, name in found.items():
        with pointed(pointer(*place)):
            arrays[name] = load_measured(name, assets)
    return arrays


def validated(description: Mapping[str, Any]) -> MaterialModel:
    """Return the model of a material object without textures; all its faults at once."""
    from pydantic import ValidationError

    from matiere.scene.document import plain
    from matiere.scene.materials import check_material

    value, found = plain(description)
    material = None
    try:
        material = check_material(value)
    except ValidationError as error:
        for line in error.errors(include_url=False):
            found.append(Fault(pointer(*line["loc"]), line["type"], line["msg"]))
    if found or material is None:
        first: dict[str, Fault] = {}
        for each in found:
            first.setdefault(each.pointer, each)
        raise SceneValidationError(first.values())
    if textures := material.textures():
        why = "a material outside a scene takes numbers and colours, no textures"
        raise SceneValidationError([Fault(pointer(*next(iter(textures))), "unsupported", why)])
    return material


def rows(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return (N, 3) real numbers, or raise ProbeError with the pointer of what is wrong."""
    try:
        array = np.asarray(values)
    except ValueError:  # rows of unequal length
        array = np.asarray(None)
    if array.dtype.kind not in "fiu":
        raise ProbeError(f"{name} must be an array of real numbers", pointer=pointer(name))
    if array.shape == (3,):
        array = array.reshape(1, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        why = f"{name} must have shape (N, 3) or (3,), not {array.shape}"
        raise ProbeError(why, pointer=pointer(name))
    return array


def directions(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return (N, 3) finite unit vectors, or raise ProbeError with the pointer of the first bad."""
    w = rows(values, name)
    _check_rows(w, np.isfinite(w), name, "a direction must be finite")
    lengths = np.linalg.norm(w.astype(float), axis=1, keepdims=True)
    _check_rows(w, np.abs(lengths - 1) <= UNIT_TOLERANCE, name, "a direction must have length 1")
    return w


def _check_rows(w: NDArray[Any], good: NDArray[np.bool_], name: str, rule: str) -> None:
    if good.all():
        return
    bad = np.flatnonzero(~good.all(axis=1))
    k = int(bad[0])
    shown = ", ".join(f"{float(x):g}" for x in w[k])
    more = f" ({len(bad)} rows are wrong)" if len(bad) > 1 else ""
    raise ProbeError(f"{rule}, got [{shown}]{more}", pointer=pointer(name, k))


def _check_sizes(a: NDArray[Any], b: NDArray[Any], name: str) -> None:
    if len(a) != len(b) and 1 not in (len(a), len(b)):
        why = f"wo has {len(a)} rows and {name} {len(b)}; give equal numbers, or one row of either"
        raise ProbeError(why, pointer=pointer(name))
