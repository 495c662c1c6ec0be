"""Command trace, for camera images by ray tracing."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._checks import counted
from .._whole_files import whole_folder
from ..runs.record import arrays, now, peak_memory, scene_hash, versions, write_record
from .shell import (
    Changes,
    Debug,
    Out,
    SceneFile,
    Seed,
    Size,
    app,
    can_draw,
    check_target,
    errors_told,
    load,
    numbers,
    print_table,
    progress_bar,
    stage_rows,
    typed,
)

if TYPE_CHECKING:
    from ..raytrace import TracedImage


@app.command("trace", short_help="Compute the camera image of a scene by ray tracing.")
def trace_command(
    context: typer.Context,
    scene_file: SceneFile,
    changes: Changes = None,
    n_rays: Annotated[
        int | None,
        typer.Option(
            help="Number of rays; with --tol or --max-seconds the largest number. By default "
            "65536, or without limit if --tol or --max-seconds is given."
        ),
    ] = None,
    tol: Annotated[
        float | None,
        typer.Option(
            help="End when the relative standard error of the hidden object's light on the whole "
            "detector is this small, 1e-6 to 1. Single pixels have larger errors."
        ),
    ] = None,
    max_seconds: Annotated[
        float | None, typer.Option(help="End after this time, s; the result so far is written.")
    ] = None,
    max_bounces: Annotated[int, typer.Option(help="Largest number of reflections, 1 to 64.")] = 5,
    seed: Seed = 0,
    out: Out = None,
    size: Size = None,
    t_start: Annotated[
        float | None,
        typer.Option(
            help="Start of the first bin of a histogram of path lengths, m. Give --delta-t and "
            "--n-bins too."
        ),
    ] = None,
    delta_t: Annotated[
        float | None, typer.Option(help="Width of a bin of this histogram, m.")
    ] = None,
    n_bins: Annotated[int | None, typer.Option(help="Number of bins of this histogram.")] = None,
    outer_legs: Annotated[
        bool,
        typer.Option(
            "--outer-legs/--no-outer-legs",
            help="Whether the lengths in the histogram include the paths from the laser to the "
            "first reflection and from the last reflection to the lens.",
        ),
    ] = True,
    wavelengths_nm: Annotated[
        str | None,
        typer.Option(
            help="Trace at these wavelengths, nm, for example '450, 550, 650', instead of the "
            "laser's; for materials whose albedo depends on the wavelength."
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Compute the camera image of a scene by ray tracing, with the standard error of every pixel.

    The light takes any number of reflections between wall, object and room, without diffraction.
    Rooms that scatter light and walls on which rays cross (caustics) can be traced; waves cannot
    model them. The output folder, by default SCENE_trace, gets pictures (PNG), all pixels
    (image.npz) and result.json with the power balance. With --wavelengths-nm, there are such files
    for each wavelength, 450nm_image.npz for example. An existing folder is replaced only if an
    earlier command wrote it.

    Example: nlosoptics trace corner --size 64 --n-rays 100000
    """
    with errors_told(debug):
        start = time.perf_counter()
        folder = Path(f"{scene_file.stem}_trace") if out is None else out
        from .. import raytrace

        scene = load(scene_file, size, changes)
        check_target(folder)
        drawn = can_draw()
        with progress_bar() as progress:
            options: dict[str, Any] = {
                "n_rays": n_rays,
                "tol": tol,
                "max_seconds": max_seconds,
                "max_bounces": max_bounces,
                "t_start": t_start,
                "delta_t": delta_t,
                "n_bins": n_bins,
                "outer_legs": outer_legs,
                "seed": seed,
                "progress": progress,
            }
            if wavelengths_nm is None:
                images = {"": raytrace.trace_image(scene, **options)}
            else:
                nm = numbers("--wavelengths-nm", wavelengths_nm)
                options["wavelengths"] = [one / 1e9 for one in nm]
                colours = raytrace.trace_image(scene, **options).colours
                images = {f"{one:g}nm_": image for one, image in zip(nm, colours, strict=True)}
            image = next(iter(images.values()))
            progress("writing", 1.0)
            report = _report(image) | {
                "command_line": typed(context),
                "seed": seed,
                "scene_file": scene_file.name,
                "scene_sha256": scene_hash(scene),
            }
            if wavelengths_nm is not None:
                report["figures_by_wavelength"] = {
                    name[:-1]: _report(one)["figures"] for name, one in images.items()
                }
            with whole_folder(folder) as new:
                for name, one in images.items():
                    _write_image(one, new, drawn, name)
                report["seconds"]["total"] = time.perf_counter() - start
                write_record(report, new)
        for text in image.paths.unreached:
            typer.echo(f"nlosoptics: rays find by chance only {text}", err=True)
        for name, one in images.items():
            print_table(_image_rows(one, report, folder, name[:-1]))


def _report(image: TracedImage) -> dict[str, Any]:
    """Contents of ``result.json`` for a traced image; errors of too few rays are null."""
    paths = image.paths
    values = {
        "flux": (paths.flux, paths.standard_error),
        "stray": (paths.stray, paths.stray_error),
        **{
            f"bounce {k}": (float(power), float(error))
            for k, (power, error) in enumerate(
                zip(paths.by_bounce, paths.by_bounce_error, strict=True)
            )
            if k > 0
        },
    }
    ledger = {name: (power, paths.ledger_error[name]) for name, power in paths.ledger.items()}
    return {
        "program": "nlosoptics",
        "command": "trace",
        "status": "done",
        "finished": now(),
        "figures": {
            "power": {name: _value(*pair) for name, pair in values.items()},
            "ledger": {name: _value(*pair) for name, pair in ledger.items()},
            "electrons_peak": float(image.expected.max()),
            "electrons_mean": float(image.expected.mean()),
            "image_shape": list(image.expected.shape),
            "n_rays": paths.n_rays,
            "stopped": paths.stopped,
            "peak_memory_bytes": peak_memory(),
        },
        "uncertain": list(paths.uncertain),
        "unreached": list(paths.unreached),
        "seconds": {"tracing": paths.seconds},
        "versions": versions(),
    }


def _value(power: float, error: float) -> dict[str, float | None]:
    """Return a power and its standard error, W, for JSON."""
    return {"watts": power, "standard_error": error if math.isfinite(error) else None}


def _write_image(image: TracedImage, folder: Path, drawn: bool, prefix: str) -> None:
    """Write the pixels and the histogram, and pictures of them; file names begin with a prefix."""
    from dataclasses import fields

    import numpy as np

    parts = {f.name: getattr(image, f.name) for f in fields(image) if f.name != "paths"}
    np.savez(
        folder / f"{prefix}image.npz", **arrays({k: v for k, v in parts.items() if v is not None})
    )
    if not drawn:
        return
    from .. import views

    views.save(views.traced_image(image), folder / f"{prefix}image.png")
    views.save(views.traced_image(image, quantity="power"), folder / f"{prefix}object.png")
    if image.histogram is not None:
        views.save(views.path_lengths(image.histogram), folder / f"{prefix}path_lengths.png")


def _image_rows(
    image: TracedImage, report: dict[str, Any], folder: Path, colour: str
) -> Iterator[tuple[str, str]]:
    paths = image.paths
    ny, nx = image.expected.shape
    if colour:
        yield ("wavelength", colour)
    yield ("image", f"{nx} x {ny} pixels of {1e6 * image.pitch:.3g} um")
    yield (
        "electrons per pixel",
        f"{image.expected.max():.3g} at most, {image.expected.mean():.3g} on average",
    )
    yield ("light of the object", f"{paths.flux:.4g} ± {paths.standard_error:.2g} W")
    for k, power in enumerate(paths.by_bounce):
        if power > 0.0:
            yield (f"  of {counted(k, 'reflection')}", f"{power:.4g} W")
    yield ("stray light", f"{paths.stray:.4g} ± {paths.stray_error:.2g} W")
    if paths.uncertain:
        yield ("errors maybe too small", ", ".join(paths.uncertain))
    yield ("rays", f"{paths.n_rays}, ended by {paths.stopped}")
    yield from stage_rows(report)
    yield ("written to", str(folder))
