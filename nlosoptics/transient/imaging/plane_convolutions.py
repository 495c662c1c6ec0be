"""Propagation of fields from an even grid of wall points to planes, by FFT convolution.

If the planes have the pitch of the wall grid, or one pitch is a whole multiple of the other, the
sum of `rayleigh_sommerfeld` over near points is a convolution with ``exp(i k r)``. Zero padding
prevents wrap-around, so that the result equals the direct sum up to rounding. If voxels and wall
points coincide in x and y, the kernel is even and a cosine transform of one quadrant suffices.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ...errors import SamplingError
from .rayleigh_sommerfeld import Advance, Legs
from .virtual_pulse import Band, blocks
from .volume import Volume

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

#: Bytes of transformed planes that one thread holds at a time, about the cache of a core.
PLANES = 2**21
#: Number of elements to transform below which threads cost more time than they save.
FEW = 2**18
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
    spectra: ComplexArray,
    times: Array,
    advance: Advance,
) -> ComplexArray:
    """Return the field at each voxel by FFT convolution from the wall to each plane.

    Returns (t, nz, ny, nx) complex, in the precision of ``spectra``.
    """
    kind = spectra.dtype
    fields = np.zeros((len(times), *volume.shape), dtype=kind)
    walls = grid.walls(spectra)
    mirrored = all(axis.can_mirror for axis in grid.axes)
    room = Room(volume, legs, grid, band, mirrored)
    # with one set of spectra, transform the wall once for all planes; for many lasers the
    # transforms would take too much memory
    only = room.wall(walls[:, 0]) if walls.shape[1] == 1 else None
    if only is not None and legs.twice and len(times) == 1 and room.can_keep(kind):
        turns = np.exp(1j * band.wavenumbers * times[0]).astype(kind)
        fields[0] = room.all_planes(only * turns[:, None, None])
        advance(1.0)
        return fields
    n_planes = max(1, int(PLANES // (len(band.numbers) * room.size * kind.itemsize)))
    work = len(band.numbers) * room.size * len(volume.z) * walls.shape[1]
    if work > FEW:
        n_planes = min(n_planes, -(-len(volume.z) // 2))
    parts = list(blocks(len(volume.z), n_planes))

    def carry(part: slice) -> slice:
        response = room.kernels(volume.z[part] - grid.depth, kind)
        for j in range(walls.shape[1]):
            wall = room.wall(walls[:, j]) if only is None else only
            if legs.twice and len(times) == 1:
                turns = np.exp(1j * band.wavenumbers * times[0]).astype(kind)
                fields[0, part] = room.together(wall * turns[:, None, None], response)
            else:
                far = np.empty((0, 3)) if legs.paired else legs.far[j : j + 1]
                room.add(wall, response, far, part, times, fields)
        return part

    for part in _threaded(carry, parts):
        advance(part.stop / len(volume.z))
    return fields


def _threaded(carry: Any, parts: list[slice]) -> Iterable[slice]:
    if len(parts) == 1:
        return map(carry, parts)
    from ...raytrace.intersection.meshes import worker_pool

    return worker_pool().map(carry, parts)


@dataclass(frozen=True, eq=False)
class Room:
    """Padded transforms between a wall and planes; ``mirrored`` uses the symmetry of kernels."""

    volume: Volume
    legs: Legs
    grid: Lattice
    band: Band
    mirrored: bool

    @property
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
    def size(self) -> int:
        """Number of elements in one plane's kernel or inverse transform, whichever is larger."""
        y, x = self.grid.axes
        kernel = len(y.steps(self.mirrored)) * len(x.steps(self.mirrored))
        return max(kernel, self.coarse[0] * self.coarse[1])

    def kernels(self, away: Array, kind: np.dtype) -> ComplexArray:
        """Return transforms of exp(i k r), (n, nz, y, x), for planes at distances ``away``, m."""
        waves = self.band.wavenumbers[0], self.band.step, len(self.band.numbers)
        ways = 2 if self.legs.twice else 1
        return _kernels(self.grid.axes, self.mirrored, away, ways, waves, kind)

    def can_keep(self, kind: np.dtype) -> bool:
        """Whether kernels of all planes fill at most 256 MB, and products are not folded."""
        quadrant = math.prod(len(axis.steps(True)) for axis in self.grid.axes)
        size = len(self.band.numbers) * len(self.volume.z) * quadrant * kind.itemsize
        return self.mirrored and self.coarse == self.shape and size <= 2**28

    def all_planes(self, wall: ComplexArray) -> ComplexArray:
        """Return planes (nz, ny, nx) of all waves, by kernels that are kept between captures.

        Each kernel of one quadrant serves the four mirrored frequencies of the wall.
        """
        waves = self.band.wavenumbers[0], self.band.step, len(self.band.numbers)
        away = tuple(self.volume.z - self.grid.depth)
        kernels = _kept_kernels(self.grid.axes, away, waves, wall.dtype)
        y, x = (np.arange(count) for count in kernels.shape[:2])
        corners = [(i[:, None], j) for i in (y, -y) for j in (x, -x)]
        spectra = np.stack([wall[:, i, j] for i, j in corners], axis=-1)
        light = np.matmul(kernels, spectra.transpose(1, 2, 0, 3))
        products = np.empty((len(away), *self.shape), dtype=wall.dtype)
        for k, (i, j) in enumerate(corners):
            products[:, i, j] = light[..., k].transpose(2, 0, 1)
        return self.planes(products)

    def wall(self, spectra: ComplexArray) -> ComplexArray:
        """Return padded transforms (n, Y, X) of the wall's spectra (n, y, x).

        They are divided by the steps per voxel, because the inverse transforms are shorter by that
        factor, see `coarse`.
        """
        import ducc0

        padded = np.zeros((len(spectra), *self.shape), dtype=spectra.dtype)
        rows, columns = (axis.places(self.mirrored) for axis in self.grid.axes)
        steps = self.shape[0] * self.shape[1] // (self.coarse[0] * self.coarse[1])
        padded[:, rows[:, None], columns] = spectra / spectra.dtype.type(steps)
        return np.asarray(ducc0.fft.c2c(padded, axes=(1, 2), out=padded))

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

    def together(self, wall: ComplexArray, response: ComplexArray) -> ComplexArray:
        """Return planes (nz, ny, nx), summing all waves before one inverse transform per plane."""
        from . import _phasor_kernels

        products = np.empty((response.shape[1], *self.coarse), dtype=response.dtype)
        _phasor_kernels.sum_waves(wall, response, products)
        return self.planes(products)

    def add(
        self,
        wall: ComplexArray,
        response: ComplexArray,
        far: Array,
        part: slice,
        times: Array,
        fields: ComplexArray,
    ) -> None:
        """Add each wave, with the phase of its leg from ``far``, to ``fields`` (t, nz, ny, nx)."""
        from . import _phasor_kernels

        volume, waves = self.volume, self.band.wavenumbers
        products = np.empty((*response.shape[:2], *self.coarse), dtype=response.dtype)
        _phasor_kernels.multiply_waves(wall, response, products)
        _phasor_kernels.add_waves(
            self.planes(products),
            volume.x,
            volume.y,
            volume.z[part],
            far,
            waves[0],
            self.band.step,
            np.exp(1j * np.outer(times, waves)),
            fields[:, part],
        )


def _kernels(
    axes: tuple[Axis, Axis],
    mirrored: bool,
    away: Array,
    ways: int,
    waves: tuple[float, float, int],
    kind: np.dtype,
) -> ComplexArray:
    """Return `Room.kernels`, for ``waves`` by first wavenumber, step and number."""
    import ducc0

    from . import _phasor_kernels

    up, across = (axis.steps(mirrored) for axis in axes)
    shape = (waves[2], len(away), len(up), len(across))
    values = np.empty(shape, dtype=kind)
    _phasor_kernels.fill_kernels(across, up, away, ways, waves[0], waves[1], values)
    if mirrored:
        # the transform of an even kernel is the cosine transform of one quadrant
        real = values.view(values.real.dtype).reshape(*shape, 2)
        ducc0.fft.dct(real, 1, axes=(2, 3), out=real)
    else:
        ducc0.fft.c2c(values, axes=(2, 3), out=values)
    return values


@lru_cache(maxsize=1)
def _kept_kernels(
    axes: tuple[Axis, Axis], away: tuple[float, ...], waves: tuple[float, float, int], kind: Any
) -> ComplexArray:
    """Return kernels of confocal planes, (y, x, nz, n), of one quadrant."""
    quadrant = tuple(len(axis.steps(True)) for axis in axes)
    shape = (*quadrant, len(away), waves[2])
    fits_memory("kernels of all planes", math.prod(shape) * kind.itemsize, "ask for fewer voxels")
    kernels = np.empty(shape, dtype=kind)
    for k, z in enumerate(away):
        plane = _kernels(axes, True, np.array([z]), 2, waves, kind)[:, 0]
        kernels[:, :, k] = plane.transpose(1, 2, 0)
    return kernels
