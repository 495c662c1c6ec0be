"""Propagated fields by every method, what each is predicted to err, and refusals, on record."""

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.psf.propagation.propagate import METHODS

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
