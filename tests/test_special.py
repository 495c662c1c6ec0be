"""Special functions and Fourier transforms against scipy's, which a run does not load."""

import numpy as np
import pytest
import scipy

from nlosoptics import _fourier, _special

ARGUMENTS = np.concatenate(
    [[0.0], np.geomspace(1e-9, 1e-2, 50), np.linspace(0.01, 80.0, 20_001), np.geomspace(80, 1e6)]
)


@pytest.mark.parametrize("order", [0, 1])
def test_bessel_functions_are_scipys(order: int) -> None:
    """On both sides of the change from Taylor's series to Hankel's expansion, to rounding."""
    own = (_special.bessel_j0, _special.bessel_j1)[order](ARGUMENTS)
    theirs = (scipy.special.j0, scipy.special.j1)[order](ARGUMENTS)
    # cosines of arguments up to 25, each of which is rounded to 3.6e-15
    assert np.abs(own - theirs).max() <= 1.5e-15


def test_bessel_j1_is_exact_near_zero() -> None:
    """Half of the argument, so that 2 J1(v)/v is 1 to the last bits."""
    small = np.geomspace(1e-9, 1e-2, 50)
    assert _special.bessel_j1(small) == pytest.approx(scipy.special.j1(small), rel=1e-15)


@pytest.mark.parametrize("a", [0.01, 0.5, 1.0, 7.3, 150.0, 4e4])
def test_upper_gamma_share_is_scipys(a: float) -> None:
    """In its power series, in its continued fraction and in both tails."""
    for x in (0.0, 1e-9, *(a + np.linspace(-6, 30, 73) * np.sqrt(a)).clip(0.0)):
        # the exponent, about x + a log a, is rounded before its exponential is taken
        error = 2e-14 * max(a, x, 1.0)
        expected = scipy.special.gammaincc(a, x)
        assert _special.upper_gamma_share(a, x) == pytest.approx(expected, rel=error, abs=1e-15)


def test_transforms_are_scipys() -> None:
    """Odd and even sides, with and without continuation, in both precisions."""
    image = np.random.default_rng(0).normal(size=(2, 13, 18))
    for precision, error in ((np.float64, 1e-12), (np.float32, 1e-3)):
        own = image.astype(precision)
        spectrum = _fourier.rfft2(own, (16, 20))
        assert spectrum == pytest.approx(scipy.fft.rfft2(image, (16, 20)), abs=error)
        assert _fourier.irfft2(spectrum, 20)[:, :13, :18] == pytest.approx(own, abs=error)
        even = np.abs(spectrum) ** 2
        assert _fourier.irfft2(even, 20) == pytest.approx(scipy.fft.irfft2(even), abs=error)
    cosines = scipy.fft.dctn(image[0], norm="ortho")
    assert _fourier.cosines2(image[0]) == pytest.approx(cosines, abs=1e-13)
    lengths = range(1, 3000)
    fast = [scipy.fft.next_fast_len(n, real=True) for n in lengths]
    assert [_fourier.fast_length(n) for n in lengths] == fast
