"""Relay walls from sampled heights, measured or drawn at random, and from a user's functions."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import in_range, one_of, pair, positive, whole
from ..._nouns import check_pickles
from ..._random import generator
from ...errors import SamplingError, SceneError
from ...kernels.codes import GRID
from ..parts._sources import SourceFile, source
from .analytic import Array, Wall, _term

HEIGHTS: Final = 301  # stream of the random generator
#: Lags, in correlation lengths, at which the autocorrelations have fallen below 1e-15.
REACH: Final = {"gaussian": 6.0, "exponential": 35.0}


@dataclass(frozen=True, eq=False)
class HeightMapWall(Wall):
    """Wall through heights on a regular grid, bicubic with continuous slopes.

    Parameters
    ----------
    heights : array_like (ny, nx), str or Path
        Heights, m, [y, x], row 0 at the lowest y, or an .npy file of them; at least 4 by 4. The
        grid is centred on the origin.
    pitch : float
        Distance between neighbours, m.
    size : float or (float, float), optional
        Full extent in x and y, m; by default, and at most, that of the grid.

    Attributes
    ----------
    drawn : dict or None
        Arguments of `random` that drew the heights, which a scene file keeps in their stead; None
        for other heights, those of a copy with another size included.
    """

    heights: Any
    pitch: float
    _: KW_ONLY
    size: Any = None
    drawn: dict[str, Any] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pitch", positive("wall.pitch", self.pitch, unit="m"))
        object.__setattr__(self, "heights", source(self.heights))
        if not isinstance(self.heights, SourceFile):
            own = np.array(self.heights, dtype=np.float64)
            own.flags.writeable = False
            object.__setattr__(self, "heights", own)
        samples = self._samples
        if samples.ndim != 2 or min(samples.shape) < 4:
            raise SceneError(f"wall.heights has shape {samples.shape}; give (ny, nx), 4 at least")
        if not np.isfinite(samples).all():
            place = np.argwhere(~np.isfinite(samples))[0].tolist()
            raise SceneError(f"wall.heights{place} is NaN or infinite; fill the gaps first")
        covered = tuple((n - 1) * self.pitch for n in samples.shape[::-1])
        if self.size is None:
            object.__setattr__(self, "size", covered)
        self._check_size()
        for axis in (0, 1):
            if self.size[axis] > covered[axis] * (1 + 1e-12):
                raise SceneError(
                    f"wall.size[{axis}] = {self.size[axis]:g} m exceeds the height map's "
                    f"{covered[axis]:g} m; give more heights or a smaller wall"
                )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, HeightMapWall):
            return NotImplemented
        same = (self.pitch, self.size) == (other.pitch, other.size)
        return same and np.array_equal(self._samples, other._samples)

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def _samples(self) -> Array:
        return _read(self.heights) if isinstance(self.heights, SourceFile) else self.heights

    @classmethod
    def random(
        cls,
        *,
        height_rms: float,
        correlation_length: float,
        size: float | tuple[float, float],
        pitch: float,
        autocorrelation: str = "gaussian",
        seed: int = 0,
    ) -> HeightMapWall:
        """Draw a stationary Gaussian random surface.

        Parameters
        ----------
        height_rms : float
            Of the ensemble, m; one wall's own scatters about it by some
            ``correlation_length / size``.
        correlation_length : float
            Lag l at which the autocorrelation has fallen to 1/e, m; at least two pitches.
        size : float or (float, float)
            Full extent in x and y, m, met or passed by less than a pitch.
        pitch : float
            Distance between drawn heights, m.
        autocorrelation : {"gaussian", "exponential"}
            ``C(r) = exp(-r^2/l^2)`` or ``exp(-r/l)``. The second has slopes that grow without bound
            as the pitch shrinks: the bicubic surface has those of its pitch.
        seed : int
            The same seed and grid give the same wall, with any number of threads.

        Returns
        -------
        HeightMapWall

        Raises
        ------
        SamplingError
            If the pitch is too coarse for the correlation length.

        Notes
        -----
        Circulant embedding: white noise filtered by the square root of the autocorrelation's
        discrete spectrum on a grid so much larger that its wrap-around does not show.
        """
        from scipy import fft

        from ..._checks import fits_memory

        height_rms = in_range("wall.height_rms", height_rms, 0.0, unit="m")
        length = positive("wall.correlation_length", correlation_length, unit="m")
        pitch = positive("wall.pitch", pitch, unit="m")
        one_of("wall.autocorrelation", autocorrelation, REACH)
        seed = whole("wall.seed", seed, 0, 2**64 - 1)
        if length < 2 * pitch:
            raise SamplingError(
                f"wall.correlation_length = {length:g} m is below two pitches of {pitch:g} m; "
                f"give a pitch of at most {length / 2:g} m"
            )
        extent = pair("wall.size", size)
        nodes = [max(4, math.ceil(s / pitch * (1 - 1e-12)) + 1) for s in extent]
        counts = [
            fft.next_fast_len(n + math.ceil(REACH[autocorrelation] * length / pitch)) for n in nodes
        ]
        fits_memory(
            f"wall.pitch = {pitch:g} m: a random height map of {counts[0]} x {counts[1]} nodes",
            64.0 * counts[0] * counts[1],
            "use a coarser pitch",
        )
        x, y = (np.minimum(np.arange(n), n - np.arange(n)) * pitch / length for n in counts)
        square = x * x + y[:, None] ** 2
        lags = np.exp(-square if autocorrelation == "gaussian" else -np.sqrt(square))
        # what rounding leaves of spectra that vanish may be negative
        spectrum = np.maximum(fft.rfft2(lags).real, 0.0)
        noise = generator(seed, HEIGHTS).standard_normal((counts[1], counts[0]))
        heights = fft.irfft2(fft.rfft2(noise) * np.sqrt(spectrum), s=noise.shape)
        wall = cls(height_rms * heights[: nodes[1], : nodes[0]], pitch)
        drawn = {
            "height_rms": height_rms,
            "correlation_length": length,
            "size": extent,
            "pitch": pitch,
            "autocorrelation": autocorrelation,
            "seed": seed,
        }
        object.__setattr__(wall, "drawn", drawn)
        return wall

    @cached_property
    def _fit(self) -> tuple[Array, Array]:
        from scipy.interpolate import RectBivariateSpline

        ny, nx = self._samples.shape
        x, y = ((np.arange(n) - (n - 1) / 2) * self.pitch for n in (nx, ny))
        spline = RectBivariateSpline(x, y, self._samples.T)
        slopes = [spline(x, y, dx=dx, dy=dy).T.ravel() for dx, dy in ((1, 0), (0, 1), (1, 1))]
        term = _term(GRID, x[0], y[0], self.pitch, self.pitch, nx, ny, 0)
        return term, np.concatenate([self._samples.ravel(), *slopes])

    def compiled(self) -> tuple[Array, Array]:
        """One bicubic grid."""
        return self._fit

    @cached_property
    def max_curvature(self) -> float:
        """Bound on the second derivatives of the height, 1/m."""
        return grid_limits(self._fit[0][0], self._fit[1])[2]

    @property
    def finest_period(self) -> float:
        """Four pitches, m."""
        return 4 * self.pitch

    @property
    def is_flat(self) -> bool:
        """Whether every height is zero."""
        return not self._samples.any()


def _read(path: SourceFile) -> Array:
    if not path.is_held and not path.is_file():
        raise SceneError(f"wall.heights: there is no file {path}; give the path of an .npy file")
    file = io.BytesIO(path.content)
    try:
        return np.asarray(np.load(file, allow_pickle=False), dtype=np.float64)
    except (OSError, ValueError, TypeError, EOFError) as error:
        raise SceneError(
            f"wall.heights: {path} holds no array of numbers ({type(error).__name__}); "
            "write one by numpy.save"
        ) from None


def grid_limits(row: Array, tables: Array) -> tuple[float, float, float]:
    """Lowest and highest height of a bicubic Hermite surface and a bound on its curvature.

    From the Hermite basis on [0, 1]: values mix convexly, slopes add at most step/4 of their
    size; a first derivative is at most 3/2 of the difference quotient plus the largest slope; a
    second derivative is linear between nodes.
    """
    sx, sy, nx, ny, offset = row[3], row[4], int(row[5]), int(row[6]), int(row[7])
    v, vx, vy, vxy = tables[offset : offset + 4 * nx * ny].reshape(4, ny, nx)

    def top(a: Array) -> float:
        return float(np.abs(a).max())

    def second(values: Array, slopes: Array, step: float) -> float:
        quotient = 6 * np.diff(values) / step
        start, stop = slopes[:, :-1], slopes[:, 1:]
        return (
            max(top(quotient - 4 * start - 2 * stop), top(quotient - 2 * start - 4 * stop)) / step
        )

    swing = (sx * top(vx) + sy * top(vy)) / 4 + sx * sy * top(vxy) / 16
    hxx = second(v, vx, sx) + sy / 4 * second(vy, vxy, sx)
    hyy = second(v.T, vy.T, sy) + sx / 4 * second(vx.T, vxy.T, sy)
    rows, columns = np.diff(v, axis=0) / sy, np.diff(vy, axis=1) / sx
    twist = 1.5 * top(np.diff(rows, axis=1)) / sx + top(np.diff(vx, axis=0)) / sy
    hxy = 1.5 * twist + 1.5 * top(columns) + top(vxy)
    return float(v.min()) - swing, float(v.max()) + swing, max(hxx, hyy) + hxy


@dataclass(frozen=True, eq=False)
class CallableWall(Wall):
    """Wall whose height is a user's own vectorised Python function.

    It is met by rays and aims waves like any other, in Python instead of compiled code: some
    hundred times slower. No scene file holds one.

    Parameters
    ----------
    height : callable
        ``height(x, y)``, m, of arrays of equal shape, m.
    gradient : callable
        ``gradient(x, y)``: (dh/dx, dh/dy).
    hessian : callable, optional
        ``hessian(x, y)``: (d2h/dx2, d2h/dxdy, d2h/dy2), 1/m; by default central differences of the
        gradient over 1e-5 of the finest period, or of a metre without one.
    size : float or (float, float), optional
        Full extent in x and y, m; None for an unbounded wall.
    max_height : float
        Bound on abs(height) over the wall, m.
    max_curvature : float
        Bound on the second derivative of the height in any direction, 1/m; to be given.
    finest_period : float
        Shortest lateral scale on which the height turns around, m.

    Raises
    ------
    SceneError
        From every use in which the functions break a bound or return what is no height.
    """

    height: Callable[[Array, Array], ArrayLike] = field()  # type: ignore[assignment]
    gradient: Callable[[Array, Array], Any]
    _: KW_ONLY
    hessian: Callable[[Array, Array], Any] | None = None
    size: tuple[float, float] | None = None
    max_height: float
    # a default, or the base's property would be in its place; its check refuses it
    max_curvature: float = math.inf
    finest_period: float = math.inf

    is_compiled = False

    def __post_init__(self) -> None:
        for name in ("height", "gradient", "hessian"):
            value = getattr(self, name)
            if not callable(value) and not (name == "hessian" and value is None):
                raise SceneError(
                    f"wall.{name} = {value!r} is not callable; give a function of x, y"
                )
        for name in ("max_height", "max_curvature"):
            value = in_range(f"wall.{name}", getattr(self, name), 0.0)
            object.__setattr__(self, name, value)
        if self.finest_period != math.inf:
            positive("wall.finest_period", self.finest_period, unit="m")
        self._check_size()

    def __getstate__(self) -> dict[str, Any]:
        for name in ("height", "gradient", "hessian"):
            check_pickles(f"wall.{name}", getattr(self, name))
        return super().__getstate__()

    def compiled(self) -> tuple[Array, Array]:
        """Refused: functions of Python are not compiled."""
        raise SceneError(
            "a CallableWall has no compiled form; sample its heights into a HeightMapWall here"
        )

    def derivatives(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Height and its derivatives (h, hx, hy, hxx, hxy, hyy), shape (..., 6).

        Raises
        ------
        SceneError
            If a function breaks a bound or returns what is no height.
        """
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        out = np.empty((*x.shape, 6))
        out[..., 0] = self._called("height", self.height(x, y), x)
        out[..., 1], out[..., 2] = self._slopes(x, y)
        if self.hessian is not None:
            bends = self.hessian(x, y)
            if len(bends) != 3:
                raise SceneError(f"wall.hessian returned {len(bends)} values; give hxx, hxy, hyy")
            for k in range(3):
                out[..., 3 + k] = self._called("hessian", bends[k], x)
        else:
            step = 1e-5 * (self.finest_period if self.finest_period < math.inf else 1.0)
            (xx1, yx1), (xx0, yx0) = self._slopes(x + step, y), self._slopes(x - step, y)
            (xy1, yy1), (xy0, yy0) = self._slopes(x, y + step), self._slopes(x, y - step)
            out[..., 3], out[..., 5] = (xx1 - xx0) / (2 * step), (yy1 - yy0) / (2 * step)
            out[..., 4] = (xy1 - xy0 + yx1 - yx0) / (4 * step)
        inside = self.contains(x, y)
        self._within("max_height", np.abs(out[..., 0])[inside])
        mean, half = (out[..., 3] + out[..., 5]) / 2, (out[..., 3] - out[..., 5]) / 2
        self._within("max_curvature", (np.abs(mean) + np.hypot(half, out[..., 4]))[inside])
        return out

    def _slopes(self, x: Array, y: Array) -> tuple[Array, Array]:
        slopes = self.gradient(x, y)
        if len(slopes) != 2:
            raise SceneError(f"wall.gradient returned {len(slopes)} values; give hx and hy")
        return self._called("gradient", slopes[0], x), self._called("gradient", slopes[1], x)

    @staticmethod
    def _called(name: str, values: ArrayLike, like: Array) -> Array:
        values = np.asarray(values, dtype=np.float64)
        if values.shape not in (like.shape, ()):
            raise SceneError(
                f"wall.{name} returned shape {values.shape} for {like.shape}; vectorise it"
            )
        if not np.isfinite(values).all():
            raise SceneError(f"wall.{name} returned NaN or infinity; give a height everywhere")
        return values

    def _within(self, name: str, values: Array) -> None:
        # differences of gradients are good to some 1e-5 of the bound
        limit = float(getattr(self, name))
        largest = float(values.max(initial=0.0))
        if largest > limit * (1 + 1e-4) + 1e-9:
            raise SceneError(
                f"wall.{name} = {limit:g} is passed by the wall's own {largest:g}; give a bound"
            )
