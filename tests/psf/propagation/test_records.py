"""Propagated fields by every method, what each is predicted to err, and refusals, on record."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.propagation.diffraction_sums import Axis, band, impulse_error, is_near, leak
from nlosoptics.psf.propagation.propagate import METHODS, _candidates

from ...records import attempt

WAVELENGTH, PITCH = 500e-9, 10e-6


@pytest.fixture(params=[False, True], ids=["open", "periodic"])
def field(request):
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:40, :48] - 20.3
    samples = np.exp(-(x**2 + 0.6 * y**2) / 60 + 0.02j * x * y) * (
        1 + 0.1 * rng.normal(size=x.shape)
    )
    return psf.ScalarField(
        samples=samples, pitch=PITCH, wavelength=WAVELENGTH, z=0.1, periodic=request.param
    )


@pytest.mark.parametrize("distance", [-3e-3, 0.0, 2e-2, 0.3, 4.0])
@pytest.mark.parametrize("method", ["auto", *METHODS])
def test_a_field(field, method, distance, on_record):
    own = attempt(psf.propagate, field, distance, method=method, tol=2e-2)
    other = attempt(
        psf.propagate, field, distance, method=method, pitch=1.3 * PITCH, shape=(20, 25), tol=0.1
    )
    on_record([own, other, field.power, field.sampling_error])


@pytest.mark.parametrize("pitch", [0.27e-6, 0.39e-6, 0.6e-6])
@pytest.mark.parametrize("distance", [4e-6, 3e-5, 4e-4])
def test_rays_at_large_angles(pitch, distance, on_record):
    """Noise at all angles, whose steepest rays miss the output and are removed."""
    rng = np.random.default_rng(6)
    samples = rng.normal(size=(19, 24)) + 1j * rng.normal(size=(19, 24))
    field = psf.ScalarField(samples=samples, pitch=pitch, wavelength=WAVELENGTH)
    on_record(
        attempt(
            psf.propagate,
            field,
            distance,
            method="angular_spectrum",
            pitch=1.2 * pitch,
            shape=(31, 22),
            tol=1.0,
        )
    )


@pytest.mark.parametrize("pitch", [0.2e-6, 0.33e-6, 0.39e-6, 2e-6])
@pytest.mark.parametrize("paraxial", [False, True])
def test_bands_and_their_tails(pitch, paraxial, on_record):
    """On the lattice of the input or beside it, near and far, evanescent or not."""
    found = []
    for other, (edge, tol) in itertools.product(
        (1.0, 1.7), ((0.0, 1e-3), (3e-12, 1e-3), (2e-8, 1e-3), (2e-8, 1e-6))
    ):
        axis = Axis(-3, 19, pitch, 26, other * pitch)
        for share in (0.0, 0.05, 0.6, 4.0, 300.0, 3e4):
            z = share * axis.reach
            found.append(band(axis, edge, WAVELENGTH, z, paraxial, tol))
            if not paraxial:
                found.append(band(axis, edge, WAVELENGTH, z, paraxial, tol, 0.4 * axis.reach))
                found.append(is_near(axis.reach, WAVELENGTH, z))
    on_record([[axis.reach, axis.same], found])


def test_reach_from_the_first_to_the_last_sample():
    """The farther of both pairs of ends, for inputs at either side of the output."""
    for first, n, count in ((-3, 19, 26), (5, 4, 9), (-30, 8, 9), (0, 1, 1), (-2, 3, 40)):
        axis = Axis(first, n, 0.3, count, 0.5)
        inputs = 0.3 * np.arange(first, first + n)
        outputs = 0.5 * (np.arange(count) - count // 2)
        assert axis.reach == pytest.approx(np.abs(inputs[:, None] - outputs).max(), abs=1e-15)
        assert np.array_equal(axis.indices(), np.arange(first, first + n))
        assert not axis.same
        assert replace(axis, pitch=0.3 * (1 + 5e-13)).same


def test_errors_of_the_fresnel_sum(on_record):
    """Along either axis, from orders that land in the output to those that miss it."""
    rng = np.random.default_rng(4)
    samples = rng.normal(size=(23, 61)) + 1j * rng.normal(size=(23, 61))
    samples *= np.exp(-(((np.arange(61) - 30) / 9) ** 2))
    found = [
        impulse_error(samples, Axis(-7, samples.shape[k], PITCH, 45, 1.4 * PITCH), k, edge, 5e-7, z)
        for k, edge, z in itertools.product((0, 1), (0.0, 2e-7), (2e-4, 3e-3, 8e-3, 0.5))
    ]
    on_record([found, leak(np.array([-1.0, 1e-6, 3e-3]), 4e-10), leak(np.array([2.0]), 0.0)])


@pytest.mark.parametrize("z", [2e-6, 2e-4, 3e-3, 8e-3, 0.04])
@pytest.mark.parametrize("pitch", [0.21e-6, 0.9e-6])
def test_predicted_costs(field, z, pitch, on_record):
    """Costs, errors and memory of each method, cheapest first, for an output of another shape."""
    if field.periodic:
        return
    fine = replace(field, pitch=pitch)
    n = max(fine.shape)
    found = []
    for step, size in ((pitch, (40, 48)), (1.6 * pitch, (31, 57)), (0.4 * pitch, (60, 21))):
        found.append(_candidates(fine, z, step, size, 1e-3))
    own = WAVELENGTH * z / (n * pitch)
    for part in (0.0, 0.8e-9, 1.2e-9):
        found.append(_candidates(fine, z, own * (1 + part), (n, n), 1e-3))
    on_record([[(c.method, c.cost, c.error, c.model, c.bytes) for c in one] for one in found])
