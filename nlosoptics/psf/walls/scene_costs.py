"""Predicted cost of a smooth wall's image, and the pupil grids that a cut wave needs."""

from __future__ import annotations

import math

from ..._checks import memory_limit
from ...errors import SamplingError
from ..pupil.scene_optics import FINER
from ..pupil.wall_wavefront import AUTO_GRID_SAMPLES
from ..transform import costs
from ..transform.selection import possible
from ..transform.task import Task
from ..transform.transforms import able
from ..transform.wide_pixels import inner_parts
from ..wave.detilted import Residual
from ..window import error_bounds
from ..window.pixels import pixel_rule
from ..window.window import peak_pixel
from .rough_wall import Cost


def smooth_cost(
    residual: Residual, pitch: float, shape: tuple[int, int], tol: float, cells: int = 0
) -> Cost:
    """Predict the cost of `detilted_wide_spread` by the scalar model."""
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
