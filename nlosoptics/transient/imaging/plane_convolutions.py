"""Propagation of fields from an even grid of wall points to planes, by FFT convolution.

If the planes have the pitch of the wall grid, or one pitch is a whole multiple of the other, the
sum of `rayleigh_sommerfeld` over near points is a convolution with ``exp(i k r)``. Zero padding
prevents wrap-around. If voxels and wall points coincide in x and y, the kernel is even and a cosine
transform of one quadrant suffices.

The sum over waves is done first, for the samples of the pulse over time that a plane needs: their
number is that of its range of paths, whereas that of the waves is that of all paths of the volume.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted, fits_memory
from ...errors import SamplingError
from .gridding import Gridding
from .rayleigh_sommerfeld import Advance, Legs
from .virtual_pulse import Band, blocks
from .volume import Volume

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

#: Bytes of kernels that one thread holds at a time.
PLANES = 2**25
#: Frequencies that are multiplied at a time, from the cache of a core.
BLOCK = 128
#: Largest bytes of kernels of all planes that are kept for the next capture.
KEPT = 2**28
#: Bytes of kernels, times lasers, below which threads cost more time than they save.
FEW = 2**21
#: Largest deviation of points from an even grid, as a fraction of the wavelength.
UNEVEN = 1e-4


@dataclass(frozen=True, eq=False)
class Lattice:
    """Common fine grid of the wall points and of the planes of a volume."""

    shape: tuple[int, int]  # (int, int): Number of wall points along y and x
    # Axes of the wall grid (0 for y, 1 for x) along which coordinates decrease
    flips: tuple[int, ...]
    depth: float  # z of the wall points, m
    axes: tuple[Axis, Axis]  # (Axis, Axis): Relation of wall points and voxels along y and x

    def walls(self, spectra: ComplexArray) -> ComplexArray:
        """Reshape spectra (n, m, points) to (n, m, ny, nx), with y and x increasing."""
        walls = spectra.reshape(*spectra.shape[:2], *self.shape)
        return np.flip(walls, tuple(axis + 2 for axis in self.flips))

    @property
    def size(self) -> int:
        """Number of elements in the transform of one plane."""
        return self.axes[0].size(False) * self.axes[1].size(False)


@dataclass(frozen=True)
class Axis:
    """One axis of a convolution, on a fine grid with steps of ``pitch`` (m).

    The axis has ``n`` wall points, ``wall_step`` steps apart, and ``m`` voxels, ``voxel_step``
    steps apart. The first voxel lies ``shift`` steps after the first wall point.
    """

    pitch: float
    n: int
    m: int
    wall_step: int
    voxel_step: int
    shift: float

    @property
    def spans(self) -> tuple[int, int]:
        """Number of fine grid points that wall and voxels span, ends included."""
        return (self.n - 1) * self.wall_step + 1, (self.m - 1) * self.voxel_step + 1

    @property
    def can_mirror(self) -> bool:
        """Whether the kernel is even and its mirrored transform not much longer than a full one."""
        if abs(self.shift - round(self.shift)) > 1e-9:
            return False
        return self.size(True) <= 1.25 * self.size(False) + 2

    def size(self, mirrored: bool) -> int:
        """Return a fast transform length without wrap-around, a multiple of ``voxel_step``."""
        import ducc0

        (wall, voxels), unit = self.spans, self.voxel_step
        if not mirrored:
            return unit * int(ducc0.fft.good_size(-(-(wall + voxels - 1) // unit)))
        shift = round(self.shift)
        reach = max(abs(shift - wall + 1), abs(shift + voxels - 1), (max(wall, voxels) + 1) // 2)
        return 2 * unit * int(ducc0.fft.good_size(-(-reach // unit)))

    def places(self, mirrored: bool) -> NDArray[np.int64]:
        """Return the indices (n,) of the wall points in the padded transform."""
        start = -round(self.shift) if mirrored else 0
        return np.asarray((start + self.wall_step * np.arange(self.n)) % self.size(mirrored))

    def steps(self, mirrored: bool) -> Array:
        """Return the kernel's coordinates, m: half of them if even, else in transform order."""
        size = self.size(mirrored)
        if mirrored:
            return self.pitch * np.arange(size // 2 + 1.0)
        index = np.arange(size)
        return self.pitch * (np.where(index < self.spans[1], index, index - size) + self.shift)


def lattice(points: Array, volume: Volume, wavelength: float) -> Lattice:
    """Return the common fine grid of wall points and of a volume's planes."""
    if points.ndim != 3:
        raise SamplingError(
            f"wall points of shape {points.shape[:-1]} are no grid (ny, nx); give method='direct'"
        )
    lines = (points[:, 0, 1], points[0, :, 0])
    flips = tuple(axis for axis, line in enumerate(lines) if line[-1] < line[0])
    points = np.flip(points, flips)
    limit = UNEVEN * wavelength
    y = _axis("y", points[:, 0, 1], volume.y, limit)
    x = _axis("x", points[0, :, 0], volume.x, limit)
    even = np.empty_like(points)
    even[..., 0] = points[0, 0, 0] + x.pitch * x.wall_step * np.arange(x.n)
    even[..., 1] = points[0, 0, 1] + y.pitch * y.wall_step * np.arange(y.n)[:, None]
    even[..., 2] = points[0, 0, 2]
    off = float(np.abs(points - even).max())
    if off > limit:
        raise SamplingError(
            f"wall points lie up to {off:.3g} m off an even grid, limit {limit:.3g} m; give "
            "method='direct'"
        )
    return Lattice((y.n, x.n), flips, float(points[0, 0, 2]), (y, x))


def _axis(name: str, wall: Array, voxels: Array, limit: float) -> Axis:
    own, its = (float(a[-1] - a[0]) / max(1, len(a) - 1) for a in (wall, voxels))
    coarse, fine = max(own, its), min(own, its)
    multiple = 1
    if fine > 0.0:
        multiple = round(coarse / fine)
        if abs(coarse - multiple * fine) * max(len(wall), len(voxels)) > limit:
            raise SamplingError(
                f"volume.{name} steps by {its:.6g} m and the wall's points by {own:.6g} m, must be "
                f"equal or whole multiples; change volume.{name} or give method='direct'"
            )
        pitch = own if own <= its else its
    else:
        pitch = coarse or 1.0
    wall_step, voxel_step = (multiple, 1) if own > its else (1, multiple)
    shift = float(voxels[0] - wall[0]) / pitch
    return Axis(pitch, len(wall), len(voxels), wall_step, voxel_step, shift)


def plane_by_plane(
    volume: Volume,
    legs: Legs,
    grid: Lattice,
    band: Band,
    waves: slice,
    spectra: ComplexArray,
    times: Array,
    tol: float,
    advance: Advance,
) -> ComplexArray:
    """Return the field at each voxel by FFT convolution from the wall to each plane.

    Returns (t, nz, ny, nx) complex, in the precision of ``spectra``, which are those of some
    ``waves``. The pulse is interpolated to a tenth of ``tol``.
    """
    kind = spectra.dtype
    fields = np.zeros((len(times), *volume.shape), dtype=kind)
    walls = grid.walls(spectra)
    # the error falls by exp(-pi sqrt(1 - 1/oversampling)) a tap, Barnett et al. 2019, eq. 4.12
    taps = max(4, math.ceil(math.log(3.0 / tol) / (math.pi * math.sqrt(0.2))))
    room = Room(volume, legs, grid, band, waves, times, Gridding(taps, 1.25))
    n_lasers, n_planes = walls.shape[1], len(volume.z)
    size = math.prod((room.distances(volume.z[-1])[1], *room.quadrant)) * kind.itemsize
    keeps = size * n_planes <= KEPT
    kept = _kept(room.key, tuple(volume.z), kind) if keeps else {}
    step = max(1, PLANES // size)
    if size * n_planes * n_lasers > FEW:
        step = min(step, -(-n_planes // 2))
    parts = list(blocks(n_planes, step))
    # one laser's wall is transformed once for all planes; of many, those would take much memory
    alone = [slice(0, n_planes)] if n_lasers == 1 else []
    most = max(last - first for first, last in (room.ends(0, part) for part in alone or parts))
    fits_memory(
        f"the pulse at {counted(most, 'moment')} on {grid.size} padded wall points",
        8.0 * most * grid.size * kind.itemsize,  # copies and two threads
        "use a smaller aperture, nearer times, or method='direct'",
    )
    only = room.wall(walls[:, 0], 0, alone[0]) if alone else None

    def carry(part: slice) -> slice:
        planes = range(part.start, part.stop)
        kernels = {k: kept[k] if k in kept else room.kernel(volume.z[k], kind) for k in planes}
        if keeps:
            kept.update(kernels)
        for j in range(n_lasers):
            wall = only or room.wall(walls[:, j], j, part)
            for k, kernel in kernels.items():
                room.add(kernel, wall, j, k, fields[:, k])
        return part

    for part in _threaded(carry, parts):
        advance(part.stop / n_planes)
    return fields


@lru_cache(maxsize=1)
def _kept(key: Any, depths: tuple[float, ...], kind: Any) -> dict[int, Array]:
    """Return the kernels by number of plane that are kept for the next capture."""
    return {}


def _threaded(carry: Any, parts: list[slice]) -> Iterable[slice]:
    if len(parts) == 1:
        return map(carry, parts)
    from ...raytrace.intersection.meshes import worker_pool

    return worker_pool().map(carry, parts)


@dataclass(frozen=True, eq=False)
class Room:
    """Padded transforms between a wall and planes.

    A plane's field is a sum over wall points at distances r from a voxel, at the moment t that the
    other leg gives it. Both are gridded to multiples of one pitch, so that the wall's pulse is
    needed at multiples of it only: sample j + t of the wall meets sample j of the kernel.
    """

    volume: Volume
    legs: Legs
    grid: Lattice
    band: Band
    waves: slice
    times: Array
    gridding: Gridding

    @cached_property
    def mirrored(self) -> bool:
        """Whether the symmetry of kernels is used."""
        return all(axis.can_mirror for axis in self.grid.axes)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Lengths of the forward transforms, (y, x)."""
        y, x = self.grid.axes
        return y.size(self.mirrored), x.size(self.mirrored)

    @property
    def coarse(self) -> tuple[int, int]:
        """Lengths of the inverse transforms, (y, x), which return samples at voxels only."""
        y, x = self.grid.axes
        return self.shape[0] // y.voxel_step, self.shape[1] // x.voxel_step

    @property
    def carrier(self) -> float:
        """Middle of the wavenumbers, rad/m."""
        return float(self.band.step * 0.5 * (self.band.numbers[0] + self.band.numbers[-1]))

    @property
    def pitch(self) -> float:
        """Spacing of the samples, m of optical path."""
        width = self.band.step * max(1, len(self.band.numbers) - 1)
        return float(2.0 * math.pi / (self.gridding.oversampling * width))

    @property
    def sampling(self) -> tuple[float, float, int, float]:
        """Carrier, pitch, and taps and beta of the gridding, for the kernels."""
        return self.carrier, self.pitch, self.gridding.taps, self.gridding.beta

    @cached_property
    def ways(self) -> int:
        """Number of times that a path covers the distance from the wall to a voxel."""
        return 2 if self.legs.twice else 1

    @property
    def key(self) -> tuple[Any, ...]:
        """Values that kernels depend on, apart from the planes and the precision."""
        return self.grid.axes, self.grid.depth, self.ways, self.sampling

    def far(self, j: int) -> Array:
        """Return laser point j, (1, 3), or (0, 3) if paths have one leg, or equal ones."""
        return np.empty((0, 3)) if self.legs.paired else self.legs.far[j : j + 1]

    @property
    def at_once(self) -> bool:
        """Whether all voxels have the same moment, which needs no interpolation."""
        return len(self.times) == 1 and not len(self.far(0))

    def _samples(self, low: float, high: float) -> tuple[int, int]:
        """Return the first sample, and their number, from which a range is interpolated."""
        half = 0.5 * self.gridding.taps
        first = math.ceil(low / self.pitch - half - 1e-9)
        return first, math.ceil(high / self.pitch - half + 1e-9) + self.gridding.taps - first

    def distances(self, z: float) -> tuple[int, int]:
        """Return the samples of the distances between the wall and a plane, see `_samples`."""
        away = z - self.grid.depth
        return self._samples(self.ways * away, self.ways * math.hypot(away, *self.reach))

    def moments(self, j: int, z: float) -> tuple[int, int]:
        """Return the samples of the moments of a plane's voxels, see `_samples`."""
        if self.at_once:
            return 0, 1
        low = high = 0.0
        for x, y, depth in self.far(j):
            sides = (np.abs(self.volume.x - x), np.abs(self.volume.y - y))
            low = math.hypot(z - depth, *(side.min() for side in sides))
            high = math.hypot(z - depth, *(side.max() for side in sides))
        return self._samples(low + float(self.times.min()), high + float(self.times.max()))

    def ends(self, j: int, part: slice) -> tuple[int, int]:
        """Return the first sample on the wall that planes need of laser j, and the end of all."""
        ends = []
        for z in self.volume.z[part]:
            r, t = self.distances(z), self.moments(j, z)
            ends.append((r[0] + t[0], r[0] + t[0] + r[1] + t[1] - 1))
        # one more than is needed, since `correlate` takes samples in pairs
        return min(a for a, _ in ends), max(b for _, b in ends) + 1

    @cached_property
    def steps(self) -> tuple[Array, Array]:
        """Coordinates of kernels, (y, x), m."""
        y, x = (axis.steps(self.mirrored) for axis in self.grid.axes)
        return y, x

    @cached_property
    def reach(self) -> list[float]:
        """Largest distances along y and x between voxels and wall points, padding included, m."""
        return [float(np.abs(step).max()) for step in self.steps]

    @cached_property
    def quadrant(self) -> tuple[int, int]:
        """Numbers of frequencies of a kernel, (y, x)."""
        return len(self.steps[0]), len(self.steps[1])

    def corners(self) -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
        """Return the parts of a transform, and the parts of a kernel that they share."""
        ways = []
        for count, size in zip(self.quadrant, self.shape, strict=True):
            own = slice(0, count)
            ways.append([(own, own), (slice(count, size), slice(count - 2, 0, -1))])
        y, x = ways if self.mirrored else (way[:1] for way in ways)
        return [((i, j), (m, n)) for i, m in y for j, n in x]

    def kernel(self, z: float, kind: np.dtype) -> Array:
        """Return the transformed kernel of a plane, see `_phasor_kernels.correlate`."""
        import ducc0

        from . import _phasor_kernels

        up, across = self.steps
        first, count = self.distances(z)
        values = np.empty((count + count % 2, 2, *self.quadrant), np.empty(0, kind).real.dtype)
        away = z - self.grid.depth
        _phasor_kernels.fill_kernels(across, up, away, self.ways, self.sampling, first, values)
        if self.mirrored:
            # the transform of an even kernel is the cosine transform of one quadrant
            ducc0.fft.dct(values, 1, axes=(2, 3), out=values)
        else:
            whole = ducc0.fft.c2c(values[:, 0] + 1j * values[:, 1], axes=(1, 2))
            values = np.stack([whole.real, whole.imag], axis=1)
        return np.ascontiguousarray(np.moveaxis(_blocks(values), 2, 0))

    def wall(self, spectra: ComplexArray, j: int, part: slice) -> tuple[Array, int]:
        """Return padded transforms of the pulse on the wall, and the first sample.

        ``spectra`` (n, y, x) are those of laser j. The transforms, see `_phasor_kernels.correlate`,
        are divided by the steps per voxel, because inverse transforms are shorter, see `coarse`.
        """
        import ducc0

        first, last = self.ends(j, part)
        waves, pitch = self.band.wavenumbers[self.waves], self.pitch
        slow = waves - self.carrier
        share = self.gridding.correction(slow * pitch / (2.0 * math.pi))
        # distances are gridded, and moments if there are several
        turns = share * np.exp(1j * waves * self.times[0]) if self.at_once else share**2
        steps = self.shape[0] * self.shape[1] // (self.coarse[0] * self.coarse[1])
        sums = np.exp(1j * np.outer(pitch * np.arange(first, last), slow)) * (turns / steps)
        samples = sums.astype(spectra.dtype) @ spectra.reshape(len(spectra), -1)
        padded = np.zeros((last - first, *self.shape), dtype=spectra.dtype)
        rows, columns = (axis.places(self.mirrored) for axis in self.grid.axes)
        padded[:, rows[:, None], columns] = samples.reshape(-1, *spectra.shape[1:])
        ducc0.fft.c2c(padded, axes=(1, 2), out=padded)
        corners = self.corners()
        parts = np.zeros((len(corners), len(padded), 2, *self.quadrant), padded.real.dtype)
        for own, (whole, shared) in zip(parts, corners, strict=True):
            own[:, 0, *shared], own[:, 1, *shared] = (
                padded.real[:, *whole],
                padded.imag[:, *whole],
            )
        return np.ascontiguousarray(np.moveaxis(_blocks(parts), 3, 0)), first

    def planes(self, products: ComplexArray) -> ComplexArray:
        """Return the voxels (..., ny, nx) of the inverse transform.

        Rows outside the volume are dropped before the transform along x, to save time.
        """
        import ducc0

        up, across = products.ndim - 2, products.ndim - 1
        rows, columns = self.grid.axes[0].m, self.grid.axes[1].m
        ducc0.fft.c2c(products, axes=(up,), forward=False, inorm=2, out=products)
        kept = ducc0.fft.c2c(products[..., :rows, :], axes=(across,), forward=False, inorm=2)
        return np.asarray(kept[..., :columns])

    def add(
        self, kernel: Array, wall: tuple[Array, int], j: int, k: int, fields: ComplexArray
    ) -> None:
        """Add the light of laser j to the fields (t, ny, nx) of plane k."""
        from . import _phasor_kernels

        volume, z = self.volume, self.volume.z[k]
        first, count = self.moments(j, z)
        start = self.distances(z)[0] + first - wall[1]
        sums = np.empty((count, wall[0].shape[1], len(kernel), BLOCK), dtype=fields.dtype)
        _phasor_kernels.correlate(kernel, wall[0], start, sums)
        y, x = self.quadrant
        sums = sums.reshape(*sums.shape[:2], -1)[..., : y * x].reshape(*sums.shape[:2], y, x)
        products = np.empty((count, *self.shape), dtype=fields.dtype)
        for c, (whole, shared) in enumerate(self.corners()):
            products[:, *whole] = sums[:, c, *shared]
        rows, columns = self.coarse
        if products.shape[1:] != (rows, columns):
            # summing b periods of a transform gives b times the transform of every b-th sample, so
            # that the inverse transform returns only the samples at voxels
            folded = products.reshape(count, -1, rows, self.shape[1]).sum(axis=1)
            products = folded.reshape(count, rows, -1, columns).sum(axis=2)
        samples = self.planes(products)
        if self.at_once:
            fields[0] += samples[0]
            return
        place = (volume.x, volume.y, z, self.far(j))
        _phasor_kernels.add_moments(samples, place, self.times, self.sampling, first, fields)


def _blocks(values: Array) -> Array:
    """Return (..., y, x) as (..., blocks, BLOCK), filled up with zeros."""
    flat = values.reshape(*values.shape[:-2], -1)
    more = -flat.shape[-1] % BLOCK
    flat = np.pad(flat, [(0, 0)] * (flat.ndim - 1) + [(0, more)])
    return flat.reshape(*flat.shape[:-1], -1, BLOCK)
