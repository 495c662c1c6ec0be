"""Commands transient and phasor, for time-resolved captures."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._whole_files import whole_folder
from ..errors import SceneError
from ..runs.record import arrays, now, peak_memory, scene_hash, versions, write_record
from .shell import (
    Changes,
    Debug,
    Out,
    SceneFile,
    Seed,
    app,
    can_draw,
    check_file,
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
    from ..transient import PhasorImage, TransientCapture

PICOSECOND = 299792458e-12  # m of optical path


@app.command("transient", short_help="Simulate a time-resolved capture of a scene.")
def transient_command(
    scene_file: SceneFile,
    changes: Changes = None,
    out: Annotated[
        Path | None,
        typer.Option(help="HDF5 file to write; by default the name of the scene file with .hdf5."),
    ] = None,
    tol: Annotated[
        float,
        typer.Option(
            help="Largest relative error of light with three reflections: sum of the magnitudes of "
            "the errors of all time bins, divided by the sum of the bins."
        ),
    ] = 1e-3,
    tol_multiple: Annotated[
        float,
        typer.Option(help="As --tol, for light with four or more reflections."),
    ] = 1e-2,
    seed: Seed = 0,
    quantity: Annotated[
        str,
        typer.Option(
            help="Quantity to store at each wall point: irradiance, radiance or radiosity."
        ),
    ] = "irradiance",
    photons: Annotated[
        float | None,
        typer.Option(
            help="Expected number of photons in the whole capture. If given, the file holds photon "
            "counts with noise instead of the light."
        ),
    ] = None,
    jitter_ps: Annotated[
        float, typer.Option(help="Standard deviation of the detector's arrival times, ps.")
    ] = 0.0,
    dark_counts: Annotated[
        float, typer.Option(help="Expected counts without light, for each time bin and wall point.")
    ] = 0.0,
    compression: Annotated[
        int, typer.Option(min=0, max=9, help="gzip compression level of the file, 0 (none) to 9.")
    ] = 1,
    debug: Debug = False,
) -> None:
    """Simulate a time-resolved capture: the light at points of the wall as a function of time.

    The scene needs a table [transient]. The HDF5 file can also be read by the program y-tal.
    """
    with errors_told(debug):
        start = time.perf_counter()
        if photons is None and (jitter_ps or dark_counts):
            raise typer.BadParameter(
                "is missing, but --jitter-ps and --dark-counts need it", param_hint="--photons"
            )
        path = Path(f"{scene_file.stem}.hdf5") if out is None else out
        from .. import transient

        scene = load(scene_file, None, changes)
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
        print_table(_capture_rows(capture, path, time.perf_counter() - start))


@app.command("phasor", short_help="Form an image of the hidden scene from a time-resolved capture.")
def phasor_command(
    context: typer.Context,
    capture_file: Annotated[
        Path, typer.Argument(metavar="CAPTURE", help="Capture file: HDF5 or .mat.")
    ],
    out: Out = None,
    camera: Annotated[
        str, typer.Option(help="Virtual camera: confocal_time_gated or direct_light.")
    ] = "confocal_time_gated",
    wl_mean: Annotated[
        float | None,
        typer.Option(help="Central wavelength of the virtual pulse, m; by default from the file."),
    ] = None,
    wl_sigma: Annotated[
        float | None,
        typer.Option(help="Length (sigma) of the virtual pulse, m; by default wl-mean/sqrt(2)."),
    ] = None,
    near: Annotated[
        float | None,
        typer.Option(
            help="Distance of the first image plane from the wall, m; by default from the file."
        ),
    ] = None,
    far: Annotated[
        float | None,
        typer.Option(
            help="Distance of the last image plane from the wall, m; by default from the file."
        ),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(help="Distance between neighbouring planes, m; by default from the file."),
    ] = None,
    aperture: Annotated[
        float | None,
        typer.Option(
            help="Use only wall points in a central square with this side, m; by default all."
        ),
    ] = None,
    delta_t: Annotated[
        float | None,
        typer.Option(help="Width of a time bin, m of optical path, if the file does not state it."),
    ] = None,
    t_start: Annotated[
        float | None,
        typer.Option(help="Start of bin 0, m of optical path, if the file does not state it."),
    ] = None,
    pairing: Annotated[
        str | None,
        typer.Option(
            help="Which laser and sensor points belong together, if the file does not state it: "
            "all (every pair) or confocal (the same point for both)."
        ),
    ] = None,
    laser_points: Annotated[
        str,
        typer.Option(
            help="Position of the only laser point, 'x, y, z' in m, if the file does not state it."
        ),
    ] = "",
    outer_legs: Annotated[
        bool | None,
        typer.Option(
            "--outer-legs/--no-outer-legs",
            help="Whether times include the paths from laser to wall and from wall to sensor, if "
            "the file does not state it.",
        ),
    ] = None,
    gate_start: Annotated[
        float | None,
        typer.Option(help="Drop all earlier bins, to remove direct light; m of optical path."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Form an image of the hidden scene from a time-resolved capture, by the phasor-field method.

    The output folder gets the volume (volume.npz), views from the front, the top and the side, and
    result.json. Options that only describe the capture are needed if the file does not state them.
    """
    with errors_told(debug):
        start = time.perf_counter()
        folder = Path(capture_file.stem) if out is None else out
        from .. import transient

        check_target(folder)
        drawn = can_draw()
        picture = {"wl_mean": wl_mean, "near": near, "far": far, "step": step}
        capture = transient.TransientCapture.load(
            capture_file,
            delta_t=delta_t,
            t_start=t_start,
            pairing=pairing,
            laser_points=numbers("--laser-points", laser_points) or None,
            outer_legs=outer_legs,
        )
        if gate_start is not None:
            capture = transient.gated(capture, start=gate_start)
        wanted = _planes(capture_file, capture, picture)
        volume = transient.Volume.facing(
            _grid(capture), (wanted["near"], wanted["far"], wanted["step"])
        )
        with progress_bar(width=32) as progress, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the image's notes repeat the warnings
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
                _write_picture(image, new, drawn)
                report["seconds"]["total"] = time.perf_counter() - start
                write_record(report, new)
        for note in image.notes:
            typer.echo(f"nlosoptics: {note}", err=True)
        print_table(_picture_rows(report, folder))


def _grid(capture: TransientCapture) -> Any:
    """Return the grid of wall points that the volume faces.

    These are the sensor points, or the laser points if there is a single sensor point.
    """
    sensors, lasers = capture.sensor_points, capture.laser_points
    # some files store a single point as a grid
    alone = sensors.ndim < 3 or (sensors.size == 3 and lasers.ndim == 3)
    return lasers if alone else sensors


def _planes(
    path: Path, capture: TransientCapture, picture: dict[str, float | None]
) -> dict[str, float]:
    """Return wavelength and planes of an image: the options, else those of the capture's scene."""
    stored = capture.details.get("picture")
    wanted = dict(stored) if isinstance(stored, dict) else {}
    wanted |= {name: value for name, value in picture.items() if value is not None}
    missing = [f"--{name.replace('_', '-')}" for name in picture if name not in wanted]
    if missing:
        raise SceneError(f"{path} does not state all values for an image; add {', '.join(missing)}")
    return wanted


def _report(image: PhasorImage, capture: TransientCapture, path: Path) -> dict[str, Any]:
    """Contents of ``result.json`` for an image of a capture."""
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


def _write_picture(image: PhasorImage, folder: Path, drawn: bool) -> None:
    """Write the volume with its axes, and pictures of it from the wall, from above and the side."""
    import numpy as np

    np.savez(
        folder / "volume.npz", intensity=image.intensity, field=image.field, **arrays(image.volume)
    )
    if not drawn:
        return
    from .. import views

    for name, axis in (("front", "z"), ("top", "y"), ("side", "x")):
        views.save(views.volume(image, axis=axis), folder / f"{name}.png")


def _capture_rows(
    capture: TransientCapture, path: Path, seconds: float
) -> Iterator[tuple[str, str]]:
    yield ("bins", f"{capture.n_bins} of {1e3 * capture.delta_t:g} mm")
    lasers, sensors = (
        " x ".join(map(str, shape)) or "1" for shape in (capture.laser_shape, capture.sensor_shape)
    )
    yield ("points", f"{lasers} laser, {sensors} sensor, {capture.pairing}")
    total = float(capture.H.sum())
    yield ("light in all bins", f"{total:.4g} ({capture.quantity})")
    for bounces, part in capture.by_bounce.items():
        yield (f"  of {bounces} reflections", f"{float(part.sum()):.4g}")
    yield ("seconds", f"{seconds:.2f}")
    yield ("written to", str(path))


def _picture_rows(report: dict[str, Any], folder: Path) -> Iterator[tuple[str, str]]:
    figures = report["figures"]
    place = ", ".join(f"{value:.3g}" for value in figures["brightest_voxel"])
    yield ("brightest voxel", f"({place}) m")
    yield ("voxels", " x ".join(map(str, figures["volume_shape"])))
    yield ("camera", f"{report['camera']}, wavelength {report['wl_mean']:g} m")
    yield from stage_rows(report)
    yield ("written to", str(folder))
