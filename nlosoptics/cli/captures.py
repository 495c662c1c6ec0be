"""Commands of time-resolved light: transient and phasor."""

from __future__ import annotations

import json
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._whole_files import whole_folder
from ..runs.record import arrays, now, peak_memory, scene_hash, versions
from .shell import (
    Debug,
    SceneFile,
    Seed,
    app,
    check_file,
    check_target,
    errors_told,
    load,
    numbers,
    progress_bar,
    require,
    typed,
)

if TYPE_CHECKING:
    from ..transient import PhasorImage, TransientCapture

PICOSECOND = 299792458e-12  # m of optical path


@app.command("transient")
def transient_command(
    scene_file: SceneFile,
    out: Annotated[Path | None, typer.Option(help="HDF5 file; ./<scene's name>.hdf5.")] = None,
    tol: Annotated[
        float, typer.Option(help="Relative error of three reflections, L1 of each histogram.")
    ] = 1e-3,
    tol_multiple: Annotated[float, typer.Option(help="The same of more reflections.")] = 1e-2,
    seed: Seed = 0,
    quantity: Annotated[
        str, typer.Option(help="irradiance, radiance or radiosity at the wall.")
    ] = "irradiance",
    photons: Annotated[
        float | None,
        typer.Option(help="Photons of the whole capture: counts of a detector are written."),
    ] = None,
    jitter_ps: Annotated[float, typer.Option(help="Of the detector, one sigma, ps.")] = 0.0,
    dark_counts: Annotated[float, typer.Option(help="Of the detector, in each bin.")] = 0.0,
    compression: Annotated[int, typer.Option(min=0, max=9, help="Of the file, gzip.")] = 1,
    debug: Debug = False,
) -> None:
    """Render the light of a scene over time, off its wall, into an HDF5 file that y-tal reads."""
    with errors_told(debug):
        start = time.perf_counter()
        if photons is None and (jitter_ps or dark_counts):
            raise typer.BadParameter(
                "is missing beside --jitter-ps or --dark-counts", param_hint="--photons"
            )
        path = Path(f"{scene_file.stem}.hdf5") if out is None else out
        from .. import transient

        scene = load(scene_file, None)
        check_file(path)
        detector = None
        if photons is not None:
            detector = transient.Detector(
                photons=photons, jitter=jitter_ps * PICOSECOND, dark_counts=dark_counts
            )
        with progress_bar(width=32) as progress:
            capture = transient.render_scene(
                scene,
                tol=tol,
                tol_multiple=tol_multiple,
                seed=seed,
                quantity=quantity,
                progress=progress,
            )
            if detector is not None:
                progress("counting photons", 1.0)
                capture = detector.measure(capture, seed)
            progress("writing", 1.0)
            capture = capture.with_details(
                run={
                    "seed": seed,
                    "tol": tol,
                    "tol_multiple": tol_multiple,
                    "scene_sha256": scene_hash(scene),
                    "seconds": time.perf_counter() - start,
                    "versions": versions(),
                }
            )
            capture.save(path, compression=compression)
        _print_capture(capture, path, time.perf_counter() - start)


@app.command("phasor")
def phasor_command(
    context: typer.Context,
    capture_file: Annotated[
        Path, typer.Argument(metavar="CAPTURE", help="HDF5 or .mat of a capture.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Output folder; ./<capture's name> by default.")
    ] = None,
    camera: Annotated[
        str, typer.Option(help="confocal_time_gated or direct_light.")
    ] = "confocal_time_gated",
    wl_mean: Annotated[
        float | None, typer.Option(help="Virtual wavelength, m; the file's by default.")
    ] = None,
    wl_sigma: Annotated[
        float | None, typer.Option(help="Of the pulse, m; wl-mean/sqrt(2) by default.")
    ] = None,
    near: Annotated[float | None, typer.Option(help="First plane, m from the wall.")] = None,
    far: Annotated[float | None, typer.Option(help="Last plane, m.")] = None,
    step: Annotated[float | None, typer.Option(help="Between planes, m.")] = None,
    aperture: Annotated[
        float | None, typer.Option(help="Side of the square of the wall to use, m; all.")
    ] = None,
    layout: Annotated[
        str | None, typer.Option("--format", help="Layout of the file, where it is in doubt.")
    ] = None,
    bin_width: Annotated[
        float | None, typer.Option(help="m of optical path, where the file does not say it.")
    ] = None,
    t_start: Annotated[float | None, typer.Option(help="m, likewise.")] = None,
    side: Annotated[float | None, typer.Option(help="Of the wall, m, likewise.")] = None,
    pairing: Annotated[str | None, typer.Option(help="all or confocal, likewise.")] = None,
    laser_point: Annotated[str, typer.Option(help="'x, y, z' in m, likewise.")] = "",
    outer_legs: Annotated[
        bool | None,
        typer.Option("--outer-legs/--no-outer-legs", help="Whether times hold them, likewise."),
    ] = None,
    gate_start: Annotated[
        float | None, typer.Option(help="m; bins that begin before it become 0.")
    ] = None,
    debug: Debug = False,
) -> None:
    """Reconstruct the hidden scene of a capture with a virtual camera of phasor fields."""
    with errors_told(debug):
        start = time.perf_counter()
        folder = Path(capture_file.stem) if out is None else out
        from .. import transient

        check_target(folder)
        require("matplotlib", "views")
        capture = transient.TransientCapture.load(
            capture_file,
            format=layout,
            bin_width=bin_width,
            t_start=t_start,
            side=side,
            pairing=pairing,  # type: ignore[arg-type]  # checked there
            laser_point=numbers("--laser-point", laser_point) or None,
            outer_legs=outer_legs,
            gate_start=gate_start,
        )
        wanted = _picture(capture, {"wl_mean": wl_mean, "near": near, "far": far, "step": step})
        volume = transient.Volume.facing(
            _grid(capture), (wanted["near"], wanted["far"], wanted["step"])
        )
        with progress_bar(width=32) as progress, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they are in the image's notes
            image = transient.phasor_image(
                capture,
                volume,
                camera=camera,  # type: ignore[arg-type]  # checked there
                wl_mean=wanted["wl_mean"],
                wl_sigma=wl_sigma,
                aperture=aperture,
                progress=progress,
            )
            progress("writing", 1.0)
            report = _report(image, capture, capture_file) | {"command_line": typed(context)}
            with whole_folder(folder) as new:
                _write_picture(image, new)
                report["seconds"]["total"] = time.perf_counter() - start
                report["files"] = sorted([*(p.name for p in new.iterdir()), "result.json"])
                text = json.dumps(report, indent=2, allow_nan=False)
                (new / "result.json").write_text(text + "\n")
        for note in image.notes:
            typer.echo(f"nlosoptics: {note}", err=True)
        _print_picture(report, folder)


def _grid(capture: TransientCapture) -> Any:
    """Points before which the picture is taken: the sensors', or the lasers' before one sensor."""
    sensors, lasers = capture.sensor_points, capture.laser_points
    # files may lay one point as a grid
    alone = sensors.ndim < 3 or (sensors.size == 3 and lasers.ndim == 3)
    return lasers if alone else sensors


def _picture(capture: TransientCapture, given: dict[str, float | None]) -> dict[str, float]:
    """Wavelength and planes: what is given, else what the capture's scene wants."""
    held = capture.details.get("picture")
    wanted = dict(held) if isinstance(held, dict) else {}
    wanted |= {name: value for name, value in given.items() if value is not None}
    for name in given:
        if name not in wanted:
            option = f"--{name.replace('_', '-')}"
            raise typer.BadParameter(
                "is missing, and the capture does not say it", param_hint=option
            )
    return wanted


def _report(image: PhasorImage, capture: TransientCapture, path: Path) -> dict[str, Any]:
    """Machine-readable account of a picture: the contents of result.json."""
    import hashlib

    import numpy as np

    z, y, x = np.unravel_index(int(image.intensity.argmax()), image.intensity.shape)
    volume = image.volume
    ran = capture.details.get("run")
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "program": "nlosoptics",
        "command": "phasor",
        "status": "done",
        "finished": now(),
        "figures": {
            "brightest_voxel": [float(volume.x[x]), float(volume.y[y]), float(volume.z[z])],
            "volume_shape": list(volume.shape),
            "capture_shape": list(capture.H.shape),
            "peak_memory_bytes": peak_memory(),
        },
        "camera": image.camera,
        "wl_mean": image.wl_mean,
        "wl_sigma": image.wl_sigma,
        "aperture": image.aperture,
        "notes": list(image.notes),
        "details": {k: v for k, v in image.details.items() if isinstance(v, str | int | float)},
        "capture_file": path.name,
        "capture_sha256": digest,
        "capture_run": dict(ran) if isinstance(ran, dict) else None,
        "seconds": {"reconstruction": image.seconds},
        "versions": versions(),
    }


def _write_picture(image: PhasorImage, folder: Path) -> None:
    """Write the volume with its axes, and its views from the wall and from the side."""
    import numpy as np

    from .. import views

    np.savez(
        folder / "volume.npz", intensity=image.intensity, field=image.field, **arrays(image.volume)
    )
    for name, axis in (("front", "z"), ("top", "y"), ("side", "x")):
        views.save(views.volume(image, axis=axis), folder / f"{name}.png")


def _print_capture(capture: TransientCapture, path: Path, seconds: float) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table("figure", "value", box=box.SIMPLE_HEAD)
    table.add_row("bins", f"{capture.n_bins} of {1e3 * capture.delta_t:g} mm")
    lasers, sensors = (
        " x ".join(map(str, shape)) or "1" for shape in (capture.laser_shape, capture.sensor_shape)
    )
    table.add_row("points", f"{lasers} laser, {sensors} sensor, {capture.pairing}")
    total = float(capture.H.sum())
    table.add_row("light in all bins", f"{total:.4g} ({capture.quantity})")
    for bounces, part in capture.by_bounce.items():
        table.add_row(f"  of {bounces} reflections", f"{float(part.sum()):.4g}")
    table.add_row("seconds", f"{seconds:.2f}")
    table.add_row("written to", str(path))
    Console().print(table)


def _print_picture(report: dict[str, Any], folder: Path) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table("figure", "value", box=box.SIMPLE_HEAD)
    figures = report["figures"]
    place = ", ".join(f"{value:.3g}" for value in figures["brightest_voxel"])
    table.add_row("brightest voxel", f"({place}) m")
    table.add_row("voxels", " x ".join(map(str, figures["volume_shape"])))
    table.add_row("camera", f"{report['camera']}, wavelength {report['wl_mean']:g} m")
    for stage, seconds in report["seconds"].items():
        table.add_row(f"  {stage}", f"{seconds:.2f} s")
    table.add_row("written to", str(folder))
    Console().print(table)
