"""Command deblur, and the options of all commands that read photographs."""

from __future__ import annotations

import json
import math
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from .._checks import lasting
from .._whole_files import whole_folder
from ..errors import SceneError
from .shell import (
    DOES_NOT_FIT,
    Debug,
    Out,
    app,
    can_draw,
    check_target,
    errors_told,
    numbers,
    print_table,
    progress_bar,
    typed,
)

Dark = Annotated[
    Path | None,
    typer.Option(help="Dark frame: image with the same exposure time and without light."),
]
Flat = Annotated[
    Path | None, typer.Option(help="Flat field: image of an evenly lit white surface.")
]
Full = Annotated[
    float | None,
    typer.Option(
        help="Pixel value at which a pixel is saturated; by default the largest that the file's "
        "number format can hold."
    ),
]
Channel = Annotated[
    str | None,
    typer.Option(
        help="Channel to use of a picture in colour: red, green, blue, grey (their mean) or rgb "
        "(all; the default of deblur)."
    ),
]
Gamma = Annotated[
    str,
    typer.Option(help="How the file stores light: linear, or srgb as JPEGs and most PNGs do."),
]
Crop = Annotated[
    str,
    typer.Option(
        metavar="X,Y,W,H",
        help="Part of the picture to use: column and row of its first pixel, width and height.",
    ),
]
Rotate = Annotated[
    float, typer.Option(help="Degrees by which to turn the picture counter-clockwise first.")
]
Corners = Annotated[
    str,
    typer.Option(
        metavar="'X,Y X,Y X,Y X,Y'",
        help="Corners of the area that the scene's camera sees, in a picture taken at an angle: "
        "pixels from the top left of the cropped picture, in the order top left, top right, "
        "bottom right, bottom left of the scene's image.",
    ),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Exit with code 3 if the image contradicts the model.")
]


def reading(
    channel: str | None, gamma: str, rotate: float, crop: str, corners: str = ""
) -> dict[str, Any]:
    """Return the options of `imaging.camera_image` for those of a command."""
    marked = numbers("--corners", corners.replace(";", ",").replace(" ", ","))
    if marked and len(marked) != 8:
        raise typer.BadParameter(
            f"{corners!r} has {len(marked)} numbers; give four positions 'x,y x,y x,y x,y'",
            param_hint="--corners",
        )
    return {
        "channel": channel,
        "gamma": gamma,
        "rotate": rotate,
        "crop": numbers("--crop", crop) or None,
        "corners": list(zip(marked[::2], marked[1::2], strict=True)) or None,
    }


@contextmanager
def warnings_told() -> Iterator[None]:
    """Print each warning as one line on stderr."""
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        yield
    for text in dict.fromkeys(str(note.message) for note in notes):
        typer.echo(f"nlosoptics: {' '.join(text.split())}", err=True)


@app.command("deblur", short_help="Sharpen a photograph whose blur is known, without any scene.")
def deblur_command(
    context: typer.Context,
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE",
            help="Photographs (PNG, TIFF, JPEG, .npy or raw); several of one view are averaged.",
        ),
    ],
    psf: Annotated[
        Path | None,
        typer.Option(
            help="Image of a point on the same pixels (PNG, TIFF or .npy), point in the middle."
        ),
    ] = None,
    disc: Annotated[
        float | None, typer.Option(help="Blur by a disc of this radius, pixels: out of focus.")
    ] = None,
    gaussian: Annotated[
        float | None,
        typer.Option(help="Blur by a Gaussian of this standard deviation, pixels."),
    ] = None,
    channel: Channel = None,
    gamma: Gamma = "linear",
    rotate: Rotate = 0.0,
    crop: Crop = "",
    dark: Dark = None,
    flat: Flat = None,
    full: Full = None,
    out: Out = None,
    strict: Strict = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the contents of result.json.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Sharpen a photograph whose blur is known, by total-variation deconvolution.

    State the blur by one of --psf, --disc and --gaussian.
    Of all pictures whose blurred image agrees with the photograph, the result is the one with the
    fewest and weakest edges. Colours are sharpened one by one. The output folder gets the picture
    (object.png), its values (object.npz), an overview and result.json.

    Example: nlosoptics deblur photo.jpg --disc 3 --gamma srgb
    """
    with errors_told(debug):
        started = time.perf_counter()
        import numpy as np

        from .. import imaging, inverse
        from ..runs.record import now, versions, write_record
        from .figures import displayed, write_photograph

        folder = Path(images[0].stem) if out is None else out
        check_target(folder)
        kernel = _kernel(psf, disc, gaussian)
        with warnings_told():
            options = reading(channel or "rgb", gamma, rotate, crop)
            photo = imaging.camera_image(images, dark=dark, flat=flat, full=full, **options)
        drawn = can_draw()
        with progress_bar(width=60) as progress:
            answer = inverse.tv_deconvolve(photo, kernel, progress=progress)
            progress("writing", 1.0)
            values = answer.physical_parameters
            maps = {name: value for name, value in values.items() if np.ndim(value) > 1}
            veil = float(maps["veil"].mean() / photo.values.mean()) if "veil" in maps else 0.0
            report = {
                "program": "nlosoptics",
                "command": "deblur",
                "command_line": typed(context),
                "status": "done",
                "finished": now(),
                "figures": {
                    "reconstruction_status": answer.status,
                    "reconstruction_reasons": list(answer.reasons),
                    "reconstruction_score": answer.score,
                    "expected_correlation": values.get("expected_correlation"),
                    "noise_sigma": values["noise_sigma"],
                    "veil_fraction": veil,
                    "masked_fraction": float(photo.masked.mean()),
                    "image_shape": list(photo.values.shape),
                },
                "seconds": {"solver": answer.seconds, "total": time.perf_counter() - started},
                "versions": versions(),
            }
            with whole_folder(folder) as new:
                (new / "object.png").write_bytes(displayed(answer.object, gamma))
                np.savez(
                    new / "object.npz",
                    object=answer.object,
                    image=photo.values,
                    point_spread=kernel,
                    **maps,
                )
                if drawn:
                    write_photograph(photo.values, kernel, answer, gamma, new)
                report = write_record(report, new)
        if as_json:
            typer.echo(json.dumps(report, indent=2))
        else:
            print_table(_rows(report, folder))
        if strict and answer.status == "does_not_fit":
            raise typer.Exit(DOES_NOT_FIT)


def _kernel(psf: Path | None, disc: float | None, gaussian: float | None) -> Any:
    """Return the point spread (ky, kx) that the options state, with a sum of 1."""
    import numpy as np
    from scipy import special

    from .._checks import in_range
    from ..imaging.camera_files import read_camera_file

    if sum(option is not None for option in (psf, disc, gaussian)) != 1:
        raise SceneError(
            "the blur has no or several options; give one of --psf, --disc and --gaussian"
        )
    if psf is not None:
        return read_camera_file(psf, "grey")[0]
    if disc is not None:
        in_range("--disc", disc, 0.1, 100.0, unit="pixels")
        arm = math.ceil(disc - 0.5)
        parts = math.ceil(64.0 / (1.0 + disc))  # of a pixel along each side
        at = (np.arange((2 * arm + 1) * parts) + 0.5) / parts - arm - 0.5
        inside = np.hypot(at[:, None], at) <= disc
        kernel = inside.reshape(2 * arm + 1, parts, 2 * arm + 1, parts).mean(axis=(1, 3))
    else:
        assert gaussian is not None
        in_range("--gaussian", gaussian, 0.1, 100.0, unit="pixels")
        arm = math.ceil(4.0 * gaussian)
        line = np.diff(special.ndtr((np.arange(2 * arm + 2) - arm - 0.5) / gaussian))
        kernel = np.multiply.outer(line, line)
    return kernel / kernel.sum()


def _rows(report: dict[str, Any], folder: Path) -> Iterator[tuple[str, str]]:
    f = report["figures"]
    yield ("sharpened photograph", f["reconstruction_status"])
    for reason in f["reconstruction_reasons"]:
        yield ("", reason)
    if f["expected_correlation"] is not None:
        yield ("expected correlation with the truth", f"{f['expected_correlation']:.3f}")
    yield ("residual", f"{f['reconstruction_score']:.4g} of the noise")
    yield ("noise, rms", f"{f['noise_sigma']:.3g} counts")
    if f["veil_fraction"]:
        yield ("smooth veil, taken off", f"{100 * f['veil_fraction']:.2g} % of the light")
    if f["masked_fraction"]:
        yield ("saturated or dead pixels", f"{100 * f['masked_fraction']:.2g} %")
    yield ("run time", lasting(report["seconds"]["total"]))
    yield ("written to", str(folder))
