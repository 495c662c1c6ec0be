"""Statistics of the heights of a rough wall."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range, one_of, positive
from ..._nouns import Noun, check_pickles
from ...errors import SceneError
from .autocorrelations import GaussianRemainder, Remainder, fall_length, smoothed

Array = NDArray[np.float64]
NAMED: Final = ("gaussian", "exponential")
#: Largest last value of a measured autocorrelation, which is 0 at longer lags.
LAST: Final = 0.02


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
        callable or measured C, the approximate distance over which it falls.
    autocorrelation : {"gaussian", "exponential"}, callable or array_like (2, n)
        Autocorrelation C(r) of the heights of two wall points at the distance (lag) r; C(0) = 1:

        - ``"gaussian"`` is ``exp(-r^2/l^2)`` and ``"exponential"`` is ``exp(-r/l)``.
        - A callable takes an array of lags, m, and returns the values of C. It may have a method
          ``structure`` that returns 1 - C accurately at short lags, and an attribute ``end``, the
          lag, m, beyond which C is 0.
        - A measured C is an array: row 0 holds lags, m, increasing from 0, and row 1 the values of
          C. It is interpolated by monotone cubics, and 0 beyond the last lag.

    Raises
    ------
    SceneError
        If C is not 1 at lag 0, exceeds 1 elsewhere, or a measured C ends above 0.02.

    See Also
    --------
    mean_point_spread : Mean PSF over all walls of one roughness.
    sample_point_spread : PSF of one random rough wall.
    two_scale_point_spread : PSF of coarse and fine roughness.

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
            one_of("roughness.autocorrelation", self.autocorrelation, NAMED)
            return
        if not callable(self.autocorrelation):
            put(self, "autocorrelation", _table(self.autocorrelation))
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

        Parameters
        ----------
        lags : array_like
            Distances between wall points, m, of any shape.

        Returns
        -------
        ndarray
            C, 1 at lag 0, in the shape of ``lags``.
        """
        r = np.asarray(lags, dtype=np.float64)
        scaled = r / self.correlation_length
        if isinstance(self.autocorrelation, str):
            return np.asarray(np.exp(-(scaled**2) if self._is_gaussian else -scaled))
        if isinstance(self.autocorrelation, np.ndarray):
            last = self.autocorrelation[0, -1]
            return np.asarray(np.where(r <= last, self._interpolant(np.minimum(r, last)), 0.0))
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
            1 - C, 0 at lag 0, in the shape of ``lags``. A measured C, or a callable without a
            method ``structure``, loses digits at short lags.
        """
        r = np.asarray(lags, dtype=np.float64)
        if isinstance(self.autocorrelation, str):
            scaled = r / self.correlation_length
            return np.asarray(-np.expm1(-(scaled**2) if self._is_gaussian else -scaled))
        own = getattr(self.autocorrelation, "structure", None)
        return 1 - self.correlation(r) if own is None else np.asarray(own(r), dtype=np.float64)

    def split(self, cutoff: float) -> tuple[Roughness, Roughness]:
        """Split the heights into two independent parts: coarse and fine structure.

        Parameters
        ----------
        cutoff : float
            Period between coarse and fine, m, 0 to infinity. The transition is gradual: of the
            power of a ripple of period L, the coarse part receives the fraction
            ``exp(-(pi cutoff/L)^2)`` and the fine part the rest.

        Returns
        -------
        long, short : Roughness
            Coarse part (long periods) and fine part (short periods). The sum of two walls with
            these statistics has the statistics of the whole. With a cutoff of 0 or infinity one
            part has the height 0.

        Raises
        ------
        SceneError
            If C is not Gaussian and one part would have less than 1e-6 of the variance, or if C is
            measured and the cutoff is below the spacing of its lags.

        Notes
        -----
        Let l be the correlation length. If the autocorrelation is "gaussian", that of the coarse
        part is, too, with the correlation length ``sqrt(l^2 + cutoff^2)`` and the variance
        ``height_rms^2 l^2/(l^2 + cutoff^2)``. All other parts have a callable autocorrelation. A
        coarse part that is not Gaussian is tabulated to 1e-8 of the variance; the fine part is the
        difference from the whole.
        """
        if cutoff != math.inf:
            cutoff = in_range("cutoff", cutoff, 0.0, unit="m")
        h, length = self.height_rms, self.correlation_length
        if cutoff == math.inf:
            return Roughness(0.0, length), self
        if self._is_gaussian:
            rest = GaussianRemainder(length, cutoff)
            if rest.held == 0:  # below rounding
                return self, Roughness(0.0, length)
            # hypot keeps the correlation length exactly for a cutoff near 0
            long = Roughness(h * math.sqrt(rest.passed), math.hypot(length, cutoff))
            short = Roughness(h * math.sqrt(rest.held), fall_length(rest, length), rest)
            return long, short
        if cutoff == 0:
            return self, Roughness(0.0, length)
        passed = smoothed(self.correlation, length, self._end(), cutoff, self._lags(cutoff))
        left = Remainder(self.correlation, passed)
        found = np.abs(left(length * np.append(0.0, np.geomspace(1e-3, 1e3, 97)))).max()
        if found > 1 + 1e-9:
            raise SceneError(
                f"cutoff = {cutoff:.3g} m leaves short waves with an autocorrelation up to "
                f"{found:.6g}, limit 1, since C implies negative power there; smooth C, or use a "
                "longer cutoff"
            )
        scale = fall_length(passed, math.hypot(length, cutoff))
        return (
            Roughness(h * math.sqrt(passed.passed), scale, passed),
            Roughness(h * math.sqrt(1 - passed.passed), fall_length(left, length), left),
        )

    def reach(self, level: float) -> float:
        """Return the lag beyond which the autocorrelation is negligible.

        Parameters
        ----------
        level : float
            Largest modulus of C that counts as negligible, above 0.

        Returns
        -------
        float
            Lag, m, beyond which ``|C|`` is at most ``level``; infinite if there is none. For a
            measured C it is the last lag.
        """
        if isinstance(self.autocorrelation, str):
            fall = math.log(1 / level)
            return self.correlation_length * (math.sqrt(fall) if self._is_gaussian else fall)
        if isinstance(self.autocorrelation, np.ndarray):
            return float(self.autocorrelation[0, -1])
        length = self.correlation_length
        end = getattr(self.autocorrelation, "end", math.inf)
        # search far beyond the correlation length, since a tail can have another scale
        lags = np.geomspace(
            1e-2 * length, *((1e3 * length, 401) if math.isinf(end) else (end, 1601))
        )
        above = np.nonzero(np.abs(self.correlation(lags)) > level)[0]
        if above.size and above[-1] == lags.size - 1:
            return math.inf if math.isinf(end) else end
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
        lags = self.correlation_length * np.geomspace(1e-8, 1e3, 1101)
        passed = np.nonzero(self.structure(lags) >= structure)[0]
        if not passed.size:
            return math.inf
        low, high = (0.0 if passed[0] == 0 else lags[passed[0] - 1]), lags[passed[0]]
        for _ in range(40):
            middle = (low + high) / 2
            if self.structure(middle) >= structure:
                high = middle
            else:
                low = middle
        return float(high)

    def _end(self) -> float:
        """Return the lag beyond which C is negligible (1e-16), m."""
        end = self.reach(1e-16)
        if math.isinf(end):
            raise SceneError(
                "roughness.autocorrelation stays above 1e-16 up to 1000 correlation lengths, but "
                "a split needs its full extent; give one that falls to 0"
            )
        return end

    def _lags(self, cutoff: float) -> Array | None:
        """Return measured lags, or None; refuse a cutoff below the spacing of measured lags."""
        if not isinstance(self.autocorrelation, np.ndarray):
            return None
        lags: Array = self.autocorrelation[0]
        widest = float(np.diff(lags).max())
        if cutoff < widest:
            raise SceneError(
                f"cutoff = {cutoff:.3g} m is below the spacing of the measured lags, {widest:.3g} "
                "m, which do not resolve shorter waves; use a cutoff at least as long, or 0"
            )
        return lags

    @property
    def _is_gaussian(self) -> bool:
        return isinstance(self.autocorrelation, str) and self.autocorrelation == "gaussian"

    @cached_property
    def _interpolant(self) -> Callable[[Array], Array]:
        from scipy.interpolate import PchipInterpolator  # half a second to load

        lags, values = self.autocorrelation
        interpolant: Callable[[Array], Array] = PchipInterpolator(lags, values)
        return interpolant


def _table(given: ArrayLike) -> Array:
    """Return checked, read-only measured lags and values (2, n)."""
    table = np.array(given, dtype=np.float64)
    if table.ndim != 2 or table.shape[0] != 2 or table.shape[1] < 4:
        raise SceneError(
            f"roughness.autocorrelation has shape {table.shape}; give (2, n) with n of 4 or more, "
            "a row of lags in m and a row of values"
        )
    if not np.isfinite(table).all() or table[0, 0] != 0 or np.any(np.diff(table[0]) <= 0):
        raise SceneError(
            "roughness.autocorrelation[0] must be finite lags in m that rise from 0; sort the lags"
        )
    if abs(table[1, -1]) > LAST:
        raise SceneError(
            f"roughness.autocorrelation ends with {table[1, -1]:.3g} at a lag of {table[0, -1]:.3g}"
            f" m, limit {LAST}; measure to larger lags"
        )
    table.setflags(write=False)
    return table
