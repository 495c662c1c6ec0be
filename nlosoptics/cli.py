"""The command line: parse, call, write.

Exit codes: 0 done, 1 failed, 2 bad input. An error is one line on stderr, without a traceback
unless ``--debug`` asks for it. A run's output folder appears whole or not at all.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import __version__
from .errors import MissingExtraError, NlosError
from .records import arrays, peak_memory, scene_hash, versions

if TYPE_CHECKING:
    from .scene import Scene
    from .simulation import Result

DONE, FAILED, BAD_INPUT = 0, 1, 2
MOST_SEED = 2**64 - 1  # that of _random, which would load numpy

# typer has no public name for it: click's own class in old versions, its copy in new ones
_UsageError: Any = typer.BadParameter.__base__

app = typer.Typer(
    name="nlosoptics",
    help="The optics of seeing around corners: what a camera sees by way of a relay wall.",
    add_completion=False,
    pretty_exceptions_enable=False,
)

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).")]
Tol = Annotated[
    float,
    typer.Option(
        help="Wanted error of the point spread, 1e-12 to 0.1 of its peak. The image's own error is "
        "fixed: 1e-3 of the wall's diffuse light."
    ),
]
Size = Annotated[
    int | None,
    typer.Option(help="Image pixels along x, over the same field; the scene's own by default."),
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with 0 (done), 1 (failed) or 2 (bad input).

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after the program's name; those of this process by default.
    """
    try:
        code = app(args=arguments, prog_name="nlosoptics", standalone_mode=False)
    except (Exception, KeyboardInterrupt) as error:
        code = _tell(error)
    sys.exit(code or DONE)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"nlosoptics {__version__}")
        raise typer.Exit(DONE)


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass


@app.command("plan")
def plan_command(
    scene_file: SceneFile, tol: Tol = 1e-3, size: Size = None, debug: Debug = False
) -> None:
    """Say what a run computes, what it skips and why, with predicted seconds and error."""
    with _told(debug):
        from .planning import plan

        typer.echo(str(plan(_load(scene_file, size), tol, reconstruct=True)))


@app.command("run")
def run_command(
    scene_file: SceneFile,
    tol: Tol = 1e-3,
    seed: Annotated[int, typer.Option(min=0, max=MOST_SEED, help="Of all random draws.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Output folder; ./<scene's name> by default.")
    ] = None,
    size: Size = None,
    reconstruct: Annotated[
        bool, typer.Option("--reconstruct/--no-reconstruct", help="Reconstruct the hidden object.")
    ] = True,
    debug: Debug = False,
) -> None:
    """Simulate a scene file; write figures, arrays and pictures into one folder."""
    with _told(debug):
        start = time.perf_counter()
        folder = Path(scene_file.stem) if out is None else out
        from .planning import plan
        from .scene.file import format_scene
        from .simulation import simulate

        scene = _load(scene_file, size)
        planned = plan(scene, tol, reconstruct=reconstruct)
        _check_target(folder)
        _require("matplotlib", "views")
        if planned.runs("reconstruction"):
            _require("torch", "inverse", ", or pass --no-reconstruct")
        with _progress() as progress:
            result = simulate(scene, tol, seed, reconstruct, progress=progress)
            progress("writing", 1.0)
            report = _report(result)
            with _whole_folder(folder) as new:
                began = time.perf_counter()
                _write_arrays(result, new)
                _write_pictures(result, new)
                (new / "scene.toml").write_text(format_scene(scene, folder), encoding="utf-8")
                report["seconds"]["writing"] = time.perf_counter() - began
                report["seconds"]["total"] = time.perf_counter() - start
                report["files"] = sorted([*(p.name for p in new.iterdir()), "result.json"])
                text = json.dumps(report, indent=2, allow_nan=False)
                (new / "result.json").write_text(text + "\n")
        _print_summary(report, folder)


@app.command("feasibility")
def feasibility_command(
    scene_file: SceneFile,
    size: Size = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print figures as JSON.")] = False,
    out: Annotated[Path | None, typer.Option(help="Also write a picture: .png or .pdf.")] = None,
    debug: Debug = False,
) -> None:
    """Say before any fit what an image can tell: light, noise, modulation, modes, the wave."""
    with _told(debug):
        from .limits import feasibility

        scene = _load(scene_file, size)
        if out is not None:
            _require("matplotlib", "views")
        with _progress() as progress:
            progress("feasibility", 0.0)
            found = feasibility(scene)
        if out is not None:
            from . import views

            views.save(views.feasibility(found), out)
        typer.echo(json.dumps(found.figures(), indent=2) if as_json else str(found))


@app.command("reconstruct")
def reconstruct_command(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE...", help="Pictures: PNG, TIFF or .npy, grey.")
    ],
    scene_file: Annotated[Path, typer.Option("--scene", help="Scene file (TOML).")],
    dark: Annotated[Path | None, typer.Option(help="Dark frame of the same exposure.")] = None,
    flat: Annotated[Path | None, typer.Option(help="Flat field, of an even light.")] = None,
    full: Annotated[
        float | None, typer.Option(help="Count at which a pixel is full; the type's by default.")
    ] = None,
    method: Annotated[
        str, typer.Option(help="tv, wiener, or another that nlosoptics.inverse has.")
    ] = "tv",
    defocus: Annotated[
        str, typer.Option(help="Known extra focus of each picture, waves rms: '0, 0.5'.")
    ] = "",
    tol: Tol = 1e-3,
    seed: Annotated[int, typer.Option(min=0, max=MOST_SEED, help="Of all random draws.")] = 0,
    size: Size = None,
    out: Annotated[
        Path | None, typer.Option(help="Output folder; ./<first image's name> by default.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the kept state.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print result.json.")] = False,
    debug: Debug = False,
) -> None:
    """Reconstruct the hidden object from a camera's pictures; Ctrl-C keeps the best so far.

    Exit code 1 where it was interrupted: --resume goes on.
    """
    with _told(debug):
        _require("torch", "inverse")
        from . import reconstructing

        folder = Path(images[0].stem) if out is None else out
        scene = _load(scene_file, size)
        _check_target(folder)
        task = reconstructing.prepared(
            scene,
            images,
            method=method,
            dark=dark,
            flat=flat,
            full=full,
            defocus=_numbers("--defocus", defocus),
            seed=seed,
            tol=tol,
        )
        with _progress(width=60) as progress, _interruptible() as interrupted:
            report = reconstructing.carry_out(
                task, folder, resume=resume, progress=progress, interrupted=interrupted
            )
        if as_json:
            typer.echo(json.dumps(report, indent=2))
        else:
            _print_reconstruction(report, folder)
        if report["status"] == "interrupted":
            typer.echo(
                f"nlosoptics: interrupted; the best so far is in {folder}, --resume goes on",
                err=True,
            )
            raise typer.Exit(FAILED)


@app.command("train")
def train_command(
    scene_file: SceneFile,
    out: Annotated[Path, typer.Option(help="File of the network.")] = Path("cnn.safetensors"),
    pairs: Annotated[int, typer.Option(min=2, help="Images to learn from.")] = 2000,
    epochs: Annotated[int, typer.Option(min=1, help="Times that each is shown.")] = 20,
    waves: Annotated[float, typer.Option(help="Largest rms of a wall's aberration, waves.")] = 0.5,
    frame: Annotated[
        int | None, typer.Option(help="Pixels a side of a region of interest, object and all.")
    ] = None,
    base: Annotated[int, typer.Option(help="Channels of the network: 8, 16 or 32.")] = 16,
    seed: Annotated[int, typer.Option(min=0, max=MOST_SEED, help="Of all random draws.")] = 0,
    size: Size = None,
    debug: Debug = False,
) -> None:
    """Train a network on simulated images of random objects by random walls.

    Ctrl-C keeps the best network so far, with exit code 1.
    """
    with _told(debug):
        _require("torch", "inverse")
        _require("safetensors", "inverse")
        scene = _load(scene_file, size)
        _check_file(out)
        from . import inverse

        inverse.CnnBaseline(base=base)  # refuses what it cannot be before pairs are made
        with _progress() as progress:
            made = inverse.training_pairs(
                scene,
                pairs,
                waves=waves,
                size=frame,
                seed=seed,
                progress=lambda done, _: progress("training pairs", done),
            )
            training = inverse.train_cnn(
                made,
                base=base,
                epochs=epochs,
                seed=seed,
                progress=lambda done, told: progress(told.removeprefix("training: "), done),
            )
            training.network.save(out)
        error = training.history["validation"].min()
        typer.echo(
            f"{out}: mean squared error {error:.4f} on {max(1, round(0.1 * pairs))} pairs that it "
            f"was not shown, {len(training.history['validation'])} epochs, {training.seconds:.0f} s"
        )
        if training.interrupted:
            typer.echo(f"nlosoptics: interrupted; the best network so far is in {out}", err=True)
            raise typer.Exit(FAILED)


@app.command("schema")
def schema_command(debug: Debug = False) -> None:
    """Print the JSON schema of scene files, for editors."""
    with _told(debug):
        from .scene.file import scene_schema

        typer.echo(json.dumps(scene_schema(), indent=2))


def _load(path: Path, size: int | None) -> Scene:
    from .scene import Scene

    scene = Scene.load(path)
    return scene if size is None else scene.resized(size)


def _require(package: str, extra: str, otherwise: str = "") -> None:
    """Raise `MissingExtraError` before any work that would end at a missing package."""
    if importlib.util.find_spec(package) is None:
        raise MissingExtraError(
            f"{package} is not installed; run pip install 'nlosoptics[{extra}]'{otherwise}"
        )


@contextmanager
def _told(debug: bool) -> Iterator[None]:
    """Turn an exception into one line on stderr and an exit code."""
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        raise typer.Exit(_tell(error)) from None


def _tell(error: BaseException) -> int:
    """Print an error as one line on stderr; return its exit code."""
    code = FAILED
    if isinstance(error, typer.Exit):
        return int(error.exit_code)
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        message = "interrupted; nothing was written"
    elif isinstance(error, _UsageError):
        message = f"{error.format_message().rstrip('.')}; nlosoptics --help shows how"
        code = BAD_INPUT
    elif isinstance(error, NlosError):
        message = str(error)
        code = FAILED if isinstance(error, MissingExtraError) else BAD_INPUT
    else:
        message = f"{type(error).__name__}: {error}; --debug shows where"
    typer.echo(f"nlosoptics: {' '.join(message.split())}", err=True)
    return code


def _numbers(option: str, text: str) -> tuple[float, ...]:
    """Numbers of a list with commas; none where it is empty."""
    try:
        return tuple(float(part) for part in text.split(",")) if text.strip() else ()
    except ValueError:
        raise typer.BadParameter(
            f"{text!r} is no list of numbers, such as '0, 0.5'", param_hint=option
        ) from None


@contextmanager
def _interruptible() -> Iterator[Callable[[], bool]]:
    """Let the first Ctrl-C be asked for; a second one interrupts at once."""
    asked = False

    def ask(signum: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _progress(width: int = 17) -> Iterator[Callable[[str, float], None]]:
    """Bar on stderr that names the stage at work; silent where stderr is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn(f"{{task.description:{width}}}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)


def _check_file(path: Path) -> None:
    """Refuse a file that could not be written in the end."""
    parent = path.absolute().parent
    for wrong, what in (
        (path.is_dir(), "is a folder; name a file"),
        (not parent.is_dir(), f"is in {parent}, which is no folder; create it first"),
        (not os.access(parent, os.W_OK), f"is in {parent}, which cannot be written"),
    ):
        if wrong:
            raise typer.BadParameter(f"{path} {what}", param_hint="--out")


def _check_target(folder: Path) -> None:
    """Refuse an output folder that could not be written, or whose contents are not ours."""

    def bad(what: str) -> Exception:
        return typer.BadParameter(f"{folder} {what}", param_hint="--out")

    if folder.exists():
        if not folder.is_dir():
            raise bad("is a file; name a folder")
        found = {p.name for p in folder.iterdir()}
        try:
            ours = set(json.loads((folder / "result.json").read_text())["files"])
        except (OSError, ValueError, KeyError, TypeError):
            ours = set()
        if found - ours:
            raise bad(f"holds {min(found - ours)}, which nlosoptics did not write; name another")
    parent = folder.absolute().parent
    if not parent.is_dir():
        raise bad(f"is in {parent}, which is no folder; create it first")
    if not os.access(parent, os.W_OK):
        raise bad(f"is in {parent}, which cannot be written; name another place")


@contextmanager
def _whole_folder(target: Path) -> Iterator[Path]:
    """Yield a folder that takes the place of ``target`` once the block has ended well."""
    target = target.absolute()
    with tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as beside:
        new, old = Path(beside) / "new", Path(beside) / "old"
        new.mkdir()
        yield new
        try:
            if target.exists():
                target.rename(old)
            new.rename(target)
        except BaseException:
            if old.exists() and not target.exists():
                old.rename(target)
            raise


def _report(result: Result) -> dict[str, Any]:
    """Machine-readable account of a run: the contents of result.json."""
    from dataclasses import asdict

    return {
        "program": "nlosoptics",
        "status": "done",
        "figures": _figures(result),
        "seed": result.seed,
        "tol": result.plan.tol,
        "scene_sha256": scene_hash(result.scene),
        "seconds": dict(result.timings),
        "plan": {
            "stages": [asdict(stage) for stage in result.plan.stages],
            "skipped": [asdict(stage) for stage in result.plan.skipped],
        },
        "versions": versions(),
    }


def _figures(result: Result) -> dict[str, Any]:
    """Numbers that sum up a run, SI units."""
    from . import psf

    pupil, wave, spread, image = (
        result.exit_pupil,
        result.wavefront,
        result.point_spread,
        result.image,
    )
    found: dict[str, Any] = {
        "exit_pupil_radius": pupil.radius,
        "image_distance": pupil.image_distance,
        "f_number": pupil.f_number,
        "stop": pupil.stop,
        "vignetting": pupil.vignetting,
        "aberration_rms": psf.rms_aberration(wave),
        "aberration_rms_waves": psf.rms_aberration(wave) / wave.wavelength,
        "point_spread_method": spread.method,
        "point_spread_error": spread.error_estimate,
        "errors": dict(result.errors),
        "field_nodes": 1 if result.field is None else result.field.weights[0].size,
        "field_modes": 1 if result.field is None else len(result.field.modes),
        "image_shape": list(image.electrons.shape),
        "electrons_peak": float(image.electrons.max()),
        "electrons_mean": float(image.electrons.mean()),
        "signal_electrons_peak": float(image.signal.max()),
        "noise_sigma_mean": float(image.noise_sigma.mean()),
        "saturated_fraction": image.saturated_fraction,
        "electrons_in_total": dict(image.ledger),
    }
    if result.reconstruction is not None:
        from .inverse import registered_correlation

        found["reconstruction_status"] = result.reconstruction.status
        found["reconstruction_score"] = result.reconstruction.score
        if image.ideal.any():
            correlation = registered_correlation(result.reconstruction, image.ideal)
            found["correlation_with_truth"] = correlation
    found["peak_memory_bytes"] = peak_memory()
    return found


def _write_arrays(result: Result, folder: Path) -> None:
    """Write every noun's arrays and numbers, one ``.npz`` each."""
    import numpy as np

    nouns = {
        "wavefront": result.wavefront,
        "point_spread": result.point_spread,
        "field": result.field,
        "image": result.image,
        "reconstruction": result.reconstruction,
    }
    for name, noun in nouns.items():
        if noun is not None:
            np.savez(folder / f"{name}.npz", **arrays(noun))


def _write_pictures(result: Result, folder: Path) -> None:
    """Write the pictures, one PNG each."""
    from . import views

    views.save(views.scene_sketch(result.scene), folder / "scene.png")
    views.save(views.wavefront(result.wavefront), folder / "wavefront.png")
    views.save(views.point_spread(result.point_spread), folder / "point_spread.png")
    views.save(views.image(result.image), folder / "image.png")
    if result.reconstruction is not None:
        brightest = result.image.ideal.max()
        truth = result.image.ideal / brightest if brightest > 0 else None
        axes = views.reconstruction(result.reconstruction, truth)
        views.save(axes, folder / "reconstruction.png")


def _print_reconstruction(report: dict[str, Any], folder: Path) -> None:
    """Print a reconstruction's figures as a table."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    f = report["figures"]
    table = Table("figure", "value", box=box.SIMPLE_HEAD)
    told = f"{f['method']}: {f['reconstruction_status']} after {f['iterations']} iterations"
    table.add_row("reconstruction", told)
    table.add_row("residual", f"{f['reconstruction_score']:.4g} of the noise")
    table.add_row("full pixels", f"{100 * f['saturated_fraction']:.2g} %")
    table.add_row("seconds", f"{report['seconds']['total']:.2f} s")
    table.add_row("written to", str(folder))
    Console().print(table)


def _print_summary(report: dict[str, Any], folder: Path) -> None:
    """Print a run's figures as a table."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    f = report["figures"]
    table = Table("figure", "value", box=box.SIMPLE_HEAD)
    table.add_row("exit pupil", f"radius {1e3 * f['exit_pupil_radius']:.4g} mm, stop: {f['stop']}")
    table.add_row("working F-number", f"{f['f_number']:.4g}")
    table.add_row(
        "wave aberration",
        f"{f['aberration_rms_waves']:.3g} waves rms ({1e9 * f['aberration_rms']:.3g} nm)",
    )
    table.add_row(
        "point spread", f"{f['point_spread_method']}, error {f['point_spread_error']:.1e}"
    )
    if f["field_nodes"] > 1:
        error = f["errors"]["field of point spreads"]
        table.add_row(
            "field", f"{f['field_nodes']} points in {f['field_modes']} modes, error {error:.1e}"
        )
    table.add_row(
        "electrons per pixel",
        f"{f['electrons_peak']:.3g} at most, {f['electrons_mean']:.3g} on average, "
        f"signal {f['signal_electrons_peak']:.3g}",
    )
    if "reconstruction_status" in f:
        told = "no light from the object reaches the camera"
        if "correlation_with_truth" in f:
            told = f"correlation with truth {f['correlation_with_truth']:.4f}"
        table.add_row("reconstruction", f"{f['reconstruction_status']}, {told}")
    for stage, seconds in report["seconds"].items():
        table.add_row(f"  {stage}", f"{seconds:.2f} s")
    if f["peak_memory_bytes"] is not None:
        table.add_row("peak memory", f"{f['peak_memory_bytes'] / 2**20:.0f} MiB")
    table.add_row("written to", str(folder))
    Console().print(table)
