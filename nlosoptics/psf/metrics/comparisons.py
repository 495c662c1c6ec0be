"""Comparison of all PSF transforms for one wave."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from ..._checks import in_range, positive, whole
from ...errors import MemoryLimitError, SamplingError
from ..transform import huygens
from ..transform.point_spread import METHODS, PointSpread, _sampling, point_spread
from ..wave.detilted import Residual, split
from ..wave.wavefront import Wavefront
from ..window.window import Window


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """Run time and error of one method of `point_spread`, as a row of a `Comparison`.

    Parameters
    ----------
    method : str
        Name of the method, such as "fft".
    seconds : float or None
        Shortest run time of the ``repeats`` of `compare`, s; None if the method did not run.
    error_estimate : float or None
        Largest error of the intensity relative to its peak, an upper bound that the method itself
        reports; None if it did not run.
    difference : float or None
        Largest difference of the intensity from that of the best method (`Comparison.best`),
        relative to the latter's peak: 0 for the best method itself, None if the method did not run.
    reason : str
        Why the method did not run; empty if it ran.

    See Also
    --------
    Comparison : Times and differences of all methods.
    compare : Run all methods on one wave.
    """

    method: str
    seconds: float | None = None
    error_estimate: float | None = None
    difference: float | None = None
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Run times and errors of all methods of `point_spread` for one wave; ``print`` shows a table.

    Parameters
    ----------
    rows : tuple of ComparisonRow
        One row for each method, also for those that did not run.
    best : str
        Method with the smallest error estimate, from which the differences are counted; empty if
        none ran. The method ``huygens`` is taken only if no other ran, because its model of
        diffraction differs.
    pitch : float
        Distance between image samples, or pixel side, m.
    shape : (int, int)
        Number of samples or pixels (ny, nx).

    See Also
    --------
    compare : Run all methods on one wave.
    """

    rows: tuple[ComparisonRow, ...]
    best: str
    pitch: float
    shape: tuple[int, int]

    def __str__(self) -> str:
        ny, nx = self.shape
        lines = [
            f"{ny} x {nx} samples of {self.pitch:.4g} m, against {self.best or 'none'}",
            f"{'method':<12}{'seconds':>10}{'estimate':>10}{'max dI':>10}",
        ]
        for row in self.rows:
            if row.seconds is None:
                lines.append(f"{row.method:<12}{row.reason}")
            else:
                lines.append(
                    f"{row.method:<12}{row.seconds:>10.2g}{row.error_estimate:>10.1e}"
                    f"{row.difference:>10.1e}"
                )
        return "\n".join(lines)


def compare(
    wavefront: Wavefront,
    *,
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    pixel_integrated: bool = False,
    repeats: int = 1,
    longest: float = 60.0,
) -> Comparison:
    """Run all methods of `point_spread` on a wave, and compare run times and results.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil.
    tol : float
        Error that the methods should reach, relative to the peak.
    pitch : float, optional
        Distance between image samples, or pixel side, m. Default lambda N/4, with the wavelength
        lambda and the F-number N; for a wave on a grid just below lambda N/2.
    shape : int or (int, int), optional
        Samples or pixels (ny, nx). Default: a window that contains all rays, see `point_spread`.
    pixel_integrated : bool
        Integrate over square pixels of side ``pitch`` instead of sampling at their centres.
    repeats : int
        Number of runs of each method; the shortest time is reported. The first run may include
        compilation.
    longest : float
        Largest predicted run time of the slow method ``huygens``, s; beyond it the method is
        skipped.

    Returns
    -------
    Comparison
        One row per method: run time, error estimate, and difference from the method with the
        smallest error estimate.

    Raises
    ------
    SceneError
        If an option is out of range.
    SamplingError
        If the default window would be wider than 4096 samples.

    See Also
    --------
    point_spread : PSF of a given wave.

    Examples
    --------
    Best method for a wave with 50 nm rms of defocus, and the methods that did not run:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 50e-9}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> found = psf.compare(wave, pitch=1.25e-6, shape=9)
    >>> found.best, [row.method for row in found.rows if row.seconds is None]
    ('quadrature', ['airy', 'geometric'])
    """
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    repeats = whole("repeats", repeats)
    positive("longest", longest, unit="s")
    residual = split(wavefront)
    pitch, size = _sampling(residual, "fft", tol, pitch, shape, pixel_integrated)
    done: dict[str, tuple[float, PointSpread]] = {}
    reasons: dict[str, str] = {}
    for method in METHODS[1:]:
        if method == "huygens" and not pixel_integrated:
            expected = _huygens_seconds(residual, pitch, size)
            if expected > longest:
                reasons[method] = f"would take about {expected:.2g} s, limit {longest:.2g} s"
                continue
        best = math.inf
        try:
            for _ in range(repeats):
                start = time.perf_counter()
                spread = point_spread(
                    wavefront,
                    method=method,  # type: ignore[arg-type]  # one of its literals
                    tol=tol,
                    pitch=pitch,
                    shape=size,
                    pixel_integrated=pixel_integrated,
                )
                best = min(best, time.perf_counter() - start)
        except (SamplingError, MemoryLimitError) as refusal:
            reasons[method] = str(refusal)
            continue
        done[method] = best, spread
    return _table(done, reasons, pitch, size)


def _table(
    done: dict[str, tuple[float, PointSpread]],
    reasons: dict[str, str],
    pitch: float,
    shape: tuple[int, int],
) -> Comparison:
    """Build the table: rows in the order of `METHODS`, differences against the best method."""
    # huygens sums spherical waves, which is another model. Outside the paraxial regime the
    # difference of the models exceeds the numerical error.
    alike = [m for m in done if m != "huygens"] or list(done)
    truth = min(alike, key=lambda m: done[m][1].error_estimate, default="")
    rows = []
    for method in METHODS[1:]:
        if method in reasons:
            rows.append(ComparisonRow(method=method, reason=reasons[method]))
            continue
        seconds, spread = done[method]
        reference = done[truth][1].intensity
        difference = float(np.abs(spread.intensity - reference).max() / reference.max())
        rows.append(
            ComparisonRow(
                method=method,
                seconds=seconds,
                error_estimate=spread.error_estimate,
                difference=difference,
            )
        )
    return Comparison(rows=tuple(rows), best=truth, pitch=pitch, shape=shape)


def _huygens_seconds(residual: Residual, pitch: float, shape: tuple[int, int]) -> float:
    """Predict the seconds of ``huygens`` in the image plane from the corners of the window."""
    window = Window.centred(pitch, shape)
    corners = np.array(
        [
            (x, y, residual.wavefront.image_distance)
            for x in window.x[[0, -1]]
            for y in window.y[[0, -1]]
        ]
    )
    return huygens.seconds(residual, corners) * shape[0] * shape[1] / len(corners)
