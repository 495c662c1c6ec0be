"""Datasets of nouns: values, coordinates and units."""

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import psf, raytrace, transient

WAVE = {"wavelength": 5e-7, "pupil_radius": 5e-3, "image_distance": 0.1}


def units(table) -> dict[str, str]:
    assert all(v.attrs["long_name"] for v in table.variables.values())
    return {str(name): v.attrs["units"] for name, v in table.variables.items()}


@pytest.fixture(scope="module")
def scene():
    return nlos.Scene.load("examples/scenes/letter_flat.toml").resized(32)


def test_an_image_has_the_positions_of_its_pixels(scene) -> None:
    result = nlos.simulate(scene, tol=1e-2)
    for noun in (result, result.image):
        table = noun.to_xarray()
        assert np.array_equal(table.electrons, result.image.electrons)
        assert table.electrons.dims == ("y", "x")
        pitch = scene.camera.image_pitch
        assert np.allclose(table.x, (np.arange(32) - 15.5) * pitch, rtol=1e-14)
        assert units(table) | {"x": "m", "signal": "electrons"} == units(table)
        assert table.attrs["exposure"] == scene.camera.exposure


def test_a_point_spread_and_a_wave() -> None:
    wave = psf.Wavefront.from_zernike({4: 5e-8}, **WAVE)
    table = wave.to_xarray()
    assert table.aberration.dims == ("ring", "angle")
    assert units(table) | {"u": "m", "aberration": "m", "weights": "m^2"} == units(table)
    assert float(table.weights.sum()) == pytest.approx(np.pi * 25e-6)
    spread = psf.point_spread(wave, shape=64)
    table = spread.to_xarray()
    at = table.intensity.argmax(...)
    assert float(table.x[at["x"]]) == float(table.y[at["y"]]) == 0.0
    assert units(table) == {"x": "m", "y": "m", "intensity": "1/pixel"}
    for layout in ({"nodes": "grid"}, {"aperture": psf.Aperture.regular(6, 4e-3)}):
        made = psf.Wavefront.from_zernike({}, **WAVE, samples=8, **layout)
        assert np.array_equal(made.to_xarray().u, made.u)


@pytest.mark.parametrize("pairing", ["all", "confocal"])
def test_a_capture_has_points_and_times(pairing) -> None:
    points = transient.wall_grid(side=1.0, count=3)
    shape = (5, 3, 3) if pairing == "confocal" else (5, 3, 3, 3, 3)
    capture = transient.TransientCapture(
        H=np.arange(np.prod(shape), dtype=float).reshape(shape),
        laser_points=points,
        sensor_points=points,
        delta_t=0.299792458,
        pairing=pairing,
        by_bounce={3: np.ones(shape)},
    )
    table = capture.to_xarray()
    assert np.array_equal(table.H, capture.H)
    assert table.H_3.dims == table.H.dims
    assert np.allclose(table.time, (np.arange(5) + 0.5) * 1e-9, rtol=1e-14)
    assert np.array_equal(table.sensor_x, points[..., 0])
    assert units(table) | {"time": "s", "path": "m", "laser_y": "m", "H": "1/m^2"} == units(table)


def test_a_volume_has_its_axes_and_the_field() -> None:
    volume = transient.Volume.box((0.0, 0.0, 1.0), (0.4, 0.2, 0.2), 0.1)
    image = transient.PhasorImage(
        intensity=np.ones(volume.shape),
        volume=volume,
        method="phasor",
        field=np.full((2, *volume.shape), 1j),
        camera="transient",
        wl_mean=0.1,
        wl_sigma=0.05,
        times=np.array([0.0, 0.1]),
    )
    table = image.to_xarray()
    assert table.field.dims == ("path", "z", "y", "x")
    assert np.array_equal(table.z, volume.z)
    assert np.array_equal(table.path, image.times)
    assert units(table) | {"x": "m", "z": "m", "path": "m"} == units(table)


def test_a_traced_image_and_its_rays(scene) -> None:
    small = scene.resized(8)
    traced = raytrace.trace_image(small, n_rays=64, t_start=2.0, delta_t=0.5, n_bins=6)
    table = traced.to_xarray()
    assert np.array_equal(table.by_bounce.sel(bounces=2), traced.by_bounce[2])
    assert np.allclose(table.path, 2.25 + 0.5 * np.arange(6), rtol=1e-14)
    assert np.array_equal(table.path_by_bounce, traced.histogram.by_bounce)
    assert np.array_equal(table.x, small.camera.image_pitch * (np.arange(8) - 3.5))
    assert units(table) | {"expected": "electrons", "path_stray": "W"} == units(table)
    paths = raytrace.trace(small, n_rays=64)
    table = paths.to_xarray()
    assert np.array_equal(table.z, paths.points[..., 2])
    assert table.surface.dims == ("path", "vertex")
    assert units(table) | {"z": "m", "path_length": "m", "weight": "W"} == units(table)
    assert table.attrs["flux"] == paths.flux
    assert "lobe" not in raytrace.pupil_rays(small, n_rays=16).to_xarray()
