"""Public results of six scenes on record: an edit that changes a number is seen here.

A record is no truth; other tests tell whether a number is right. ``python
tests/test_public_record.py`` writes the numbers anew after a change that is meant, and their
difference is read like code. An array is kept as its norm, its sum and its products with three
fixed patterns.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import nlosoptics as nlos
from nlosoptics import imaging, inverse, limits, psf, raytrace, study, transient

FILE = Path(__file__).with_suffix(".json")
EXAMPLES = Path(__file__).parents[1] / "examples"
#: Functions that compute a result, and the largest difference relative to an array's norm.
RESULTS: dict[str, tuple[Callable[[Path], dict[str, Any]], float]] = {}


def on_record(tolerance: float) -> Callable[..., Any]:
    """Register a result with the difference that rounding and stated errors explain."""

    def register(result: Callable[[Path], dict[str, Any]]) -> Callable[[Path], dict[str, Any]]:
        RESULTS[result.__name__] = (result, tolerance)
        return result

    return register


def numbers(value: Any) -> Any:
    """What is kept of a value: itself, or the products of an array with fixed patterns."""
    if isinstance(value, str | bool | int):
        return value
    array = np.asarray(value, dtype=float).ravel()
    if array.size < 8:
        return [float(x) for x in array]
    k = np.arange(array.size)
    patterns = [np.ones(array.size), *(np.cos(w * k + w) for w in (0.7, 0.031, 2.9))]
    return [float(np.linalg.norm(array)), *(float(array @ p) for p in patterns)]


@functools.cache
def scene(name: str, size: int = 64) -> nlos.Scene:
    return nlos.Scene.load(EXAMPLES / "scenes" / f"{name}.toml").resized(size)


@functools.cache
def run(name: str, reconstruct: bool = False) -> nlos.Result:
    return nlos.simulate(scene(name), seed=3, reconstruct=reconstruct)


@on_record(1e-9)
def exit_pupil_of_a_concave_wall(_: Path) -> dict[str, Any]:
    pupil = psf.exit_pupil(scene("letter_concave"))
    return {"distance": pupil.image_distance, "f_number": pupil.f_number, "centre": pupil.centre}


@on_record(1e-7)
def wave_of_a_concave_wall(_: Path) -> dict[str, Any]:
    wave = psf.wavefront(scene("letter_concave"))
    return {"rms": psf.rms_aberration(wave), "strehl": psf.strehl(wave)}


@on_record(1e-6)
def zernike_coefficients_of_a_wavy_wall(_: Path) -> dict[str, Any]:
    wave = psf.wavefront(scene("letter_wavy"))
    return {"coefficients": list(psf.fit_zernike(wave, 21).values())}


@on_record(2e-3)
def point_spreads_of_three_walls(_: Path) -> dict[str, Any]:
    return {
        name: psf.scene_point_spread(scene(name)).point_spread.intensity
        for name in ("letter_flat", "letter_concave", "letter_wavy")
    }


@on_record(1e-6)
def sharpness_of_a_flat_wall(_: Path) -> dict[str, Any]:
    wave = psf.wavefront(scene("letter_flat"))
    fine = psf.point_spread(wave, tol=1e-8)
    return {
        "mtf": psf.mtf(wave, [0.0, 1e4, 3e4]),
        "energy": psf.encircled_energy(wave, [1e-5, 3e-5]),
        "fwhm": psf.fwhm(fine),
        "intensity": fine.intensity,
    }


@on_record(1e-5)
def point_spreads_of_a_rough_wall(_: Path) -> dict[str, Any]:
    wave = psf.wavefront(scene("letter_flat"))
    rough = psf.Roughness(0.1e-6, 30e-6)
    sample = psf.sample_point_spread(scene("letter_flat"), rough, seed=4, shape=64)
    mean = psf.mean_point_spread(scene("letter_flat"), rough, shape=64)
    return {"rms": psf.rms_aberration(wave), "mean": mean.intensity, "sample": sample.intensity}


@on_record(2e-3)
def rough_scene(_: Path) -> dict[str, Any]:
    return {"image": run("letter_rough").image.electrons}


@on_record(2e-3)
def image_of_a_wavy_wall(_: Path) -> dict[str, Any]:
    return {"image": run("letter_wavy").image.electrons}


@on_record(2e-3)
def image_past_an_occluder(_: Path) -> dict[str, Any]:
    return {"diffuse": imaging.diffuse_background(scene("letter_occluder"))}


@on_record(1e-2)  # iterations stop at changes of 5e-4: light that differs by 1e-5 moves the stop
def reconstruction_round_a_corner(_: Path) -> dict[str, Any]:
    result = run("corner", reconstruct=True)
    answer = result.reconstruction
    return {"status": answer.status, "object": answer.object}


@on_record(5e-3)
def known_walls(_: Path) -> dict[str, Any]:
    model = nlos.reconstructing.known_model(scene("letter_flat"))
    image = run("letter_flat").image.electrons
    solvers = (inverse.tv_deconvolve, inverse.wiener, inverse.richardson_lucy)
    answers = {solve.__name__: solve(image, model) for solve in solvers}
    objects = {name: answer.object for name, answer in answers.items()}
    return objects | {"status": answers["tv_deconvolve"].status}


@on_record(1e-6)
def traced_paths(_: Path) -> dict[str, Any]:
    paths = raytrace.trace(scene("letter_concave"), n_rays=4096, seed=5, max_bounces=3)
    return {"flux": paths.flux, "by_bounce": paths.by_bounce, "ledger": list(paths.ledger.values())}


@on_record(1e-6)
def traced_image(_: Path) -> dict[str, Any]:
    image = raytrace.trace_image(scene("corner"), n_rays=4096, seed=6, max_bounces=3)
    return {"expected": image.expected, "power": image.power}


@on_record(1e-6)
def light_of_an_object_point(_: Path) -> dict[str, Any]:
    point = raytrace.trace_point(scene("letter_concave"), n_rays=4096, seed=7)
    return {"energy": point.energy, "flux": point.flux}


@on_record(1e-6)
def irradiance_of_a_wall(_: Path) -> dict[str, Any]:
    wall = raytrace.wall_irradiance(scene("corner"), shape=(16, 16), n_rays=4096, seed=8)
    return {"irradiance": wall.irradiance}


@on_record(1e-3)
def feasibility(_: Path) -> dict[str, Any]:
    names = ("letter_flat", "letter_concave", "letter_occluder")
    reports = {name: limits.feasibility(scene(name)) for name in names}
    return {name: report.score for name, report in reports.items()}


@on_record(1e-6)
def plan_of_a_run(_: Path) -> dict[str, Any]:
    plan = nlos.plan(scene("letter_concave"), reconstruct=True)
    return {"layout": plan.layout, "stages": ", ".join(stage.name for stage in plan.stages)}


@functools.cache
def capture() -> transient.TransientCapture:
    scene = nlos.Scene.load(EXAMPLES / "scenes" / "transient_letter.toml")
    return transient.downsampled(transient.render_scene(scene, tol=1e-2), bins=2, grid=2)


@on_record(1e-2)
def capture_of_a_letter(_: Path) -> dict[str, Any]:
    return {"H": capture().H}


@on_record(1e-2)
def phasor_field_image(_: Path) -> dict[str, Any]:
    volume = transient.Volume.box((-0.6, -0.6, 0.8), (0.6, 0.6, 1.2), 0.1)
    image = transient.phasor_image(capture(), volume, wl_mean=0.25)
    return {"intensity": image.intensity}


@on_record(1e-5)
def design_study(folder: Path) -> dict[str, Any]:
    file = folder / "study.toml"
    name = EXAMPLES / "scenes" / "letter_concave.toml"
    file.write_text(
        f'scene = "{name}"\nfigures = ["strehl", "aberration_rms"]\n'
        '[set]\n"camera.binning" = 64\n"camera.f_number" = 16\n'
        '[axes]\n"wall.radius" = ["4 m", "5 m"]\n"camera.focus_distance" = ["1.6 m", "2 m"]\n'
    )
    results = study.run_study(study.Study.load(file), folder / "store", workers=1)
    table = results.dataset
    return {name: table[name].values for name in ("strehl", "aberration_rms")}


@on_record(2e-2)
def blind_fit(_: Path) -> dict[str, Any]:
    modes, random = tuple(range(4, 16)), np.random.default_rng(3)
    letter = np.zeros((32, 32))
    letter[8:24, 10:14] = letter[20:24, 10:20] = letter[14:17, 12:20] = 1.0
    optics = {
        "pupil_radius": 0.9e-3,
        "image_distance": 51.2e-3,
        "pitch": 9e-6,
        "pixel_integrated": True,
    }
    optics |= {"wavelength": 632.8e-9, "pixel_integrated": True}
    wide = inverse.PupilPSF.from_zernike(modes, shape=64, dtype=torch.float64, **optics)
    pupil = inverse.PupilPSF.from_zernike(modes, shape=32, dtype=torch.float64, **optics)
    wall, defocus = random.normal(size=len(modes)), np.array([0.0, 0.5 * 632.8e-9])
    wall *= 0.4 / np.linalg.norm(wall)
    spreads = wide(torch.from_numpy(wall), defocus=defocus).detach().numpy()
    images = np.stack([imaging.ForwardModel(s, shape=(32, 32)).forward(letter) for s in spreads])
    noise = 0.01 * images.max()
    images = images + noise * random.normal(size=images.shape)
    measured = inverse.Measurement(images, noise_sigma=noise)
    answer = inverse.evidence_fit(measured, pupil, defocus=defocus, max_iterations=1, seed=1)
    return {
        "correlation": inverse.registered_correlation(answer, letter),
        "status": answer.status,
    }


#: Results that compile much, or take seconds.
LONG = (
    "point_spreads_of_a_rough_wall",
    "rough_scene",
    "light_of_an_object_point",
    "blind_fit",
    "reconstruction_round_a_corner",
    "feasibility",
    "traced_paths",
)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.thorough if name in LONG else ()) for name in RESULTS],
)
def test_result_is_on_record(name: str, tmp_path: Path) -> None:
    """Each number within the result's tolerance of the array's norm."""
    result, tolerance = RESULTS[name]
    before = json.loads(FILE.read_text())[name]
    now = {key: numbers(value) for key, value in result(tmp_path).items()}
    assert now.keys() == before.keys()
    for key, value in now.items():
        if isinstance(value, list):
            scale = max(map(abs, before[key]))
            np.testing.assert_allclose(value, before[key], rtol=0, atol=tolerance * scale)
        else:
            assert value == before[key]


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        record = {
            name: {key: numbers(value) for key, value in result(Path(folder)).items()}
            for name, (result, _) in RESULTS.items()
        }
    FILE.write_text(json.dumps(record, indent=1) + "\n")
