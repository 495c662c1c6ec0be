"""Point spreads of random waves by every transform, and what is predicted of them, on record."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.transform import (
    airy,
    antialiased_pupil,
    geometric,
    high_aperture,
    huygens,
    models,
    nufft,
    quadrature,
    runners,
    selection,
)
from nlosoptics.psf.transform.point_spread import METHODS
from nlosoptics.psf.transform.runners import Task
from nlosoptics.psf.walls.scene_costs import smooth_cost
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.wave.regime import regime
from nlosoptics.psf.window.pixels import pixel_rule

from ...records import attempt

KINDS = ("polar", "cells", "grid", "scattered", "map")
SEED = 23


def task_of(wave, options):
    residual = split(wave)
    shape, pitch = (options["shape"], options["shape"]), options["pitch"]
    whole = options["pixel_integrated"]
    rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape)) if whole else None
    return Task(residual, options["tol"], pitch, shape, rule)


@pytest.mark.parametrize("index", range(8))
@pytest.mark.parametrize("kind", KINDS)
def test_a_random_wave(kind, index, draw, on_record):
    case = draw(SEED, index, 0.4, kind)
    task = task_of(case.front, case.options)
    where = case.options["pitch"], task.shape, case.options["tol"]
    on_record(
        {
            "spread": attempt(psf.point_spread, case.front, **case.options, model="scalar"),
            "ways": attempt(selection.candidates, task, regime(task.residual, task.pitch)),
            "cost": attempt(smooth_cost, task.residual, *where),
        }
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("model", ["scalar", "high-aperture"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_named_method(kind, model, method, draw, on_record):
    case = draw(SEED, 1, 0.4, kind)
    asked = {"tol": 3e-2, "pitch": case.options["pitch"], "shape": (11, 16), "model": model}
    asked |= {"method": method, "max_seconds": 1.0, "polarisation": 0.3}
    if model == "scalar":
        del asked["polarisation"]
    on_record([attempt(psf.point_spread, case.front, **asked, pixel_integrated=b) for b in (0, 1)])


@pytest.mark.parametrize("index", range(8))
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_ruled_out(kind, index, draw, on_record):
    """No transform reaches so small a tolerance, and each says what it expects to err."""
    case, found = draw(SEED, index, 0.4, kind), []
    for tol in (1e-14, 1e-9):
        task = task_of(case.front, case.options | {"tol": tol})
        found += attempt(selection.candidates, task, regime(task.residual, task.pitch))
    on_record([[one.method, one.ruled_out] for one in found])


@pytest.mark.parametrize("f_number", [0.8, 6.0])
def test_steepness(f_number, on_record):
    """Toward one point each, to all sides."""
    radius = 4e-3
    system = {"wavelength": 6e-7, "pupil_radius": radius, "image_distance": 2 * radius * f_number}
    waves = [psf.Wavefront.from_zernike({2: w, 3: -w}, **system) for w in (0.0, 6e-7)]
    turns = np.arange(9.0)
    points = np.stack([np.cos(turns), np.sin(turns), 0.1 * turns - 0.3], axis=1) * 2e-4
    points[:, 2] += system["image_distance"]
    on_record(
        [huygens.steepness(split(wave), points[i : i + 1]) for wave in waves for i in range(9)]
    )


@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize("kind", KINDS)
def test_figures_on_the_way(kind, index, draw, on_record):
    """Counts of nodes and rays, bounds, and predicted errors and times."""
    case = draw(SEED, index, 0.4, kind)
    task = task_of(case.front, case.options)
    residual, seen, pitch = task.residual, task.samples, task.pitch
    spectral = kind in ("polar", "cells")
    axis = np.linspace(-3.0, 3.0, 4) * residual.airy_unit
    points = np.stack([axis, axis**2 / residual.airy_unit, 0 * axis], axis=1)
    points[:, 2] += case.front.image_distance
    rays = {"polar": geometric.ray_counts, "cells": geometric.patch_rays}
    rays = rays.get(kind, geometric.most_cells)
    on_record(
        {
            "task": [task.pixels, seen, attempt(getattr, task, "level"), task.pixel],
            "rays": [attempt(rays, residual, seen, share) for share in (1.0, 0.5)],
            "density": attempt(geometric.density, residual, seen),
            "least": geometric.least_error(residual, pitch),
            "model": [
                models.predicted_model_error(residual, pitch),
                attempt(models.plane_levels, residual),
                attempt(models.axial_share, residual),
                models.speckle_model_error(residual, "unit-sum"),
                [models.wide_pixel_error(residual, share) for share in (0.0, 0.4)],
                [models.in_normalisation(residual, 0.1, n) for n in ("flux", "ideal-peak")],
            ],
            "wide": [
                high_aperture.largest_sine(residual),
                attempt(high_aperture.node_counts, residual, seen),
                attempt(high_aperture.predicted_seconds, task, "unpolarised"),
            ],
            "sums": spectral
            and [
                quadrature.node_counts(residual, seen),
                quadrature.epsilon(residual, seen, task.tol),
                quadrature.n_bytes(residual, seen),
                runners.polar_size(task) if kind == "polar" else 0,
            ],
            "nodes": [nufft.epsilon(9000, seen, tol) for tol in (1e-3, 1e-11)],
            "room": nufft.n_bytes(9000, seen),
            "airy": airy.error_bound(residual),
            "soft": kind == "polar"
            and [attempt(antialiased_pupil.soft_wave, residual, t) for t in (1e-2, 1e-6)],
            "peak": attempt(antialiased_pupil.predicted_peak, residual) if spectral else 0.0,
            "surface": [
                attempt(huygens.node_counts, residual, points) if spectral else 0,
                attempt(huygens.seconds, residual, points),
                attempt(huygens.surface_field, residual, points),
            ],
        }
    )
