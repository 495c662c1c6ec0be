"""Batches of point spreads, on record."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.batch import batch_transform
from nlosoptics.psf.batch.point_spreads import _Batch

from ...records import attempt


@pytest.fixture(autouse=True)
def two_threads(monkeypatch):
    """Stated memory contains a workspace for each thread, of which the machine may have fewer."""
    monkeypatch.setattr(batch_transform, "threads", lambda: 2)


@pytest.mark.parametrize("integrated", [False, True])
@pytest.mark.parametrize("obscuration", [0.0, 0.4])
@pytest.mark.parametrize("waves", [0.1, 2.0])
def test_a_batch(waves, obscuration, integrated, on_record):
    system = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}
    wave = psf.Wavefront.from_zernike({6: 2e-7}, obscuration=obscuration, **system)
    rng = np.random.default_rng(5)
    modes = np.stack([psf.zernike(j, wave.u / 4e-3, wave.v / 4e-3) for j in (4, 5, 7, 11)])
    bend = np.tensordot(rng.normal(size=(3, 4)) * waves * 6e-7 / 4, modes, 1)
    unit = 6e-7 * wave.f_number
    asked = {"pitch": 0.37 * unit, "shape": (22, 17), "pixel_integrated": integrated}
    asked |= {"normalisation": "ideal-peak"}
    on_record([attempt(psf.point_spreads, wave, bend, tol=tol, **asked) for tol in (1e-2, 1e-5)])


@pytest.mark.parametrize("count", [3, 70])
@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("obscuration", [0.0, 0.3])
def test_figures_of_a_batch(obscuration, uneven, count, on_record):
    """Stated errors, slopes, degrees and numbers of nodes, for several tolerances and windows."""
    wave = psf.Wavefront.from_function(
        lambda u, v: 0 * u,
        amplitude=(lambda u, v: 1 - 2e4 * u * u + 60 * v) if uneven else None,
        wavelength=6e-7,
        pupil_radius=4e-3,
        image_distance=-0.06,
        samples=(13, 44),
        obscuration=obscuration,
    )
    rng = np.random.default_rng(7)
    turns = rng.uniform(-2e3, 2e3, (2, count, 1, 1))  # not resolved to the last digit
    bends = 1e-7 * np.cos(turns[0] * wave.u + turns[1] * wave.v + rng.uniform(0, 6, (count, 1, 1)))
    found = []
    for tol in (0.3, 1e-3, 1e-8):
        batch = _Batch(wave, bends, tol)
        plans = [batch.plan(1.1e-6, (9, 14), "flux", whole, further=4 * whole) for whole in (0, 1)]
        found.append(
            [
                [batch.degree, batch.order, batch.rays, batch.reach, batch.core, batch.single],
                [batch.lost, batch.field_errors, batch.resolved],
                [(one.nodes.u, one.nodes.heights, one.nodes.weights) for one in plans],
                [(one.memory(count), one.basis.n_k, len(one.basis.orders)) for one in plans],
                [batch.errors(batch.lost, np.full(count, 0.2), 2e-6, whole) for whole in (0, 1)],
            ]
        )
    found.append(attempt(psf.point_spreads, wave, bends[:3], tol=0.02))
    on_record(found, 1e-5)  # the last was computed in single precision
