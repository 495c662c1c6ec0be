"""Memory of a process over repeated calls of simulate, point_spread, trace and render.

python benchmarks/repeats.py [--calls 500] [--stages NAME ...]

No call repeats an earlier input: walls, waves, seeds or plates differ a little, so that anything
that is kept for an input is seen. Resident memory and the number of objects that Python has
allocated are read after each call. Their growth per call is the slope of a line through the means
of blocks of calls, without the first two fifths, in which caches are filled; its standard error is
that of the fit. The exit status is 1 if one of them grows: by more than three standard errors, and
by more than 2 MiB or 1000 objects in 500 calls, which fragments of freed memory may take.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

import nlosoptics as nlos
from nlosoptics import psf, raytrace, transient
from nlosoptics.scene import ConcaveWall, Lambert

SCENES = Path(__file__).resolve().parents[1] / "examples" / "scenes"
BLOCKS = 16  # blocks of calls, whose means are fitted
WHOLE = 500  # calls for which growth is allowed
ALLOWED = {"bytes": 2.0 * 2**20, "objects": 1000.0}  # growth in so many calls


class Growth(NamedTuple):
    """Growth per call, its standard error, and whether it is more than allowed."""

    slope: float
    error: float
    grows: bool


def stages() -> dict[str, Callable[[int], object]]:
    """Return the calls by name; each takes the number of the call."""
    scene = nlos.Scene.load(SCENES / "letter_flat.toml").resized(16)
    wave = {"wavelength": 500e-9, "pupil_radius": 5e-3, "image_distance": 0.1}
    grid = transient.wall_grid(1.0, 4)

    def simulate(number: int) -> object:
        bent = replace(scene, wall=ConcaveWall(5.0 + 1e-3 * number))
        return nlos.simulate(bent, tol=1e-2, seed=number)

    def point_spread(number: int) -> object:
        modes = {4: 60e-9 + 1e-12 * number, 7: 30e-9}
        return psf.point_spread(psf.Wavefront.from_zernike(modes, **wave), shape=64, tol=1e-4)

    def trace(number: int) -> object:
        bent = replace(scene, wall=ConcaveWall(5.0 + 1e-3 * number))
        return raytrace.trace(bent, n_rays=2000, seed=number)

    def render(number: int) -> object:
        plate = trimesh.creation.box((0.2, 0.3, 0.1))
        plate.apply_translation((0.0, 0.0, 0.6 + 1e-4 * number))
        return transient.render(
            [(plate, Lambert(0.8))],
            laser_points=(0.0, 0.0, 0.0),
            sensor_points=grid,
            t_start=0.9,
            delta_t=0.05,
            n_bins=32,
            tol=0.01,
            tol_multiple=0.1,
            seed=number,
        )

    return {"simulate": simulate, "point_spread": point_spread, "trace": trace, "render": render}


def fitted(values: np.ndarray, allowed: float) -> Growth:
    """Return the growth of a quantity over calls; ``allowed`` in `WHOLE` calls is no fault."""
    settled = values[2 * len(values) // 5 :]
    parts = np.array_split(settled, min(BLOCKS, len(settled)))
    means = np.array([part.mean() for part in parts])
    places = np.cumsum([0, *(len(part) for part in parts[:-1])]) + len(parts[0]) / 2.0
    (slope, _), covariance = np.polyfit(places, means, 1, cov=True)
    error = float(np.sqrt(max(covariance[0, 0], 0.0)))
    return Growth(float(slope), error, bool(slope > 3.0 * error and slope * WHOLE > allowed))


def repeated(call: Callable[[int], object], calls: int) -> dict[str, Growth]:
    """Return the growth of resident memory and of Python's objects over calls."""
    page, columns = os.sysconf("SC_PAGE_SIZE"), np.zeros((len(ALLOWED), calls))
    gc.collect()
    gc.freeze()  # collections look at what is new
    for number in range(calls):
        call(number)
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        columns[:, number] = pages * page, sys.getallocatedblocks()
    gc.unfreeze()
    return {
        name: fitted(column, allowed)
        for column, (name, allowed) in zip(columns, ALLOWED.items(), strict=True)
    }


def main() -> int:
    """Print a table of growth by stage; return 1 if something grows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    known = stages()
    parser.add_argument("--calls", type=int, default=WHOLE, help="calls of each stage, at least 40")
    parser.add_argument("--stages", nargs="*", choices=known, default=list(known))
    options = parser.parse_args()
    grows = False
    for name in options.stages:
        bytes_, objects = repeated(known[name], options.calls).values()
        grows |= bytes_.grows or objects.grows
        print(
            f"{name:12} {options.calls} calls: {bytes_.slope:8.0f} +- {bytes_.error:.0f} B and "
            f"{objects.slope:6.2f} +- {objects.error:.2f} objects per call"
            f"{'  GROWS' if bytes_.grows or objects.grows else ''}",
            flush=True,
        )
    return 1 if grows else 0


if __name__ == "__main__":
    sys.exit(main())
