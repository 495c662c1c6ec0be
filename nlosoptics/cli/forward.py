"""Commands plan, run, schema, materials and warmup."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from .._checks import counted, lasting
from .._whole_files import whole_folder
from .shell import (
    Changes,
    Debug,
    MaxSeconds,
    Memory,
    Out,
    SceneFile,
    Seed,
    Size,
    Tol,
    app,
    can_draw,
    check_target,
    errors_told,
    in_bytes,
    load,
    print_table,
    progress_bar,
    stage_rows,
    typed,
)


@app.command("plan", short_help="List what a run will compute, with predicted time and error.")
def plan_command(
    scene_file: SceneFile,
    changes: Changes = None,
    tol: Tol = 1e-3,
    size: Size = None,
    memory: Memory = None,
    max_seconds: MaxSeconds = 900.0,
    debug: Debug = False,
) -> None:
    """List what a run will compute and skip, with reasons, predicted times and errors.

    Example: nlosoptics plan corner --size 64
    """
    with errors_told(debug):
        from ..runs.plan import plan

        scene = load(scene_file, size, changes)
        planned = plan(
            scene, tol, reconstruct=True, memory=in_bytes(memory), max_seconds=max_seconds
        )
        typer.echo(str(planned))


@app.command("run", short_help="Simulate a scene and write the results to a folder.")
def run_command(
    context: typer.Context,
    scene_file: SceneFile,
    changes: Changes = None,
    tol: Tol = 1e-3,
    seed: Seed = 0,
    out: Out = None,
    size: Size = None,
    reconstruct: Annotated[
        bool,
        typer.Option("--reconstruct/--no-reconstruct", help="Also reconstruct the hidden object."),
    ] = True,
    memory: Memory = None,
    max_seconds: MaxSeconds = 900.0,
    figures: Annotated[
        bool, typer.Option("--figures", help="Also draw each figure of the overview by itself.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Simulate the camera image of a scene and reconstruct the hidden object.

    The output folder gets overview.png, which shows all results, arrays (.npz) and result.json with
    the most important numbers. An existing folder is replaced only if an earlier run wrote it. The
    error of the wall's diffuse light in the image is fixed at 1e-3 of this light.

    Example: nlosoptics run corner --size 64 --set "wall.curvature=0.1 1/m"
    """
    with errors_told(debug):
        start = time.perf_counter()
        folder = Path(scene_file.stem) if out is None else out
        from .._random import checked_seed
        from ..runs.plan import looked_at
        from ..runs.record import write_record
        from ..runs.results import write_result
        from ..runs.simulate import carried_out
        from .figures import write_figures, write_overview

        seed = checked_seed(seed)
        scene = load(scene_file, size, changes)
        loaded = time.perf_counter()
        planned, optics = looked_at(scene, tol, reconstruct, in_bytes(memory), max_seconds)
        check_target(folder)
        ready = time.perf_counter()
        drawn = can_draw()
        with progress_bar() as progress:
            result = carried_out(planned, scene, optics, seed, progress)
            progress("writing", 1.0)
            with whole_folder(folder) as new:
                began = time.perf_counter()
                report = write_result(result, new) | {"command_line": typed(context)}
                written = time.perf_counter()
                if drawn:
                    write_overview(result, new)
                    if figures:
                        write_figures(result, new)
                ended = time.perf_counter()
                seconds = {
                    "loading": loaded - start,
                    "planning": ready - loaded,
                    **report["seconds"],
                    "writing": written - began,
                    "figures": ended - written,
                }
                seconds["other"] = ended - start - sum(seconds.values())
                report["seconds"] = seconds | {"total": ended - start}
                write_record(report, new)
        print_table([*_summary(report, folder), ("next", f"nlosoptics report {folder}")])


@app.command("schema", short_help="Print all keys of scene files, as a JSON schema.")
def schema_command(debug: Debug = False) -> None:
    """Print all keys of scene files with their descriptions, as a JSON schema.

    Editors use the schema to complete and check scene files. It does not describe study files.

    Example: nlosoptics schema > scene.json
    """
    with errors_told(debug):
        from ..scene.file.scene_file import scene_schema

        typer.echo(json.dumps(scene_schema(), indent=2))


def _summary(report: dict[str, Any], folder: Path) -> Iterator[tuple[str, str]]:
    """Yield a run's most important figures."""
    f = report["figures"]
    if "exit_pupil_radius" in f:
        yield "exit pupil", f"radius {1e3 * f['exit_pupil_radius']:.4g} mm, stop: {f['stop']}"
        yield "working F-number", f"{f['f_number']:.4g}"
        yield (
            "wave aberration",
            f"{f['aberration_rms_waves']:.3g} waves rms ({1e9 * f['aberration_rms']:.3g} nm)",
        )
        yield "point spread", f"{f['point_spread_method']}, error {f['point_spread_error']:.1e}"
    else:
        yield "wave, point spread", "none: the wall has no mirror-like lobe and forms no image"
    if "point_spread_model_error" in f:
        model = f"{f['point_spread_model']}, error {f['point_spread_model_error']:.1e}"
        yield "model of diffraction", model
    if f["field_nodes"] > 1:
        error = f["errors"]["field of point spreads"]
        yield (
            "point spreads over the object",
            f"{f['field_nodes']} points in {counted(f['field_modes'], 'mode')}, error {error:.1e}",
        )
    yield (
        "electrons per pixel",
        f"{f['electrons_peak']:.3g} at most, {f['electrons_mean']:.3g} on average, "
        f"{f['signal_electrons_peak']:.3g} at most from the object",
    )
    if "burst_images" in f:
        yield "burst", counted(f["burst_images"], "exposure")
    if "reconstruction_status" in f:
        score = "no light from the object reaches the camera"
        if "correlation_with_truth" in f:
            score = f"correlation with the true object {f['correlation_with_truth']:.4f}"
        yield "reconstruction", f"{f['reconstruction_status']}, {score}"
        for because in f["reconstruction_reasons"]:
            yield "", because
    yield from stage_rows(report)
    if f["peak_memory_bytes"] is not None:
        yield "peak memory", f"{f['peak_memory_bytes'] / 2**20:.0f} MiB"
    yield "written to", str(folder)


@app.command("materials", short_help="List wall materials by name, with their values.")
def materials_command(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="Material to show with the range and source of each value; by default list all.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """List the wall materials that a scene file may name, or show one of them in detail.

    A scene file names a material by a line such as material = "whiteboard" in the table [wall] or
    [hidden].

    Example: nlosoptics materials whiteboard
    """
    with errors_told(debug):
        from ..scene.parts.library import entry, lobe_tables, material_library

        if name is not None:
            typer.echo(str(entry(name)))
            return
        for material in material_library().values():
            lobes = [
                f"{lobe['lobe']} ({', '.join(f'{k} {v}' for k, v in lobe.items() if k != 'lobe')})"
                for lobe in lobe_tables(material.name)
            ]
            note = ", estimates" if material.is_estimate else ""
            typer.echo(f"{material.name:26s} {' + '.join(lobes)}{note}")


@app.command("warmup", short_help="Compile in advance, for a fast first run.")
def warmup_command(
    scene_files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SCENE",
            help="Scene files for whose runs to compile, or names of examples; by default walls "
            "of all kinds.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Compile the functions that a run uses, so that the first run is as fast as later ones.

    The compiled code is kept on the disk. A run compiles by itself what is missing. Without a
    scene, this takes some minutes the first time.

    Example: nlosoptics warmup corner
    """
    with errors_told(debug):
        start = time.perf_counter()
        from ..runs.warmup import warm_up

        scenes = [load(path, None, None) for path in scene_files or ()]
        with progress_bar() as progress:
            warm_up(scenes, progress)
        typer.echo(f"compiled functions are ready, {lasting(time.perf_counter() - start)}")
