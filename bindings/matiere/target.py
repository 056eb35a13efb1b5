"""Error targets: in relMSE, in percent RMSE, or in code values of the delivered image.

    {"relmse": 0.001}
    {"rmse_percent": 1}                                        # 100 RMSE / mean radiance
    {"display": {"code_values": 1, "pixels_percent": 95}}      # through the OpenColorIO view

A target is reached when the unfavourable end of its any-time interval meets it (docs/error.md).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from matiere.errors import RenderError

if TYPE_CHECKING:
    from matiere import _core
    from matiere.scene.model import SceneModel
    from matiere.scene.model import TargetError as TargetModel

KINDS = ("relmse", "rmse_percent", "display")
MAX_CODE_VALUES = 254
DEFAULT_DISPLAY_TARGET = {"code_values": 1, "pixels_percent": 95.0}
_UPPER = {"relmse": "any_time_upper", "rmse_percent": "rmse_percent_any_time_upper"}

Target = Mapping[str, Any]


def of_scene(model: SceneModel, target: TargetModel | Target | float | None) -> Target | None:
    """Return a target as the stop rule holds it: checked, and a display target with its view.

    Raises RenderError with the pointer of the bad value.
    """
    if target is None:
        return None
    if not isinstance(target, Mapping | float | int):
        target = target.model_dump(exclude_none=True)
    checked = check(target)
    if "display" in checked and "through" not in checked["display"]:
        return through(checked, view_of(model))
    return checked


def view_of(model: SceneModel) -> dict[str, Any]:
    """Return how a scene's images are shown, and if alpha is kept."""
    output = model.output
    return {
        "config": output.config,
        "display": output.display,
        "view": output.view,
        "exposure": output.exposure,
        "despeckle": output.despeckle,
        "transparent": model.background == "transparent",
    }


def through(target: Target, view: Mapping[str, Any]) -> dict[str, Any]:
    """Return a display target that is judged through this view."""
    return {"display": {**target["display"], "through": dict(view)}}


def check(target: Target | float) -> dict[str, Any]:
    """Return a target in its full form; a bare number is a relMSE. Raises RenderError."""
    if not isinstance(target, Mapping):
        return {"relmse": _number("relmse", target)}
    if len(target) != 1 or not set(target) <= set(KINDS):
        why = f"target_error must hold one of {', '.join(KINDS)}, not {dict(target)!r}"
        raise RenderError(why, code="out_of_range", pointer="/render/target_error")
    ((kind, value),) = target.items()
    if kind != "display":
        return {kind: _number(kind, value)}
    known = {*DEFAULT_DISPLAY_TARGET, "through"}
    if not isinstance(value, Mapping) or not set(value) <= known:
        why = "target_error.display holds code_values and pixels_percent"
        raise RenderError(why, code="out_of_range", pointer="/render/target_error/display")
    full = DEFAULT_DISPLAY_TARGET | dict(value)
    codes = _number("display/code_values", full["code_values"], MAX_CODE_VALUES)
    if codes != int(codes):
        why = f"target_error.display.code_values must be a whole number, not {codes}"
        pointer = "/render/target_error/display/code_values"
        raise RenderError(why, code="out_of_range", pointer=pointer)
    share = _number("display/pixels_percent", full["pixels_percent"], 99.999)
    return {"display": full | {"code_values": int(codes), "pixels_percent": share}}


def _number(name: str, value: Any, most: float = float("inf")) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if isinstance(value, bool) or not 0.0 < number <= most or number == float("inf"):
        words = "a positive number" + ("" if most == float("inf") else f" up to {most:g}")
        why = f"target_error.{name.replace('/', '.')} must be {words}, not {value!r}"
        raise RenderError(why, code="out_of_range", pointer=f"/render/target_error/{name}")
    return number


def parse(text: str) -> dict[str, Any]:
    """Read a target as the command line takes it.

    `0.001` and `relmse=0.001`, `rmse_percent=1`, `code_values=1` and
    `code_values=1,pixels_percent=95`. Raises RenderError for anything else.
    """
    if re.fullmatch(r"[-+.\deE]+", text):
        return check({"relmse": text})
    pairs = dict(part.partition("=")[::2] for part in text.replace(" ", "").split(","))
    if set(pairs) <= set(DEFAULT_DISPLAY_TARGET):
        return check({"display": pairs})
    if len(pairs) == 1 and set(pairs) <= {"relmse", "rmse_percent"}:
        return check(pairs)
    raise RenderError(
        f"cannot read the error target {text!r}; write 0.001 (relMSE), rmse_percent=1, or "
        "code_values=1,pixels_percent=95",
        code="out_of_range",
        pointer="/render/target_error",
    )


def excess(target: Target, film: _core.Film) -> float | None:
    """Return how many times the film's samples the target is expected to need; None = unknown."""
    if "display" in target:
        from matiere.display_error import display_error

        found = display_error(film, target["display"])
        return None if found is None else found["excess"]
    return excess_of(target, film.estimate())


def excess_of(target: Target, error: Mapping[str, Any]) -> float | None:
    """Return the same of an estimate (a row of the log), for targets that need no view."""
    kind = next(iter(target))
    if kind == "display":
        found = error.get("display_excess")
        return None if found is None else float(found)
    upper = error.get(_UPPER[kind])
    if upper is None:
        return None
    ratio = float(upper) / float(target[kind])
    return ratio if kind == "relmse" else ratio * ratio


def in_words(target: Target) -> str:
    """Return a target as people read it."""
    if "display" in target:
        codes, share = (target["display"][k] for k in ("code_values", "pixels_percent"))
        some = "code value" if codes == 1 else "code values"
        return f"at most {codes} 8-bit {some} off in {share:g} % of the pixels"
    if "rmse_percent" in target:
        return f"RMSE {target['rmse_percent']:g} % of the mean"
    return f"relMSE {target['relmse']:g}"
