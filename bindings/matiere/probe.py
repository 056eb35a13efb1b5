"""One material outside any scene: vectorised eval, pdf, sample and albedo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from matiere.errors import Fault, SceneValidationError, pointer

if TYPE_CHECKING:
    from matiere import _core


def bsdf(description: Mapping[str, Any], *, precision: str = "float") -> _core.Bsdf:
    """Return the probe of a material given as in scene JSON, without textures.

    Directions are (N, 3) unit vectors in the local frame (normal +z), both leaving the surface;
    a single row goes with any number of rows. `eval(wo, wi)` is f |cos theta_i| (N, 3) in 1/sr,
    `pdf(wo, wi)` the density of `sample` per solid angle (N,), `sample(wo, u)` with u (N, 3) in
    [0, 1), the lobe choice first, a namedtuple wi (N, 3), weight (N, 3), pdf (N,), lobe (N,), eta
    (N,), where a rejected row has pdf 0 and lobe 0; `albedo(wo, n)` the share of light scattered
    (N, 3). Lobe flags: 1 diffuse, 2 glossy, 4 delta, 8 reflection, 16 transmission, 32 null.

    `precision` is "float" or "double": the same formulas in either. Raises SceneValidationError
    with pointers into `description`.
    """
    from pydantic import ValidationError

    from matiere import _core
    from matiere.scene.document import plain
    from matiere.scene.flatten import core_params
    from matiere.scene.materials import check_material

    if precision not in ("float", "double"):
        raise ValueError(f"precision must be 'float' or 'double', got {precision!r}")
    value, found = plain(description)
    try:
        material = check_material(value)
    except ValidationError as error:
        for line in error.errors(include_url=False):
            found.append(Fault(pointer(*line["loc"]), line["type"], line["msg"]))
    if found:
        raise SceneValidationError({f.pointer: f for f in reversed(found)}.values())
    if textures := material.textures():
        why = "a material outside a scene takes numbers and colours, no textures"
        raise SceneValidationError([Fault(pointer(next(iter(textures))), "unsupported", why)])
    return _core.Bsdf(material.type, core_params(material, {}), precision)
