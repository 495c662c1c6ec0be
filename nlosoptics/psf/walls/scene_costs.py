"""Predicted run time and memory of a scene's point spread function."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ..._checks import memory_limit
from ...errors import SamplingError
from ..pupil.scene_optics import FINER, PointOptics
from ..pupil.wall_wavefront import AUTO_GRID_SAMPLES
from ..rough.mean import NO_CORE
from ..rough.otf import CELL_BYTES
from ..rough.scattered_light import (
    FIRST,
    NODE_BYTES,
    PIXEL_BYTES,
    Halo,
    first_cells,
    inner_halves,
    inner_window,
)
from ..rough.view import RoughView
from ..transform import costs
from ..transform.selection import possible
from ..transform.task import Task
from ..transform.transforms import able
from ..transform.wide_pixels import inner_parts
from ..wave.detilted import Residual
from ..window import error_bounds
from ..window.pixels import pixel_rule
from ..window.window import Window, peak_pixel
from .lobe_psf import lobes_of
from .rough_wall import rough_choice, roughness_view

#: Memory of Python and numpy besides the arrays, bytes.
HELD: Final = 4e6


@dataclass(frozen=True)
class Cost:
    """Predicted cost of a computation."""

    seconds: float  # Run time on one core, s
    n_bytes: float  # Peak memory, bytes


def point_cost(
    seen: PointOptics, pitch: float, shape: tuple[int, int], tol: float, cells: int = 0
) -> Cost:
    """Predict the cost of `point_image` without refinement of the pupil nodes.

    ``cells`` is the number of cells across the pupil grid; 0 for the wave's own. Raises `NlosError`
    if the transforms would raise it before they compute anything.
    """
    residual = seen.first.residual
    if residual.wavefront.layout == "grid":
        cells = cells or len(residual.wavefront.u)
    window = Window.centred(pitch, shape)
    if seen.scene.wall_roughness is not None:
        choice = rough_choice(seen, pitch, shape, tol)
        if choice.regime != "mean":
            return Cost(choice.seconds, HELD + choice.n_bytes)
        view = roughness_view(seen)
        found = [_scattered_cost(residual, view, window, tol, cells)]
        if view.coherent_fraction > NO_CORE:
            found.append(smooth_cost(residual, pitch, shape, tol, cells))
        return Cost(sum(c.seconds for c in found), HELD + max(c.n_bytes for c in found))
    lobes = lobes_of(seen.scene, lambda: seen.view)
    found = [_scattered_cost(residual, one, window, tol, cells) for one in lobes.views(residual)]
    if not found or lobes.smooth > 0:
        found.append(smooth_cost(residual, pitch, shape, tol, cells))
    return Cost(sum(c.seconds for c in found), HELD + max(c.n_bytes for c in found))


def smooth_cost(
    residual: Residual, pitch: float, shape: tuple[int, int], tol: float, cells: int = 0
) -> Cost:
    """Predict the cost of `wide_point_spread` for a wave split into piston, tilt and residual."""
    inner = inner_parts(residual, pitch, shape, tol)
    whole = Cost(0.0, 0.0)
    if inner is not None:
        n, parts, tol = inner
        whole = Cost(3e-8 * n**2 + 2e-7 * math.prod(shape), 32.0 * n**2 + 60.0 * math.prod(shape))
        pitch, shape = pitch / parts, (n, n)
    rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape))
    task = Task(residual, tol, pitch, shape, rule)
    if cells:
        n_bytes = costs.map_bytes(cells, task.samples)
        return Cost(costs.map_sums(cells, task.samples), n_bytes + 32.0 * math.prod(shape))
    held = whole.n_bytes + 32.0 * math.prod(shape)
    every = able(task)
    ways = [
        Cost(way.seconds + whole.seconds, every[way.method].n_bytes(task) + held)
        for way in possible(task)
    ]
    return next((way for way in ways if way.n_bytes <= memory_limit()), ways[0])


def _scattered_cost(
    residual: Residual, view: RoughView, window: Window, tol: float, cells: int
) -> Cost:
    """Predict the cost of `scattered_light` on pixels, at its first fineness of cells."""
    polar = residual.wavefront.layout == "polar"
    across = first_cells(residual, view, window.pitch, tol) or cells
    edge = 2 * residual.wavefront.pupil_radius
    half = next(inner_halves(residual, view, window, tol), None)
    inner = window if half is None else inner_window(window, half)[0]
    halo = Halo(residual, view, inner, True, edge)
    # two more steps, which small errors may take, and which a narrow halo takes
    steps = (0.7 * FIRST, FIRST, 1.5 * FIRST, 2.25 * FIRST)
    nodes = [sum(runs) * n for runs, n in map(halo.counts, steps)]
    points = math.prod(inner.shape)
    lattices = across**2 * (1.25 if polar else 2.0)
    # it does not damp the errors at long separations, so that cells are halved once as well
    on_wall = edge * math.sqrt(abs(float(np.linalg.det(view.footprint))))
    waves = edge * residual.rays.slope / residual.wavefront.wavelength
    narrow = view.last_lag(1e-3) > on_wall
    finer = polar and waves > 1.0 and narrow
    lattices *= 5.0 if finer else 1.0
    taken = nodes if narrow else nodes[:2]
    again = sum(taken) + (taken[-1] if polar else 0.0)
    seconds = costs.scattered(
        lattices, again, points, 0 if half is None else math.prod(window.shape)
    )
    seconds += view.term_seconds * sum(taken)
    # then some waves need finer cells, which take up to five times as long
    seconds *= 1.4 if tol < 1e-4 else 1.0
    most = nodes[3] if tol < 6e-4 or narrow else nodes[1]
    wide = across * (3.0 if finer else 2.0 if tol < 3e-4 and polar else 1.0)
    n_bytes = max(CELL_BYTES * wide**2, NODE_BYTES * most + PIXEL_BYTES * points)
    return Cost(seconds, n_bytes + PIXEL_BYTES * math.prod(window.shape))


def grid_samples(residual: Residual, pitch: float, side: int, tol: float) -> tuple[int, ...]:
    """Return the cell counts across the pupil grids to try, the last of which should suffice."""
    # aberration across the whole pupil at the steepest slope, waves
    jump = residual.jump()[0] * len(residual.wavefront.u)
    reach = side * pitch / 2 + max(map(abs, residual.shift)) + residual.rays.reach
    period = (reach + pitch + residual.airy_unit) / residual.airy_unit
    # Error of the rim: a cell cut by it is treated as if located at the cell's centre.
    beats = error_bounds.beat(pitch / residual.airy_unit)
    level = math.sqrt(min(1.0, peak_pixel(residual, pitch) / residual.pixel_share(pitch)))
    rim = math.sqrt(2 * math.pi * jump * beats / (tol * level))
    need = max(2.1 * jump, period, rim)
    steps = (AUTO_GRID_SAMPLES, *FINER["grid"])
    for i, samples in enumerate(steps):
        if samples >= need:
            return steps[: i + 1]
    raise SamplingError(
        f"the wall's edge cuts the cone of light, so its wave needs a grid of {need:.0f} cells "
        f"across, limit {steps[-1]}; enlarge the wall, stop the lens down or use a larger tol"
    )
