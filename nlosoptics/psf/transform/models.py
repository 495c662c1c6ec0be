"""Choice between scalar and vector diffraction in `point_spread`, by the scalar model's error."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from ..._checks import one_of
from ...errors import SamplingError, SceneError
from ..wave.detilted import Residual
from ..wave.regime import Regime
from ..window.error_bounds import rounded_up
from ..window.window import Window
from . import geometric, high_aperture
from .high_aperture import Polarisation
from .runners import Result, Task, transform
from .selection import MANY_WAVES, automatic

Model = Literal["auto", "scalar", "high-aperture"]
MODELS: Final = ("auto", "scalar", "high-aperture")

#: Largest bound, relative to the peak, that is given by the closed form for slow beams.
SLOW: Final = 1e-3
#: Pixel side, Airy units, above which the error is that of the energy's distribution over pixels.
WIDE: Final = 2.0
#: Image points per side of a probe, and accuracy of its transform.
SIDE, ACCURACY = 40, 1e-6
#: Factor from the largest error that was found to the bound. Most errors between the probed points
#: are smaller, see the test of random waves.
MARGIN: Final = 1.5
#: Distance beyond the rays up to which a probe searches for the largest error, Airy units.
NEAR: Final = 3.0


@dataclass(frozen=True, eq=False)
class Modelled:
    """Result of a model, with its error.

    Parameters
    ----------
    result : Result
        Intensity and numerical error.
    reason : str
        One line: why this method and this model were used.
    model : {"scalar", "high-aperture"}
        Model of diffraction.
    model_error : float
        Bound of max |dI|/max I of the scalar model; 0 for the other.
    """

    result: Result
    reason: str
    model: str
    model_error: float


def check_model(model: Model, method: str, polarisation: Polarisation) -> Polarisation:
    """Check the options of the model; return the polarisation as an angle, rad, or unpolarised.

    Raises
    ------
    SceneError
        If they contradict one another.
    """
    one_of("model", model, MODELS)
    found = high_aperture.check_polarisation(polarisation)
    if model == "high-aperture" and method not in high_aperture.METHODS:
        raise SceneError(
            f"method = '{method}' with model = 'high-aperture', which it cannot compute; use "
            "method='auto'"
        )
    scalar = model == "scalar" or (model == "auto" and method != "auto")
    if scalar and not isinstance(found, str):
        raise SceneError(
            f"polarisation = {polarisation!r} with the scalar model, which has none; use "
            "model='high-aperture'"
        )
    return found


def modelled(
    task: Task,
    kind: Regime,
    method: str,
    model: Model,
    polarisation: Polarisation,
    normalisation: str,
    max_seconds: float,
) -> Modelled:
    """Compute a point spread by the scalar model, by the high-aperture model, or the cheapest.

    Parameters
    ----------
    task : Task
        Wave and window.
    kind : Regime
        Regime of the wave.
    method, model, normalisation
        Options of `point_spread`.
    polarisation : "unpolarised" or float
        As returned by `check_model`.
    max_seconds : float
        Limit of the predicted run time on one core.

    Returns
    -------
    Modelled
    """
    started, why = time.process_time(), "high-aperture model was requested"
    if model == "auto" and not isinstance(polarisation, str):
        why = "high-aperture model of a polarised wave"
    elif model != "high-aperture":
        if method == "auto":
            result, reason = automatic(task, kind, max_seconds)
        else:
            result, reason = transform(task, method), f"{method} was requested"
        error = scalar_model_error(task, result, normalisation)
        if model == "scalar" or method != "auto" or error <= task.tol:
            return Modelled(result, reason, "scalar", error)
        why = f"high-aperture model, since the scalar model errs by {error:.2g}"
    left = max_seconds - (time.process_time() - started)
    result = _high_aperture(task, kind, method, polarisation, left)
    return Modelled(result, f"{why}; {result.method} suits its nodes", "high-aperture", 0.0)


def _high_aperture(
    task: Task, kind: Regime, method: str, polarisation: Polarisation, max_seconds: float
) -> Result:
    """Run the high-aperture model, by rays if ``auto`` finds them accurate enough and faster."""
    if method != "auto":
        return high_aperture.transform(task, method, polarisation)
    seconds = high_aperture.predicted_seconds(task, polarisation)
    rays = task.rule is not None and kind.peak_to_valley > MANY_WAVES
    if rays and geometric.least_error(task.residual, task.pitch) <= task.tol:
        result = high_aperture.transform(task, "geometric", polarisation)
        if result.error <= task.tol:
            return result
    ny, nx = task.samples.shape
    if seconds > max_seconds:
        raise SamplingError(
            f"the high-aperture model to {ny} x {nx} samples would take about {seconds:.2g} s, "
            f"limit {max_seconds:.3g} s; use max_seconds = {rounded_up(seconds + 1)}, a smaller "
            "shape, or model='scalar'"
        )
    result = high_aperture.transform(task, "auto", polarisation)
    if result.error > task.tol:
        counts = " x ".join(map(str, task.residual.wavefront.u.shape))
        raise SamplingError(
            f"the high-aperture model has an error of {result.error:.2g}, limit tol = "
            f"{task.tol:g}; use tol = {rounded_up(result.error)}, or more pupil nodes (now "
            f"{counts})"
        )
    return result


def scalar_model_error(task: Task, result: Result, normalisation: str) -> float:
    """Bound the error of a scalar point spread, max |dI|/max I, against an unpolarised vector wave.

    Parameters
    ----------
    task : Task
        Wave and window.
    result : Result
        Intensity by the scalar model.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Normalisation in which the models are compared.

    Returns
    -------
    float
        Infinite for an image surface other than the image plane.

    Notes
    -----
    Let s be the sine of the cone's half angle. To the order s^2 the models differ by the field
    along the axis, ``|grad U|^2/(2 k^2)``, and by a factor due to the normalisation. The field's
    band limit k s bounds its gradient (Bernstein's inequality), so that the difference is at most
    ``s^2``. This is the bound for slow beams. Otherwise both models are computed at some points
    about the brightest one and about the rays.
    """
    residual = task.residual
    if task.surface is not None:
        return math.inf
    closed = slow_bound(residual)
    fine = task.rule is not None or task.pitch <= residual.nyquist_pitch * (1 + 1e-9)
    if fine and closed <= min(SLOW, task.tol):
        return closed
    if task.rule is not None and task.pitch > WIDE * residual.airy_unit:
        share = float(result.mean.max()) * result.level
        return in_normalisation(residual, wide_pixel_error(residual, share), normalisation)
    found = max(_probe(task, result, window, normalisation) for window in _windows(task, result))
    return MARGIN * found


def slow_bound(residual: Residual) -> float:
    """Bound the scalar model's error for any slow wave: the squared sine of the half angle."""
    return high_aperture.check_cone(residual) ** 2


def uneven_energy(residual: Residual) -> float:
    """Return the largest relative difference between the models' energies of one direction.

    The vector model weights the energy of a ray by 1/cos of its angle to the axis. It bounds the
    scalar model's error where diffraction does not matter, for normalised energies.
    """
    wave = residual.wavefront
    square = np.minimum((wave.u**2 + wave.v**2) / wave.image_distance**2, 1 - 1e-9)
    energy = wave.amplitude**2 * wave.weights
    mean = float(np.sum(energy / np.sqrt(1 - square)) / np.sum(energy))
    rim = 1 / math.sqrt(1 - slow_bound(residual))
    return max(1 - 1 / mean, rim / mean - 1)


def wide_pixel_error(residual: Residual, share: float = 0.0) -> float:
    """Bound the scalar model's error on pixels much wider than an Airy unit, for unit energy.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    share : float
        Fraction of the energy in the brightest pixel; 0 if it is not known.

    Notes
    -----
    Energies of rays differ by at most `uneven_energy`. What the brightest pixel loses, all others
    gain, so that its loss is also at most that fraction of the others' energy.
    """
    others = max(1 - share, 0.0) / share if share > 0.5 else 1.0
    return MARGIN * uneven_energy(residual) * others


def in_normalisation(residual: Residual, error: float, normalisation: str) -> float:
    """Return the error in a normalisation, given the one for unit energy in the image plane."""
    if normalisation != "ideal-peak":
        return error
    point = Window.centred(residual.airy_unit, (1, 1))
    nodes = high_aperture.nodes_of(residual, point)
    peak, secant = high_aperture.levels(residual, nodes, nodes.weights(residual, "unpolarised"))
    return error * secant / peak + abs(secant / peak - 1)


def _windows(task: Task, result: Result) -> list[Window]:
    """Return the samples or pixels to probe: about the brightest one, and about all rays."""
    ny, nx = task.shape
    row, column = divmod(int(np.argmax(result.mean)), nx)
    pixels, residual = task.pixels, task.residual
    size = min(ny, SIDE), min(nx, SIDE)
    top, left = (
        min(max(middle - n // 2, 0), total - n)
        for middle, n, total in zip((row, column), size, (ny, nx), strict=True)
    )
    x, y = pixels.first
    pitch = pixels.pitch
    near = Window(pitch, size, (x + left * pitch, y + top * pitch))
    if task.rule is not None:
        return [near]
    # Part of the window that holds the rays, by as many points
    half = residual.rays.reach + NEAR * residual.airy_unit
    low, high = [], []
    for first, n, centre in zip(pixels.first, (nx, ny), residual.shift, strict=True):
        low.append(max(first, centre - half))
        high.append(min(first + (n - 1) * pitch, centre + half))
    width = max(high[0] - low[0], high[1] - low[1])
    if width <= (SIDE - 1) * pitch or min(high[0] - low[0], high[1] - low[1]) < 0:
        return [near]
    step = width / (SIDE - 1)
    counts = (int((high[1] - low[1]) / step) + 1, int((high[0] - low[0]) / step) + 1)
    return [near, Window(step, counts, (low[0], low[1]))]


def _probe(task: Task, result: Result, window: Window, normalisation: str) -> float:
    """Return the largest difference of the models in a window, relative to the peak.

    The window has the pixels of the result if they are integrated, otherwise any points.
    """
    residual = task.residual
    samples = _fine(task, window)
    nodes = high_aperture.nodes_of(residual, samples)
    weights = nodes.weights(residual, "unpolarised")
    peak, secant = high_aperture.levels(residual, nodes, weights)
    scalar = np.ones_like(nodes.u)
    if result.method == "huygens":  # its spherical waves carry the cosines of the sine condition
        d = residual.wavefront.image_distance
        scalar = (1 - (nodes.u**2 + nodes.v**2) / d**2) ** -0.25
    squares = nodes.squares(residual, [scalar, *weights], samples, ACCURACY)
    old = task.averaged(next(squares)) / high_aperture.levels(residual, nodes, [scalar])[0]
    new = task.averaged(sum(squares, np.zeros(samples.shape))) / peak
    if normalisation != "ideal-peak":
        new *= task.level * peak / secant / result.level
    largest = min(float(result.mean.max()), float(new.max()))
    return float(np.abs(new - old).max()) / largest


def _fine(task: Task, window: Window) -> Window:
    """Return the points at which the intensity of a part of the pixels is computed."""
    rule = task.rule
    if rule is None:
        return window
    whole = rule.window(window.pitch, window.shape)
    centred = Window.centred(window.pitch, window.shape)
    moved = [
        first + start - middle
        for first, start, middle in zip(whole.first, window.first, centred.first, strict=True)
    ]
    return Window(whole.pitch, whole.shape, (moved[0], moved[1]))
