"""`matiere render`: one scene, here and now, without any store."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from matiere import Film, Scene

Progress = Mapping[str, Any]
TARGET_HELP = (
    "Stop at this error: 0.001 (relMSE), rmse_percent=1, or code_values=1,pixels_percent=95 "
    "(8-bit steps in the delivered image)."
)

Denoise = Annotated[
    bool,
    typer.Option(
        "--denoise",
        help="Also write out.denoised.png beside out.png: smooth, without an error bar "
        "(pip install 'matiere[denoise]').",
    ),
]
Despeckle = Annotated[
    bool | None,
    typer.Option(help="Leave specks of single samples out of PNG and JPEG (EXR keeps them)."),
]


def render(
    scene: Annotated[Path, typer.Argument(help="Scene (JSON).", show_default=False)],
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output", "-o", help="Image to write: .png, .jpg or .exr; may be given again."
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write the report (error against time) as JSON.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Write error against time as a plot: .svg or .png.")
    ] = None,
    film: Annotated[
        Path | None, typer.Option(help="Save the film, to continue or merge it later.")
    ] = None,
    resume: Annotated[Path | None, typer.Option(help="Continue this saved film.")] = None,
    spp: Annotated[
        int | None, typer.Option(min=1, help="Samples per pixel (rounded up to whole passes).")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Stop after this time.")] = None,
    target_error: Annotated[str | None, typer.Option(help=TARGET_HELP)] = None,
    threads: Annotated[
        int, typer.Option(min=0, help="Render threads; 0: one per usable core.")
    ] = 0,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the random numbers.")] = None,
    adaptive: Annotated[
        bool | None,
        typer.Option(help="More samples for the tiles where they lower the error most."),
    ] = None,
    view: Annotated[str | None, typer.Option(help="OpenColorIO view.")] = None,
    display: Annotated[str | None, typer.Option(help="OpenColorIO display.")] = None,
    exposure: Annotated[float | None, typer.Option(help="Exposure in stops.")] = None,
    despeckle: Despeckle = None,
    denoise: Denoise = False,
    asset_root: Annotated[
        Path | None, typer.Option(help="Folder of the scene's files (default: its own).")
    ] = None,
    memory_limit: Annotated[
        float | None,
        typer.Option(help="Memory the film may take, GiB (default: half of the free)."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Render a scene and write it with its error bar.

    Stops at whichever comes first of --spp, --seconds and --target-error (or what the scene says).
    Example: matiere render scene.json -o out.png --seconds 30
    """
    import matiere as mt

    with _worded(scene):
        loaded = mt.load(scene, asset_root=asset_root)
        shown = _view(loaded, view, display, exposure, despeckle)
        files = _outputs(loaded, scene, output, (film, report, plot))
        stop = _stop(loaded, spp, seconds, target_error, shown)
        made_by = _denoiser() if denoise else None
        if not quiet:
            typer.echo(_film_line(loaded), err=True)
        old = mt.load_film(resume) if resume is not None else None
        with _progress(quiet) as callback:
            done = mt.render(
                loaded,
                **stop,
                seed=seed,
                adaptive=adaptive,
                threads=threads,
                film=old,
                callback=callback,
                memory_limit=None if memory_limit is None else int(memory_limit * 2**30),
            )
        for path in files:
            _write(path, done, loaded, shown)
        if made_by is not None:
            files += _write_denoised(files, done, loaded, shown, made_by)
        beside = _write_beside(done, (film, report, plot), scene.stem, shown["despeckle"])
    if not quiet:
        written = [*files, *beside]
        _summary(done, loaded, shown["despeckle"], written)


@contextmanager
def _worded(scene: Path) -> Iterator[None]:
    """Print errors as `scene.json: /pointer: what to do` and end with code 2."""
    from matiere.errors import MatiereError, SceneValidationError

    try:
        yield
    except SceneValidationError as error:
        for fault in error.faults:
            place = f"{scene}: {fault.pointer}" if fault.pointer else f"{scene}"
            typer.echo(f"{place}: {fault.message}", err=True)
        raise typer.Exit(2) from None
    except MatiereError as error:
        place = f"{scene}: {error.pointer}: " if error.pointer else ""
        typer.echo(f"{place}{error.message}", err=True)
        raise typer.Exit(2) from None
    except KeyboardInterrupt:
        typer.echo("interrupted; nothing was written", err=True)
        raise typer.Exit(130) from None


def _stop(
    loaded: Scene,
    spp: int | None,
    seconds: float | None,
    target_error: str | None,
    shown: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the stop rule: the flags if there are any, else what the scene says."""
    from matiere import target

    settings = loaded.model.render
    asked = None if target_error is None else target.parse(target_error)
    goal = target.of_scene(loaded.model, asked)
    if spp is None and seconds is None and target_error is None:
        spp, seconds = settings.spp, settings.seconds
        goal = target.of_scene(loaded.model, settings.target_error)
    if goal and "display" in goal:  # the view of the flags, not only of the scene
        goal = target.through(goal, {**goal["display"]["through"], **shown})
    return {"spp": spp, "seconds": seconds, "target_error": goal}


def _view(
    loaded: Scene,
    view: str | None,
    display: str | None,
    exposure: float | None,
    despeckle: bool | None,
) -> dict[str, Any]:
    """Return what `write_image` shows a film with; unknown names fail before the render."""
    from matiere.develop import check_view

    output = loaded.model.output
    shown = {
        "config": output.config,
        "display": display or output.display,
        "view": view or output.view,
    }
    if view is not None or display is not None:
        check_view(shown["config"], shown["display"], shown["view"])
    return {
        **shown,
        "exposure": output.exposure if exposure is None else exposure,
        "despeckle": output.despeckle if despeckle is None else despeckle,
    }


def _outputs(
    loaded: Scene, scene: Path, output: list[Path] | None, others: tuple[Path | None, ...]
) -> list[Path]:
    """Return the images to write, after checking that they can be written."""
    from matiere.errors import ImageError

    files = output or [scene.parent / name for name in loaded.model.output.files]
    if not files and not any(others):
        raise ImageError(
            'say where to write: -o out.png, or "output": {"files": [...]} in the scene'
        )
    plot = others[-1]
    if plot is not None and plot.suffix.lower() not in (".svg", ".png"):
        raise ImageError(f"cannot write {str(plot)!r}; a plot is .svg or .png")
    for path in files:
        if path.suffix.lower() not in (".png", ".jpg", ".jpeg", ".exr"):
            raise ImageError(f"cannot write {str(path)!r}; use .png, .jpg or .exr")
    for place in [*files, *(p for p in others if p is not None)]:
        folder = place.parent
        if not folder.is_dir():
            raise ImageError(f"the folder of {str(place)!r} does not exist; make it first")
        if place.is_dir() or not os.access(folder, os.W_OK):
            raise ImageError(f"{str(place)!r} cannot be written")
    return list(files)


def _write(path: Path, done: Film, loaded: Scene, shown: Mapping[str, Any]) -> None:
    from matiere.imageio import write_image

    depth = loaded.model.output.bit_depth
    suffix = path.suffix.lower()
    if suffix == ".exr":  # scene-linear: neither view nor exposure
        write_image(path, done, bit_depth=depth.exr)
    else:
        write_image(path, done, **shown, bit_depth=depth.png if suffix == ".png" else 8)


def _denoiser() -> dict[str, str]:
    """Return what denoised pictures say of themselves; fails where they cannot be made."""
    from matiere.denoise import notes

    return notes()


def _write_denoised(
    files: list[Path], done: Film, loaded: Scene, shown: Mapping[str, Any], made_by: dict[str, str]
) -> list[Path]:
    """Write a denoised picture beside each image; return where."""
    from matiere.denoise import beside, denoise
    from matiere.imageio import write_image

    depth = loaded.model.output.bit_depth
    depths = {".exr": depth.exr, ".png": depth.png}
    view = {key: value for key, value in shown.items() if key != "despeckle"}
    cleaned, written = denoise(done), [beside(path) for path in files]
    for path in written:
        suffix = path.suffix.lower()
        options = {} if suffix == ".exr" else view
        depth_of = depths.get(suffix, 8)
        write_image(path, cleaned, **options, bit_depth=depth_of, metadata=made_by)
    return written


def _write_beside(
    done: Film, places: tuple[Path | None, ...], label: str, despeckle: bool
) -> list[Path]:
    """Write film, report and plot where they were asked for."""
    from matiere.report import picture_report

    film, report, plot = places
    if film is not None:
        done.save(film)
    if plot is not None:
        _write_plot(plot, done, label)
    if report is not None:
        picture = picture_report(done, despeckle)
        _write_text(report, json.dumps(done.report | {"picture": picture}, indent=1) + "\n")
    return [path for path in places if path is not None]


def _write_plot(path: Path, done: Film, label: str) -> None:
    from matiere.errors import ImageError
    from matiere.plot import certificate_plot

    try:
        page = certificate_plot(done, label)
    except ValueError as error:
        raise ImageError(f"no plot was made: {error}") from None
    page.save(path)


def _write_text(path: Path, text: str) -> None:
    from matiere.imageio import atomic_file

    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


# What the user sees


def _error_text(error: Mapping[str, Any] | None) -> str:
    if not error or error.get("relmse") is None:
        return "relMSE unknown"
    lower, upper = error.get("lower"), error.get("upper")
    interval = "" if lower is None or upper is None else f" [{lower:.2g}, {upper:.2g}]"
    return f"relMSE {error['relmse']:.2g}{interval}"


def _left_text(seconds: float | None) -> str:
    if seconds is None:
        return "time left unknown"
    if seconds < 90:
        return f"{seconds:.0f} s left"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min left"
    return f"{seconds / 3600:.1f} h left"


def _share(progress: Progress) -> float:
    """Return the part of the time that has passed; of the samples while that is unknown."""
    left, elapsed = progress.get("seconds_left"), progress["elapsed_s"]
    if left is not None and elapsed + left > 0:
        return float(elapsed / (elapsed + left))
    limit = progress.get("spp_limit") or 0
    return float(progress["spp"] / limit) if limit else 0.0


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[Progress], None] | None]:
    """Give the callback that draws the bar (on a terminal) or prints a line now and then."""
    if quiet:
        yield None
        return
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _line_printer()
        return
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(), TextColumn("{task.description}"))
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task("building the scene", total=1.0)

        def draw(progress: Progress) -> None:
            text = (
                f"{progress['spp']} spp, {_error_text(progress.get('error'))}, "
                f"{_left_text(progress.get('seconds_left'))}"
            )
            bar.update(task, completed=_share(progress), description=text)

        yield draw


def _line_printer() -> Callable[[Progress], None]:
    """Return a callback for logs: a line at 1 s, 2 s, 4 s, ..."""
    started = time.monotonic()
    due = 1.0

    def show(progress: Progress) -> None:
        nonlocal due
        elapsed = time.monotonic() - started
        if elapsed >= due:
            due = max(due * 2, elapsed)
            error = _error_text(progress.get("error"))
            left = _left_text(progress.get("seconds_left"))
            typer.echo(f"{elapsed:.0f} s: {progress['spp']} spp, {error}, {left}", err=True)

    return show


def _summary(done: Film, loaded: Scene, despeckle: bool, files: list[Path]) -> None:
    report = done.report
    for note in loaded.notes:
        place = f"{note['pointer']}: " if note["pointer"] else ""
        typer.echo(f"note: {place}{note['message']}", err=True)
    for warning in report["warnings"]:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(f"{done.spp} spp in {report['wall_s']:.1f} s; {report['reason_text']}")
    if report["spp_note"]:
        typer.echo(report["spp_note"])
    typer.echo(_error_line(report["error"]))
    if despeckle:
        share = 100 * done.despeckled.energy
        typer.echo(f"the picture holds back {share:.2g} % of the light as specks; EXR has it all")
    if target := report["certificate"]["target"]:
        typer.echo(_target_line(target, report["wall_s"]))
    for path in files:
        typer.echo(f"wrote {path}")


def _error_line(error: Mapping[str, Any]) -> str:
    """Return the error bar in words; m is the luminance below which errors count absolutely."""
    share = f"{100 * error['unknown_share']:.3g} % of pixels"
    if error["relmse"] is None:
        return f"error unknown (no evidence in {share})"
    interval = f"[{error['lower']:.3g}, {error['upper']:.3g}]"
    return (
        f"relMSE {error['relmse']:.3g}, 95 % interval {interval}; RMSE {error['rmse']:.3g}; "
        f"m {error['log_average']:.3g}; unknown: {share}"
    )


def _target_line(target: Mapping[str, Any], wall_s: float) -> str:
    """Return in words whether the target was met, or when it is expected to be."""
    if target["reached"]:
        return f"target reached: {target['text']}"
    if target["excess"] is None:
        return f"target not reached: {target['text']}; the error is unknown"
    needed = wall_s * (target["excess"] - 1)
    return f"target not reached: {target['text']}; expected after {needed:.3g} s more"


def _film_line(loaded: Scene) -> str:
    """Return what the film will hold, before anything is allocated."""
    from matiere import chunks
    from matiere.render import film_bytes

    width, height = chunks.size(loaded.model)
    need = film_bytes(loaded)
    return (
        f"film {width} x {height}, {need['bytes_per_pixel']} bytes per pixel, "
        f"{need['bytes'] / 2**20:.1f} MiB"
    )
