"""Choice between scalar and vector diffraction in `point_spread`, by the scalar model's error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, Literal

from ..._checks import one_of
from ...errors import SceneError
from ..wave.detilted import Residual
from ..window.window import peak_pixel
from . import high_aperture, nufft
from .high_aperture import Polarisation
from .selection import automatic
from .task import Result, Task
from .transforms import transform

Model = Literal["auto", "scalar", "high-aperture"]
MODELS: Final = ("auto", "scalar", "high-aperture")

#: Pixel side, Airy units, above which diffraction moves little energy between pixels.
WIDE: Final = 2.0
#: Largest energy of the axial field at a point, in units of twice its share of the whole energy and
#: of the peak: of an ideal spot, and of an aberrated one. Measured on random waves.
IDEAL, ABERRATED = 0.17, 0.5
#: Factor from an estimate of the scalar model's error to its bound.
MARGIN: Final = 1.25


def check_model(model: Model, method: str, polarisation: Polarisation) -> Polarisation:
    """Check the options of the model; return the polarisation as an angle, rad, or unpolarised.

    Raises
    ------
    SceneError
        If they contradict one another.
    """
    one_of("model", model, MODELS)
    found = high_aperture.check_polarisation(polarisation)
    if model == "high-aperture" and method in ("fft", "airy"):
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


def check_scalar(model: Model, wall: str) -> None:
    """Refuse the high-aperture model for a wall whose statistics blur the scalar point spread."""
    if model == "high-aperture":
        raise SceneError(
            f"model = 'high-aperture' for a wall with {wall}, which only the scalar model blurs; "
            "use model='scalar', whose model_error is returned"
        )


def modelled(
    task: Task,
    method: str,
    model: Model,
    polarisation: Polarisation,
    normalisation: str,
    max_seconds: float,
) -> Result:
    """Compute a point spread by the scalar model, or by the high-aperture one where tol needs it.

    Parameters
    ----------
    task : Task
        Wave and window, for the scalar model.
    method, model, normalisation
        Options of `point_spread`.
    polarisation : "unpolarised" or float
        As returned by `check_model`.
    max_seconds : float
        Limit of the predicted run time on one core.
    """

    def run(task: Task) -> Result:
        if method == "auto":
            return automatic(task, max_seconds)
        return replace(transform(task, method), reason=f"{method} was requested")

    why = "the high-aperture model was requested"
    if model == "auto" and not isinstance(polarisation, str):
        why = "the high-aperture model, since the wave is polarised"
    elif model != "high-aperture":
        result = run(task)
        error = scalar_model_error(task, result, normalisation)
        if model == "scalar" or method != "auto" or error <= task.tol:
            return replace(result, model="scalar", model_error=error)
        why = f"the high-aperture model, since the scalar model errs by {error:.2g}"
    result = run(replace(task, polarisation=polarisation))
    return replace(result, reason=f"{why}; {result.reason}")


def scalar_model_error(task: Task, result: Result, normalisation: str) -> float:
    """Return an upper bound of the error of a scalar point spread, relative to its peak.

    The reference is the vector diffraction of unpolarised light.

    Parameters
    ----------
    task : Task
        Wave and window.
    result : Result
        Intensity by the scalar model.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Normalisation in which the models are compared.

    Notes
    -----
    Let s be the sine of the cone's half angle. To the order s^2 the models differ by the axial
    field, whose intensity is ``|grad U|^2/(2 k^2)``, and by a factor due to the normalisation. The
    axial field has the fraction c of the energy, s^2/4 for a round pupil. For a plane of unit
    energy this is the error of the peak. Relative to the ideal peak, the axial intensity is at most
    0.26 c in an ideal spot. The field's band limit bounds its gradient (Bernstein's inequality), so
    that it approaches c in strongly aberrated spots.
    """
    residual = task.residual
    largest = float(result.mean.max())
    if task.rule is None and task.pitch > residual.nyquist_pitch * (1 + 1e-9):
        error = 2 * ABERRATED * axial_share(residual) / largest  # samples may miss the peak
    else:
        error = _axial_error(residual, largest)
    if normalisation != "ideal-peak":
        error = max(error, _level_error(residual, task.level / result.level))
    if task.rule is not None and task.pitch > WIDE * residual.airy_unit:
        wide = wide_pixel_error(residual, largest * result.level)
        error = min(error, in_normalisation(residual, wide, normalisation))
    return MARGIN * error


def predicted_model_error(residual: Residual, pitch: float) -> float:
    """Predict `scalar_model_error` on pixels of a side ``pitch``, m, for unit energy."""
    bright = peak_pixel(residual, pitch)
    error = _axial_error(residual, min(bright / residual.pixel_share(pitch), 1.0))
    error = max(error, _level_error(residual, 1.0))
    if pitch > WIDE * residual.airy_unit:
        error = min(error, wide_pixel_error(residual, bright))
    return MARGIN * error


def _axial_error(residual: Residual, largest: float) -> float:
    """Return the model error by the axial field, for a largest intensity over the ideal peak."""
    return 2 * axial_share(residual) * (IDEAL + (ABERRATED - IDEAL) * max(1 - largest, 0.0))


def _level_error(residual: Residual, level: float) -> float:
    """Return the model error by the ratio of the energies per pixel at the ideal peaks.

    ``level`` is the energy per pixel of the ideal scalar wave over that of the result.
    """
    peak, secant = plane_levels(residual)
    ratio = level * peak / secant
    return max(abs(ratio - 1), abs(1 / ratio - 1))


def plane_levels(residual: Residual) -> tuple[float, float]:
    """Return `high_aperture.levels` of an unpolarised wave."""
    wave = residual.wavefront
    if residual.has_series and residual.is_uniform:
        # the wave's own nodes on a disc or ring may be too few
        counts = (high_aperture.more_nodes(residual)[0], 5) if residual.is_round else wave.u.shape
        pupil = wave.pupil_radius, wave.obscuration, wave.aperture
        return high_aperture.clear_levels(*pupil, counts, wave.image_distance)
    return high_aperture.levels(nufft.own_nodes(residual), wave.image_distance, "unpolarised")


def axial_share(residual: Residual) -> float:
    """Return the energy of the vector wave that the peak lacks, s^2/4 for a slow round beam."""
    peak, secant = plane_levels(residual)
    return max(secant / peak - 1, 0.0)


def speckle_model_error(residual: Residual, normalisation: str) -> float:
    """Bound the scalar model's error for a wave of any aberration, also random ones."""
    return in_normalisation(residual, MARGIN * 2 * axial_share(residual), normalisation)


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
    The vector model weights the energy of a ray by 1/cos of its angle to the axis, so that the
    models differ by the ratio of this to its mean. What the brightest pixel loses, all others gain,
    so that its loss is also at most that fraction of the others' energy.
    """
    _, mean = plane_levels(residual)
    rim = 1 / math.sqrt(1 - high_aperture.largest_sine(residual) ** 2)
    others = max(1 - share, 0.0) / share if share > 0.5 else 1.0
    return MARGIN * max(1 - 1 / mean, rim / mean - 1) * others


def in_normalisation(residual: Residual, error: float, normalisation: str) -> float:
    """Return the error in a normalisation, given the one for unit energy in the image plane."""
    if normalisation != "ideal-peak":
        return error
    peak, secant = plane_levels(residual)
    return error * secant / peak + abs(secant / peak - 1)
