"""Picture of a hidden object from the shadows that an occluder throws on a matt wall."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._checks import in_range, positive, whole, whole_pair
from ...errors import SamplingError, SceneError
from ..data.arrays import real_array
from ..data.reconstruction import Reconstruction, frozen
from .linear_model import Evidence, WallImage, evidence, wall_image
from .total_variation import least_variation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Limits:
    """Limits of the tests of a fit.

    ``detection``: least gain in log evidence over a wall without an object, odds of 1000 to 1.
    ``misfit``: largest power of the residual beyond the noise, over that power and the one that the
    object explains; ``correlation``: least expected correlation of the linear estimate.
    ``disagreement``: largest power of what the residual adds to the linear estimate, beyond that of
    the noise, over the power of the estimate. ``errors``: as many standard errors of the power of
    the noise are allowed in both.
    """

    detection: float = math.log(1000.0)
    misfit: float = 0.005
    errors: float = 5.0
    correlation: float = 0.8
    disagreement: float = 0.1


LIMITS = Limits()


class Operator(NamedTuple):
    """Operator of a wall: ``matrix`` (P, N), and the shapes of its pixels and of its cells."""

    matrix: Array
    pixels: tuple[int, int]
    cells: tuple[int, int]


class Settings(NamedTuple):
    """Options of the sharp fit; ``colour`` is whether the object has an axis of colours."""

    brightest: float
    most: int
    tolerance: float
    colour: bool


def shadow_fit(
    image: Any,
    operator: Any,
    *,
    cells: tuple[int, int] | None = None,
    noise: Any = None,
    reference: Any = None,
    ambient: int | None = None,
    brightest: float = math.inf,
    max_iterations: int = 1000,
    tolerance: float = 1e-3,
) -> Reconstruction:
    """Reconstruct an object from the shadows that a known occluder throws on a matt wall.

    Parameters
    ----------
    image : array_like, (H, W) or (H, W, C)
        Image of the wall, linear in the light, in one colour or several. NaN marks a pixel that is
        to be ignored.
    operator : WallTransport or array_like, (P, N)
        Light in each of P pixels for each of N cells of the object, without ambient light: an
        array, or an object with ``matrix``, ``pixel_shape`` and ``cell_shape``, such as
        `nlosoptics.imaging.WallTransport`. If it has fewer pixels than the image by a whole factor
        along each side, pixels of the image are added up.
    cells : tuple of int, optional
        Rows and columns of the object's cells; needed for an array.
    noise : float or array_like, optional
        Rms noise of each pixel, in the image's unit; a number, or an array of the image's shape. It
        is estimated from neighbouring pixels if it is not given, as photon noise and a constant.
    reference : array_like, optional
        Second exposure without the object's light, of the image's shape. It is subtracted.
    ambient : int, optional
        Order of the polynomial over the wall that describes ambient light, -1 to 12; -1 is none.
        The evidence chooses an order up to 6 if it is not given.
    brightest : float
        Largest value of the object, in the operator's unit; the least is 0.
    max_iterations : int
        Maximum number of iterations.
    tolerance : float
        Stop when the relative change of the object in one iteration is below this value.

    Returns
    -------
    Reconstruction
        Object in the operator's unit, (rows, columns) or (rows, columns, C), and status.
        ``physical_parameters`` has, apart from ``gain`` 1, ``background`` (mean ambient light),
        ``noise_sigma`` (rms, of a pixel of the operator): ``noise_ratio``, rms of all that the
        model leaves over the noise; ``ambient_order``; ``modes``, number of the object's modes
        above the noise in each colour; ``resolved_object``, the object at the resolution of these
        modes, which may be negative; ``object_error``, its standard deviation, both of the object's
        shape; ``expected_correlation`` of the resolved object with the truth, and
        ``resolved_correlation`` with the truth at the same resolution; ``detection``, gain in log
        evidence over a wall without an object; ``misfit``, the share of the power beyond noise and
        ambient light that the object does not explain; ``disagreement``, power beyond the noise of
        the resolved residual over that of the resolved object; ``log_evidence``.

    Raises
    ------
    SamplingError
        If the shapes of image, operator, noise and reference do not fit each other.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    occluder_fit : Fit for an occluder at an unknown place.
    nlosoptics.limits.feasibility : Predict what an image can show.

    Notes
    -----
    The image is ``A f + B c + n`` with operator A, object f, polynomials B and noise n. A linear
    Gaussian model in which objects have the spectrum 1/f^2 is fitted first. Its evidence chooses
    the strength of the object, the scale of the noise and the order of the polynomials [1]_. If
    the residual is correlated between pixels, as errors of the model are, pixels count for less.
    The object then minimises squared residual and total variation for values in the box. The weight
    of the variation is the one for which the variation's exponent equals the number of modes above
    the noise. No value is chosen by hand, nor by the truth.

    The status is "does_not_fit" if the object leaves more than 0.5 % of the power beyond noise and
    ambient light. Without a detected object, only structure wider than pixels counts, since the
    noise may be wrong. Otherwise the status is "too_few_photons" without a detected object, whose
    values are then 0, and for an expected correlation below 0.8. For an object that is known
    better, it is "does_not_fit" too if the residual would add more than 10 %, and more than noise
    does, to the power of the linear estimate, which may be negative. An object that is shifted
    together with the occluder has nearly the same shadows, and is not recognised.

    "converged" speaks of the object at the resolution of its modes. The expected correlation is
    that of objects with the spectrum 1/f^2. No image tells how much of an object is finer than the
    modes: of fine dots, the correlation with the truth is lower.

    References
    ----------
    .. [1] MacKay, Neural Computation 4 (1992) 415.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.inverse import shadow_fit
    >>> wall, cell = np.arange(400)[:, None], np.arange(16)
    >>> edge = (wall % 20) / 20 * 16 - cell  # a doorway: each column sees further around its edge
    >>> operator = np.clip(edge, 0.0, 1.0)
    >>> truth = np.where((cell > 4) & (cell < 9), 100.0, 0.0)
    >>> noise = np.random.default_rng(0).standard_normal((20, 20))
    >>> image = (operator @ truth).reshape(20, 20) + 500.0 + noise
    >>> fit = shadow_fit(image, operator, cells=(1, 16), noise=1.0)
    >>> fit.status, bool(abs(fit.object[0] - truth).max() < 10.0)
    ('converged', True)
    """
    started = time.perf_counter()
    known = checked_operator(operator, np.shape(image), cells)
    data = wall_image(image, known.pixels, noise, reference, ambient)
    settings = checked_settings(image, brightest, max_iterations, tolerance)
    return fitted(data, known, settings, started)


def checked_settings(image: Any, brightest: Any, most: Any, tolerance: Any) -> Settings:
    """Return the options of the sharp fit, checked."""
    return Settings(
        math.inf if brightest == math.inf else positive("brightest", brightest),
        whole("max_iterations", most),
        in_range("tolerance", tolerance, 0.0, 0.1),
        np.ndim(image) == 3,
    )


def checked_operator(
    operator: Any, image: tuple[int, ...], cells: tuple[int, int] | None = None
) -> Operator:
    """Return an operator or a matrix with the shapes of its pixels and cells, checked."""
    matrix = real_array("operator", getattr(operator, "matrix", operator))
    cells = getattr(operator, "cell_shape", cells)
    cells = None if cells is None else whole_pair("cells", cells)
    if cells is None or matrix.ndim != 2 or math.prod(cells) != matrix.shape[1]:
        raise SamplingError(
            f"operator has shape {matrix.shape} for {cells} cells, must be (pixels, rows * columns)"
            "; give cells=(rows, columns)"
        )
    if not np.isfinite(matrix).all() or not matrix.any():
        raise SceneError("operator has values that are not finite, or is 0; compute it again")
    pixels = getattr(operator, "pixel_shape", None)
    if pixels is None:
        rows, columns = image[:2] if len(image) > 1 else (0, 0)
        steps = math.isqrt(max(1, rows * columns // matrix.shape[0]))
        pixels = (rows // steps, columns // steps)
    if math.prod(pixels) != matrix.shape[0]:
        raise SamplingError(
            f"operator has {matrix.shape[0]} rows and image the shape {image}; give one row for "
            "each pixel, or for each square of pixels"
        )
    return Operator(matrix, pixels, cells)


def fitted(
    data: WallImage,
    known: Operator,
    settings: Settings,
    started: float,
    reasons: tuple[tuple[str, str], ...] = (),
    **more: Any,
) -> Reconstruction:
    """Return the fit for an operator; ``reasons`` are further pairs of status and sentence."""
    data, linear = settled(data, known)
    values = np.zeros((known.matrix.shape[1], len(data.sigma)))
    before = left = float((unexplained(data, known.matrix, linear, values) ** 2).sum())
    changes, detected = [0.0], linear.gain >= LIMITS.detection
    if detected:
        values, changes = sharpened(data, known, linear, settings)
        left = float((unexplained(data, known.matrix, linear, values) ** 2).sum())
    count = data.values.size / data.correlated
    beyond = max(left - count - LIMITS.errors * math.sqrt(2.0 * count), 0.0)
    misfit = beyond / max(before - left + beyond, 1e-300)
    unlike = float(((linear.estimate - linear.resolved(values, known.cells)) ** 2).sum())
    (noise, error), power = linear.noise(), max(len(values) * linear.estimate.var(0).sum(), 1e-300)
    disagreement = float((unlike - noise) / power)
    # without an object to compare with, the noise may be wrong; errors of the model vary slowly
    slow = data.correlated > 1.0 + LIMITS.errors * math.sqrt(18.0 / data.values.size)
    tests = (
        (
            changes[-1] > settings.tolerance,
            "unconverged",
            f"the relative change is {changes[-1]:.2g} after {len(changes)} iterations, limit "
            f"{settings.tolerance:g}; raise max_iterations",
        ),
        (
            (detected or slow) and misfit > LIMITS.misfit,
            "does_not_fit",
            f"the object leaves {misfit:.2g} of the power beyond noise and ambient light, limit "
            f"{LIMITS.misfit:g}; check the occluder's place (occluder_fit) and the ambient light",
        ),
        (
            not detected,
            "too_few_photons",
            f"no object is detected: it raises the log evidence by {linear.gain:.1f}, limit "
            f"{LIMITS.detection:.1f}; expose longer",
        ),
        (
            detected and linear.correlation < LIMITS.correlation,
            "too_few_photons",
            f"the expected correlation is {linear.correlation:.2f}, limit "
            f"{LIMITS.correlation:g}; expose longer, or use a larger part of the wall",
        ),
        (
            detected and disagreement > max(LIMITS.disagreement, LIMITS.errors * error / power),
            "does_not_fit",
            f"the residual beyond the noise adds {disagreement:.2g} of its power to the linear "
            f"estimate, limit {LIMITS.disagreement:g}: no object without negative values explains "
            "the image; check the occluder's place and shape",
        ),
    )
    failed = [test[1:] for test in tests if test[0]] + list(reasons)
    light = data.values * data.noise[:, None] - known.matrix[data.used] @ values / data.sigma
    shape = known.cells + ((len(data.sigma),) if settings.colour else ())
    return Reconstruction(
        object=values.reshape(shape),
        physical_parameters={
            "gain": 1.0,
            "background": float((light.mean(0) * data.sigma).mean()),
            "noise_sigma": float(np.sqrt((data.sigma**2).mean())),
            "noise_ratio": float(np.sqrt(linear.scale.mean())),
            "ambient_order": linear.order,
            "modes": linear.modes if settings.colour else float(linear.modes[0]),
            "resolved_object": linear.estimate.reshape(shape),
            "object_error": linear.error.reshape(shape),
            "expected_correlation": linear.correlation,
            "resolved_correlation": math.sqrt(max(1.0 - noise / power, 0.0)),
            "disagreement": disagreement,
            "detection": linear.gain,
            "misfit": misfit,
            "log_evidence": linear.log,
            **more,
        },
        status=failed[0][0] if failed else "converged",  # type: ignore[arg-type]
        score=math.sqrt(left / count),
        history=frozen({"change": changes}),
        seconds=time.perf_counter() - started,
        reasons=tuple(sentence for _, sentence in failed),
    )


def settled(data: WallImage, known: Operator) -> tuple[WallImage, Evidence]:
    """Return the image for as many correlated pixels as its residual shows, and the evidence."""
    linear = evidence(data, known.matrix, known.cells)
    data = data.of_correlated(unexplained(data, known.matrix, linear, linear.estimate))
    return data, evidence(data, known.matrix, known.cells) if data.correlated > 1.0 else linear


def unexplained(data: WallImage, matrix: Array, linear: Evidence, values: Array) -> Array:
    """Return the residual (P, C) over the noise of an object (N, C) in the operator's unit."""
    residual = data.values - data.over_noise(matrix) @ (values / data.sigma)
    smooth = data.ambient(linear.order)
    return np.asarray(residual - smooth @ (smooth.T @ residual))


def sharpened(
    data: WallImage, known: Operator, linear: Evidence, settings: Settings
) -> tuple[Array, list[float]]:
    """Return the object of least total variation, and the relative changes of its iterations."""
    smooth = data.ambient(linear.order)
    response = data.over_noise(known.matrix)
    response -= smooth @ (smooth.T @ response)
    # each colour is divided by its noise, so that all share one matrix
    level = np.sqrt((linear.estimate**2).mean(0))
    noise = data.sigma * np.sqrt(linear.scale)
    common = math.sqrt(float(((level / noise) ** 2).mean()))
    unit = noise * common
    values, changes = least_variation(
        common**2 * (response.T @ response),
        common * response.T @ (data.values * data.sigma / noise),
        known.cells,
        float(linear.modes.sum()),
        start=np.clip(linear.estimate, 0.0, settings.brightest) / unit,
        brightest=settings.brightest / unit,
        tolerance=settings.tolerance,
        most=settings.most,
    )
    return values * unit, changes
