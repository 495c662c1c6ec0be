"""Windows, pixels and error bounds of random waves, on record."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.transform import costs
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window import antialiased_disc, error_bounds, grids, pixels, rim_tails, window

from ...records import attempt

KINDS = ("polar", "cells", "grid", "scattered", "map")


@pytest.mark.parametrize("index", [0, 1, 3, 6])
@pytest.mark.parametrize("kind", KINDS)
def test_windows_and_costs(kind, index, draw, on_record):
    case = draw(23, index, 0.4, kind)
    residual, pitch = split(case.front), case.options["pitch"]
    seen = window.Window.centred(pitch, (40, 33))
    grid, distances = attempt(grids.pupil_grid, residual), np.array([0.0, 3.0, 50.0])
    on_record(
        {
            "shapes": [
                attempt(window.default_shape, residual, pitch),
                [attempt(psf.window_shape, case.front, pitch=pitch, tol=t) for t in (1e-2, 1e-4)],
                attempt(window.window_side, residual, pitch, 1e-3),
                [window.holds_rays(residual, pitch, (n, n + 1)) for n in (1, 9, 70)],
            ],
            "peak": [window.peak_pixel(residual, n * pitch) for n in (0.1, 1.0, 30.0)],
            "reach": window.ray_reach(residual),
            "check": attempt(window.check_rays, residual, pitch, (3, 4), "give more"),
            "costs": [
                costs.airy(seen),
                costs.sum_over_nodes(1e3, seen),
                attempt(costs.polar_sum, residual, seen),
                costs.soft_grid(residual, seen, 1e-5, 200),
                costs.map_fft(residual, seen, 512),
                costs.map_chirp(residual, seen),
                costs.map_sums(64, seen),
                kind == "scattered" and costs.scattered_sum(residual, seen),
                costs.rays(residual, seen),
                costs.scattered(10.0, 200.0, 3e3, 4e4),
            ],
            "grid": grid,
            "soft": [
                attempt(error_bounds.soft_rim_error, residual, n * pitch, distances, 1e-3)
                for n in (0.3, 1.0, 20.0)
            ],
            "edges": not isinstance(grid, Exception)
            and [
                attempt(error_bounds.edge_errors, residual, grid, seen.x, seen.y, 0.3 * pitch),
                attempt(error_bounds.damping_error, residual, grid, 0.7),
            ],
            "rims": attempt(rim_tails.edge_ratio, case.front),
        }
    )


def test_pixels_and_tails(on_record):
    image = np.random.default_rng(3).random((30, 24))
    found = []
    for pitch, nyquist, count in ((1e-6, 3e-6, 8), (3e-6, 2.2e-6, 5), (2e-5, 2e-6, 4)):
        rule = pixels.pixel_rule(pitch, nyquist, count)
        side = rule.window(pitch, (count, count)).shape[0]
        fine = np.random.default_rng(4).random((side, side))
        found.append([rule, rule.window(pitch, (count, count)), rule.count(side)])
        found.append([rule.mean(fine), rule.mean_down(fine), rule.matrix(side)])
    aperture = psf.Aperture.hexagons(1, 0.6, 0.05, angle=0.1, central=False)
    x = np.linspace(-4.0, 5.0, 12)
    on_record(
        {
            "rules": found,
            "bounds": [
                error_bounds.intensity_error(image, 1e-3, 1e-5, pixel=p, level=q)
                for p, q in ((0.1, 1.0), (1.0, 0.2), (5.0, 1e-3))
            ],
            "spill": error_bounds.intensity_error(
                image, 1e-4 * image, 0.0, spill=1e-6 * image, pixel=0.6, level=0.8
            ),
            "transform": [error_bounds.transform_error(image, 1e-9, pixel=p) for p in (0.2, 3.0)],
            "beats": [error_bounds.beat(p) for p in (0.0, 0.1, 0.5, 1.0, 30.0)],
            "tail": error_bounds.tail(np.array([0.0, 0.3, 1.0, 20.0])),
            "rounded": [error_bounds.rounded_up(v) for v in (1.0, 1.001, 0.0123, 987.0, 5e-9)],
            "rims": [
                rim_tails.tail(aperture, x, 0.3 * x),
                [rim_tails.reach(aperture, 1e-5, 2e-6, share) for share in (1e-2, 1e-4)],
            ],
            "soft disc": [
                antialiased_disc.leak(np.array([0.0, 0.4, 0.5, 1.5])),
                [antialiased_disc.cut(radius, 3) for radius in (5.0, 40.0)],
                antialiased_disc.SoftDisc(6.3)(np.array([0.0, 5.0, 6.0, 6.3, 7.0, 9.0])),
            ],
            "squares": [
                attempt(window.square_shape, *one)
                for one in ((1e-3, 1e-6, 1e-6, 32), (1e-5, 1e-6, 2e-6, 64), (1.0, 1e-6, 1e-6, 32))
            ],
            "middle": [window.middle((10, 13), (4, 5)), window.middle((7, 7), (7, 1))],
            "sizes": [grids.grid_size(4e-3, p) for p in (1e-5, 3.3e-4, 1e-2)],
        }
    )
