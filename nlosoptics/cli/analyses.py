"""Command analyse, for the optics of a scene on one page."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from .._checks import lasting
from .._whole_files import whole_folder
from ..errors import SceneError
from ..runs.record import scene_hash, write_record
from .shell import (
    Changes,
    Debug,
    Out,
    SceneFile,
    Tol,
    app,
    check_target,
    errors_told,
    load,
    numbers,
    print_table,
    progress_bar,
    typed,
)


@app.command("analyse", short_help="Analyse the optics of a scene: spots, MTF, focus, Zernikes.")
def analyse_command(
    context: typer.Context,
    scene_file: SceneFile,
    changes: Changes = None,
    out: Out = None,
    tol: Tol = 1e-3,
    point: Annotated[
        str,
        typer.Option(
            help="Object point 'x, y, z' in m, such as '0.5, 0, 1'; by default the middle of the "
            "object."
        ),
    ] = "",
    debug: Debug = False,
) -> None:
    """Analyse the optics of a scene for one object point, by way of the wall's mirror-like part.

    The output folder, by default SCENE_analysis, gets one page (analysis.png) with wave aberration,
    point spread, spot diagram, MTF (contrast of fine stripes), encircled energy and quality through
    focus, and its numbers as CSV files, with the Zernike coefficients (shape of the aberration, in
    Noll's order), and result.json with the most important ones.

    Example: nlosoptics analyse design --out optics
    """
    with errors_told(debug):
        start = time.perf_counter()
        import numpy as np

        from .. import psf, views

        folder = Path(f"{scene_file.stem}_analysis") if out is None else out
        check_target(folder)
        scene = load(scene_file, None, changes)
        if not scene.wall_material.mirror_lobes:
            raise SceneError(
                "wall.material has no mirror-like lobe, so that the wall forms no image; add a "
                'table [[wall.material]] with lobe = "specular", or use nlosoptics feasibility'
            )
        with progress_bar(width=20) as progress:
            optics = psf.scene_point_spread(
                scene, tol, object_point=numbers("--point", point) or None, progress=progress
            )
            progress("metrics", 0.5)
            figure, tables = views.analysis(optics)
        wave = optics.wavefront
        figures = {
            "f_number": wave.f_number,
            "aberration_rms_waves": psf.rms_aberration(wave) / wave.wavelength,
            "strehl": psf.strehl(wave),
            "spot_radius": psf.spot_radius(wave),
            "best_focus": 1e-3 * tables["through_focus"][1][:, 0].mean(),  # centre of the shifts
        }
        with whole_folder(folder) as new:
            figure.savefig(new / "analysis.png")
            for name, (header, values) in tables.items():
                np.savetxt(
                    new / f"{name}.csv", values, "%.9g", delimiter=",", header=header, comments=""
                )
            record = {
                "command": "analyse",
                "command_line": typed(context),
                "figures": figures,
                "tol": tol,
                "scene_sha256": scene_hash(scene),
                "seconds": {"total": time.perf_counter() - start},
            }
            write_record(record, new)
        print_table(
            [
                ("F-number", f"{figures['f_number']:.4g}"),
                ("wave aberration", f"{figures['aberration_rms_waves']:.3g} waves rms"),
                ("Strehl ratio", f"{figures['strehl']:.4g}"),
                ("rms spot radius", f"{1e6 * figures['spot_radius']:.4g} um"),
                ("best focus", f"{1e3 * figures['best_focus']:.4g} mm"),
                ("run time", lasting(time.perf_counter() - start)),
                ("written to", str(folder)),
            ]
        )
