"""Fisher information of the wave, against finite differences of images of a point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.limits.modulation import Noise, Picture, _frequencies, _twice
from nlosoptics.limits.wave_bounds import wave_bounds

WAVELENGTH, DISTANCE, RADIUS = 632.8e-9, 0.05, 1e-3
PITCH = WAVELENGTH * DISTANCE / (2 * RADIUS) / 2  # lambda N = 2 pixels
SIZE, ELECTRONS, VARIANCE = 64, 1e5, 9.0


def wave(coefficients: dict[int, float]) -> psf.Wavefront:
    """Wave of Zernike coefficients in waves."""
    return psf.Wavefront.from_zernike(
        {j: c * WAVELENGTH for j, c in coefficients.items()},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=DISTANCE,
    )


def image(coefficients: dict[int, float]) -> np.ndarray:
    """Expected electrons of a point of light."""
    spread = psf.point_spread(
        wave(coefficients), pitch=PITCH, shape=SIZE, tol=1e-8, pixel_integrated=True
    )
    return ELECTRONS * spread.intensity


def point() -> Picture:
    """Spectra of a point: its power is the same at every frequency."""
    frequency = _frequencies((SIZE, SIZE), PITCH)
    return Picture(
        power=np.full(frequency.shape, ELECTRONS**2),
        transfer=np.ones_like(frequency),
        frequency=frequency,
        twice=_twice(SIZE),
        grid=(SIZE, SIZE),
        samples=SIZE**2,
        noise=Noise(photons=0.0, readout=VARIANCE, speckle=0.0),
        grain=1.0,
        fill=1.0,
    )


def brute(base: dict[int, float], modes: tuple[int, ...], frames: tuple[float, ...]) -> list[float]:
    """Bounds from differences of images, tilts and gain of every frame unknown."""
    step, kept = 1e-3, np.zeros((len(modes), len(modes)))
    for extra in frames:
        at = dict(base)
        at[4] = at.get(4, 0.0) + extra
        columns = []
        for j in (*modes, 2, 3):
            up, down = (image({**at, j: at.get(j, 0.0) + s * step}) for s in (1.0, -1.0))
            columns.append(((up - down) / (2 * step)).ravel())
        columns.append(image(at).ravel())
        a = np.stack(columns, axis=1)
        full = a.T @ a / VARIANCE
        n = len(modes)
        kept += full[:n, :n] - full[:n, n:] @ np.linalg.solve(full[n:, n:], full[n:, :n])
    return list(np.sqrt(np.diag(np.linalg.inv(kept))))


@pytest.mark.parametrize("frames", [(0.0,), (0.0, 0.5)])
def test_bounds_are_those_of_differenced_images(frames: tuple[float, ...]) -> None:
    base, modes = {4: 0.15, 6: -0.1, 8: 0.08}, (4, 5, 6, 7, 8, 11)
    found = wave_bounds(point(), wave(base), scale=1.0, pitch=PITCH, modes=modes, defocus=frames)[
        -1
    ]
    # the window of 64 pixels cuts the tail, and the differences err by their step squared: 0.2 %
    assert list(found.values()) == approx(brute(base, modes, frames), rel=0.01)
    assert list(found) == list(modes)


def test_even_terms_of_a_perfect_wave_are_untold_by_one_frame() -> None:
    one, two = wave_bounds(
        point(), wave({}), scale=1.0, pitch=PITCH, modes=(4, 5, 7, 11), defocus=(0.0, 0.5)
    )
    assert [math.isinf(one[j]) for j in (4, 5, 7, 11)] == [True, True, False, True]
    assert all(math.isfinite(value) for value in two.values())
    assert two[7] < one[7]


def test_scale_of_the_object_does_not_count() -> None:
    """Frequencies on the object are those on the detector over the scale."""
    base = {4: 0.2, 7: 0.1}
    near = wave_bounds(point(), wave(base), scale=1.0, pitch=PITCH)[0]
    far = point()
    far = Picture(
        **{
            **{k: getattr(far, k) for k in far.__dataclass_fields__},
            "frequency": far.frequency / 20.0,
        }
    )
    again = wave_bounds(far, wave(base), scale=20.0, pitch=PITCH)[0]
    assert list(again.values()) == approx(list(near.values()), rel=1e-9)
