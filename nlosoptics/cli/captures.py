"""Commands transient, image and capture check, for time-resolved captures."""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._checks import lasting, one_of
from .._whole_files import whole_folder
from ..errors import NlosError
from ..runs.record import arrays, peak_memory, scene_hash, versions, write_record
from .shell import (
    Changes,
    Debug,
    Group,
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
    from ..transient import TransientCapture, VolumeImage
    from ..transient.imaging.depth import DepthMap

PICOSECOND = 299792458e-12  # m of optical path
_LENGTHS = ("wl_mean", "wl_sigma", "aperture")


CaptureFile = Annotated[
    Path, typer.Argument(metavar="CAPTURE", help="Capture file: HDF5, .mat, .npy or .npz.")
]
ArrayName = Annotated[
    str, typer.Option(help="Name of the array of counts, in a file whose layout is not recognised.")
]
Axes = Annotated[
    str, typer.Option(help="Order of this array's axes, such as y,x,t; -y runs downward.")
]
Side = Annotated[str, typer.Option(help="Side of the scanned wall in such a file, such as 0.7m.")]
BinWidth = Annotated[
    str,
    typer.Option(help="Width of a time bin, as time (16ps) or path (4.8mm); replaces the file's."),
]
Start = Annotated[str, typer.Option(help="Start of bin 0, as time or path; replaces the file's.")]
Pairs = Annotated[
    str | None,
    typer.Option(
        help="Which laser and sensor points belong together: all (every pair) or confocal "
        "(the same point for both); replaces the file's."
    ),
]
LaserPoint = Annotated[
    str,
    typer.Option(
        help="Position of the only laser point, 'x, y, z' in m; replaces the file's points."
    ),
]
OuterLegs = Annotated[
    bool | None,
    typer.Option(
        "--outer-legs/--no-outer-legs",
        help="Whether times include the paths from laser to wall and from wall to sensor; "
        "replaces the file's. To subtract them, the two origins below must be known.",
    ),
]
Origin = Annotated[
    str, typer.Option(help="Position of this device, 'x, y, z' in m; replaces the file's.")
]
GateStart = Annotated[
    str, typer.Option(help="Drop all earlier bins, to remove direct light; time or optical path.")
]

captures = typer.Typer(
    cls=Group,
    help="Check a file with a time-resolved capture.",
    short_help="Check a file with a time-resolved capture.",
)
app.add_typer(captures, name="capture")


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
            help="Tolerance of light with three reflections: sum of the magnitudes of the errors "
            "of all time bins, divided by the sum of the bins."
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
            help="Quantity to store at each wall point, per W of laser power: irradiance (1/m^2), "
            "radiosity (light that leaves the wall, 1/m^2) or radiance (1/(m^2 sr))."
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

    Example: nlosoptics transient transient --out flash.hdf5
    """
    with errors_told(debug):
        start = time.perf_counter()
        if photons is None and (jitter_ps or dark_counts):
            raise typer.BadParameter(
                "is missing; give it for --jitter-ps and --dark-counts", param_hint="--photons"
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
        seconds = ("run time", lasting(time.perf_counter() - start))
        files = (("written to", str(path)), ("next", f"nlosoptics image {path}"))
        print_table([*_capture_rows(capture), seconds, *files])


@app.command("image", short_help="Form an image of the hidden scene from a time-resolved capture.")
def image_command(
    context: typer.Context,
    capture_file: CaptureFile,
    out: Out = None,
    method: Annotated[
        str,
        typer.Option(
            help="phasor (phasor field), fk (f-k migration), lct (light-cone transform), "
            "backprojection, or inverse (likelihood of a confocal capture's counts; sharper, 2 to "
            "30 s)."
        ),
    ] = "phasor",
    camera: Annotated[
        str | None,
        typer.Option(
            help="Virtual camera of phasor: confocal_time_gated (pulse and camera are focused on "
            "the same point; by default) or direct_light (light that the scene reflected once)."
        ),
    ] = None,
    wl_mean: Annotated[
        str,
        typer.Option(
            help="Central wavelength of phasor's virtual pulse, such as 6cm; by default from the "
            "file's scene or chosen from the photons."
        ),
    ] = "",
    wl_sigma: Annotated[
        str,
        typer.Option(help="Length (sigma) of this pulse, such as 4cm; by default wl-mean/sqrt(2)."),
    ] = "",
    near: Annotated[
        str, typer.Option(help="Distance of the first image plane from the wall, such as 0.4m.")
    ] = "",
    far: Annotated[
        str, typer.Option(help="Distance of the last image plane from the wall, such as 0.9m.")
    ] = "",
    step: Annotated[
        str, typer.Option(help="Distance between neighbouring planes, such as 5mm.")
    ] = "",
    aperture: Annotated[
        str,
        typer.Option(
            help="Use only wall points in a central square with this side, such as 1m; by default "
            "all. For phasor only."
        ),
    ] = "",
    array: ArrayName = "",
    axes: Axes = "t,y,x",
    side: Side = "",
    bin: BinWidth = "",
    t_start: Start = "",
    pairing: Pairs = None,
    laser_points: LaserPoint = "",
    outer_legs: OuterLegs = None,
    laser_origin: Origin = "",
    sensor_origin: Origin = "",
    gate_start: GateStart = "",
    seed: Seed = 0,
    debug: Debug = False,
) -> None:
    """Form an image of the hidden scene from a time-resolved capture.

    Gate, background, wavelength and planes that neither the file nor an option states are chosen
    from the capture: two halves of its photons must agree on the front view. A length without unit
    is in m. The output folder gets the volume with depths (volume.npz), views from the front, the
    top and the side, a map of depths, and result.json.

    Example: nlosoptics image flash.hdf5 --out flash
    """
    with errors_told(debug):
        start = time.perf_counter()
        folder = Path(capture_file.stem) if out is None else out

        check_target(folder)
        one_of("--method", method, ("phasor", "fk", "lct", "backprojection", "inverse"))
        names = ("near", "far", "step") if method == "inverse" else ()
        for name in ("camera", "wl_mean", "wl_sigma", "aperture", *names):
            if (value := context.params[name]) and method != "phasor":
                raise typer.BadParameter(
                    f"{value!r} is not for --method {method}; leave it out, or use phasor",
                    param_hint=_option(name),
                )
        drawn = can_draw()
        picture, options = (
            {name: _path(_option(name), context.params[name]) for name in names}
            for names in (("wl_mean", "near", "far", "step"), ("wl_sigma", "aperture"))
        )
        capture = _read(context.params)
        chosen = {n: v for n, v in {"camera": camera, **options}.items() if v is not None}
        with progress_bar(width=32) as progress, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the image's notes repeat the warnings
            with _options_named():
                image, depths = _formed(capture, picture, method, seed, progress, **chosen)
            progress("writing", 1.0)
            report = _report(image, capture, capture_file) | {"command_line": typed(context)}
            with whole_folder(folder) as new:
                if image is not None and depths is not None:
                    _write_picture(image, depths, new, drawn)
                report["seconds"]["total"] = time.perf_counter() - start
                write_record(report, new)
        for note in report["notes"]:
            typer.echo(f"nlosoptics: {note}", err=True)
        print_table([*_picture_rows(report, folder), ("next", f"nlosoptics report {folder}")])


@captures.command("check", short_help="Say what a capture file holds, and what can image it.")
def check_command(
    context: typer.Context,
    capture_file: CaptureFile,
    array: ArrayName = "",
    axes: Axes = "t,y,x",
    side: Side = "",
    bin: BinWidth = "",
    t_start: Start = "",
    pairing: Pairs = None,
    laser_points: LaserPoint = "",
    outer_legs: OuterLegs = None,
    laser_origin: Origin = "",
    sensor_origin: Origin = "",
    gate_start: GateStart = "",
    debug: Debug = False,
) -> None:
    """Say what a capture file holds: points, bins, light of the hidden scene, fitting methods.

    A file that cannot be read, or that lacks a value, is refused with the option that supplies it.
    A length without unit is in m.

    Example: nlosoptics capture check flash.hdf5
    """
    with errors_told(debug):
        capture = _read(context.params)
        print_table([*_capture_rows(capture), *_light_rows(capture)])


def _read(options: Mapping[str, Any]) -> TransientCapture:
    """Read a capture file, with what the options state, and drop the bins before the gate."""
    from .. import transient

    places = ("laser_points", "laser_origin", "sensor_origin")
    lengths = {n: _path(_option(n), options[n]) for n in ("side", "bin", "t_start", "gate_start")}
    with _options_named():
        capture = transient.TransientCapture.load(
            options["capture_file"],
            array=options["array"]
            or ("array" if options["capture_file"].suffix == ".npy" else None),
            axes=options["axes"],
            side=lengths["side"],
            delta_t=lengths["bin"],
            t_start=lengths["t_start"],
            pairing=options["pairing"],
            **{name: numbers(_option(name), options[name]) or None for name in places},
            outer_legs=options["outer_legs"],
        )
    gate = lengths["gate_start"]
    return capture if gate is None else transient.gated(capture, start=gate)


@contextmanager
def _options_named() -> Iterator[None]:
    """Replace the arguments that an error names by the options of the command."""
    try:
        yield
    except NlosError as error:
        raise type(error)(_with_options(error)) from None


def _with_options(error: NlosError) -> str:
    """Return the text of an error with options instead of arguments."""
    names = r"\b(delta_t|t_start|laser_points|outer_legs|sensor_points|(laser|sensor)_origin)\b"
    others = {"delta_t": "bin", "sensor_points": "side"}
    return re.sub(names, lambda found: _option(others.get(found[0], found[0])), str(error))


def _option(name: str) -> str:
    """Return the option that gives an argument of this name."""
    return f"--{name.replace('_', '-')}"


def _path(option: str, text: str) -> float | None:
    """Return a length or time of light, such as 4.8mm or 16ps, in m; a number is in m."""
    from ..scene.file.units import measured
    from ..scene.parts._quantities import Kind

    if not text:
        return None
    with suppress(ValueError):
        return float(text)
    value, kind = measured(text) or (0.0, None)
    if kind not in (Kind.LENGTH, Kind.TIME):
        raise typer.BadParameter(
            f"{text!r} is neither a length nor a time; give such as 4.8mm or 16ps",
            param_hint=option,
        )
    return value if kind == Kind.LENGTH else value * 1e12 * PICOSECOND


def _formed(
    capture: TransientCapture,
    picture: dict[str, float | None],
    method: str,
    seed: int,
    progress: Any,
    **options: Any,
) -> tuple[VolumeImage | None, DepthMap | None]:
    """Return an image and its depths by the options, the file's scene, or else the photons."""
    from .. import transient
    from ..transient.imaging.advice import AMPLITUDE, grid_of

    stored = capture.details.get("picture")
    wanted: dict[str, float] = dict(stored) if isinstance(stored, dict) else {}
    wanted |= {name: value for name, value in picture.items() if value is not None}
    if method == "inverse" or set(picture) - set(wanted):
        advice = transient.advise(capture, seed=seed, progress=progress)
        if advice.image is None:
            return None, None
        if method == "inverse":
            found = transient.inverse_image(capture, advice=advice, seed=seed, progress=progress)
            return found, transient.depth_map(found, threshold=found.details["threshold"])
        if method == "phasor" and not wanted and not options:
            return advice.image, advice.depths
        z = advice.image.volume.z
        wl_mean = advice.image.wl_mean
        step = wl_mean / (4 if method == "phasor" else 16)  # the others have sharper edges
        wanted = {"near": z[0], "far": z[-1], "step": step, "wl_mean": wl_mean} | wanted
        capture = advice.light
    if method in ("fk", "lct"):
        capture = transient.without_outer_legs(capture)
        if not capture.is_confocal:
            capture = transient.normal_moveout(capture)
    volume = transient.Volume.facing(
        grid_of(capture), (wanted["near"], wanted["far"], wanted["step"])
    )
    if method == "phasor":
        image: VolumeImage = transient.phasor_image(
            capture, volume, wl_mean=wanted["wl_mean"], progress=progress, **options
        )
    elif method == "backprojection":
        image = transient.backprojection(capture, volume, progress=progress)
    elif method == "fk":  # the root of noise would be brighter than the noise
        image = transient.fk_migration(capture, volume, amplitude="albedo", progress=progress)
    else:
        image = transient.lct(capture, volume, progress=progress)
    # the rim of an even surface lies at half its light; intensities of waves are squares
    share = {"phasor": AMPLITUDE, "fk": 0.4}.get(method, 0.5)
    power = 2 if method in ("phasor", "fk") else 1
    return image, transient.depth_map(image, threshold=share**power)


def _report(image: VolumeImage | None, capture: TransientCapture, path: Path) -> dict[str, Any]:
    """Contents of ``result.json`` for an image of a capture."""
    import hashlib

    import numpy as np

    figures: dict[str, Any] = {
        "reconstruction_status": "no object above the noise",
        "capture_shape": list(capture.H.shape),
        "peak_memory_bytes": peak_memory(),
    }
    if image is not None:
        z, y, x = np.unravel_index(int(image.intensity.argmax()), image.intensity.shape)
        volume = image.volume
        figures |= {
            "reconstruction_status": "converged",
            "method": image.method,
            "brightest_voxel": [float(volume.x[x]), float(volume.y[y]), float(volume.z[z])],
            "volume_shape": list(volume.shape),
        }
    ran = capture.details.get("run")
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    details = {} if image is None else image.details
    return {
        "command": "image",
        "figures": figures,
        **{name: getattr(image, name, None) for name in ("camera", *_LENGTHS)},
        "notes": list(getattr(image, "notes", ())),
        "details": {k: v for k, v in details.items() if isinstance(v, str | int | float)},
        "capture_file": path.name,
        "capture_sha256": digest,
        "capture_run": dict(ran) if isinstance(ran, dict) else None,
        "seconds": {} if image is None else {"reconstruction": image.seconds},
    }


def _write_picture(image: VolumeImage, depths: DepthMap, folder: Path, drawn: bool) -> None:
    """Write the volume with its axes and depths, and pictures of it."""
    import numpy as np

    field = {"field": image.field} if hasattr(image, "field") else {}
    np.savez(
        folder / "volume.npz",
        intensity=image.intensity,
        depth=depths.depth,
        confidence=depths.confidence,
        **field,
        **arrays(image.volume),
    )
    if not drawn:
        return
    from .. import views

    for name, axis in (("front", "z"), ("top", "y"), ("side", "x")):
        views.save(views.volume(image, axis=axis), folder / f"{name}.png")
    views.save(views.depth_map(depths), folder / "depth.png")


def _capture_rows(capture: TransientCapture) -> Iterator[tuple[str, str]]:
    """Rows of a table on points, bins and light of a capture."""
    low, high = capture.edges[[0, -1]]
    yield ("bins", f"{capture.n_bins} of {1e3 * capture.delta_t:g} mm, {low:.4g} to {high:.4g} m")
    lasers, sensors = (
        " x ".join(map(str, shape)) or "1" for shape in (capture.laser_shape, capture.sensor_shape)
    )
    yield ("points", f"{lasers} laser, {sensors} sensor, {capture.pairing}")
    total = float(capture.H.sum())
    yield ("light in all bins", f"{total:.4g} ({capture.quantity})")
    for bounces, part in capture.by_bounce.items():
        yield (f"  of {bounces} reflections", f"{float(part.sum()):.4g}")


def _light_rows(capture: TransientCapture) -> Iterator[tuple[str, str]]:
    """Rows on the light of the hidden scene, and on the methods that can image it."""
    from .. import transient
    from ..transient.capture.hidden_light import counts_photons
    from ..transient.imaging.advice import shortest_wavelength
    from ..transient.imaging.confocal_grids import confocal_grid

    yield ("outer legs", "included in times" if capture.outer_legs else "not included")
    try:
        light = transient.hidden_light(capture)
    except NlosError as error:
        yield ("light of the scene", _with_options(error).split(";")[0])
        return
    facts: Any = light.details["hidden_light"]
    yield (
        "light of the scene",
        f"{facts['start']:.4g} to {facts['stop']:.4g} m of path beyond the straight one",
    )
    yield ("background", f"{facts['background']:.3g} in each bin and pair")
    yield ("shortest wavelength", f"{shortest_wavelength(capture):.3g} m")
    methods = "phasor, backprojection"
    try:
        light = transient.without_outer_legs(light)
        whole = light if light.is_confocal else transient.normal_moveout(light)
        confocal_grid(whole, "fk")
        methods += ", fk, lct" if whole is light else ", fk, lct (after normal moveout)"
        methods += ", inverse" if capture.is_confocal and counts_photons(capture) else ""
    except NlosError as error:
        methods += f"; not fk, lct: {_with_options(error).split(';')[0]}"
    yield ("methods", methods)


def _picture_rows(report: dict[str, Any], folder: Path) -> Iterator[tuple[str, str]]:
    figures = report["figures"]
    yield ("reconstruction", figures["reconstruction_status"])
    if "brightest_voxel" in figures:
        place = ", ".join(f"{value:.3g}" for value in figures["brightest_voxel"])
        yield ("brightest voxel", f"({place}) m")
        yield ("voxels", " x ".join(map(str, figures["volume_shape"])))
        yield ("method", figures["method"])
    if report["wl_mean"] is not None:
        yield ("virtual wavelength", f"{report['wl_mean']:.3g} m")
    yield from stage_rows(report)
    yield ("written to", str(folder))
