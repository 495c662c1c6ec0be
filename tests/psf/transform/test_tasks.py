"""Limits by which the transforms refuse a wave's samples, and figures of their input."""

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError
from nlosoptics.psf.transform import runners
from nlosoptics.psf.transform.runners import Task
from nlosoptics.psf.wave.detilted import Residual, split
from nlosoptics.psf.window import error_bounds
from nlosoptics.psf.window.pixels import pixel_rule

WAVELENGTH, RADIUS, DISTANCE = 5.3e-7, 4e-3, -0.07
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
UNIT = WAVELENGTH * 0.07 / (2 * RADIUS)
PENTAGON = psf.Aperture.regular(5, 3.5e-3, 0.2)


def task_of(wave, pitch=1.3e-6, shape=(9, 14), tol=1e-3, pixels=False, **more):
    residual = wave if isinstance(wave, Residual) else split(wave)
    rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape)) if pixels else None
    return Task(residual, tol, pitch, shape, rule, **more)


def tilted(layout="polar", defocus=0.0, **options):
    if layout == "cells":
        options = {"aperture": PENTAGON} | options
    coefficients = {2: 3e-7, 3: -1e-7, 4: defocus}
    return psf.Wavefront.from_zernike(coefficients, nodes=layout, **SYSTEM, **options)


@pytest.mark.parametrize("pixels", [False, True])
@pytest.mark.parametrize("layout", ["polar", "cells"])
@pytest.mark.parametrize("pitch", [0.3 * UNIT, 2.7 * UNIT])
def test_figures_of_a_task(layout, pixels, pitch):
    task = task_of(tilted(layout), pitch=pitch, pixels=pixels)
    assert task.pixels.first == approx((-7 * pitch, -4 * pitch))
    assert (task.pixels.pitch, task.pixels.shape) == (pitch, (9, 14))
    if pixels:
        assert task.samples == task.rule.window(pitch, (9, 14))
    else:
        assert task.samples == task.pixels
    assert task.level == task.residual.pixel_share(pitch)
    side = pitch / UNIT if pixels else 0.0
    # lobes of an aperture may be wider than an Airy unit
    expected = min(side, 0.8) if layout == "cells" else side
    assert task.pixel == approx(expected, rel=1e-12)
    intensity = np.array([[0.3, 0.7], [0.1, 0.2]])
    given = {"spill": 1e-4, "pixel": task.pixel, "level": task.level}
    bound = error_bounds.intensity_error(intensity, 1e-3, 1e-5, **given)
    assert task.bound(intensity, 1e-3, 1e-5, 1e-4) == bound
    epsilon = 1e-3
    inside = error_bounds.transform_error(intensity, epsilon, pixel=task.pixel)
    assert task.transform_error(intensity, epsilon) == inside
    part = task_of(tilted(layout), pixels=pixels, whole=False)
    outside = 2 * epsilon / math.sqrt(0.7) + epsilon**2 / 0.7
    assert part.transform_error(intensity, epsilon) == approx(outside, rel=1e-12)


@pytest.mark.parametrize("pixels", [False, True])
def test_means_of_a_field(pixels):
    task = task_of(tilted(), pitch=2.1 * UNIT, shape=(4, 7), pixels=pixels)
    rng = np.random.default_rng(1)
    field = rng.normal(size=task.samples.shape) + 1j * rng.normal(size=task.samples.shape)
    expected = np.abs(field) ** 2
    if pixels:
        expected = task.rule.mean(np.ascontiguousarray(task.rule.mean(expected).T)).T
        assert expected.shape == (4, 7)
    assert task.means(field) == approx(expected, rel=1e-12)
    assert task.averaged(np.abs(field) ** 2) == approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("defocus", "pitch", "shape"),
    [
        (0.0, 1e-6, (8, 8)),
        (0.0, 4e-6, (900, 1100)),
        (3e-5, 1e-6, (8, 8)),
        (1e-8, 7.7e-7, (9, 4000)),
    ],
)
def test_size_of_a_polar_transform(defocus, pitch, shape):
    """Twice the window's reach, the spot and a margin, and 512 points across the pupil."""
    task = task_of(tilted(defocus=defocus), pitch=pitch, shape=shape)
    x, y = task.residual.shift
    reach = max(
        abs(-(shape[1] // 2) * pitch - x),
        abs((shape[1] - 1 - shape[1] // 2) * pitch - x),
        abs(-(shape[0] // 2) * pitch - y),
        abs((shape[0] - 1 - shape[0] // 2) * pitch - y),
    )
    period = max(2 * reach, 4.4 * task.residual.rays.reach + 16 * UNIT, 512 * UNIT)
    size = runners.polar_size(task)
    assert size == math.ceil(period / pitch - 1e-9)
    found = runners.grid_period_pitch(task, size)
    assert found == approx(WAVELENGTH * 0.07 / (size * pitch), rel=1e-12)


def step_wave(step, n=12):
    """Map with one step between neighbours, waves, beside the axis, whose plane is subtracted."""
    surface = np.zeros((n, n))
    surface[4, 5] = step * WAVELENGTH
    return psf.Wavefront.from_map(
        surface, wavelength=WAVELENGTH, pupil_pitch=3e-4, image_distance=DISTANCE
    )


def test_steps_of_more_than_half_a_wave():
    """The number of samples by which the steps would be small enough."""
    for step in (0.3, 0.45, 0.7, 1.9):
        task = task_of(step_wave(step), pitch=2e-6, shape=(3, 4))
        jump, where = task.residual.grid_jump()
        if jump <= 0.5:
            runners.check_sampling(task)
            assert runners.checked_grid(task).values.shape == (12, 12)
            continue
        need = math.ceil(12 * max(jump / 0.5, share_of(task)))
        told = (
            rf"aberration jumps {jump:.2f} waves at pixel \({where[0]}, {where[1]}\), limit 0.50; "
        )
        with pytest.raises(SamplingError, match=f"{told}use {need} or more pupil samples .now 12."):
            runners.check_sampling(task)


def share_of(task):
    """Reach of window and rays over the period at which a grid repeats the image."""
    wave = task.residual.wavefront
    x, y = task.residual.shift
    ny, nx = task.shape
    far = [abs(-(n // 2) * task.pitch - s) for n, s in ((nx, x), (ny, y))]
    far += [abs((n - 1 - n // 2) * task.pitch - s) for n, s in ((nx, x), (ny, y))]
    need = max(far) + task.residual.rays.reach
    if task.rule is not None:
        need += task.pitch / 2 + task.residual.airy_unit
    spacing = task.residual.spacing
    return need * spacing / (WAVELENGTH * abs(wave.image_distance))


def scattered():
    u, v = np.random.default_rng(2).uniform(-2.5e-3, 2.5e-3, (2, 400))
    return psf.Wavefront(
        u=u,
        v=v,
        aberration=2e-5 * u + 1e-3 * u * v,
        amplitude=np.ones(400),
        weights=np.full(400, 6e-8),
        layout="scattered",
        **SYSTEM,
    )


@pytest.mark.parametrize("pixels", [False, True])
@pytest.mark.parametrize("layout", ["grid", "scattered"])
def test_windows_wider_than_the_period(layout, pixels):
    wave = tilted("grid", samples=40) if layout == "grid" else scattered()
    n, power = len(wave.u), 1 if layout == "grid" else 2
    accepted, residual = [], split(wave)
    for width in range(3, 400, 9):
        task = task_of(residual, shape=(5, width), pixels=pixels)
        share = share_of(task)
        accepted.append(share <= 1)
        if accepted[-1]:
            runners.check_sampling(task)
            continue
        period = WAVELENGTH * 0.07 / task.residual.spacing
        need = math.ceil(n * share**power)
        told = f"every {period:.3g} m, inside the window, which needs {share * period:.3g} m; "
        with pytest.raises(
            SamplingError, match=f"{told}use {need} or more pupil samples .now {n}., or a"
        ):
            runners.check_sampling(task)
    assert 3 < sum(accepted) < 42


def test_steps_of_scattered_nodes():
    """A denser set may have a pair that is farther apart, hence a margin of 1.2."""
    wave = scattered()
    steep = psf.Wavefront(
        u=wave.u,
        v=wave.v,
        aberration=0.2 * wave.u * wave.v,
        amplitude=wave.amplitude,
        weights=wave.weights,
        layout="scattered",
        **SYSTEM,
    )
    task = task_of(steep, shape=(3, 3))
    jump, (node,) = task.residual.grid_jump()
    need = math.ceil(400 * (1.2 * max(jump / 0.5, share_of(task))) ** 2)
    told = rf"aberration jumps {jump:.2f} waves at node \({node},\), limit 0.50; use {need} or more"
    with pytest.raises(SamplingError, match=told):
        runners.check_sampling(task)


@pytest.mark.parametrize("pixels", [False, True])
def test_bound_of_a_grid(pixels):
    """Rim, truncation and, over pixels, damping."""
    task = task_of(tilted("grid", samples=40), pixels=pixels)
    grid, mean = runners.checked_grid(task), np.full((9, 14), 0.2)
    half = task.pitch / 2 if pixels else 0.0
    edge = error_bounds.edge_errors(task.residual, grid, task.pixels.x, task.pixels.y, half)
    bound = task.bound(mean, edge.field, edge.energy, edge.spill)
    if pixels:
        bound += error_bounds.damping_error(task.residual, grid, task.pitch)
    assert runners.grid_bound(task, mean, grid) == approx(bound, rel=1e-12)
    assert bound > 0
