"""Transforms from a pupil's cells to an image: sums over pairs of cells, sizes, and refusals."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch

from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.inverse.wave.pupil_optics import PupilOptics
from nlosoptics.inverse.wave.pupil_waves import SlopeWaves, ZernikeWaves, fitted_modes, noll_mode
from nlosoptics.psf import Aperture, Wavefront

WAVELENGTH, RADIUS, DISTANCE = 6e-7, 1.1e-3, 0.07
SPREAD = WAVELENGTH * DISTANCE
NYQUIST = SPREAD / (4 * RADIUS)  # 9.5 um


def shade(u, v):
    return 1.0 + 300.0 * u - 150.0 * v


def optics_of(**options):
    given = {
        "wavelength": WAVELENGTH,
        "pupil_radius": RADIUS,
        "image_distance": DISTANCE,
        "pitch": 7e-6,
        "shape": (12, 15),
        "dtype": torch.float64,
    }
    return PupilOptics(**given | options)


def image_of(optics, turns):
    """Energy per pixel: each pair of cells makes a fringe, which a pixel averages."""
    pitch, (rows, columns) = optics.pitch, optics.shape
    v, u = (part.ravel() for part in np.meshgrid(optics.v, optics.u, indexing="ij"))
    field = optics.amplitude.ravel() * np.exp(2j * np.pi * turns.ravel() * np.sign(DISTANCE))
    if optics.image_distance < 0:
        field = field.conj()
    pairs = np.outer(field, field.conj())
    fu, fv = ((part[:, None] - part) / SPREAD for part in (u, v))
    if optics.pixel_integrated:
        pairs = pairs * np.sinc(fu * pitch) * np.sinc(fv * pitch)
    y, x = ((np.arange(n) - n // 2) * pitch for n in (rows, columns))
    image = [[np.sum(pairs * np.exp(-2j * np.pi * (fu * a + fv * b))).real for a in x] for b in y]
    area = (optics.u[1] - optics.u[0]) * (optics.v[1] - optics.v[0])
    return np.array(image) * pitch**2 * area / SPREAD**2 / np.sum(optics.amplitude**2)


CASES = {
    "points": {},
    "behind": {"image_distance": -DISTANCE},
    "pixels": {"pixel_integrated": True},
    "wide pixels": {"pixel_integrated": True, "pitch": 22e-6, "shape": (5, 4)},
}


@pytest.mark.parametrize("transmission", [None, shade])
@pytest.mark.parametrize("name", CASES)
def test_images_are_sums_over_pairs_of_cells(name, transmission):
    optics = optics_of(**CASES[name], transmission=transmission)
    sizes = optics.v.size, optics.u.size
    turns = np.random.default_rng(4).uniform(-0.4, 0.4, (2, *sizes))
    expected = np.stack([image_of(optics, one) for one in turns])
    found = optics.point_spread(torch.from_numpy(turns)).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-9 * expected.max())
    rows, columns = optics.shape
    spectrum = np.fft.rfft2(np.roll(expected, (-(rows // 2), -(columns // 2)), (1, 2)))
    transfer = optics.transfer(torch.from_numpy(turns)).numpy()
    np.testing.assert_allclose(transfer, spectrum, atol=1e-9 * np.abs(spectrum).max())
    # one period of the image, of all its pixels
    assert found.sum(axis=(1, 2)) == pytest.approx([1.0, 1.0], rel=1e-9)


def test_cells_of_one_period():
    """Each side has its own; the rim ends within half a cell of the last one."""
    optics = optics_of(transmission=shade)
    assert optics.v == pytest.approx(5e-4 * np.arange(-2, 3))
    assert optics.u == pytest.approx(4e-4 * np.arange(-3, 4))
    assert optics.pupil_pitch == pytest.approx((5e-4, 4e-4))
    assert optics.nyquist_pitch == pytest.approx(NYQUIST, rel=1e-12)
    assert optics.share[2, 3] == pytest.approx(1.0, rel=1e-12)
    assert optics.share.sum() * 2e-7 == pytest.approx(math.pi * RADIUS**2, rel=1e-9)
    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    assert optics.amplitude == pytest.approx(optics.share * shade(u, v), rel=1e-12)
    weights = optics.cell_weights()
    # |field|^2 of the fine samples adds up to 1 over their period of 12 x 15
    assert np.sum(weights**2) * 12 * 15 == pytest.approx(1.0, rel=1e-12)
    assert weights / weights[2, 3] == pytest.approx(optics.amplitude / optics.amplitude[2, 3])
    for share, cells in ((1 - 1e-6, 5), (1 + 1e-6, 7)):  # of a rim at the edge of the last cell
        assert optics_of(pupil_radius=1.25e-3 * share, pitch=7e-6).v.size == cells
    assert optics.fine_grid == (12, 15)
    assert optics.pixel_transfer().tolist() == np.ones((12, 8)).tolist()
    assert (optics.dtype, optics.device.type) == (torch.float64, "cpu")


@pytest.mark.parametrize(("pitch", "finer"), [(0.999, 1), (1.0, 1), (1.001, 2), (2.0, 2), (2.3, 3)])
def test_wide_pixels_have_fine_samples(pitch, finer):
    optics = optics_of(pitch=pitch * NYQUIST, pixel_integrated=True, shape=(9, 7))
    assert optics.fine_grid == (9 * finer, 7 * finer)
    y, x = np.fft.fftfreq(9 * finer) * finer, np.fft.rfftfreq(7 * finer) * finer
    expected = np.outer(np.sinc(y), np.sinc(x)) * finer**2
    assert optics.pixel_transfer() == pytest.approx(expected, abs=1e-12)


def test_other_images_of_the_same_pupil():
    given = {"pixel_integrated": True, "transmission": shade, "image_distance": -DISTANCE}
    optics = optics_of(**given, dtype=torch.float32)
    other, known = optics.resized((9, 16), 6e-6), optics_of(**given, pitch=6e-6, shape=(9, 16))
    assert (other.dtype, other.shape) == (torch.float64, (9, 16))
    turns = torch.from_numpy(np.random.default_rng(1).normal(size=known.share.shape))
    assert torch.equal(other.point_spread(turns), known.point_spread(turns))


def test_steepest_step_of_lit_cells():
    optics = optics_of()
    turns = torch.zeros((2, 5, 7), dtype=torch.float64)
    turns[1, 2, 3] = 0.501
    assert optics.steepest(turns) == pytest.approx(0.501)
    with pytest.warns(UserWarning, match=r"rises 0\.501 waves from one pupil cell of 0\.0004 m to"):
        optics.warn_of_steps(turns)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optics.warn_of_steps(turns / 1.0021)
    dark = torch.where(torch.from_numpy(optics.share > 0), 0.0, 9.0)
    assert float(dark.max()) == 9.0
    assert optics.steepest(dark) == 0.0
    rows, columns = torch.meshgrid(torch.arange(5.0), torch.arange(7.0), indexing="ij")
    assert optics.steepest(0.3 * rows - 0.2 * columns) == pytest.approx(0.3, rel=1e-6)
    assert optics.steepest(0.1 * rows - 0.2 * columns) == pytest.approx(0.2, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dtype": torch.float16}, "dtype = torch.float16 is not supported by the transform"),
        ({"wavelength": 0.99e-8}, "wavelength = 9.9e-09 m"),
        ({"wavelength": 1.01e-3}, "wavelength = 0.00101 m"),
        ({"image_distance": 0.0}, "image_distance = 0 m, must not be 0"),
        ({"pitch": 1.001 * NYQUIST}, r"pitch = 9.555e-06 m, limit for point samples \(Nyquist\) "),
        (
            {"shape": (5, 15)},
            r"shape\[0\] = 5 samples the pupil every 0.0012 m, limit its radius, 0.0011 m; use 6 ",
        ),
        ({"shape": (12, 5)}, r"shape\[1\] = 5 samples the pupil every 0.0012 m"),
    ],
)
def test_what_cannot_be_sampled_is_refused(change, words):
    with pytest.raises((SamplingError, SceneError), match=words):
        optics_of(**change)
    assert optics_of(shape=(6, 6)).v.size == 3  # as the refusal says


def test_memory_of_a_transform():
    """64 bytes for each fine sample."""
    options = {"pixel_integrated": True, "pitch": 1.5 * NYQUIST, "shape": (12, 15)}
    optics = optics_of(**options)
    grid = (24, 30)
    need = 64.0 * 24 * 30
    with within(Budget(memory=need * (1 + 1e-9), seconds=9.0)):
        optics_of(**options)
    with within(Budget(memory=need * (1 - 1e-9), seconds=9.0)):
        sizes = rf"\({optics.v.size}, {optics.u.size}\) pupil cells to \({grid[0]}, {grid[1]}\)"
        with pytest.raises(MemoryLimitError, match=f"the transform of {sizes} samples"):
            optics_of(**options)


def test_modes_beside_a_known_wave():
    """Whole waves of it leave the image, and its digits, alone."""
    optics, single = optics_of(), optics_of(dtype=torch.float32)

    def known(seen):
        v, u = np.meshgrid(seen.v, seen.u, indexing="ij")
        return np.where(seen.share > 0, WAVELENGTH * (12345.3 + 400.0 * u - 900.0 * v), np.nan)

    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    lit = optics.share > 0
    rest = np.where(lit, 12345.3 + 400.0 * u - 900.0 * v, 0.0)
    modes = (4, 6, 7)
    table = np.stack([noll_mode(mode, optics) for mode in modes])
    strengths = np.array([[0.2, -0.1, 0.3], [0.0, 0.5, -0.4]])
    plain = np.einsum("km,muv->kuv", strengths, table)
    alone = ZernikeWaves(modes, optics)
    given = torch.from_numpy(strengths)
    assert (alone.modes, alone.leaf_shape, alone.rest) == (modes, (3,), None)
    assert alone.rest_on(optics) is None
    assert alone(given).numpy() == pytest.approx(plain, abs=1e-14)
    assert alone.unwrapped(given).numpy() == pytest.approx(plain, abs=1e-14)
    waves = ZernikeWaves(modes, optics, known)
    assert waves.rest.numpy() == pytest.approx(rest, rel=1e-12)
    assert waves.rest_on(optics) == pytest.approx(rest, rel=1e-12)
    assert waves.unwrapped(given).numpy() == pytest.approx(plain + rest, rel=1e-12)
    wrapped = plain + rest - np.round(rest)
    assert waves(given).numpy() == pytest.approx(wrapped, abs=1e-11)
    few = ZernikeWaves(modes, single, known)(given.float()).numpy()
    assert few == pytest.approx(wrapped, abs=3e-7)


def test_modes_that_no_pupil_holds():
    optics = optics_of(shape=(6, 6))
    lit = int(np.count_nonzero(optics.share))
    assert ZernikeWaves(range(2, 2 + lit), optics).leaf_shape == (lit,)
    message = f"{lit} pupil cells cannot hold {lit + 1} modes; use fewer modes or a larger shape"
    with pytest.raises(SamplingError, match=message):
        ZernikeWaves(range(2, 3 + lit), optics)
    need = 24.0 * optics.share.size * 3
    for room, fits in ((1 + 1e-9, True), (1 - 1e-9, False)):
        with within(Budget(memory=need * room, seconds=9.0)):
            if fits:
                ZernikeWaves((4, 5, 6), optics)
                continue
            with pytest.raises(MemoryLimitError, match=r"3 modes on the pupil .*use fewer modes"):
                ZernikeWaves((4, 5, 6), optics)
    slopes = pytest.raises(MemoryLimitError, match=r"7 x 7 slopes .*use fewer slopes")
    with within(Budget(memory=200.0 * 7**2 * (1 - 1e-9), seconds=9.0)), slopes:
        SlopeWaves(7, 5e-4, optics)


def test_slopes_of_quadratics_in_sets():
    """In waves per pupil radius at the nodes; rows are v, and cells of the pupil are not square."""
    optics, count, pitch = optics_of(), 7, 4.7e-4
    waves = SlopeWaves(count, pitch, optics)
    y, x = np.mgrid[:count, :count] * (pitch / RADIUS) - count // 2 * pitch / RADIUS
    v, u = np.meshgrid(optics.v / RADIUS, optics.u / RADIUS, indexing="ij")
    slopes, expected = [], []
    for a, b, p, q, r in ((0.3, -0.2, 0.0, 0.0, 0.0), (0.1, 0.05, 0.4, -0.3, 0.7)):
        slopes.append(np.stack([a + p * x + q * y, b + q * x + r * y], axis=-1))
        expected.append(a * u + b * v + p * u * u / 2 + q * u * v + r * v * v / 2)
    found = waves(torch.from_numpy(np.stack(slopes))).numpy()
    lit = optics.share > 0
    assert (found[:, ~lit] == 0.0).all()
    off = found[:, lit] - np.array(expected)[:, lit]
    assert off == pytest.approx(off[:, :1] * np.ones(off.shape), abs=1e-12)  # any piston
    again = waves.unwrapped(torch.from_numpy(slopes[1]))
    assert again.numpy() == pytest.approx(found[1], abs=1e-13)


def test_modes_fitted_to_a_wave():
    """What no mode asked for takes is the rest, on the cells of any optics."""
    optics = optics_of()
    given = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
    terms = {2: 1e-7, 5: 2e-7, 7: -1.5e-7, 11: 3e-7}
    rest_of, found = fitted_modes(Wavefront.from_zernike(terms, **given), (7, 5))
    assert found == pytest.approx([-0.25, 1 / 3], rel=1e-9)
    rest = 1e-7 * noll_mode(2, optics) + 3e-7 * noll_mode(11, optics)
    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    inside = np.hypot(u, v) <= RADIUS
    assert rest_of(optics)[inside] == pytest.approx(rest[inside], abs=1e-18)
    assert not rest_of(optics)[optics.share == 0].any()
    cells = Wavefront.from_zernike(
        terms, nodes="cells", aperture=Aperture.regular(6, 1e-3), **given
    )
    with pytest.raises(SamplingError, match="sampled on cells, not on polar nodes; use polar ones"):
        fitted_modes(cells, (5,))[0](optics)
