"""Lines as users of prysm, HCIPy, Optiland, deepinv and y-tal would write them at first.

They were written down before they were tried. Each works, or answers in one line with the right
call.
"""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pytest import approx

import nlosoptics as nlos
from nlosoptics import psf, study, transient

SCENES = Path(__file__).parents[1] / "examples" / "scenes"

#: Beginnings of lines that take a second and more at their first call.
SLOW = ("study.sweep(scene, {'laser", "transient.render_scene", "views.study_map")
#: Lines by task, each with the right call that its error names; empty if the line works.
LINES = {
    "load a scene": {
        "nlos.Scene.load(file)": "",
        "nlos.Scene.load(str(file))": "",
        "nlos.load_scene(file)": "use nlosoptics.Scene.load",
        "nlos.Scene(laser=laser, wall=nlos.ConcaveWall(5.0), hidden=letter, camera=camera)": "",
        "nlos.Laser(wavelength=632.8e-9, power=5e-3, position=(0.3, 0.0, 1.2))": "",
        "nlos.PlanarObject(picture, 0.7, position=(0.38, 0.0, 1.0))": "",
        "scene.summary()": "",
    },
    "change a value": {
        "scene.with_values({'camera.f_number': 8})": "",
        "scene.with_values({'laser.power': 20e-3})": "",
        "scene.with_values({'laser.power': '20 mW'})": "",
        "scene.with_values({'wall.curvature': 0.25})": "",
        "concave.with_values({'wall.radius': 4.0})": "",
        "scene.with_values({'camera.fnumber': 8})": "did you mean f_number",
        "replace(scene, wall=nlos.ConcaveWall(4.0))": "",
        "scene.camera.f_number": "",
        "scene.resized(16)": "",
    },
    "point spread": {
        "psf.point_spread(scene)": "",
        "psf.point_spread(result)": "",
        "psf.point_spread(wave)": "",
        "psf.wavefront(result)": "",
        "psf.strehl(scene)": "",
        "psf.strehl(wave)": "",
        "psf.fwhm(scene)": "window has 1 samples, must have 3; use a larger shape",
        "psf.exit_pupil(scene).f_number": "",
        "result.point_spread.intensity": "",
    },
    "MTF and encircled energy": {
        "psf.mtf(scene)": "missing 1 required positional argument: 'frequency'",
        "psf.mtf(result)": "missing 1 required positional argument: 'frequency'",
        "psf.mtf(wave)": "missing 1 required positional argument: 'frequency'",
        "psf.encircled_energy(scene, 20e-6)": "",
        "psf.encircled_energy(result, [10e-6, 20e-6])": "",
        "psf.encircled_energy(result.point_spread, 20e-6)": "",
    },
    "image of a picture": {
        "nlos.simulate(scene).image.electrons": "",
        "imaging.form_image(scene)": "",
        "nlos.simulate(replace(scene, hidden=replace(scene.hidden, image=picture)))": "",
        "scene.with_values({'hidden.image': 'picture.png'})": "",
        "imaging.ForwardModel(result.point_spread, shape=(32, 32)).forward(result.image.ideal)": "",
        "nlos.reconstructing.known_model(scene).forward(result.image.ideal)": "",
    },
    "spots and Zernike coefficients": {
        "psf.spot_diagram(scene)": "",
        "views.spot_diagram(scene)": "",
        "psf.spot_radius(scene)": "",
        "psf.through_focus(scene)": "",
        "psf.fit_zernike(scene)": "",
        "psf.fit_zernike(wave, 15)": "",
        "psf.rms_aberration(result)": "",
    },
    "sweep": {
        "study.sweep(scene, {'wall.curvature': [-0.1, 0.0, 0.1]}, figures=['strehl'])": "",
        "study.sweep(scene, {'camera.f_number': np.array([4, 8])}, 'strehl').to_dataframe()": "",
        "study.sweep(scene, {'laser.power': [1e-3, 5e-3]}, figures=['photons']).to_xarray()": "",
        "views.study_map(study.sweep(scene, {'camera.f_number': [4, 8]}, 'strehl'), 'strehl')": "",
        "study.sweep(scene, {'camera.f_number': [4, 8]}, figures=['mtf'])": "argument: 'frequency'",
    },
    "reconstruct a photograph": {
        "inverse.tv_deconvolve(photo, kernel)": "",
        "inverse.wiener(photo, result.point_spread)": "",
        "inverse.richardson_lucy(result.image, kernel)": "",
        "inverse.tv_deconvolve(imaging.camera_image('picture.png'), kernel)": "",
        "inverse.wiener(photo, result)": "",
        "result.reconstruction.object": "",
    },
    "time-resolved light": {
        "transient.render_scene(flash)": "",
        "transient.load_capture('capture.hdf5')": "use TransientCapture.load",
        "transient.phasor_image(capture)": "missing 1 required positional argument: 'volume'",
        "transient.backprojection(capture, volume)": "",
        "transient.depth_map(transient.phasor_image(capture, volume))": "argument: 'wl_mean'",
    },
    "plot, save, export": {
        "result.plot()": "",
        "result.point_spread.plot()": "",
        "views.image(result)": "",
        "result.save('run')": "",
        "np.asarray(result.point_spread)": "",
        "psf.to_prysm(wave)": "sample it with nodes='grid'",
    },
}


@pytest.fixture(scope="module")
def nouns(tmp_path_factory):
    """What the lines name: a scene of 32 x 32 pixels, its result, a photograph, a capture."""
    file = SCENES / "letter_flat.toml"
    scene = nlos.Scene.load(file).resized(32)
    picture = np.zeros((16, 16))
    picture[4:12, 6:10] = 0.8
    result = nlos.simulate(scene, 1e-2, reconstruct=True)
    row = np.exp(-(np.linspace(-2.0, 2.0, 9) ** 2))
    folder = tmp_path_factory.mktemp("natural")
    Image.fromarray(np.uint8(255 * np.kron(picture, np.ones((2, 2))))).save(folder / "picture.png")
    wall = transient.wall_grid(side=0.6, count=8)
    counts = np.random.default_rng(1).random((96, 8, 8))
    return {
        **{name: getattr(nlos, name) for name in nlos.__all__},
        **globals(),
        "folder": folder,
        "file": file,
        "scene": scene,
        "concave": nlos.Scene.load(SCENES / "letter_concave.toml").resized(32),
        "flash": nlos.Scene.load(SCENES / "transient_letter.toml", {"transient.count": 4}),
        "laser": scene.laser,
        "camera": scene.camera,
        "picture": picture,
        "letter": nlos.PlanarObject(picture, 0.7, position=scene.hidden.position),
        "result": result,
        "wave": psf.wavefront(scene),
        "kernel": np.outer(row, row),
        "photo": result.image.electrons,
        "capture": transient.TransientCapture(
            H=counts, laser_points=np.zeros(3), sensor_points=wall, delta_t=0.04
        ),
        "volume": transient.Volume.facing(wall, (0.5, 1.5, 0.1)),
    }


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        pytest.param(*pair, marks=pytest.mark.thorough if pair[0].startswith(SLOW) else ())
        for lines in LINES.values()
        for pair in lines.items()
    ],
)
def test_a_natural_line_works_or_names_the_right_call(nouns, line, answer, monkeypatch):
    monkeypatch.chdir(nouns["folder"])
    if not answer:
        eval(line, nouns)
        return
    with pytest.raises((nlos.errors.NlosError, AttributeError, TypeError)) as refused:
        eval(line, nouns)
    assert answer in str(refused.value)
    assert "\n" not in str(refused.value)


def test_most_lines_work():
    answers = [answer for lines in LINES.values() for answer in lines.values()]
    assert len(LINES) == 10
    assert len(answers) == 66
    assert answers.count("") >= 55


def test_scenes_and_results_give_the_figures_of_their_waves(nouns):
    scene, result, wave = (nouns[name] for name in ("scene", "result", "wave"))
    for function in (psf.strehl, psf.rms_aberration, psf.spot_radius, psf.fit_zernike):
        assert function(scene) == approx(function(wave))
        assert function(result) == approx(function(wave))
    spread = result.point_spread
    assert np.array_equal(np.asarray(spread), spread.intensity)
    assert psf.point_spread(result, tol=1e-2).shape == spread.shape
    assert psf.encircled_energy(result, 1e-4) == psf.encircled_energy(spread, 1e-4)
    assert pickle.loads(pickle.dumps(psf.strehl)) is psf.strehl
    assert "electrons" in result.summary()


def test_a_curvature_is_a_signed_radius_and_passes_through_flat(nouns):
    scene, concave = nouns["scene"], nouns["concave"]
    assert (
        concave.with_values({"wall.radius": 4.0}).wall
        == concave.with_values({"wall.curvature": 0.25}).wall
    )
    walls = [scene.with_values({"wall.curvature": c}).wall for c in (-0.25, 0, "0.25 1/m")]
    assert [type(wall).__name__ for wall in walls] == ["ConvexWall", "FlatWall", "ConcaveWall"]
    # physics: the light of a concave wall comes to its focus in front of the detector, W < 0
    defocus = [psf.fit_zernike(scene.with_values({"wall.curvature": c}))[4] for c in (-0.01, 0.01)]
    assert defocus[0] > 0 > defocus[1]
    wavy = nlos.Scene.load(SCENES / "letter_wavy.toml")
    bent = wavy.with_values({"wall.curvature": 0.1})
    assert bent.wall.terms == (
        replace(wavy.wall, size=bent.wall.terms[0].size),
        nlos.ConcaveWall(10.0),
    )
    with pytest.raises(nlos.errors.SceneError, match="convex wall has a shape of its own"):
        concave.with_values({"wall.radius": -4.0})
    same = concave.with_values({})
    assert (same.wall, same.camera, same.laser) == (concave.wall, concave.camera, concave.laser)


def test_a_sweep_agrees_with_scenes_one_by_one(nouns):
    scene = nouns["scene"]
    bends, stops = [-0.02, 0.0, 0.02], np.array([5e-3, 1e-2])
    axes = {"wall.curvature": bends, "camera.stop_diameter": stops}
    table = study.sweep(scene, axes, figures=["aberration_rms"]).to_xarray()
    for c in bends:
        for d in stops:
            wave = psf.wavefront(
                scene.with_values({"wall.curvature": c, "camera.stop_diameter": d})
            )
            found = table["aberration_rms"].sel({"wall.curvature": c, "camera.stop_diameter": d})
            assert float(found) == approx(psf.rms_aberration(wave) / wave.wavelength)
