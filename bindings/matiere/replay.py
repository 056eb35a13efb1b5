"""Replay one sample of a film: the path in words, vertex by vertex, and the light it met."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from matiere import chunks
from matiere.errors import RenderError

if TYPE_CHECKING:
    from matiere.scene.scene import Scene

ENDS = {
    "escaped": "leaves the scene",
    "emitter": "ends on a light that scatters nothing",
    "absorbed": "is absorbed: the sampled direction carries nothing",
    "max_depth": "ends at max_depth",
    "threshold": "ends as its throughput is below threshold",
    "roulette": "is ended by Russian roulette",
    "black": "ends: nothing is left to carry",
    "depth_guard": "is cut at the guard of 10,000 scattering events (inside media: 16,777,216)",
}
HOW = {
    "light": "by looking for lights",
    "bsdf": "by a direction of the material",
    "camera": "seen by the camera directly",
}


@dataclass(frozen=True, slots=True)
class Replay:
    """One sample again. `path` holds plain JSON values; see docs/replay.md for its keys."""

    path: Mapping[str, Any]

    @property
    def value(self) -> tuple[float, float, float]:
        """Linear R, G, B that the sample gave its pixel, to the bit what the render added."""
        r, g, b = self.path["value"]
        return r, g, b

    @property
    def text(self) -> str:
        """The path in words."""
        return _text(self.path)


def replay(
    scene: Scene,
    *,
    pixel: tuple[int, int],
    replicate: int = 0,
    sample: int = 0,
    seed: int | None = None,
    threads: int = 0,
) -> Replay:
    """Trace one sample of a scene again and return what it met.

    `pixel` is (x, y) in the whole film, from the upper left; `sample` counts from 0 inside the
    replicate. These four and the seed (default: the scene's) are what `report["outliers"]` names.
    `threads` is for building the scene. Raises RenderError for numbers outside the film and
    SceneValidationError where the scene cannot be built.
    """
    from matiere import _core

    asked = scene if seed is None else scene.with_render(seed=_whole("seed", seed, 2**53))
    film = scene.model.film
    x = _whole("pixel x", pixel[0], film.width)
    y = _whole("pixel y", pixel[1], film.height)
    of = chunks.plan(scene.model)
    replicate = _whole("replicate", replicate, of.replicates)
    sample = _whole("sample", sample, _core.MAX_SPP)
    settings = chunks.settings(asked.model)
    record = _core.replay(scene.build(threads), settings, x, y, replicate, sample)
    which = {"pixel": [x, y], "replicate": replicate, "sample": sample, "seed": settings.seed}
    return Replay({**which, **_named(record, scene)})


def _whole(name: str, value: Any, end: int) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number < end:
        raise RenderError(
            f"{name} must be a whole number from 0 to {end - 1}, not {value!r}", code="out_of_range"
        )
    return number


def _named(record: dict[str, Any], scene: Scene) -> dict[str, Any]:
    """Put in what the core does not know: materials by name, and where its origin lies."""
    materials = list(scene.model.materials.items())

    def name(index: int | None) -> str | None:
        return None if index is None else materials[index][0]

    def place(point: list[float]) -> list[float]:
        return [a + b for a, b in zip(point, scene.center, strict=True)]

    record["origin"] = place(record["origin"])
    for vertex in record["vertices"]:
        vertex["position"] = place(vertex["position"])
        index = vertex["material"]
        vertex["model"] = None if index is None else materials[index][1].type
        vertex["material"], vertex["medium"] = name(index), name(vertex["medium"])
    return record


def _text(path: Mapping[str, Any]) -> str:
    x, y = path["pixel"]
    lines = [
        f"pixel ({x}, {y}), replicate {path['replicate']}, sample {path['sample']}, "
        f"seed {path['seed']}: R G B {_numbers(path['value'])} W/m^2/sr",
        f"  from the camera at {_numbers(path['origin'])} towards {_numbers(path['direction'])}",
    ]
    for number, vertex in enumerate(path["vertices"], 1):
        lines += _vertex_lines(number, vertex)
    lines += [f"  in the background: {_light(m)}" for m in path["background"]]
    if path["end"] is not None:
        lines.append(f"  The path {ENDS[path['end']]}.")
    return "\n".join(lines) + "\n"


def _vertex_lines(number: int, v: Mapping[str, Any]) -> list[str]:
    event = v["event"]
    what = "a light" if v["material"] is None else f"'{v['material']}' ({v['model']})"
    side = "" if v["outside"] else " from behind"
    inside = "" if v["medium"] is None else f" inside '{v['medium']}'"
    if event == "scatter_inside":
        what, side = "an event of the medium", ""
    lines = [
        f"{number:3}. after {_number(v['distance'])} m{inside}: {what}{side} at "
        f"{_numbers(v['position'])}, throughput {_numbers(v['throughput'])}"
    ]
    lines += [f"       {_light(m)}" for m in v["lights"]]
    if event == "pass":
        lines.append("       passes straight through")
    elif event == "hidden":
        lines.append("       hidden inside a medium of higher priority: nothing is there to see")
    elif event in ("scatter", "scatter_inside"):
        lines.append(f"       {_scatter(v)}")
    return lines


def _scatter(v: Mapping[str, Any]) -> str:
    delta, inside = "specular" in v["lobe"], v["event"] == "scatter_inside"
    parts = [
        f"goes on by {'scattering' if inside else ' '.join(v['lobe'])}"
        + (", with directions of hidden light mixed in" if v["guided"] else ""),
        f"{'lobe probability' if delta else 'pdf'} {_number(v['pdf'])}" + ("" if delta else " /sr"),
        f"weight {_numbers(v['weight'])}",
    ]
    if v["eta"] != 1:
        parts.append(f"relative index {_number(v['eta'])}")
    if v["lane"] is not None:
        parts.append(f"as {('red', 'green', 'blue')[v['lane']]} alone")
    if v["survival"] < 1:
        parts.append(f"roulette lets it live with probability {_number(v['survival'])}")
    return ", ".join(parts)


def _light(m: Mapping[str, Any]) -> str:
    kind = m["kind"] or "light"
    found = f"{kind} light {m['light']} {HOW[m['how']]}"
    if m["blocked"]:
        return f"{found}: blocked"
    weights = f"MIS weight {_number(m['mis_weight'])}"
    if m["pdf_light"] > 0:
        weights += f", pdf of light sampling {_number(m['pdf_light'])} /sr"
    if m["how"] != "camera" and m["pdf_bsdf"] > 0:
        weights += f", of the material {_number(m['pdf_bsdf'])}"
    return f"{found}: adds {_numbers(m['contribution'])} ({weights})"


def _number(x: float) -> str:
    return f"{x:.4g}"


def _numbers(values: Any) -> str:
    return "(" + ", ".join(_number(v) for v in values) + ")"
