"""Sections of the report of a run, a reconstruction or an image of a capture."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from .._checks import reason
from .._html import Html, joined, png, tag
from ..errors import MissingExtraError, NlosError, SceneError
from .elements import Part, facts, number, plot, quantity, seconds, sections, spaced, wide_table

#: Result of each command.
COMMANDS = {
    "run": "simulation",
    "reconstruct": "reconstruction from camera images",
    "image": "image from a time-resolved capture",
}

#: Meaning of a reconstruction's status for its object; see `inverse.Reconstruction`.
STATUS = {
    "converged": "More iterations would hardly change the object, and with a known point spread no "
    "test found a fault of the model.",
    "unconverged": "The fit ended before it converged. The object may still change with more "
    "iterations and is not reliable.",
    "ambiguous": "The wall was fitted too, and another answer, such as the image itself without "
    "any blur, fits as well. The picture says little about the object.",
    "too_few_photons": "The noise hides the object: the picture is a rough estimate, or empty if "
    "no object was detected. Expose longer, or average several images.",
    "does_not_fit": "Image and model contradict each other, so the object is not to be trusted. "
    "Check the scene file (wall, distances, focus), the background and the camera's response.",
}


def contents(folder: Path, record: dict[str, Any], computed: bool) -> tuple[str, Html, list[Part]]:
    """Return title, header and sections of the page about a folder with its record."""
    command, figures = record["command"], record.get("figures", {})
    name = folder.resolve().name
    made: list[tuple[str, str, Iterator[Html]]] = []
    if command == "run":
        from ..runs.results import load_result

        result = load_result(folder)
        made += [
            ("scene", "Scene", _scene(result, computed)),
            ("plan", "Plan", _plan(result.plan)),
        ]
        if result.point_spread is not None:
            made += [("spread", "Wave and point spread", _spread(result))]
        made += [("image", "Image", _image(result))]
        if result.reconstruction is not None:
            made += [("reconstruction", "Reconstruction", _fit(result, figures))]
    elif command == "reconstruct":
        made += [("reconstruction", "Reconstruction", _reconstruction(folder, figures))]
    elif (folder / "volume.npz").is_file() or "brightest_voxel" in figures:
        made += [("volume", "Hidden volume", _volume(folder, record, computed))]
    made += [
        ("times", "Accuracy and time", _times(record)),
        ("provenance", "Provenance", _provenance(folder, record)),
    ]
    return f"{name}, nlosoptics {command}", _head(name, record), sections(made)


def _head(name: str, record: dict[str, Any]) -> Html:
    """Return the name of the run, the outcome in one sentence, and key figures."""
    figures, took = record.get("figures", {}), record.get("seconds", {})
    status = figures.get("reconstruction_status")
    lead = "No object was reconstructed."
    if "brightest_voxel" in figures:
        place = ", ".join(map(number, figures["brightest_voxel"]))
        lead = f"The brightest voxel of the hidden scene is at ({place}) m."
    elif status is not None:
        lead = f"Reconstruction: {spaced(status)}."
    version = record.get("versions", {}).get("nlosoptics", "")
    told = [str(record.get("finished") or "").replace("T", " ").replace("+00:00", " UTC")]
    told += [f"{key} {record[key]}" for key in ("seed", "tol") if record.get(key) is not None]
    notice = None
    if record.get("status", "done") != "done":
        text = f"Status: {record['status']}. This page shows the last saved state."
        notice = tag("p", text, class_="notice")
    # name, value and unit of the key figures
    tiles = [
        ("Correlation with the truth", figures.get("correlation_with_truth"), ""),
        (
            "Agreement of halves" if figures.get("method") == "phase_retrieval" else "Residual",
            figures.get("reconstruction_score"),
            "" if figures.get("method") == "phase_retrieval" else "of the noise",
        ),
        ("Error of the point spread", figures.get("point_spread_error"), "of its peak"),
        ("Wave aberration", figures.get("aberration_rms_waves"), "waves rms"),
        ("Working F-number", figures.get("f_number"), ""),
        ("Brightest pixel", figures.get("electrons_peak"), "electrons"),
        ("Exposures", figures.get("burst_images"), "of a burst"),
        ("Iterations", figures.get("iterations"), ""),
        ("Virtual wavelength", record.get("wl_mean"), "m"),
    ]
    shown: list[tuple[object, object]] = [
        (title, joined([number(value), tag("small", unit)]))
        for title, value, unit in tiles
        if value is not None
    ]
    if "total" in took:
        shown.append(("Whole run", seconds(took["total"])))
    return joined(
        [
            tag("p", f"nlosoptics {version}, {COMMANDS[record['command']]}", class_="kind"),
            tag("h1", name),
            tag("p", lead, class_="lead"),
            tag("p", ", ".join(filter(None, told)), class_="when"),
            notice,
            facts(shown, class_="tiles"),
        ]
    )


def _card(noun: Any, draw: Callable[[Any], Any] | None = None) -> Iterator[Html]:
    """Yield the picture and the figures of a result; ``draw`` replaces its usual picture."""
    from ..views import cards
    from ..views.saving import figure_file

    title, rows, alt = noun._figures()
    try:
        picture = plot(figure_file((draw or cards.axes)(noun)), title, alt)
    except MissingExtraError as error:
        picture = tag("p", f"The picture is left out: {error}.", class_="notice")
    yield tag("div", picture, facts(rows.items()), class_="figures")


def _room(plotter: Any, text: str) -> Iterator[Html]:
    """Yield a view that can be rotated, with a still picture for print."""
    from ..views.saving import plotter_file

    try:
        document, still = plotter_file(plotter, ".html").decode(), None
        try:
            picture = png(plotter_file(plotter, ".png"))
            still = tag("img", src=picture, alt=f"3-D view. {text}", class_="still")
        except MissingExtraError:
            text += " A printout lacks the view, because this machine cannot render it."
    finally:
        plotter.close()
    frame = tag(
        "iframe",
        srcdoc=document,
        title="3-D view that can be rotated",
        loading="lazy",
        sandbox="allow-scripts",
    )
    yield tag("figure", frame, still, tag("figcaption", text), class_="room")


def _left_out(error: NlosError) -> Html:
    return tag("p", f"The 3-D view is left out: {error}.", class_="notice")


def _scene(result: Any, computed: bool) -> Iterator[Html]:
    """Yield the scene in three dimensions, with light paths, and its sketch."""
    if computed and result.scene.laser.power == 0.0:
        from .. import views

        yield from _room(views.scene_3d(result.scene), "The scene, which has no laser.")
    elif computed:
        from .. import raytrace, views

        rays, most = 4096, 300
        try:
            paths = raytrace.trace(result.scene, n_rays=rays, keep_paths=True, seed=result.seed)
            count = min(most, len(paths.weight))
            yield from _room(
                views.ray_paths(paths, result.scene, most=most)
                if count
                else views.scene_3d(result.scene),
                f"{count} light paths that reach the camera, from {rays} rays traced for this page "
                "with the seed of the run. Paths via the hidden object are drawn first, and the "
                "density of lines is proportional to their power.",
            )
        except NlosError as error:
            yield _left_out(error)
    yield from _card(result.scene)


def _plan(plan: Any) -> Iterator[Html]:
    yield wide_table(
        "What ran",
        {"Stage": None, "Wanted error": None, "Predicted (s)": "number", "Why": None},
        [(s.name, s.error, f"{s.seconds:.2f}", s.reason) for s in plan.stages],
    )
    skipped = [(s.name, s.reason) for s in plan.skipped]
    yield wide_table("What was skipped", {"Stage": None, "Why not": None}, skipped)


def _spread(result: Any) -> Iterator[Html]:
    for noun in (result.wavefront, result.pupil_field, result.point_spread):
        if noun is not None:
            yield from _card(noun)


def _image(result: Any) -> Iterator[Html]:
    """Yield the camera image and the sources of its electrons."""
    yield from _card(result.image)
    ledger = result.image.ledger
    names = {
        "signal": "image of the object",
        "diffuse": "diffuse light of the wall",
        "spot": "laser spot on the wall",
        "ambient": "ambient light on the wall",
        "glare": "lens glare",
        "dark": "dark current",
    }
    total = sum(ledger.get(name, 0.0) for name in names) or 1.0
    rows = [
        (meaning, number(ledger[name]), f"{number(100 * ledger[name] / total)} %")
        for name, meaning in names.items()
        if name in ledger
    ]
    columns = {"Part": None, "Electrons": "number", "Share": "number"}
    yield wide_table("Sources of the expected electrons", columns, rows)


def _fit(result: Any, figures: dict[str, Any]) -> Iterator[Html]:
    """Yield the reconstruction of a run beside the truth."""
    from .. import views
    from ..views.run_overview import shown_fit

    fit, truth, options = shown_fit(result)
    yield from _card(fit, lambda fit: views.reconstruction(fit, truth, **options))
    yield _outcome(figures)


def _outcome(figures: dict[str, Any]) -> Html:
    """Return the status of a reconstruction in words, and its other figures."""
    status = figures.get("reconstruction_status")
    if status is None:
        return Html()
    parameters = figures.get("physical_parameters", {})
    return facts(
        [
            ("Status", f"{spaced(status)}. {STATUS.get(status, '')}".rstrip()),
            ("Because", "; ".join(figures.get("reconstruction_reasons", ())) or None),
            ("Method", figures.get("method")),
            *((spaced(name), _settled(value)) for name, value in parameters.items()),
        ]
    )


def _settled(value: Any) -> str:
    """Format the value or values of a fitted parameter."""
    if isinstance(value, list):
        return ", ".join(map(_settled, value))
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return number(value) if is_number else str(value)


def _arrays(path: Path, *names: str) -> list[Any]:
    """Return arrays of an ``.npz`` file; raise SceneError if they cannot be read."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return [file[name] for name in names]
    except Exception as error:  # numpy lets through what its parsers and zipfile raise
        raise SceneError(
            f"{path} cannot be read ({reason(error)}); run the command again"
        ) from None


def _reconstruction(folder: Path, figures: dict[str, Any]) -> Iterator[Html]:
    """Yield the object of ``nlosoptics reconstruct``, or its last preview."""
    from .. import views
    from ..views.saving import figure_file

    path, preview = folder / "reconstruction.npz", folder / "preview.png"
    if path.exists():
        (values,) = _arrays(path, "object")
        fit: Any = SimpleNamespace(
            object=values, status=figures.get("reconstruction_status", "unfinished")
        )
        alt = "Reconstructed object."
        axes = views.reconstruction(fit, mirrored=figures.get("method") != "shadows")
        yield plot(figure_file(axes), "Reconstruction", alt)
    elif preview.exists():
        yield plot(preview.read_bytes(), "Last saved state", "Object so far.")
    yield _outcome(figures)


def _volume(folder: Path, record: dict[str, Any], computed: bool) -> Iterator[Html]:
    """Yield the image of a capture, in three dimensions and projected along each axis."""
    from .. import views
    from ..transient import Volume, VolumeImage
    from ..views.saving import figure_file

    intensity, x, y, z = _arrays(folder / "volume.npz", "intensity", "x", "y", "z")
    image = VolumeImage(intensity=intensity, volume=Volume(x=x, y=y, z=z), method="phasor_image")
    if computed:
        try:
            yield from _room(
                views.phasor_volume(image),
                "Surface at 0.25 of the brightest voxel, coloured by distance from the wall. The "
                "initial view is from the far end of the room, from where letters appear "
                "mirror-reversed.",
            )
        except NlosError as error:
            yield _left_out(error)
    titles = {"z": "From the wall", "x": "From the side", "y": "From above"}
    alt = "Brightest voxels of the hidden scene. {}."
    yield tag(
        "div",
        *(
            plot(figure_file(views.volume(image, axis=axis)), title, alt.format(title))
            for axis, title in titles.items()
        ),
        class_="figures",
    )
    sigma, aperture = record.get("wl_sigma"), record.get("aperture")
    yield facts(
        [
            ("Voxels", " × ".join(map(str, image.intensity.shape))),
            ("Virtual camera", spaced(record.get("camera") or "")),
            ("Virtual pulse", None if sigma is None else f"sigma {quantity(sigma, 'm')}"),
            (
                "Aperture",
                "whole wall" if aperture is None else f"{quantity(aperture, 'm')} square",
            ),
            *(("Sampling limit", note) for note in record.get("notes", ())),
        ]
    )


def _times(record: dict[str, Any]) -> Iterator[Html]:
    """Yield the run time and the estimated error of each stage."""
    took, errors = record.get("seconds", {}), record.get("figures", {}).get("errors", {})
    longest = max((value for name, value in took.items() if name != "total"), default=1.0)
    rows = []
    for name, value in took.items():
        share = 0.0 if name == "total" else 100 * value / (longest or 1.0)
        bar = tag("span", class_="bar", style=f"width: {share:.1f}%") if share else None
        error = number(errors[name], 2) if name in errors else ""
        rows.append(
            (joined(["whole run" if name == "total" else name, bar]), f"{value:.2f}", error)
        )
    columns = {"Stage": None, "Took (s)": "number", "Estimated error": "number"}
    yield wide_table("Run time and error of each stage", columns, rows)


def _provenance(folder: Path, record: dict[str, Any]) -> Iterator[Html]:
    scene_file = folder / "scene.toml"
    code = {
        name: tag("code", record[key]) if record.get(key) else None
        for name, key in (
            ("Scene, SHA-256", "scene_sha256"),
            ("Capture, SHA-256", "capture_sha256"),
            ("Command line", "command_line"),
        )
    }
    again = None
    if record["command"] == "run":
        name = folder.resolve().name
        words = ["nlosoptics", "run", f"{name}/scene.toml", "--tol", repr(record["tol"])]
        words += ["--seed", str(record["seed"]), "--out", f"{name}-again"]
        if any(stage["name"] == "reconstruction" for stage in record["plan"]["skipped"]):
            words.append("--no-reconstruct")
        again = tag("code", shlex.join(words))
    rows = [("Capture", record.get("capture_file")), *code.items(), ("To repeat it", again)]
    yield facts(rows)
    sizes = [
        (name, quantity((folder / name).stat().st_size, "B"))
        for name in record.get("files", ())
        if (folder / name).is_file() and not name.endswith(".html")
    ]
    versions = list(record.get("versions", {}).items())
    yield tag(
        "div",
        wide_table("Versions", {"Package": None, "Version": "number"}, versions),
        wide_table("Files of the run", {"File": None, "Size": "number"}, sizes),
        class_="figures",
    )
    if scene_file.is_file():
        yield tag("h3", "Scene file")
        yield tag("pre", scene_file.read_text(encoding="utf-8", errors="replace"), tabindex=0)
