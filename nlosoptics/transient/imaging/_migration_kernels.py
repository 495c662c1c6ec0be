"""Compiled loops of f-k migration (Stolt's change of variable) and of backprojection."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...kernels.parallel import threaded


@threaded()
def stolt(spectrum, lateral_sq, scales, gridding, n_waves, out):
    """Fill ``out`` (b, kx, n) with the spectrum over depth, kz = j/period in element j mod n.

    ``spectrum`` (b, kx, n_f + 2 taps) is the oversampled spectrum over half the path, with
    frequency m/(grid_size bin_width) at index m + taps. ``lateral_sq`` (b, kx) is kx^2 + ky^2,
    1/m^2. The value at kz is the spectrum at f = sqrt(kx^2 + ky^2 + kz^2) times df/dkz = kz/f, and
    0 beyond the Nyquist frequency of the bins. ``table`` holds the gridding kernel from -taps/2 to
    taps/2. ``scales`` is (period, bin_width, grid_size, centre, first_depth) and ``gridding``
    (table, taps, per_tap).
    """
    period, bin_width, grid_size, centre, first_depth = scales
    table, taps, per_tap = gridding
    n = out.shape[2]
    half = 0.5 * taps
    limit = 0.5 / bin_width
    for row in prange(out.shape[0] * out.shape[1]):
        b = row // out.shape[1]
        c = row % out.shape[1]
        k_sq = lateral_sq[b, c]
        for j in range(n):
            out[b, c, j] = 0.0
        for j in range(1, n_waves):
            kz = j / period
            f = math.sqrt(k_sq + kz * kz)
            if f > limit:
                break
            u = f * bin_width * grid_size
            first = int(math.ceil(u - half))
            real = imaginary = 0.0
            for t in range(taps):
                place = (first + t - u + half) * per_tap
                cell = int(place)
                part = place - cell
                w = table[cell] + part * (table[cell + 1] - table[cell])
                value = spectrum[b, c, first + t + taps]
                real += w * value.real
                imaginary += w * value.imag
            angle = 2.0 * math.pi * (kz * first_depth - f * centre)
            co, si = math.cos(angle) * kz / f, math.sin(angle) * kz / f
            out[b, c, j % n] += complex(co * real - si * imaginary, co * imaginary + si * real)


@threaded()
def backproject(series, pairs, axes, window, power, out, seen):
    """Fill ``out`` (ny, nx, nz) with the sum over pairs of the intensity at the path over a voxel.

    ``series`` (n_paths, n_bins + 2) is the intensity of pair p over time, with an empty bin before
    and after. ``pairs`` is (lasers, sensors, laser_of, sensor_of, legs), ``axes`` the voxels'
    (x, y, z), and ``window`` (start, width) of the bins. The path goes from ``lasers[laser_of[p]]``
    over the voxel to ``sensors[sensor_of[p]]``; recorded times are longer by ``legs[p]``. Values
    are interpolated linearly between bin centres and weighted by (r1 r2)^power with power -2, 0, 1
    or 2. ``seen`` (ny, nx, nz) tells whether any path of a voxel lies within the bins.
    """
    lasers, sensors, laser_of, sensor_of, legs = pairs
    x, y, z = axes
    start, width = window
    last = series.shape[1] - 1.0
    nz = z.shape[0]
    per_bin = 1.0 / width
    for column in prange(y.shape[0] * x.shape[0]):
        iy = column // x.shape[0]
        ix = column % x.shape[0]
        total = np.zeros(nz)
        lengths = np.empty(nz)
        weights = np.ones(nz)
        inside = np.zeros(nz, dtype=np.bool_)
        for p in range(series.shape[0]):
            a, b = laser_of[p], sensor_of[p]
            dx, dy = x[ix] - lasers[a, 0], y[iy] - lasers[a, 1]
            ex, ey = x[ix] - sensors[b, 0], y[iy] - sensors[b, 1]
            d_sq, e_sq = dx * dx + dy * dy, ex * ex + ey * ey
            laser_z, sensor_z = lasers[a, 2], sensors[b, 2]
            if d_sq == e_sq and laser_z == sensor_z:
                for k in range(nz):
                    r = math.sqrt(d_sq + (z[k] - laser_z) ** 2)
                    lengths[k] = r + r
                    weights[k] = r * r
            else:
                for k in range(nz):
                    r1 = math.sqrt(d_sq + (z[k] - laser_z) ** 2)
                    r2 = math.sqrt(e_sq + (z[k] - sensor_z) ** 2)
                    lengths[k] = r1 + r2
                    weights[k] = r1 * r2
            if power == -2:
                for k in range(nz):
                    weights[k] = 1.0 / (weights[k] * weights[k])
            elif power == 2:
                for k in range(nz):
                    weights[k] *= weights[k]
            elif power == 0:
                for k in range(nz):
                    weights[k] = 1.0
            shift = legs[p] - start
            for k in range(nz):
                place = (lengths[k] + shift) * per_bin + 0.5
                inside[k] |= (place >= 0.5) & (place <= last - 0.5)
                place = min(max(place, 0.0), last)
                cell = min(int(place), series.shape[1] - 2)
                part = place - cell
                light = series[p, cell] + part * (series[p, cell + 1] - series[p, cell])
                total[k] += light * weights[k]
        for k in range(nz):
            out[iy, ix, k] = total[k]
            seen[iy, ix, k] = inside[k]
