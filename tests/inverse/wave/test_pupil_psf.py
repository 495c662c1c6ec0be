"""Point spreads of a wave's coefficients in torch, against `psf.point_spread`."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.inverse import PupilPSF
from nlosoptics.inverse.wave.frames import known_defoci
from nlosoptics.psf import Wavefront, point_spread, zernike

WAVELENGTH = 632.8e-9
DISTANCE = 0.06
PITCH = 5e-6
MODES = {2: 0.2, 4: 0.3, 5: -0.1, 7: 0.1, 11: 0.07}  # waves


def radius(cells, side, distance=DISTANCE):
    """Pupil radius of so many cells of a period of so many pixels, m."""
    return cells * WAVELENGTH * abs(distance) / (side * PITCH)


def pupil(modes=MODES, *, shape=64, cells=14.0, distance=DISTANCE, dtype=torch.float64, **options):
    if isinstance(modes, dict):
        # as many waves as few cells hold
        share = WAVELENGTH * min(1.0, (cells / 14.0) ** 2)
        modes = {mode: value * share for mode, value in modes.items()}
    side = shape if isinstance(shape, int) else max(shape)
    return PupilPSF.from_zernike(
        modes,
        wavelength=WAVELENGTH,
        pupil_radius=radius(cells, side, distance),
        image_distance=distance,
        pitch=PITCH,
        shape=shape,
        dtype=dtype,
        **options,
    )


def wave_of(module):
    """The same pupil, cell by cell, as `psf` takes it."""
    return Wavefront.from_map(
        module.aberration().detach().numpy(),
        module.optics.share,
        wavelength=WAVELENGTH,
        pupil_pitch=module.optics.pupil_pitch[0],
        image_distance=module.optics.image_distance,
        pupil_radius=module.optics.pupil_radius,
    )


@pytest.mark.parametrize("shape", [64, 65])
@pytest.mark.parametrize("distance", [DISTANCE, -DISTANCE])
def test_equals_the_point_spread_of_the_same_wave(shape, distance):
    module = pupil(shape=shape, distance=distance)
    expected = point_spread(wave_of(module), method="fft", pitch=PITCH, shape=shape).intensity
    found = module().detach().numpy()
    # roundings of two transforms
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * expected.max())


@pytest.mark.parametrize("cells", [14.0, 30.0])  # a pixel below Nyquist's and one twice as wide
def test_equals_pixel_integrals_of_the_same_wave(cells):
    # the transfer function of a pixel is exact; the sum over finer samples errs by 4e-11
    module = pupil(cells=cells, pixel_integrated=True)
    expected = point_spread(
        wave_of(module), method="mdft", pitch=PITCH, shape=64, pixel_integrated=True
    ).intensity
    found = module().detach().numpy()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * expected.max())


def test_single_precision_agrees_with_double():
    expected = pupil()().detach()
    found = pupil(dtype=torch.float32)()
    assert found.dtype == torch.float32
    # some ten roundings of 6e-8 in phases of some rad
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=3e-6 * float(expected.max()))


def summed(module, finer=1):
    """Energy at points of the image by the Fraunhofer sum over the module's cells."""
    optics = module.optics
    phase = 2 * np.pi / WAVELENGTH * module.aberration().detach().numpy()
    field = optics.share * np.exp(1j * phase)
    spread = WAVELENGTH * optics.image_distance
    points = [(np.arange(n * finer) - (n // 2) * finer) * PITCH / finer for n in module.shape]
    along_y, along_x = (
        np.exp(-2j * np.pi * np.outer(x, u) / spread)
        for x, u in zip(points, (optics.v, optics.u), strict=True)
    )
    energy = np.abs(along_y @ field @ along_x.T) ** 2
    return energy / energy.sum()


@pytest.mark.parametrize("shape", [(48, 80), (33, 20)])
@pytest.mark.parametrize("distance", [DISTANCE, -DISTANCE])
def test_oblong_images_have_oblong_cells(shape, distance):
    cells = max(shape) * min(shape) / max(shape) / 4.5
    module = pupil(shape=shape, distance=distance, cells=cells)
    # the longer side has the finer cells; roundings of two transforms
    assert module.optics.share.shape[shape[0] < shape[1]] > 2 * int(cells)
    expected = summed(module)
    np.testing.assert_allclose(
        module().detach().numpy(), expected, rtol=0, atol=1e-12 * expected.max()
    )


@pytest.mark.parametrize("shape", [(24, 30), (21, 17)])
def test_oblong_pixels_integrate_the_sum_over_cells(shape):
    module = pupil(shape=shape, cells=7.0, pixel_integrated=True)
    finer = 24  # an even number, with half samples at a pixel's two ends: the trapezium rule
    fine = np.pad(summed(module, finer), finer // 2, mode="wrap")
    ends = np.ones(finer + 1)
    ends[[0, -1]] = 0.5
    expected = np.empty(shape)
    for row, column in np.ndindex(shape):
        block = fine[row * finer :, column * finer :][: finer + 1, : finer + 1]
        expected[row, column] = ends @ block @ ends
    # the trapezium rule at 24 steps a pixel that is up to twice Nyquist's: 0.5/24^2
    np.testing.assert_allclose(
        module().detach().numpy(), expected, rtol=0, atol=2e-3 * expected.max()
    )


@pytest.mark.parametrize("shape", [(64, 64), (33, 40)])
@pytest.mark.parametrize("integrated", [False, True])
def test_transfer_is_the_spectrum_of_the_point_spread(shape, integrated):
    module = pupil(shape=shape, cells=7.0, pixel_integrated=integrated)
    spread = module().roll((-(shape[0] // 2), -(shape[1] // 2)), (-2, -1))
    # roundings of one transform; the spread sums to 1
    torch.testing.assert_close(module.transfer(), torch.fft.rfft2(spread), rtol=0, atol=1e-13)


def test_batches_and_defocused_frames_are_single_calls_side_by_side():
    module = pupil([5, 6, 8])
    leaves = torch.randn(2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    defocus = torch.tensor([0.0, 3e-7], dtype=torch.float64)
    stack = module(0.1 * leaves, defocus=defocus)
    assert tuple(stack.shape) == (2, 2, 64, 64)
    wide = pupil([5, 6, 8, 4])
    for row, one in zip(stack, leaves, strict=True):
        for spread, extra in zip(row, defocus, strict=True):
            alone = wide(torch.cat((0.1 * one, extra[None] / WAVELENGTH)))
            torch.testing.assert_close(spread, alone, rtol=0, atol=1e-15)  # energies below 0.1


@pytest.mark.parametrize("integrated", [False, True])
def test_gradients(integrated):
    module = pupil(list(MODES), shape=(12, 11), cells=2.4, pixel_integrated=integrated)
    leaves = torch.linspace(-0.2, 0.3, 10, dtype=torch.float64).view(2, 5).requires_grad_()
    flat = torch.zeros(5, dtype=torch.float64, requires_grad=True)
    for start in (leaves, flat):
        # `fast_mode` compares random sums of the derivatives, not each of them
        for function in (lambda c: module(c, defocus=[0.0, 2e-7]), module.transfer):
            assert torch.autograd.gradcheck(function, start, atol=1e-8, rtol=1e-6, fast_mode=True)


# torch's own forward derivatives compile helpers in a way that it deprecates
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_second_and_forward_derivatives_and_maps_over_batches():
    module = pupil([4, 5, 6], shape=10, cells=2.0)
    leaves = torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(module, leaves, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(module, leaves)
    stack = torch.stack((leaves, -leaves)).detach()
    # the same transforms in another order, of energies below 1
    torch.testing.assert_close(torch.func.vmap(module)(stack), module(stack), rtol=0, atol=1e-15)


def test_start_values_are_waves_of_the_given_metres():
    module = pupil()
    torch.testing.assert_close(
        module.coefficients.detach(), torch.tensor(list(MODES.values()), dtype=torch.float64)
    )
    assert module.modes == tuple(MODES)
    optics = module.optics
    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    rho, theta = np.hypot(u, v) / optics.pupil_radius, np.arctan2(v, u)
    expected = sum(value * WAVELENGTH * zernike(mode, rho, theta) for mode, value in MODES.items())
    np.testing.assert_allclose(
        module.aberration().detach().numpy(),
        np.where(optics.share > 0, expected, 0.0),
        rtol=0,
        atol=1e-12 * WAVELENGTH,  # roundings of a sum of waves
    )


@pytest.mark.parametrize(
    ("options", "kind", "text"),
    [
        ({"modes": [1, 2]}, SceneError, "piston"),
        ({"modes": [4, 4]}, SceneError, "4 more than once"),
        ({"modes": []}, SceneError, "modes is empty"),
        ({"modes": 4}, SceneError, "give a sequence of Noll indices"),
        ({"modes": {4: float("nan")}}, SceneError, r"modes\[4\]"),
        ({"cells": 17.0}, SamplingError, "limit for point samples"),
        ({"cells": 0.7}, SamplingError, "samples the pupil every"),
        ({"distance": 0.0}, SceneError, "image_distance = 0"),
        ({"dtype": torch.float16}, SamplingError, "float16 is not supported"),
        ({"modes": range(2, 40), "cells": 2.0}, SamplingError, "cannot hold 38 modes"),
    ],
)
def test_bad_options_are_refused_in_one_line(options, kind, text):
    options = dict(options)
    modes = options.pop("modes", MODES)
    if options.get("distance") == 0.0:
        with pytest.raises(kind, match=text):
            PupilPSF.from_zernike(
                [4],
                wavelength=WAVELENGTH,
                pupil_radius=1e-3,
                image_distance=0.0,
                pitch=PITCH,
                shape=64,
            )
        return
    with pytest.raises(kind, match=text) as caught:
        pupil(modes, **options)
    assert "\n" not in str(caught.value)


def test_wrong_leaves_are_refused():
    module = pupil()
    with pytest.raises(SamplingError, match=r"must end in \(5,\)"):
        module(torch.zeros(4, dtype=torch.float64))
    with pytest.raises(SamplingError, match=r"must be \(K,\)"):
        module(defocus=torch.zeros(2, 2))


@pytest.mark.parametrize(
    ("coefficients", "kind", "words"),
    [
        (np.zeros(2), SceneError, "ndarray are not a tensor; give"),
        ([0.0, 0.0], SceneError, "list are not a tensor; give"),
        (torch.zeros(2, dtype=torch.float64), SamplingError, "torch.float64.*torch.float32; give"),
    ],
)
def test_coefficients_of_another_kind_are_one_line(coefficients, kind, words):
    spread = PupilPSF.from_zernike(
        [4, 5], wavelength=5e-7, pupil_radius=5e-3, image_distance=0.1, pitch=2e-6, shape=32
    )
    for call in (spread, spread.transfer, spread.aberration):
        with pytest.raises(kind, match=words):
            call(coefficients)


@pytest.mark.parametrize(
    ("defocus", "words"),
    [
        ([0.5], r"defocus = \[0.5\] m rms, limit 0.001; give metres, not waves"),
        ([np.nan], "nan.* m rms, limit"),
        ("far", "defocus of type str has no numbers"),
    ],
)
def test_defocus_in_waves_or_words_is_refused(defocus, words):
    module = pupil()
    for call in (module, module.transfer):
        with pytest.raises(SceneError, match=words) as caught:
            call(defocus=defocus)
        assert "\n" not in str(caught.value)


def test_the_largest_defocus_is_a_millimetre():
    for sign in (1.0, -1.0):
        assert known_defoci([0.0, sign * 1e-3], 2)[1] == sign * 1e-3
        with pytest.raises(SceneError, match="limit 0.001"):
            known_defoci([0.0, sign * np.nextafter(1e-3, 1.0)], 2)


def test_modes_beyond_the_memory_are_refused_before_they_are_computed():
    size = pupil().optics.share.size
    with (
        within(Budget(memory=24.0 * 59 * size, seconds=60.0)),
        pytest.raises(MemoryLimitError, match="60 modes on the pupil needs .* use fewer modes"),
    ):
        pupil(dict.fromkeys(range(2, 62), 0.0))
