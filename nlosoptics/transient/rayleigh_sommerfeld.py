"""Fields carried from wall points into a volume: the direct sum, and planes by transforms.

The field of a wave with wavenumber k at a voxel x is the Rayleigh-Sommerfeld sum over the wall

    F_k(x) = sum_ji s_k[j, i] exp(i k (|x - far_j| + |x - near_i|)),

without the far leg where light was not focused; the sign of the phase looks back in time, from the
wall to where light came from. Voxel weights are equal (Liu et al., Nature 572, 620 (2019), drop the
1/r, which changes little over the wall), or 1/r for each leg.

On planes whose x and y steps are those of the grid ``near``, the sum over i is a convolution, done
with transforms so long that nothing wraps around.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import SamplingError
from .phasor_fields import Band, blocks
from .volumes import Volume

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

#: Bytes of transformed planes that are held at once.
PLANES = 2**25
#: Pairs of paths and waves in one step of the direct sum.
STEP = 2e8
#: Share of a wavelength by which points may lie off an even grid.
UNEVEN = 1e-4

#: Threads of a transform: two share a batch well, more pay only on large walls.
THREADS = 2

Advance = Callable[[float], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Legs:
    """The wall points that paths to a voxel start from and end at.

    Parameters
    ----------
    near : ndarray
        (n, 3), m: each has a spectrum.
    far : ndarray
        (m, 3), m; (0, 3) without a second leg.
    paired : bool
        Whether far_i belongs to near_i, and not to all.
    falls : bool
        Whether each leg divides by its length.
    """

    near: Array
    far: Array
    paired: bool = False
    falls: bool = False

    @property
    def twice(self) -> bool:
        """Whether both legs are the same."""
        return self.paired and bool(np.allclose(self.near, self.far, rtol=0.0, atol=1e-9))


@dataclass(frozen=True, eq=False)
class Lattice:
    """How a volume's planes lie over an even grid of wall points.

    ``shape`` of the wall (y, x), ``origin`` its first point and ``pitch`` (y, x), m; ``flips``
    name the wall's axes that fall.
    """

    shape: tuple[int, int]
    origin: Array
    pitch: tuple[float, float]
    flips: tuple[int, ...]


def lattice(points: Array, volume: Volume, wavelength: float) -> Lattice:
    """The even grid that wall points and a volume's planes share.

    Parameters
    ----------
    points : ndarray
        (ny, nx, 3), m.
    volume : Volume
    wavelength : float
        m, of what points may be off by `UNEVEN`.

    Raises
    ------
    SamplingError
        If there is none, saying what does not fit.
    """
    if points.ndim != 3:
        raise SamplingError(
            f"wall points of shape {points.shape[:-1]} are no grid; take method='direct'"
        )
    flips = tuple(a for a in (0, 1) if points.shape[a] > 1 and _falls(points, a))
    points = np.flip(points, flips)
    shape, origin = points.shape[:2], points[0, 0]
    limit = UNEVEN * wavelength
    pitch = []
    for axis, wanted in ((0, volume.y), (1, volume.x)):
        count, component = shape[axis], 1 - axis
        line = points[:, 0] if axis == 0 else points[0]
        own = _pitch(line[:, component], count)
        its = _pitch(wanted, len(wanted))
        if own and its and abs(own - its) * max(count, len(wanted)) > limit:
            raise SamplingError(
                f"volume.{'yx'[axis]} steps by {its:.6g} m and the wall's points by {own:.6g} m; "
                "give both one pitch, or take method='direct'"
            )
        pitch.append(own or its or 1.0)
    even = np.empty_like(points)
    even[..., 0] = origin[0] + pitch[1] * np.arange(shape[1])
    even[..., 1] = origin[1] + pitch[0] * np.arange(shape[0])[:, None]
    even[..., 2] = origin[2]
    off = float(np.abs(points - even).max())
    if off > limit:
        raise SamplingError(
            f"wall points lie up to {off:.3g} m off an even grid, limit {limit:.3g} m; take "
            "method='direct'"
        )
    return Lattice((shape[0], shape[1]), origin, (pitch[0], pitch[1]), flips)


def direct_sum(
    volume: Volume, legs: Legs, band: Band, spectra: ComplexArray, times: Array, advance: Advance
) -> ComplexArray:
    """The field at each voxel by summing every path.

    Parameters
    ----------
    volume : Volume
    legs : Legs
    band : Band
        Its n wavenumbers.
    spectra : ndarray
        (n, m, points) complex, m = 1 unless all far points belong to all near ones.
    times : ndarray
        (t,), m.
    advance : callable
        Takes the share done.

    Returns
    -------
    ndarray
        (t, nz, ny, nx) complex128.
    """
    from . import _phasor_kernels as kernels

    waves = band.wavenumbers
    voxels = volume.points.reshape(-1, 3)
    fields = np.empty((len(times), len(voxels)), dtype=np.complex128)
    last = np.ascontiguousarray(np.moveaxis(spectra, 0, -1).astype(np.complex128))
    turns = np.exp(1j * np.outer(times, waves))
    kind = kernels.ALONE if not len(legs.far) else kernels.PAIRED if legs.paired else kernels.ALL
    far = legs.far if len(legs.far) else legs.near[:1]
    for part in blocks(len(voxels), max(1, int(STEP // last.size))):
        out = np.empty((len(times), part.stop - part.start), dtype=np.complex128)
        kernels.direct_sum(
            voxels[part], legs.near, far, kind, legs.falls, waves[0], band.step, last, turns, out
        )
        fields[:, part] = out
        advance(part.stop / len(voxels))
    return fields.reshape(len(times), *volume.shape)


def plane_by_plane(
    volume: Volume,
    legs: Legs,
    grid: Lattice,
    band: Band,
    spectra: ComplexArray,
    times: Array,
    advance: Advance,
) -> ComplexArray:
    """The field at each voxel by convolutions of wall and planes; as `direct_sum`.

    ``spectra`` keeps its precision, and with it the field.
    """
    room = Room.of(volume, grid, legs)
    kind = spectra.dtype
    fields = np.zeros((len(times), *volume.shape), dtype=kind)
    walls = spectra.reshape(*spectra.shape[:2], *grid.shape)
    walls = np.flip(walls, tuple(axis + 2 for axis in grid.flips))
    size = len(band.numbers) * room.shape[0] * room.shape[1] * kind.itemsize
    for part in blocks(len(volume.z), max(1, int(PLANES // size))):
        away = volume.z[part] - grid.origin[2]
        response = room.kernels(away, band, kind)
        for j in range(walls.shape[1]):
            wall = room.wall(walls[:, j])
            if legs.twice and len(times) == 1:
                turns = np.exp(1j * band.wavenumbers * times[0]).astype(kind)
                fields[0, part] = room.added(wall * turns[:, None, None], response)
            else:
                far = np.empty((0, 3)) if legs.paired else legs.far[j : j + 1]
                room.add(wall, response, band, far, part, times, fields)
            advance(
                (part.start + (part.stop - part.start) * (j + 1) / walls.shape[1]) / len(volume.z)
            )
    return fields


@dataclass(frozen=True, eq=False)
class Room:
    """Padded transforms between a wall and planes; ``folds`` mirror kernels that are even."""

    volume: Volume
    legs: Legs
    shape: tuple[int, int]
    starts: tuple[int, int]
    up: Array
    across: Array
    folds: tuple[NDArray[np.int64], NDArray[np.int64]]
    even: bool

    @classmethod
    def of(cls, volume: Volume, grid: Lattice, legs: Legs, *, mirrored: bool = True) -> Room:
        """Sizes, and the kernels' coordinates, for a volume over a wall.

        ``mirrored``: whether to use that kernels may be even.
        """
        plans = []
        for axis, wanted in ((0, volume.y), (1, volume.x)):
            plans.append(
                _axis_plan(
                    grid.shape[axis],
                    len(wanted),
                    (wanted[0] - grid.origin[1 - axis]) / grid.pitch[axis],
                )
            )
        even = mirrored and all(plan.even for plan in plans)
        axes = [plan.mirrored() if even else plan.whole() for plan in plans]
        return cls(
            volume,
            legs,
            (axes[0][0], axes[1][0]),
            (axes[0][1], axes[1][1]),
            axes[0][2] * grid.pitch[0],
            axes[1][2] * grid.pitch[1],
            (axes[0][3], axes[1][3]),
            even,
        )

    def kernels(self, away: Array, band: Band, kind: np.dtype) -> ComplexArray:
        """(n, nz, y, x): transforms of exp(i k r), for planes at ``away``."""
        import ducc0

        from . import _phasor_kernels

        shape = (len(band.numbers), len(away), len(self.up), len(self.across))
        values = np.empty(shape, dtype=kind)
        _phasor_kernels.fill_kernels(
            self.across,
            self.up,
            away,
            2 if self.legs.twice else 1,
            self.legs.falls,
            band.wavenumbers[0],
            band.step,
            values,
        )
        if self.even:
            # an even kernel's transform is a cosine transform of its quarter
            real = values.view(values.real.dtype).reshape(*shape, 2)
            ducc0.fft.dct(real, 1, axes=(2, 3), out=real, nthreads=THREADS)
        else:
            ducc0.fft.c2c(values, axes=(2, 3), out=values, nthreads=THREADS)
        return values

    def wall(self, spectra: ComplexArray) -> ComplexArray:
        """(n, Y, X): transforms of the wall's spectra (n, y, x), padded."""
        import ducc0

        padded = np.zeros((len(spectra), *self.shape), dtype=spectra.dtype)
        rows = (np.arange(spectra.shape[1]) + self.starts[0]) % self.shape[0]
        columns = (np.arange(spectra.shape[2]) + self.starts[1]) % self.shape[1]
        padded[:, rows[:, None], columns] = spectra
        return np.asarray(ducc0.fft.c2c(padded, axes=(1, 2), nthreads=THREADS))

    def planes(self, products: ComplexArray) -> ComplexArray:
        """(..., ny, nx) of the transforms' inverse."""
        import ducc0

        up, across = products.ndim - 2, products.ndim - 1
        options = {"forward": False, "inorm": 2, "nthreads": THREADS}
        ducc0.fft.c2c(products, axes=(up,), out=products, **options)
        kept = products[..., : len(self.volume.y), :]
        return np.asarray(ducc0.fft.c2c(kept, axes=(across,), **options))[..., : len(self.volume.x)]

    def added(self, wall: ComplexArray, response: ComplexArray) -> ComplexArray:
        """(nz, ny, nx): all waves together, by one inverse transform a plane."""
        from . import _phasor_kernels as kernels

        products = np.empty((response.shape[1], *self.shape), dtype=response.dtype)
        kernels.add_folded(wall, response, *self.folds, products)
        return self.planes(products)

    def add(
        self,
        wall: ComplexArray,
        response: ComplexArray,
        band: Band,
        far: Array,
        part: slice,
        times: Array,
        fields: ComplexArray,
    ) -> None:
        """Add to ``fields`` (t, nz, ny, nx) wave by wave, each with its leg from a far point."""
        from . import _phasor_kernels as kernels

        volume, waves = self.volume, band.wavenumbers
        products = np.empty((*response.shape[:2], *self.shape), dtype=response.dtype)
        kernels.multiply_folded(wall, response, *self.folds, products)
        kernels.add_waves(
            self.planes(products),
            volume.x,
            volume.y,
            volume.z[part],
            far,
            self.legs.falls,
            waves[0],
            band.step,
            np.exp(1j * np.outer(times, waves)),
            fields[:, part],
        )


@dataclass(frozen=True)
class _AxisPlan:
    """One axis of a convolution: n wall points, m voxels, the first ``shift`` steps further."""

    n: int
    m: int
    shift: float
    even: bool

    def mirrored(self) -> tuple[int, int, Array, NDArray[np.int64]]:
        """Size, where the wall starts, the kernel's half in steps, and how it unfolds."""
        size, shift = self.size(), round(self.shift)
        index = np.arange(size)
        return size, -shift, np.arange(size // 2 + 1.0), np.minimum(index, size - index)

    def size(self) -> int:
        """Even, fast, and free of wrapping for an even kernel."""
        import ducc0

        shift = round(self.shift)
        reach = max(abs(shift - self.n + 1), abs(shift + self.m - 1))
        most = max(reach, (self.n + 1) // 2, (self.m + 1) // 2)
        return 2 * int(ducc0.fft.good_size(most))

    def whole(self) -> tuple[int, int, Array, NDArray[np.int64]]:
        """The same where the kernel has no mirror: all of it, in order of the transform."""
        import ducc0

        size = int(ducc0.fft.good_size(self.n + self.m - 1))
        index = np.arange(size)
        steps = np.where(index < self.m, index, index - size) + self.shift
        return size, 0, steps, index


def _axis_plan(n: int, m: int, shift: float) -> _AxisPlan:
    import ducc0

    plan = _AxisPlan(n, m, shift, True)
    near = abs(shift) < 1e6 and abs(shift - round(shift)) < 1e-9
    short = near and plan.size() <= 1.25 * ducc0.fft.good_size(n + m - 1) + 2
    return _AxisPlan(n, m, shift, bool(short))


def _falls(points: Array, axis: int) -> bool:
    line = points[:, 0, 1] if axis == 0 else points[0, :, 0]
    return bool(line[-1] < line[0])


def _pitch(line: Array, count: int) -> float:
    return float(line[-1] - line[0]) / (count - 1) if count > 1 else 0.0
