"""Point spreads by HCIPy: images as .npy files, seconds as JSON on stdout.

Started by psf_peers.py in the peers' interpreter. Its best here: a supersampled aperture, modes
kept, and each of its transforms to a chosen pitch, the matrix transform with its matrices kept and
the zoomed one. Its naive transform takes nodes anywhere, so Gauss-Legendre radii with equal angles
bring it to rounding, in the seconds of a direct sum; its matrix is not kept, as HCIPy advises.
Lengths in pupil diameters and lambda N.
"""

from __future__ import annotations

import hcipy
import numpy as np
from psf_common import FINE, answer, grids, transmission


def image_grid(case):
    """Samples of the image, as wave numbers of pupil diameters."""
    size, pitch = case["size"], 2 * np.pi * case["pitch"]
    return hcipy.CartesianGrid(
        hcipy.RegularCoords([pitch, pitch], [size, size], [-(size // 2) * pitch] * 2)
    )


def images(case, orders, grid, aperture, transform):
    """Function from coefficients to intensity."""
    modes = [hcipy.zernike(n, m, 1, grid, radial_cutoff=False) for n, m in orders]
    basis, waves = hcipy.ModeBasis(modes) if orders else None, np.array(case["waves"])

    def image():
        pupil = aperture.astype(np.complex128)
        if orders:
            pupil = aperture * np.exp(2j * np.pi * basis.linear_combination(waves))
        field = transform.forward(pupil)
        return np.asarray(field.real**2 + field.imag**2).reshape(case["size"], -1)

    return image


def transformed(kind):
    def build(case, orders, n):
        grid = hcipy.make_pupil_grid(n, 1)
        if case["pupil"]:
            axes = (2 * axis for axis in grid.separated_coords)
            aperture = hcipy.Field(transmission(case["pupil"], *axes).ravel(), grid)
        else:
            aperture = hcipy.evaluate_supersampled(
                hcipy.make_circular_aperture(1), grid, max(4, min(16, FINE // n))
            )
        return images(case, orders, grid, aperture, kind(grid, image_grid(case)))

    return build


def naive(case, orders, n):
    x, weights = np.polynomial.legendre.leggauss(n // 4)
    r, angle = np.sqrt((1 + x) / 2) / 2, 2 * np.pi * np.arange(n) / n
    nodes = [(r[:, None] * turn).ravel() for turn in (np.cos(angle), np.sin(angle))]
    areas = np.repeat(weights, n) * np.pi / (8 * n)
    grid = hcipy.CartesianGrid(hcipy.UnstructuredCoords(nodes), areas)
    transform = hcipy.NaiveFourierTransform(grid, image_grid(case))
    return images(case, orders, grid, grid.ones(), transform)


def few(case, samples):
    """Angles of the naive transform, in windows that a direct sum can fill."""
    return [128] if case["size"] <= 256 and not case["pupil"] else []


if __name__ == "__main__":
    answer(
        "HCIPy",
        {
            "matrix": (transformed(hcipy.MatrixFourierTransform), grids),
            "zoomed": (transformed(hcipy.ZoomFastFourierTransform), grids),
            "naive, polar nodes": (naive, few),
        },
    )
