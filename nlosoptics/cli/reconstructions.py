"""Commands feasibility and reconstruct."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from .._checks import counted, lasting
from .photographs import (
    Channel,
    Corners,
    Crop,
    Dark,
    Flat,
    Full,
    Gamma,
    Rotate,
    Strict,
    reading,
    warnings_told,
)
from .shell import (
    DOES_NOT_FIT,
    INTERRUPTED,
    Changes,
    Debug,
    Out,
    SceneFile,
    Seed,
    Size,
    Tol,
    app,
    check_file,
    check_target,
    errors_told,
    interruptible,
    load,
    numbers,
    print_table,
    progress_bar,
    require,
    typed,
)


@app.command("feasibility", short_help="Predict which detail of the object an image can show.")
def feasibility_command(
    scene_file: SceneFile,
    changes: Changes = None,
    size: Size = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the forecast as JSON.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Also draw the forecast to this file: .png, .pdf or .svg.")
    ] = None,
    debug: Debug = False,
) -> None:
    """Predict whether the object can be reconstructed, and which detail its image can show.

    The first line is the verdict, with what is missing if the object is not recoverable. Zernike
    terms Z4, Z5, ... of the wall's wave are in Noll's order. The last lines give, for stripes of so
    many cycles/m on the object, their contrast in the image (modulation) and in the light of a matt
    wall, each with its signal to noise. No image and no reconstruction is needed.

    Example: nlosoptics feasibility corner --out forecast.png
    """
    with errors_told(debug):
        from ..limits import feasibility

        scene = load(scene_file, size, changes)
        if out is not None:
            require("matplotlib", "views")
            check_file(out, ".png", ".pdf", ".svg")
        with progress_bar() as progress:
            progress("feasibility", 0.0)
            found = feasibility(scene)
        if out is not None:
            from .. import views

            views.save(views.feasibility(found), out)
        typer.echo(json.dumps(found.figures(), indent=2) if as_json else str(found))


@app.command("reconstruct", short_help="Reconstruct the hidden object from camera images.")
def reconstruct_command(
    context: typer.Context,
    images: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGE", help="Camera images: PNG, TIFF, JPEG, .npy or raw."),
    ],
    scene_file: Annotated[
        Path,
        typer.Option(
            "--scene",
            metavar="SCENE",
            help="Scene file (TOML) of the set-up, or the name of an example.",
        ),
    ],
    changes: Changes = None,
    dark: Dark = None,
    flat: Flat = None,
    full: Full = None,
    channel: Channel = None,
    gamma: Gamma = "linear",
    rotate: Rotate = 0.0,
    crop: Crop = "",
    corners: Corners = "",
    method: Annotated[
        str | None,
        typer.Option(
            help="Solver. If the scene file describes the wall, from one image or the mean of "
            "several: tv (total variation), wiener, inverse_filter, richardson_lucy, "
            "phase_retrieval. If the wall is unknown and fitted too, from one image or several of "
            "known --defocus: evidence (Bayesian), wu2024 (network). For a rough wall seen from "
            "several camera positions, one image each: burst. For a matt wall with occluders: "
            "shadows. By default shadows for such a wall, else tv."
        ),
    ] = None,
    iterations: Annotated[
        int | None,
        typer.Option(min=1, help="Maximum number of iterations; by default that of the method."),
    ] = None,
    defocus: Annotated[
        str,
        typer.Option(
            help="Known additional defocus of each image, in wavelengths rms over the pupil (Noll "
            "4), positive if the detector is too close to the lens, for example '0, 0.5' for two "
            "images. Only for methods evidence and wu2024."
        ),
    ] = "",
    tol: Tol = 1e-3,
    seed: Seed = 0,
    size: Size = None,
    out: Out = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Resume from the state saved in the output folder.")
    ] = False,
    strict: Strict = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the contents of result.json.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Reconstruct the hidden object from camera images.

    Several images are averaged, or fitted together by methods evidence and burst. Ctrl-C ends the
    fit, writes the best object so far and exits with code 130; --resume continues. nlosoptics new
    photo.toml --kind photo writes both files of the example.

    Example: nlosoptics reconstruct photo.png --scene photo.toml
    """
    with errors_told(debug):
        if method not in (None, "tv", "shadows"):
            require("torch", "inverse")
        from ..runs import reconstructing

        folder = Path(images[0].stem) if out is None else out
        scene = load(scene_file, size, changes)
        check_target(folder)
        with warnings_told():
            task = reconstructing.prepared(
                scene,
                images,
                method=method,
                dark=dark,
                flat=flat,
                full=full,
                reading=reading(channel, gamma, rotate, crop, corners),
                defocus=numbers("--defocus", defocus),
                iterations=iterations,
                seed=seed,
                tol=tol,
            )
        with progress_bar(width=60) as progress, interruptible() as interrupted:
            report = reconstructing.carry_out(
                task,
                folder,
                resume=resume,
                progress=progress,
                interrupted=interrupted,
                command_line=typed(context),
            )
        if as_json:
            typer.echo(json.dumps(report, indent=2))
        else:
            print_table(_reconstruction_rows(report, folder))
        if report["status"] == "interrupted":
            typer.echo(
                f"nlosoptics: interrupted; the best object so far is in {folder}; "
                "--resume continues",
                err=True,
            )
            raise typer.Exit(INTERRUPTED)
        if strict and report["figures"]["reconstruction_status"] == "does_not_fit":
            raise typer.Exit(DOES_NOT_FIT)


def _reconstruction_rows(report: dict[str, Any], folder: Path) -> Iterator[tuple[str, str]]:
    f = report["figures"]
    told = (
        f"{f['method']}: {f['reconstruction_status']} after {counted(f['iterations'], 'iteration')}"
    )
    yield ("reconstruction", told)
    for reason in f["reconstruction_reasons"]:
        yield ("", reason)
    if f["method"] == "phase_retrieval":
        yield ("agreement of two halves of the starts", f"{f['reconstruction_score']:.4g}")
    else:
        yield ("residual", f"{f['reconstruction_score']:.4g} of the noise")
    if f["method"] == "shadows":
        fitted = f["physical_parameters"]
        shown = f"{fitted['modes']:.3g}, expected correlation {fitted['expected_correlation']:.3g}"
        yield ("modes above the noise", shown)
    yield ("saturated pixels", f"{100 * f['saturated_fraction']:.2g} %")
    if "bad_pixels" in f["physical_parameters"]:
        yield ("dead, hot or saturated pixels found", str(f["physical_parameters"]["bad_pixels"]))
    yield ("run time", lasting(report["seconds"]["total"]))
    yield ("written to", str(folder))
