"""Statistics of the heights of a rough wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import in_range, one_of, positive
from ..._nouns import Noun, check_pickles
from ..._vectors import Array
from ...errors import SceneError


@dataclass(frozen=True, eq=False)
class Roughness(Noun):
    """Statistics of a rough wall: rms height, correlation length and autocorrelation.

    The heights are Gaussian random numbers that are added to the wall's mean shape.

    Parameters
    ----------
    height_rms : float
        Root mean square height h, m.
    correlation_length : float
        Distance l between wall points, m, at which the autocorrelation C has fallen to 1/e. For a
        callable C, the approximate distance over which it falls.
    autocorrelation : {"gaussian", "exponential"} or callable
        Autocorrelation C(r) of the heights of two wall points at the distance (lag) r; C(0) = 1:

        - ``"gaussian"`` is ``exp(-r^2/l^2)`` and ``"exponential"`` is ``exp(-r/l)``.
        - A callable takes an array of lags, m, and returns the values of C.
          It can interpolate a measured C: ``lambda r: np.interp(r, lags, values, right=0)``.

    Raises
    ------
    SceneError
        If C is not 1 at lag 0 or exceeds 1 elsewhere.

    See Also
    --------
    mean_point_spread : Mean PSF over all walls of one roughness.

    Examples
    --------
    Rms slope of a wall of Gaussian bumps, and its autocorrelation at a distance of 1 mm:

    >>> from nlosoptics import psf
    >>> rough = psf.Roughness(height_rms=100e-9, correlation_length=1e-3)
    >>> print(f"slope {rough.slope_rms:.2e} rad, C = {rough.correlation(1e-3):.3f}")
    slope 1.41e-04 rad, C = 0.368
    """

    height_rms: float
    correlation_length: float
    autocorrelation: Any = "gaussian"

    def __post_init__(self) -> None:
        put = object.__setattr__
        rms = in_range("roughness.height_rms", self.height_rms, 0.0, unit="m")
        put(self, "height_rms", rms)
        length = positive("roughness.correlation_length", self.correlation_length, unit="m")
        put(self, "correlation_length", length)
        if isinstance(self.autocorrelation, str):
            one_of("roughness.autocorrelation", self.autocorrelation, ("gaussian", "exponential"))
            return
        if not callable(self.autocorrelation):
            raise SceneError(
                f"roughness.autocorrelation is a {type(self.autocorrelation).__name__}; give "
                "'gaussian', 'exponential' or a function of the lags in m"
            )
        found = self.correlation(length * np.append(0.0, np.geomspace(1e-3, 1e3, 97)))
        if abs(found[0] - 1) > 1e-9 or np.abs(found).max() > 1 + 1e-9:
            raise SceneError(
                f"roughness.autocorrelation is {found[0]:.6g} at lag 0 and reaches "
                f"{np.abs(found).max():.6g}, must be 1 and at most 1; divide it by its value at 0"
            )

    def __getstate__(self) -> dict[str, Any]:
        check_pickles("roughness.autocorrelation", self.autocorrelation)
        return super().__getstate__()

    @property
    def slope_rms(self) -> float:
        """Rms slope of the wall along one axis, rad: ``sqrt(2) height_rms/correlation_length``.

        Raises
        ------
        SceneError
            Unless the autocorrelation is "gaussian", for which alone the formula holds. The rms
            slope of "exponential" heights is infinite.
        """
        if self.autocorrelation != "gaussian":
            raise SceneError(
                "roughness.slope_rms is available only for autocorrelation = 'gaussian'; compute "
                "it from the curvature of C at lag 0"
            )
        return math.sqrt(2) * self.height_rms / self.correlation_length

    def correlation(self, lags: ArrayLike) -> Array:
        """Return the autocorrelation C of the heights.

        Lags are distances between wall points, m, of any shape, which is that of the result.
        """
        r = np.asarray(lags, dtype=np.float64)
        scaled = r / self.correlation_length
        if isinstance(self.autocorrelation, str):
            return np.asarray(np.exp(-(scaled**2) if self._is_gaussian else -scaled))
        found = np.asarray(self.autocorrelation(r), dtype=np.float64)
        if found.shape != r.shape or not np.isfinite(found).all():
            raise SceneError(
                f"roughness.autocorrelation gave shape {found.shape} for lags of shape {r.shape}, "
                "or values that are not finite; return one number per lag"
            )
        return found

    def structure(self, lags: ArrayLike) -> Array:
        """Return 1 minus the autocorrelation, without loss of digits at short lags.

        Parameters
        ----------
        lags : array_like
            Distances between wall points, m, of any shape.

        Returns
        -------
        ndarray
            1 - C, 0 at lag 0, in the shape of ``lags``. A callable C loses digits at short lags.
        """
        r = np.asarray(lags, dtype=np.float64)
        if isinstance(self.autocorrelation, str):
            scaled = r / self.correlation_length
            return np.asarray(-np.expm1(-(scaled**2) if self._is_gaussian else -scaled))
        return 1 - self.correlation(r)

    def reach(self, level: float) -> float:
        """Return the lag beyond which the autocorrelation is negligible.

        Parameters
        ----------
        level : float
            Largest modulus of C that counts as negligible, above 0.

        Returns
        -------
        float
            Lag, m, beyond which ``|C|`` is at most ``level``; infinite if there is none.
        """
        if isinstance(self.autocorrelation, str):
            fall = math.log(1 / level)
            return self.correlation_length * (math.sqrt(fall) if self._is_gaussian else fall)
        # search far beyond the correlation length, since a tail can have another scale
        lags = self.correlation_length * np.geomspace(1e-2, 1e3, 401)
        above = np.nonzero(np.abs(self.correlation(lags)) > level)[0]
        if above.size and above[-1] == lags.size - 1:
            return math.inf
        return float(lags[above[-1] + 1 if above.size else 0])

    def lag_of(self, structure: float) -> float:
        """Return the smallest lag at which the autocorrelation has fallen by a given amount.

        Parameters
        ----------
        structure : float
            Value of 1 - C, 0 to 1.

        Returns
        -------
        float
            Lag, m; infinite if C never falls that far.
        """
        from scipy.optimize import brentq

        lags = self.correlation_length * np.append(0.0, np.geomspace(1e-8, 1e3, 1101))
        passed = np.nonzero(self.structure(lags) >= structure)[0]
        if not passed.size:
            return math.inf
        low, high = lags[max(passed[0] - 1, 0)], lags[passed[0]]

        def miss(lag: float) -> float:
            return float(self.structure(lag)) - structure

        return float(brentq(miss, low, high, xtol=1e-13 * high)) if high > 0 else 0.0

    @property
    def _is_gaussian(self) -> bool:
        return isinstance(self.autocorrelation, str) and self.autocorrelation == "gaussian"
