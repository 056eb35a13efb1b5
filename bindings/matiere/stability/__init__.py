"""Stability report: is a material, at its exact parameters, safe to render with?"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matiere.stability.report import Report


def check(
    material: Mapping[str, Any], *, seed: int = 1, asset_root: str | PathLike[str] = "."
) -> Report:
    """Return the stability report of a material given as in scene JSON, without textures.

    Takes about a second: furnace albedo by angle, integral of the pdf, chi-square of sampling,
    agreement of eval and sampling, reciprocity, largest weight, NaN and infinities, float against
    double, and which parameters were treated as limits. `report.verdict` is "pass", "warn" or
    "fail", `report.reason` says why; `print(report)` shows the table, `report.as_dict()` is its
    JSON, `report.save_plots(folder)` draws it. The same material and `seed` give the same report.
    `asset_root` is the folder of the files that the material names.

    Raises SceneValidationError, with pointers into `material`, for a material that a scene would
    refuse too. Sources of the tests: Veach 1997 (sections 5.2 and 10.3.3), Heitz 2014 (furnace).
    """
    from matiere.stability.report import check_material

    return check_material(material, seed=seed, asset_root=asset_root)
