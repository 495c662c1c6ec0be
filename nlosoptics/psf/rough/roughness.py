"""Statistics of a rough wall's heights."""

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
#: What a measured autocorrelation may end with; the lags beyond count as 0.
LAST: Final = 0.02


@dataclass(frozen=True, eq=False)
class Roughness(Noun):
    """Stationary Gaussian random heights on top of a wall's mean shape.

    Parameters
    ----------
    height_rms : float
        m.
    correlation_length : float
        l, m: the lag at which C has fallen to 1/e. Of a callable or measured C, the scale on which
        it falls.
    autocorrelation : {"gaussian", "exponential"}, callable or array_like (2, n)
        ``C(r) = exp(-r^2/l^2)``, ``exp(-r/l)``; a function that takes lags r, m, as an array and
        returns C; or measured lags, m, rising from 0, above their values of C, 1 at lag 0.
        Monotone cubics join them and lags beyond the last have 0. A function may have a
        method ``structure``, which returns 1 - C with its digits at short lags, and an attribute
        ``end``, m, the lag beyond which it is 0.

    Raises
    ------
    SceneError
        If C is not 1 at lag 0, passes 1 elsewhere, or a measured one ends above 0.02.
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
        """``sqrt(2) height_rms/l``, rad, per axis; of the Gaussian C alone.

        Raises
        ------
        SceneError
            For another C: the exponential has no slope, others have that of their lag 0.
        """
        if self.autocorrelation != "gaussian":
            raise SceneError(
                "roughness.slope_rms is known for autocorrelation = 'gaussian' alone; take the "
                "curvature of C at lag 0"
            )
        return math.sqrt(2) * self.height_rms / self.correlation_length

    def correlation(self, lags: ArrayLike) -> Array:
        """C at lags of any shape, m."""
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
        """``1 - C``, of the named ones without cancellation."""
        r = np.asarray(lags, dtype=np.float64)
        if isinstance(self.autocorrelation, str):
            scaled = r / self.correlation_length
            return np.asarray(-np.expm1(-(scaled**2) if self._is_gaussian else -scaled))
        own = getattr(self.autocorrelation, "structure", None)
        return 1 - self.correlation(r) if own is None else np.asarray(own(r), dtype=np.float64)

    def split(self, cutoff: float) -> tuple[Roughness, Roughness]:
        """Long waves and short waves: independent heights that add up to these.

        Parameters
        ----------
        cutoff : float
            m, 0 to infinity. The long waves keep the share ``exp(-(pi cutoff/L)^2)`` of the power
            of a ripple of period L, the short ones the rest.

        Returns
        -------
        long, short : Roughness
            Their variances and autocovariances add up to the whole's; 0 and infinity leave one of
            them without height. The long waves of the Gaussian C are Gaussian again, of length
            ``sqrt(l^2 + cutoff^2)`` and variance ``h^2 l^2/(l^2 + cutoff^2)``; all others have an
            autocorrelation that is a function, with the lag of 1/e as correlation length.

        Raises
        ------
        SceneError
            For another C, if a part would hold less than 1e-6 of the variance; for a measured one,
            if the cutoff is below the spacing of its lags.

        Notes
        -----
        Of another C the long part comes from a table, to 1e-8 of the variance, and the short one
        is what lacks to the whole.
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
            # next to cutoff 0 the long length stays that of the whole to the last bit
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
                f"{found:.6g}, limit 1: C asks there for negative power; smooth it, or use a "
                "longer cutoff"
            )
        scale = fall_length(passed, math.hypot(length, cutoff))
        return (
            Roughness(h * math.sqrt(passed.passed), scale, passed),
            Roughness(h * math.sqrt(1 - passed.passed), fall_length(left, length), left),
        )

    def reach(self, level: float) -> float:
        """Lag beyond which ``|C|`` stays at or below a level above 0, m; infinity if none does."""
        if isinstance(self.autocorrelation, str):
            fall = math.log(1 / level)
            return self.correlation_length * (math.sqrt(fall) if self._is_gaussian else fall)
        if isinstance(self.autocorrelation, np.ndarray):
            return float(self.autocorrelation[0, -1])
        length = self.correlation_length
        end = getattr(self.autocorrelation, "end", math.inf)
        # a tail may be on another scale than the fall
        lags = np.geomspace(
            1e-2 * length, *((1e3 * length, 401) if math.isinf(end) else (end, 1601))
        )
        above = np.nonzero(np.abs(self.correlation(lags)) > level)[0]
        if above.size and above[-1] == lags.size - 1:
            return math.inf if math.isinf(end) else end
        return float(lags[above[-1] + 1 if above.size else 0])

    def lag_of(self, structure: float) -> float:
        """Smallest lag at which ``1 - C`` comes to a value from 0 to 1, m; infinity if never."""
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
        """Lag beyond which C is nothing, m."""
        end = self.reach(1e-16)
        if math.isinf(end):
            raise SceneError(
                "roughness.autocorrelation stays above 1e-16 up to 1000 correlation lengths, and "
                "a split needs all of it; give one that ends"
            )
        return end

    def _lags(self, cutoff: float) -> Array | None:
        """Measured lags, if these are, with the cutoff held against their spacing."""
        if not isinstance(self.autocorrelation, np.ndarray):
            return None
        lags: Array = self.autocorrelation[0]
        widest = float(np.diff(lags).max())
        if cutoff < widest:
            raise SceneError(
                f"cutoff = {cutoff:.3g} m is below the spacing of the measured lags, {widest:.3g} "
                "m, which say nothing of shorter waves; use a cutoff at least as long, or 0"
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
    """Measured lags and values, checked, read-only."""
    table = np.array(given, dtype=np.float64)
    if table.ndim != 2 or table.shape[0] != 2 or table.shape[1] < 4:
        raise SceneError(
            f"roughness.autocorrelation has shape {table.shape}; give (2, n), lags in m above "
            "values, four or more"
        )
    if not np.isfinite(table).all() or table[0, 0] != 0 or np.any(np.diff(table[0]) <= 0):
        raise SceneError(
            "roughness.autocorrelation[0] must be finite lags in m that rise from 0; sort them"
        )
    if abs(table[1, -1]) > LAST:
        raise SceneError(
            f"roughness.autocorrelation ends with {table[1, -1]:.3g} at a lag of {table[0, -1]:.3g}"
            f" m, limit {LAST}; measure to larger lags"
        )
    table.setflags(write=False)
    return table
