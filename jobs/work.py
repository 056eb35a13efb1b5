"""The one place where jobs meet the renderer: check, render, fold, look, develop.

`Engine` and the children call these functions through a module name, so that tests of kills and
fences can put a stand-in in its place. Nothing else in `matiere.jobs` imports the core.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matiere import chunks
from matiere.jobs.job import JsonDict

if TYPE_CHECKING:
    from matiere import _core
    from matiere.film import Film
    from matiere.scene.assets import AssetRoot
    from matiere.scene.scene import Scene

OPEN_ENDED_SPP = 2**20
THUMBNAIL = 192  # pixels of the longer edge
STOP_KEYS = ("spp", "seconds", "target_error")


# -- submission (in the service) ----------------------------------------------------------------
def plan(width: int, height: int, replicates: int, adaptive: bool = False) -> _core.Plan:
    """Return the chunk plan of a film."""
    from matiere import _core

    return _core.Plan(width, height, replicates, adaptive)


def asset_folder(root: Path, pins: Mapping[str, str]) -> AssetRoot:
    """Return the folder that scenes of one submission find their files in."""
    from matiere.scene.assets import AssetRoot

    return AssetRoot(Path(root), dict(pins))


def file_names(scene: Mapping[str, Any]) -> list[str]:
    """Return the files a raw scene names."""
    from matiere.scene import references

    return [name for _, name, _ in references.files(scene)]


def inspect(scene: Mapping[str, Any], files: AssetRoot) -> JsonDict:
    """Check a scene and return what its film and its job are. Raises SceneValidationError."""
    from matiere.scene.digest import film_key
    from matiere.scene.load import check

    checked = check(dict(scene), files)
    model = checked.model
    width, height = chunks.size(model)
    document = checked.to_dict()
    output = document.pop("output", {})
    for key in STOP_KEYS:
        document.get("render", {}).pop(key, None)
    pins = dict(checked.assets)
    shapes = [document.get("shapes"), sorted(pins.items())]
    skies = document.get("environment"), document.get("background")
    images = [document.get("textures"), *skies, _texture_uses(document)]
    return {
        "film_key": film_key(checked),
        "geometry_key": _digest(shapes),
        "files_key": _digest([*shapes, *images]),
        "scene": document,
        "pins": pins,
        "width": width,
        "height": height,
        "replicates": chunks.plan(model).replicates,
        "stop": chunks.stop_rule(model),
        "output": output,
    }


def _texture_uses(document: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    return [
        (material, parameter, value["texture"])
        for material, parameters in document.get("materials", {}).items()
        for parameter, value in parameters.items()
        if isinstance(value, Mapping) and "texture" in value
    ]


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def check_files(scene: Mapping[str, Any], assets: Mapping[str, Any]) -> None:
    """Read a scene's meshes and images (in the utility child). Raises SceneValidationError.

    Under the `limits` in `assets`, if there are any: images are judged before they are decoded.
    """
    from matiere.jobs import limits
    from matiere.scene.load import load

    loaded = load(scene, asset_root=assets["root"], pins=assets["pins"])
    if allowed := assets.get("limits"):
        limits.check_files(loaded, asset_folder(assets["root"], assets["pins"]), allowed)
    loaded.flatten()


def check_material(
    material: Mapping[str, Any], seed: int, plots: bool, root: str
) -> dict[str, Any]:
    """Return the stability report (in the utility child), with its plots as SVG if asked for.

    `root` is the folder of the files that the material names.
    """
    from matiere.stability import check

    report = check(material, seed=seed, asset_root=root)
    return report.as_dict() | ({"plots": report.plots()} if plots else {})


# -- rendering (in a render child) --------------------------------------------------------------
def warm_up() -> None:
    """Import what the first request needs, so that its cancel is not heard late."""
    from matiere import _core
    from matiere.scene import load

    del _core, load


def cancel_token() -> _core.CancelToken:
    """Return a flag that stops C++ between rows of pixels."""
    from matiere import _core

    return _core.CancelToken()


class OpenScene:
    """A built scene, ready to render chunks on several threads."""

    def __init__(
        self,
        scene: Scene,
        threads: int,
        flag: _core.CancelToken | None = None,
        on_read: Callable[[], None] | None = None,
        like: OpenScene | None = None,
    ) -> None:
        """Build the acceleration structure and light tables, or share those of `like`.

        Raises Cancelled by `flag`.
        """
        self._scene = scene
        shared = None if like is None else like._scene
        self._built = scene.build(threads, flag, on_read, shared)
        self._settings, self._plan = chunks.settings(scene.model), chunks.plan(scene.model)
        self.seeds = (scene.model.render.seed,)

    def render_chunk(self, index: int, flag: _core.CancelToken) -> bytes | None:
        """Render one chunk on this thread; None if cancelled. The GIL is released."""
        part = self.render_part(index, flag)
        return None if part is None else part.to_bytes()

    def render_part(self, index: int, flag: _core.CancelToken) -> _core.ChunkFilm | None:
        """Return the sums of a chunk themselves, for a `Fold` of this process."""
        from matiere import _core

        return _core.render_chunk(self._built, self._settings, self._plan, index, flag)


def open_scene(
    scene: Mapping[str, Any],
    assets: Mapping[str, Any],
    replicates: int,
    threads: int,
    flag: _core.CancelToken | None = None,
    on_read: Callable[[], None] | None = None,
    like: OpenScene | None = None,
) -> OpenScene:
    """Load a pinned scene, its files checked against their digests, and build it.

    `on_read` is called when the files have been read; from then on `flag` stops it (Cancelled).
    Where its shapes are those of `like`, their acceleration structure serves both.
    """
    from matiere.scene.load import load

    render = {**scene.get("render", {}), "replicates": replicates}
    pinned = {**scene, "render": render}
    loaded = load(pinned, asset_root=assets["root"], pins=assets["pins"])
    return OpenScene(loaded, threads, flag, on_read, like)


# -- folding (in the utility child) -------------------------------------------------------------
class Fold:
    """A film that chunks are added to in plan order."""

    def __init__(self, film: _core.Film) -> None:
        """Go on with `film`."""
        self._film = film

    @property
    def film(self) -> _core.Film:
        """The film so far."""
        return self._film

    def add(self, data: memoryview) -> None:
        """Fold in the next chunk of a tile. Raises FilmError for any other."""
        chunks.add(self._film, bytes(data))

    def add_part(self, part: _core.ChunkFilm) -> None:
        """Fold in the sums of the next chunk of a tile, made in this process."""
        self._film.add(part)

    def look(self, spp: int, seconds: float) -> JsonDict:
        """Estimate the error: one row of the log."""
        return chunks.look(self._film, seconds)

    def measured(self, stop: Mapping[str, Any], row: JsonDict) -> JsonDict:
        """Add to a row of the log what a display target needs."""
        return chunks.measured(self._film, stop, row)

    def course(self, most: int) -> JsonDict:
        """Return what an adaptive film has decided about its next chunks."""
        return self._film.course(most)

    def to_bytes(self) -> bytes:
        """Return the film as it is stored."""
        return self._film.to_bytes()


def sign(fold: Fold, scene: OpenScene, film_key: str) -> bytes:
    """Return the bytes of a film's signature, by which nights are compared."""
    from matiere.signature import signature

    engine = next(iter(engines()))
    signed = signature(fold.film, seeds=scene.seeds, film_key=film_key, engine=engine)
    return signed.to_bytes()


def open_fold(of: _core.Plan, stored: memoryview | None) -> Fold:
    """Return the stored film, or an empty one."""
    return Fold(chunks.open_film(None if stored is None else bytes(stored), of))


def look_due(of: _core.Plan, stop: Mapping[str, Any], spp: int) -> bool:
    """Tell whether the log of a job with this stop rule has a row at this boundary."""
    return bool(chunks.next_step(of, stop, spp, 0.0)["look"])


def stop_reason(
    of: _core.Plan,
    stop: Mapping[str, Any],
    spp: int,
    seconds: float,
    newest: Mapping[str, Any] | None,
) -> str | None:
    """Return why a job ends at this boundary, or None if it goes on."""
    step = chunks.next_step(of, stop, spp, seconds, newest)
    return None if step["go_on"] else str(step["reason"])


def target_share(stop: Mapping[str, Any], newest: Mapping[str, Any]) -> float | None:
    """Return the share of the samples to the target error that are done, or None if unknown.

    For a display target the row of the log must have passed through `measured`.
    """
    from matiere.target import excess_of

    excess = excess_of(stop["target_error"], newest) if stop.get("target_error") else None
    return 1.0 / excess if excess else None


# -- images (in the utility child) --------------------------------------------------------------
def make_picture(stored: memoryview, header: JsonDict, request: JsonDict) -> bytes:
    """Return the PNG of a finished job alone."""
    output = request["output"]
    film = _film(stored, header, request)
    return _image(film, ".png", bit_depth=output.get("bit_depth", {}).get("png"), **_view(output))


def _view(output: Mapping[str, Any]) -> JsonDict:
    shown = ("config", "display", "view", "exposure", "despeckle")
    return {key: output[key] for key in shown if key in output}


def make_images(stored: memoryview, header: JsonDict, request: JsonDict) -> dict[str, bytes]:
    """Return the files of a finished job by kind: PNG, EXR, report, error plot."""

    from matiere.report import picture_report
    from matiere.signature import signature

    film = _film(stored, header, request)
    output = request["output"]
    depths = output.get("bit_depth", {})
    view = _view(output)
    job = request["job"]
    report = film.report | {
        "job": job,
        "assets": request["assets"]["pins"],
        "chunks_rendered": request["chunks_rendered"],
        "reports_superseded": request["reports_superseded"],
        "picture": picture_report(film, bool(output.get("despeckle"))),
    }
    return {
        "image.png": _image(film, ".png", bit_depth=depths.get("png"), **view),
        "image.exr": _image(film, ".exr", bit_depth=depths.get("exr")),
        "thumbnail.jpg": _small(film, view, THUMBNAIL),
        "report.json": json.dumps(report, allow_nan=False, indent=1).encode(),
        "error.svg": _plot(film, job["label"]).encode(),
        "signature": signature(film).to_bytes(),
    }


def _film(stored: memoryview, header: JsonDict, request: JsonDict) -> Film:
    from matiere.film import Film, FilmInfo
    from matiere.scene.load import load

    job = request["job"]
    render = {**request["scene"].get("render", {}), "replicates": request["replicates"]}
    document = {**request["scene"], "render": render, "output": request["output"]}
    assets = request["assets"]
    scene = load(document, asset_root=assets["root"], pins=assets["pins"])
    of = chunks.plan(scene.model)
    if "position" in scene.model.film.aovs:
        scene.flatten()  # finds where the core's origin lies
    info = replace(
        FilmInfo.of_scene(scene),
        log=tuple(header["log"]),
        reason=job["stop_reason"],
        requested=job["stop"],
        threads=request["threads"],
    )
    return Film(chunks.open_film(bytes(stored), of), info)


@cache
def engines() -> dict[str, Any]:
    """Return the fingerprint of this engine by its digest, as signatures name it."""
    from matiere.scene.digest import fingerprint
    from matiere.signature import engine_digest

    mine = fingerprint()
    return {engine_digest(mine): mine}


def _plot(film: Film, label: str) -> str:
    from matiere.plot import certificate_plot

    try:
        return certificate_plot(film, label or "this job").svg()
    except ValueError as error:  # one replicate, or all replicates equal: an answer all the same
        return (
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 720 60" width="720" height="60" '
            f'font-family="sans-serif" font-size="14"><text x="12" y="36">{error}</text></svg>\n'
        )


def _image(film: Film, suffix: str, **options: Any) -> bytes:
    from matiere.imageio import write_image

    with tempfile.TemporaryDirectory(prefix="matiere-") as folder:
        path = Path(folder) / f"image{suffix}"
        write_image(path, film, **options)
        return path.read_bytes()


def _small(film: Film, view: Mapping[str, Any], longest: int) -> bytes:
    """Return a film as JPEG of at most so many pixels: averaged in linear light, then developed."""
    from matiere.imageio import scene_linear

    light = scene_linear(film, despeckle=view.get("despeckle", False))
    plain = {key: value for key, value in view.items() if key != "despeckle"}
    return _shown_as(light, plain, ".jpg", longest)


def smaller(image: Any, longest: int) -> Any:
    """Average whole blocks of pixels until the longer edge is at most `longest`."""
    block = -(-max(image.shape[:2]) // longest)
    if block == 1:
        return image
    height, width = (max(1, edge // block) for edge in image.shape[:2])
    rows, columns = (min(block, edge) for edge in image.shape[:2])
    cut = image[: height * rows, : width * columns]
    return cut.reshape(height, rows, width, columns, -1).mean(axis=(1, 3))


def draw_image(path: str, request: JsonDict) -> bytes:
    """Return the linear image of an ended job, an EXR, as PNG or JPEG through another view."""
    from matiere.imageio import Decoded, read_image

    read: Decoded = read_image(path)
    kept = [read.channels.index(c) for c in "RGBA" if c in read.channels]
    view = {k: v for k, v in _view(request["output"]).items() if k != "despeckle"}
    light = read.pixels[:, :, kept]
    return _shown_as(light, view | request["shown"], request["suffix"], request["longest"])


def _shown_as(light: Any, view: Mapping[str, Any], suffix: str, longest: int | None) -> bytes:
    """Return linear pixels through a view, averaged down to `longest` pixels first if given."""
    from matiere.develop import develop
    from matiere.imageio import Stored, encode, quantise

    shown = quantise(develop(smaller(light, longest) if longest else light, **view), 8)
    if suffix == ".jpg":
        return encode(Stored(shown[:, :, :3], ["R", "G", "B"], {}, quality=90), suffix, "uint8")
    names = ["R", "G", "B", "A"][: shown.shape[2]]
    return encode(Stored(shown, names, {}), suffix, "uint8")


def draw_film(stored: memoryview, header: JsonDict, request: JsonDict) -> bytes:
    """Return a film as PNG or JPEG through a view: `shown`, `suffix` and, or not, `longest`."""
    film = _film(stored, header, request)
    view = _view(request["output"]) | request["shown"]
    if request["longest"]:
        return _small(film, view, request["longest"])
    return _image(film, request["suffix"], **view)


def draw_difference(
    a: tuple[memoryview, JsonDict, JsonDict], b: tuple[memoryview, JsonDict, JsonDict]
) -> tuple[bytes, JsonDict]:
    """Return what differs between two films (stored, header, request): PNG and report."""
    from matiere.compare import compare
    from matiere.imageio import Stored, encode, quantise

    found = compare(_film(*a), _film(*b))
    says = {"matiere:comparison": found.report["statement"]}
    picture = Stored(quantise(found.picture(), 8), ["R", "G", "B"], says)
    return encode(picture, ".png", "uint8"), found.report


BALL_PX, BALL_SPP, BALL_S = 192, 24, 1.5
BALL: JsonDict = {
    "version": 1,
    "camera": {"type": "pinhole", "origin": [0, 1.75, 5], "target": [0, 0.96, 0], "vfov_deg": 28},
    "film": {"width": BALL_PX, "height": BALL_PX},
    "shapes": [
        {"type": "sphere", "center": [0, 1, 0], "radius": 1, "material": "ball"},
        {
            "type": "mesh",
            "positions": [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]],
            "triangles": [[0, 2, 1], [0, 3, 2]],
            "material": "floor",
        },
    ],
    "lights": [
        {"type": "rectangle", "corner": [-3.5, 4.8, 0.5], "edge_u": [2.5, 0, 0],
         "edge_v": [0, -0.8, 2.2], "radiance": [17, 16, 14.5]},
        {"type": "rectangle", "corner": [2.6, 0.2, 1.8], "edge_u": [0, 2.6, 0],
         "edge_v": [0.4, 0, -1.6], "radiance": [6, 7, 8.5]},
    ],
    "environment": {"radiance": [0.6, 0.63, 0.7]},
}  # fmt: skip


def draw_ball(material: JsonDict, root: str) -> bytes:
    """Return a small ball of a material as PNG. Raises SceneValidationError with pointers."""
    from matiere.errors import Fault, SceneValidationError
    from matiere.render import render
    from matiere.scene.load import load

    floor = {"type": "lambert", "albedo": [0.35, 0.36, 0.38]}
    scene = {**BALL, "materials": {"ball": material, "floor": floor}}
    try:
        film = render(load(scene, asset_root=root), spp=BALL_SPP, seconds=BALL_S, threads=1)
    except SceneValidationError as error:
        prefix = "/materials/ball"
        raise SceneValidationError(
            Fault(f["pointer"].removeprefix(prefix), f["code"], f["message"], f.get("suggestion"))
            for f in error.errors
        ) from None
    return _image(film, ".png")


def make_sheet(cells: Sequence[Mapping[str, Any]], request: JsonDict) -> bytes:
    """Return the contact sheet of a sweep as PNG bytes."""
    from matiere.jobs.sheet import draw

    return draw(cells, request)
