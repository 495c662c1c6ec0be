"""Sections of the report page; a section without data in the folder is left out."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

from .. import __version__
from .._checks import counted
from .._html import Column, Html, joined, png, table, tag
from ..errors import NlosError, SceneError
from ..limits import object_scale
from ..runs.plan import FIELD
from . import words
from .elements import date, facts, figure, number, percent, quantity, seconds, section
from .folders import Folder
from .pixels import pixels
from .rooms import Room

Part = tuple[str, str, Html]
SHARES_OF_ROUNDING = 1e-12  # smaller fractions of a sum are rounding errors
NARROW = "52rem"  # window width below which the two views of the sketch are stacked


def head(held: Folder) -> Html:
    """Header: name of the run, outcome in one sentence, and key figures."""
    record = held.record
    made = f"nlosoptics {record.versions.get('nlosoptics', '')}".strip()
    when = record.finished and date(record.finished)
    told = [when, _seed(held), None if record.tol is None else f"tol {number(record.tol)}"]
    notice = words.UNFINISHED.get(record.status)
    return joined(
        [
            tag("p", f"{made}, {words.COMMANDS[record.command]}", class_="kind"),
            tag("h1", held.name),
            tag("p", _outcome(held), class_="lead"),
            tag("p", ", ".join(part for part in told if part), class_="when"),
            None if notice is None else tag("p", notice, class_="notice"),
            facts(_tiles(held), class_="tiles"),
        ]
    )


def parts(held: Folder, drawn: Room | None, missing: str) -> list[Part]:
    """Return anchor, title and contents of each section that has contents."""
    made = (
        ("scene", "Scene", _scene(held, drawn, missing)),
        ("plan", "Plan", _plan(held)),
        ("spread", "Wave and point spread", _spread(held)),
        ("image", "Image", _image(held)),
        ("reconstruction", "Reconstruction", _reconstruction(held)),
        ("volume", "Hidden volume", _volume(held, drawn, missing)),
        ("times", "Accuracy and time", _times(held)),
        ("provenance", "Provenance", _provenance(held)),
    )
    return [
        (anchor, title, section(anchor, title, *contents))
        for anchor, title, contents in ((a, t, list(c)) for a, t, c in made)
        if contents
    ]


def colophon() -> str:
    """Footer: the program that made the page."""
    return f"Made by nlosoptics report {__version__}. This file is complete and loads nothing else."


def _seed(held: Folder) -> str | None:
    return None if held.record.seed is None else f"seed {held.record.seed}"


def _outcome(held: Folder) -> str:
    """Outcome of the run in one sentence."""
    figures = held.record.figures
    if held.record.command == "phasor" and figures.brightest_voxel:
        place = ", ".join(number(value) for value in figures.brightest_voxel)
        return f"The brightest voxel of the hidden scene is at ({place}) m."
    status = figures.reconstruction_status
    if status is None:
        return "No object was reconstructed."
    told = words.OUTCOME.get(status, f"The reconstruction is {status}.")
    if figures.correlation_with_truth is not None:
        told += f" Correlation with the truth: {number(figures.correlation_with_truth, 4)}."
    return told


def _tiles(held: Folder) -> Iterator[tuple[object, object]]:
    """Key figures; accuracies are shown with their run time."""
    record, f = held.record, held.record.figures

    def tile(value: str, *notes: str | None) -> Html:
        return joined([value, tag("small", ", ".join(note for note in notes if note))])

    def took(name: str) -> str | None:
        return seconds(record.seconds[name]) if name in record.seconds else None

    if f.correlation_with_truth is not None:
        yield (
            "Correlation with the truth",
            tile(number(f.correlation_with_truth, 4), "1 is perfect", took("reconstruction")),
        )
    if f.reconstruction_score is not None:
        name = "Agreement" if f.method == "phase_retrieval" else "Residual"
        yield name, tile(number(f.reconstruction_score), *_score_note(held), took("solver"))
    if f.point_spread_error is not None:
        yield (
            "Error of the point spread",
            tile(number(f.point_spread_error, 2), "of its peak", took("point spread")),
        )
    if FIELD in f.errors:
        error = number(f.errors[FIELD], 2)
        yield "Image error of the field of point spreads", tile(error, "rms", took(FIELD))
    if f.aberration_rms is not None and f.aberration_rms_waves is not None:
        yield (
            "Wave aberration",
            tile(
                f"{number(f.aberration_rms_waves)} waves",
                f"{quantity(f.aberration_rms, 'm')} rms",
                took("wave aberration"),
            ),
        )
    if f.f_number is not None and f.exit_pupil_radius is not None:
        radius = quantity(f.exit_pupil_radius, "m")
        yield (
            "Working F-number",
            tile(number(f.f_number), f"exit pupil of {radius} radius", f"stop: {f.stop}"),
        )
    if f.electrons_peak is not None and f.electrons_mean is not None:
        yield (
            "Brightest pixel",
            tile(f"{number(f.electrons_peak)} electrons", f"mean {number(f.electrons_mean)}"),
        )
    if f.iterations is not None:
        yield "Iterations", tile(str(f.iterations), f.method)
    if record.wl_mean is not None:
        yield (
            "Virtual wavelength",
            tile(quantity(record.wl_mean, "m"), record.camera and _spaced(record.camera)),
        )
    if f.volume_shape:
        yield "Voxels", tile(" × ".join(map(str, f.volume_shape)), "depth, height, width")
    if "total" in record.seconds:
        memory = f.peak_memory_bytes
        most = None if memory is None else f"peak memory {number(memory / 2**20)} MiB"
        yield "Whole run", tile(seconds(record.seconds["total"]), most)


def _score_note(held: Folder) -> tuple[str, ...]:
    if held.record.figures.method == "phase_retrieval":
        return ("correlation of two halves of the restarts", "1 is full agreement")
    return ("in units of the noise", "1 if only noise remains")


def _turned(drawn: Room | None, missing: str) -> Iterator[Html]:
    """Rotatable 3-D view with a still picture for print, or the reason why there is none."""
    if missing:
        yield tag("p", f"The 3-D view is left out: {missing}.", class_="notice")
    if drawn is None:
        return
    frame = tag(
        "iframe",
        srcdoc=drawn.document,
        title="3-D view that can be rotated",
        loading="lazy",
        sandbox="allow-scripts",
    )
    still = paper = None
    if drawn.picture is None:
        paper = tag("span", " A printout lacks the view, because this machine cannot render it.")
    else:
        alt = f"3-D view. {drawn.told}"
        still = tag("img", src=png(drawn.picture), alt=alt, class_="still")
    yield figure(joined([frame, still]), drawn.told, paper, class_="room")


def _scene(held: Folder, drawn: Room | None, missing: str) -> Iterator[Html]:
    if held.record.command == "run":
        yield from _turned(drawn, missing)
    if sketch := held.picture("scene.png"):
        picture = tag(
            "img",
            src=png(sketch),
            alt="Plan and side view of relay wall, laser beam, hidden object and camera.",
        )
        if narrow := _narrow_sketch(held):
            stacked = tag("source", media=f"screen and (max-width: {NARROW})", srcset=png(narrow))
            picture = tag("picture", stacked, picture)
        yield figure(
            picture,
            tag("b", "From above and from the side"),
            ", in metres. The chief path leads from the laser spot via the object and the wall to "
            "the lens, as if the wall were flat.",
            class_="sketch",
        )


def _narrow_sketch(held: Folder) -> bytes | None:
    """Return the views of the sketch one above the other as PNG; None if they cannot be drawn."""
    from ..views.saving import figure_file
    from ..views.sketch import scene_sketch

    try:
        scene = held.scene()
        return None if scene is None else figure_file(scene_sketch(scene, stacked=True), ".png")
    except NlosError:
        return None


def _plan(held: Folder) -> Iterator[Html]:
    plan = held.record.plan
    columns = (Column("Stage"), Column("Why"))
    if plan.stages:
        yield table("What ran", columns, [(s.name, s.reason) for s in plan.stages])
    if plan.skipped:
        rows = [(s.name, s.reason) for s in plan.skipped]
        yield table("What was skipped", (Column("Stage"), Column("Why not")), rows)


def _spread(held: Folder) -> Iterator[Html]:
    f = held.record.figures
    shown = []
    if wave := held.picture("wavefront.png"):
        picture = tag("img", src=png(wave), alt="Map of the wave aberration over the exit pupil.")
        rms = "" if f.aberration_rms is None else f", {quantity(f.aberration_rms, 'm')} rms"
        shown.append(
            figure(
                picture,
                tag("b", "Wave aberration"),
                f"{rms}. Colours in waves, exit pupil in mm; red means a longer path.",
                class_="plot",
            )
        )
    if phase := held.picture("pupil_phase.png"):
        picture = tag("img", src=png(phase), alt="Map of the phase over the exit pupil.")
        shown.append(
            figure(
                picture,
                tag("b", "Phase in the pupil"),
                " of the light that this rough wall sends to the exit pupil, in radians.",
                class_="plot",
            )
        )
    if spread := held.picture("point_spread.png"):
        picture = tag("img", src=png(spread), alt="Point spread, logarithmic colours.")
        shown.append(
            figure(
                picture,
                tag("b", "Point spread"),
                " at the object's reference point: energy per pixel on a logarithmic scale, "
                "detector in µm.",
                class_="plot",
            )
        )
    if shown:
        yield tag("div", *shown, class_="figures")
    if f.point_spread_method is None:
        return
    error, model_error = f.point_spread_error, f.point_spread_model_error
    field = None
    if f.field_nodes > 1:
        field = f"{f.field_nodes} points over the object, in {counted(f.field_modes, 'mode')}"
    yield facts(
        [
            ("Method", f.point_spread_method),
            ("Why this one", f.point_spread_reason),
            ("Estimated error", None if error is None else f"{number(error, 2)} of the peak"),
            ("Model of diffraction", f.point_spread_model),
            (
                "Error of the scalar model",
                None if not model_error else f"{number(model_error, 2)} of the peak",
            ),
            ("Field of point spreads", field),
        ]
    )
    yield from _regime(held)


def _regime(held: Folder) -> Iterator[Html]:
    f = held.record.figures
    rows = []
    for key, value in f.point_spread_regime.items():
        if value is None or key not in words.REGIME:
            continue
        name, unit, meaning = words.REGIME[key]
        told = ("yes" if value else "no") if isinstance(value, bool) else number(value)
        rows.append((name, f"{told} {unit}".rstrip(), meaning))
    if rows:
        if f.wavelength is not None and f.f_number is not None:
            airy = quantity(f.wavelength * f.f_number, "m")
            rows.append(("Airy unit λN", airy, "wavelength times working F-number"))
        columns = (Column("Figure"), Column("Value", "number"), Column("Meaning"))
        yield table("Regime of the wave", columns, rows)


def _image(held: Folder) -> Iterator[Html]:
    f = held.record.figures
    shown = None
    found = held.arrays("image.npz", "electrons", "pitch", "exposure")
    if found is not None:
        electrons = found["electrons"]
        ny, nx = (1e3 * n * float(found["pitch"]) for n in electrons.shape)
        shown = pixels(
            electrons,
            "Camera image",
            unit="electrons",
            low=float(electrons.min()),
            high=float(electrons.max()),
            alt="Camera image: the blurred, noisy image of the hidden object.",
            told=f"{number(nx)} × {number(ny)} mm on the detector, exposed for "
            f"{quantity(float(found['exposure']), 's')}. The wall reverses it like a mirror.",
        )
    rows = [
        ("Brightest pixel", f.electrons_peak, "electrons"),
        ("Mean", f.electrons_mean, "electrons per pixel"),
        ("Object alone, brightest", f.signal_electrons_peak, "electrons"),
        ("Noise, mean rms", f.noise_sigma_mean, "electrons per pixel"),
    ]
    told: list[tuple[object, object]] = [
        (name, f"{number(value)} {unit}") for name, value, unit in rows if value is not None
    ]
    if told and f.saturated_fraction is not None:
        told.append(("Full pixels", percent(f.saturated_fraction)))
    if shown is not None or told:
        yield tag("div", shown, tag("div", facts(told), *_ledger(held)), class_="figures")


def _ledger(held: Folder) -> Iterator[Html]:
    ledger = held.record.figures.electrons_in_total
    total = sum(ledger.get(name, 0.0) for name in words.LIGHT)
    if total <= 0.0:
        return
    rows = [
        (meaning, number(ledger[name]), percent(ledger[name] / total))
        for name, meaning in words.LIGHT.items()
        if name in ledger
    ]
    columns = (
        Column("Part"),
        Column("Electrons", "number"),
        Column("Share", "number"),
    )
    yield table("Sources of the expected electrons", columns, rows)
    lost = [
        f"{percent(max(share, 0.0))} {meaning}"
        for name, meaning in words.LOST.items()
        if name in ledger and ledger.get("ideal", 0.0) > 0.0
        # the loss is a difference of sums; ignore rounding errors
        for share in (ledger[name] / ledger["ideal"],)
        if share > SHARES_OF_ROUNDING
    ]
    if lost:
        yield tag("p", f"Lost from the unblurred image of the object: {' and '.join(lost)}.")


def _reconstruction(held: Folder) -> Iterator[Html]:
    shown, told = list(_objects(held)), list(_settlement(held))
    if len(shown) == 1 and told:
        yield tag("div", *shown, tag("div", *told), class_="figures")
        return
    if shown:
        yield tag("div", *shown, class_="figures")
    yield from told


def _settlement(held: Folder) -> Iterator[Html]:
    """Outcome of a reconstruction: status, figures and fitted parameters."""
    f = held.record.figures
    status = f.reconstruction_status
    if status is None:
        return
    score = correlation = None
    if f.reconstruction_score is not None:
        score = f"{number(f.reconstruction_score)} {', '.join(_score_note(held))}"
    if f.correlation_with_truth is not None:
        correlation = (
            f"{number(f.correlation_with_truth, 4)} after registration; 1 if identical up to "
            "brightness"
        )
    yield facts(
        [
            ("Status", f"{_spaced(status)}. {words.STATUS.get(status, '')}".rstrip()),
            ("Because", "; ".join(f.reconstruction_reasons) or None),
            ("Method", f.method),
            ("Iterations", f.iterations),
            ("Agreement" if f.method == "phase_retrieval" else "Residual", score),
            ("Correlation with the truth", correlation),
            ("Masked pixels", None if f.masked_fraction is None else percent(f.masked_fraction)),
        ]
    )
    rows = [(_spaced(name), _settled(value)) for name, value in f.physical_parameters.items()]
    if rows:
        yield table("Fitted parameters", (Column("Parameter"), Column("Value")), rows)


def _objects(held: Folder) -> Iterator[Html]:
    """True object if known, and the reconstructed object or its last preview."""
    found = held.arrays("reconstruction.npz", "object")
    image = None if found is None else held.arrays("image.npz", "ideal")
    size = "" if found is None else _size_on_object(held, found["object"].shape)
    if image is not None and (brightest := float(image["ideal"].max())) > 0.0:
        yield pixels(
            image["ideal"][:, ::-1] / brightest,
            "Truth",
            alt="The object as the camera would see it without blur and noise.",
            told=f"{size}Object in the image's frame, no blur or noise; mirror reversal undone.",
            unit="of the brightest",
            low=0.0,
            high=1.0,
        )
    if found is not None:
        yield pixels(
            found["object"][:, ::-1],
            "Reconstruction",
            alt="Reconstructed object.",
            told=f"{size}Mirror reversal undone.",
            unit="of the brightest",
            low=0.0,
            high=max(1.0, float(found["object"].max())),
        )
    elif preview := held.picture("preview.png"):
        yield figure(
            tag("img", src=png(preview), alt="Object so far."),
            tag("b", "Last state kept"),
            ", mirror reversal undone; 0 is black, the brightest pixel white.",
            class_="pixels",
        )


def _size_on_object(held: Folder, shape: tuple[int, ...]) -> str:
    """Return the size of a reconstruction on the object as a sentence; empty if unknown."""
    try:
        scene = held.scene()
    except SceneError:  # the view of the room says what is wrong with it
        return ""
    if scene is None or shape != scene.camera.shape:
        return ""
    scale = 1e3 * object_scale(scene) * scene.camera.image_pitch
    return f"{number(shape[1] * scale)} × {number(shape[0] * scale)} mm on the object. "


def _spaced(name: str) -> str:
    """Replace underscores in an identifier by spaces."""
    return name.replace("_", " ")


def _settled(value: Any) -> str:
    """Format the value or values of a fitted parameter."""
    if isinstance(value, list):
        return ", ".join(_settled(inner) for inner in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "not reported" if value is None else str(value)
    return number(value)


def _volume(held: Folder, drawn: Room | None, missing: str) -> Iterator[Html]:
    if held.record.command == "phasor":
        yield from _turned(drawn, missing)
    views = {
        "front.png": ("From the wall", "x to the left, y up"),
        "side.png": ("From the side", "z away from the wall, y up"),
        "top.png": ("From above", "x to the left, z away from the wall"),
    }
    shown = [
        figure(
            tag("img", src=png(data), alt=f"Brightest voxels of the hidden scene. {title}."),
            tag("b", title),
            f": {axes}, in metres; brightest voxel along the line of sight, relative scale.",
            class_="plot",
        )
        for name, (title, axes) in views.items()
        if (data := held.picture(name))
    ]
    if shown:
        yield tag("div", *shown, class_="figures")
    record = held.record
    if record.camera is None:
        return
    sigma, aperture = record.wl_sigma, record.aperture
    yield facts(
        [
            ("Virtual camera", _spaced(record.camera)),
            ("Virtual pulse", None if sigma is None else f"sigma {quantity(sigma, 'm')}"),
            (
                "Aperture",
                "whole wall" if aperture is None else f"{quantity(aperture, 'm')} square",
            ),
            *(("Sampling limit", note) for note in record.notes),
        ]
    )


def _times(held: Folder) -> Iterator[Html]:
    """Table of each stage's requested and estimated accuracy and its run time."""
    record = held.record
    if not record.seconds:
        return
    planned = {stage.name: stage for stage in record.plan.stages}
    reached = _reached(held)
    longest = max((v for k, v in record.seconds.items() if k != "total"), default=0.0) or 1.0
    rows = []
    for name, took in record.seconds.items():
        stage = planned.get(name)
        share = 0.0 if name == "total" else took / longest
        bar = tag("span", class_="bar", style=f"width: {100 * share:.1f}%") if share else None
        cells: list[object] = [
            joined(["whole run" if name == "total" else name, bar]),
            _timed(took),
        ]
        if planned:
            cells += [
                reached.get(name, ""),
                stage.error if stage else "",
                _timed(stage.seconds) if stage else "",
            ]
        rows.append(cells)
    columns = [Column("Stage"), Column("Took (s)", "number")]
    if planned:
        columns += [Column("Reached"), Column("Wanted"), Column("Predicted (s)", "number")]
    yield _wide(table("Accuracy and run time of each stage", columns, rows), "Accuracy and time")
    if planned:
        yield tag(
            "p",
            "Bars compare run times. Predicted times are for one core, without compilation.",
            class_="kind",
        )


def _timed(value: float) -> str:
    """Format seconds with two decimals, for a column of numbers."""
    return f"{value:.2f}" if value >= 0.005 else "< 0.01"


def _reached(held: Folder) -> dict[str, str]:
    """Accuracy that the run estimated for each stage."""
    f = held.record.figures
    of = {"point spread": "of the peak", FIELD: "of the image, rms"}
    found = {
        name: f"{number(error, 2)} {of.get(name, '')}".rstrip() for name, error in f.errors.items()
    }
    if f.correlation_with_truth is not None:
        found["reconstruction"] = f"correlation {number(f.correlation_with_truth, 4)}"
    elif f.reconstruction_score is not None:
        found["reconstruction"] = f"residual {number(f.reconstruction_score)}"
    return found


def _wide(inner: Html, label: str) -> Html:
    """Wrap wide contents so that they can be scrolled sideways on a narrow page."""
    return tag("div", inner, class_="wide", tabindex=0, role="group", aria_label=label)


def _provenance(held: Folder) -> Iterator[Html]:
    record = held.record
    told: list[tuple[object, object]] = [
        ("Finished", record.finished and date(record.finished)),
        ("Seed", record.seed),
        ("tol", None if record.tol is None else number(record.tol)),
        ("Scene, SHA-256", record.scene_sha256 and tag("code", record.scene_sha256)),
        ("Capture", record.capture_file),
        ("Capture, SHA-256", record.capture_sha256 and tag("code", record.capture_sha256)),
        ("Command line", tag("code", record.command_line) if record.command_line else None),
        ("To repeat it", _repeated(held)),
    ]
    yield facts(told)
    sizes = [
        (name, quantity((held.path / name).stat().st_size, "B"))
        for name in record.files
        if (held.path / name).is_file() and not name.endswith(".html")
    ]
    listed = [
        table(caption, (Column(head), Column(value, "number")), rows)
        for caption, head, value, rows in (
            ("Versions", "Package", "Version", list(record.versions.items())),
            ("Files of the run", "File", "Size", sizes),
        )
        if rows
    ]
    yield tag("div", *listed, class_="figures")
    if text := held.text("scene.toml"):
        yield tag("h3", "Scene file", id="scene-file")
        yield tag("pre", tag("code", text), tabindex=0, role="region", aria_labelledby="scene-file")


def _repeated(held: Folder) -> Html | None:
    """Command that repeats the run from its own folder."""
    record = held.record
    if record.command != "run" or held.text("scene.toml") is None:
        return None
    parts = ["nlosoptics", "run", f"{held.name}/scene.toml", "--tol", repr(record.tol)]
    parts += ["--seed", str(record.seed), "--out", f"{held.name}-again"]
    if any(stage.name == "reconstruction" for stage in record.plan.skipped):
        parts.append("--no-reconstruct")
    return tag("code", shlex.join(parts))
