"""Stolt's change of variable by a short kernel, and sums over paths."""

from __future__ import annotations

import math

from numba import njit, prange


@njit(cache=True, parallel=True)
def stolt(
    spectrum,
    lateral_sq,
    period,
    bin_width,
    grid_size,
    centre,
    first_depth,
    table,
    taps,
    per_tap,
    n_waves,
    out,
):
    """Fill ``out`` (b, kx, n) with the waves of depth, frequency j/period in slot j mod n.

    ``spectrum`` (b, kx, n_f + 2 taps) holds the gridded frequencies of half the path, m / (grid
    bin_width) at index m + taps; ``lateral_sq`` (b, kx) is kx^2 + ky^2, 1/m^2. Each wave of depth
    kz is the spectrum at f = sqrt(k^2 + kz^2) times df/dkz = kz/f; beyond the bins' Nyquist
    frequency there is none. ``table`` holds the kernel from -taps/2 to taps/2.
    """
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


@njit(cache=True, parallel=True)
def backproject(
    series, lasers, sensors, laser_of, sensor_of, legs, x, y, z, start, width, power, out, hits
):
    """Fill ``out`` (ny, nx, nz) with sums over paths of the light at each path's length.

    ``series`` (n_paths, n_bins) is the light of the path from ``lasers[laser_of[p]]`` over the
    voxel to ``sensors[sensor_of[p]]``, whose times hold ``legs[p]`` more. Light is taken from the
    two bins whose middles are next to the path's length, and nothing from outside of the first and
    last middle; ``hits`` counts the paths that are inside. It is weighted by (r1 r2)^power.
    """
    n_bins = series.shape[1]
    nz = z.shape[0]
    for column in prange(y.shape[0] * x.shape[0]):
        iy = column // x.shape[0]
        ix = column % x.shape[0]
        for k in range(nz):
            out[iy, ix, k] = 0.0
            hits[iy, ix, k] = 0
        for p in range(series.shape[0]):
            a, b = laser_of[p], sensor_of[p]
            dx, dy = x[ix] - lasers[a, 0], y[iy] - lasers[a, 1]
            ex, ey = x[ix] - sensors[b, 0], y[iy] - sensors[b, 1]
            d_sq, e_sq = dx * dx + dy * dy, ex * ex + ey * ey
            for k in range(nz):
                dz, ez = z[k] - lasers[a, 2], z[k] - sensors[b, 2]
                r1, r2 = math.sqrt(d_sq + dz * dz), math.sqrt(e_sq + ez * ez)
                place = (r1 + r2 + legs[p] - start) / width - 0.5
                if place < 0.0 or place > n_bins - 1:
                    continue
                cell = min(int(place), n_bins - 2)
                part = place - cell
                light = series[p, cell] + part * (series[p, cell + 1] - series[p, cell])
                if power == -2:
                    light /= r1 * r1 * r2 * r2
                elif power > 0:
                    light *= (r1 * r2) ** power
                out[iy, ix, k] += light
                hits[iy, ix, k] += 1
