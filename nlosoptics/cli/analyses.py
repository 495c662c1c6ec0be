"""Command analyse, for the optics of a scene on one page."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from .._checks import lasting
from .._whole_files import whole_folder
from ..errors import SceneError
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
)


@app.command("analyse", short_help="Analyse the optics of a scene: spots, MTF, focus, Zernikes.")
def analyse_command(
    scene_file: SceneFile,
    changes: Changes = None,
    out: Out = None,
    tol: Tol = 1e-3,
    point: Annotated[
        str,
        typer.Option(help="Object point 'x, y, z' in m; by default the middle of the object."),
    ] = "",
    debug: Debug = False,
) -> None:
    """Analyse the optics of a scene for one object point, by way of the wall's mirror-like part.

    The output folder, by default SCENE_analysis, gets one page (analysis.png) with wave aberration,
    point spread, spot diagram, MTF (contrast of fine stripes), encircled energy and quality through
    focus, and its numbers as CSV files, with the Zernike coefficients (shape of the aberration).

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
        with whole_folder(folder) as new:
            figure.savefig(new / "analysis.png")
            for name, (header, values) in tables.items():
                np.savetxt(
                    new / f"{name}.csv", values, "%.9g", delimiter=",", header=header, comments=""
                )
        wave = optics.wavefront
        focus = tables["through_focus"][1][:, 0].mean()  # the shifts are centred on it
        print_table(
            [
                ("F-number", f"{wave.f_number:.4g}"),
                ("wave aberration", f"{psf.rms_aberration(wave) / wave.wavelength:.3g} waves rms"),
                ("Strehl ratio", f"{psf.strehl(wave):.4g}"),
                ("rms spot radius", f"{1e6 * psf.spot_radius(wave):.4g} um"),
                ("best focus", f"{focus:.4g} mm"),
                ("run time", lasting(time.perf_counter() - start)),
                ("written to", str(folder)),
            ]
        )
