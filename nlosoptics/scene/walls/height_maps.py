"""Relay walls from sampled heights, measured or random, and from Python functions."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import counted, in_range, numbers, one_of, pair, positive, reason, shown, whole
from ..._nouns import check_pickles
from ..._random import generator
from ...errors import SamplingError, SceneError
from ...kernels.codes import GRID
from ..parts._quantities import Length
from ..parts._sources import SourceFile, source
from .analytic import Array, Wall, _term

#: Lag, in correlation lengths, beyond which the autocorrelation is below 1e-15.
REACH: Final = {"gaussian": 6.0, "exponential": 35.0}


@dataclass(frozen=True, eq=False)
class HeightMapWall(Wall):
    """Wall that interpolates heights on a regular grid, for example measured ones.

    The interpolation is bicubic, with continuous slopes.

    Parameters
    ----------
    heights : array_like (ny, nx), str or Path
        Heights in m, indexed [y, x] with row 0 at the lowest y: an array, or the path of an .npy
        file. At least 4 x 4 values. The centre of the grid is the origin.
    pitch : float
        Distance between neighbouring heights, m.
    size : float or (float, float), optional
        Full extent of the wall in x and y, m, at most that of the grid; one number for a square. By
        default the extent of the grid.

    Attributes
    ----------
    drawn : dict or None
        Arguments of `HeightMapWall.random`, if that method drew the heights. A scene file stores
        these arguments instead of the heights. None for other walls, and for a copy with another
        size.

    Raises
    ------
    SceneError
        If the file is missing or holds no array, the heights are too few or not finite, or
        ``size`` exceeds the grid.

    See Also
    --------
    CallableWall : Wall from Python functions.
    MeshWall : Wall from a triangle mesh.
    """

    #: Predicted seconds to find a ray's wall point, and per point of a phase screen.
    ray_seconds: ClassVar[float] = 1e-5
    screen_seconds: ClassVar[float] = 1.6e-7

    heights: Any
    pitch: Length
    _: KW_ONLY
    size: Any = None
    drawn: dict[str, Any] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pitch", positive("wall.pitch", self.pitch, unit="m"))
        object.__setattr__(self, "heights", source(self.heights))
        if not isinstance(self.heights, SourceFile):
            own = numbers("wall.heights", self.heights).copy()
            own.flags.writeable = False
            object.__setattr__(self, "heights", own)
        samples = self._samples
        if samples.ndim != 2 or min(samples.shape) < 4:
            raise SceneError(f"wall.heights has shape {samples.shape}; give at least (4, 4)")
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
        """Heights on the grid, (ny, nx), m."""
        return _read(self.heights) if isinstance(self.heights, SourceFile) else self.heights

    @classmethod
    def random(
        cls,
        *,
        height_rms: Length,
        correlation_length: Length,
        size: float | tuple[float, float],
        pitch: Length,
        autocorrelation: Annotated[str, REACH] = "gaussian",
        seed: int = 0,
    ) -> HeightMapWall:
        """Draw a wall with random heights: a stationary Gaussian process on a grid.

        Parameters
        ----------
        height_rms : float
            Rms height of the ensemble of such walls, m. The rms of a single wall deviates from it
            by a fraction of about ``correlation_length / size``.
        correlation_length : float
            Distance l at which the autocorrelation of the heights has fallen to 1/e, m; at least
            two pitches.
        size : float or (float, float)
            Full extent of the wall in x and y, m; one number for a square. Rounded up to a whole
            number of pitches.
        pitch : float
            Distance between neighbouring heights, m.
        autocorrelation : {"gaussian", "exponential"}
            Autocorrelation C of the heights at distance r, with l the correlation length:
            ``C = exp(-r^2/l^2)`` or ``C = exp(-r/l)``. An exponential surface has steeper slopes
            the finer the pitch, without limit.
        seed : int
            Seed of the random generator, 0 to 2^64 - 1. The same seed and grid give the same wall
            for any number of threads.

        Returns
        -------
        HeightMapWall
            Wall with the random heights. Its attribute ``drawn`` holds the arguments.

        Raises
        ------
        SamplingError
            If the correlation length is below two pitches.
        SceneError
            If a value is out of range.
        MemoryLimitError
            If the grid would not fit in memory.

        Notes
        -----
        White noise on a periodic grid is filtered by the square root of the power spectrum, which
        is the discrete Fourier transform of the autocorrelation (circulant embedding). The grid is
        larger than the wall by the distance at which the autocorrelation is below 1e-15. Opposite
        edges of the wall are therefore uncorrelated.

        Examples
        --------
        >>> from nlosoptics.scene import HeightMapWall
        >>> wall = HeightMapWall.random(
        ...     height_rms=1e-6, correlation_length=10e-3, size=0.5, pitch=2e-3, seed=1
        ... )
        >>> wall.size, round(1e6 * float(wall.heights.std()), 2)
        ((0.5, 0.5), 1.04)
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
        # rounding can make vanishing parts of the spectrum slightly negative
        spectrum = np.maximum(fft.rfft2(lags).real, 0.0)
        noise = generator(seed, 301).standard_normal((counts[1], counts[0]))
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
        """Height term and table of the bicubic surface."""
        from scipy.interpolate import RectBivariateSpline

        ny, nx = self._samples.shape
        x, y = ((np.arange(n) - (n - 1) / 2) * self.pitch for n in (nx, ny))
        spline = RectBivariateSpline(x, y, self._samples.T)
        slopes = [spline(x, y, dx=dx, dy=dy).T.ravel() for dx, dy in ((1, 0), (0, 1), (1, 1))]
        term = _term(GRID, x[0], y[0], self.pitch, self.pitch, nx, ny, 0)
        return term, np.concatenate([self._samples.ravel(), *slopes])

    def compiled(self) -> tuple[Array, Array]:
        """Return the bicubic surface as the arrays described in `Wall.compiled`."""
        return self._fit

    @cached_property
    def max_curvature(self) -> float:
        """Upper bound on the magnitude of the second derivatives of the height, 1/m."""
        return grid_limits(self._fit[0][0], self._fit[1])[2]

    @cached_property
    def height_rms(self) -> float:
        """Rms deviation of the heights from their mean, m."""
        return float(self._samples.std())

    @cached_property
    def slope_rms(self) -> float:
        """Rms slope along each axis at the grid points, rad; a uniform tilt counts as well."""
        return math.sqrt(float(np.mean(self.node_slopes() ** 2)))

    def node_slopes(self) -> Array:
        """Return the slopes dh/dx and dh/dy at the grid points, (2, ny * nx), in C order."""
        count = self._samples.size
        return self._fit[1][count : 3 * count].reshape(2, count)

    @property
    def finest_period(self) -> float:
        """Shortest period that the grid is assumed to resolve: four pitches, m."""
        return 4 * self.pitch

    @property
    def is_flat(self) -> bool:
        """Whether every height is zero."""
        return not self._samples.any()


def _read(path: SourceFile) -> Array:
    """Return the heights of an .npy file, m."""
    if not path.is_held and not path.is_file():
        raise SceneError(f"wall.heights: there is no file {path}; give the path of an .npy file")
    file = io.BytesIO(path.content)
    try:
        return np.asarray(np.load(file, allow_pickle=False).astype(float, casting="same_kind"))
    except Exception as error:  # numpy lets through what its parser of headers raises
        raise SceneError(
            f"wall.heights: {path} holds no array of numbers ({reason(error)}); "
            "write one with numpy.save"
        ) from None


def grid_limits(row: Array, tables: Array) -> tuple[float, float, float]:
    """Return bounds of a bicubic Hermite surface: lowest height, highest height, curvature.

    The bounds follow from the Hermite basis on [0, 1]. The value weights are convex, and slopes
    contribute at most step/4 times their magnitude. A first derivative is at most 3/2 of the
    difference quotient plus the largest slope. A second derivative is linear between nodes.
    """
    sx, sy, nx, ny, offset = row[3], row[4], int(row[5]), int(row[6]), int(row[7])
    v, vx, vy, vxy = tables[offset : offset + 4 * nx * ny].reshape(4, ny, nx)

    def top(a: Array) -> float:
        """Return the largest magnitude."""
        return float(np.abs(a).max())

    def second(values: Array, slopes: Array, step: float) -> float:
        """Return the largest second derivative along axis 1, which occurs at a node."""
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
    """Wall whose height is given by vectorised Python functions.

    Such a wall can be used like every other, but cannot be saved in a scene file. Rays are
    intersected with it in Python instead of compiled code, which is about a hundred times slower.

    Parameters
    ----------
    height : callable
        ``height(x, y)`` returns the height in m for arrays x and y, m, of equal shape.
    gradient : callable
        ``gradient(x, y)`` returns (dh/dx, dh/dy).
    hessian : callable, optional
        ``hessian(x, y)`` returns (d2h/dx2, d2h/dxdy, d2h/dy2), 1/m. By default these are central
        differences of the gradient with a step of 1e-5 of the finest period, or 1e-5 m if
        the finest period is infinite.
    size : float or (float, float), optional
        Full extent of the wall in x and y, m; one number for a square. By default the wall is
        unbounded.
    max_height : float
        Upper bound on abs(height) over the wall, m.
    max_curvature : float
        Upper bound on the magnitude of the height's second derivative in any direction, 1/m. It
        must be given: the default, infinity, raises `SceneError`.
    finest_period : float
        Shortest lateral period of the height, m; infinite if it does not oscillate.

    Raises
    ------
    SceneError
        If a value is out of range. Later uses of the wall raise it if a function exceeds a bound,
        or returns values that are not finite or of the wrong shape.

    See Also
    --------
    HeightMapWall : Wall from measured heights.
    Wall : Base class of all walls.
    """

    height: Callable[[Array, Array], ArrayLike] = field()  # type: ignore[assignment]
    gradient: Callable[[Array, Array], Any]
    _: KW_ONLY
    hessian: Callable[[Array, Array], Any] | None = None
    size: tuple[float, float] | None = None
    max_height: float
    # without a default the property of the base class would become it; inf fails the check below
    max_curvature: float = math.inf
    finest_period: float = math.inf

    is_compiled = False

    def __post_init__(self) -> None:
        for name in ("height", "gradient", "hessian"):
            value = getattr(self, name)
            if not callable(value) and not (name == "hessian" and value is None):
                raise SceneError(
                    f"wall.{name} = {shown(value)} is not callable; give a function of x, y"
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
        """Raise `SceneError`, since Python functions cannot be compiled."""
        raise SceneError(
            "a CallableWall has no compiled form; sample its heights into a HeightMapWall instead"
        )

    def derivatives(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the height and its derivatives (h, hx, hy, hxx, hxy, hyy), (..., 6).

        Parameters
        ----------
        x, y : array_like, (...)
            World coordinates, m; shapes broadcast.

        Raises
        ------
        SceneError
            If a function exceeds a bound, or returns values of the wrong shape or that are not
            finite.
        """
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        out = np.empty((*x.shape, 6))
        out[..., 0] = self._called("height", self.height(x, y), x)
        out[..., 1], out[..., 2] = self._slopes(x, y)
        if self.hessian is not None:
            bends = self.hessian(x, y)
            if len(bends) != 3:
                raise SceneError(
                    f"wall.hessian returned {counted(len(bends), 'value')}; give hxx, hxy, hyy"
                )
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
        """Return the checked values of ``gradient``."""
        slopes = self.gradient(x, y)
        if len(slopes) != 2:
            raise SceneError(
                f"wall.gradient returned {counted(len(slopes), 'value')}; give hx and hy"
            )
        return self._called("gradient", slopes[0], x), self._called("gradient", slopes[1], x)

    @staticmethod
    def _called(name: str, values: ArrayLike, like: Array) -> Array:
        """Return the values of a function after checking their shape and that they are finite."""
        values = np.asarray(values, dtype=np.float64)
        if values.shape not in (like.shape, ()):
            raise SceneError(
                f"wall.{name} returned shape {values.shape} for coordinates of shape {like.shape}; "
                "vectorise the function"
            )
        if not np.isfinite(values).all():
            raise SceneError(
                f"wall.{name} returned NaN or infinity; return finite values on the whole wall"
            )
        return values

    def _within(self, name: str, values: Array) -> None:
        """Raise `SceneError` if a value exceeds the bound ``name``."""
        # the tolerance allows for finite differences, whose relative error is about 1e-5
        limit = float(getattr(self, name))
        largest = float(values.max(initial=0.0))
        if largest > limit * (1 + 1e-4) + 1e-9:
            raise SceneError(
                f"wall.{name} = {limit:g} is exceeded by the wall's actual {largest:g}; give a "
                "larger bound"
            )
