"""Lines as users of prysm, HCIPy, Optiland, deepinv and y-tal would write them at first.

They were written down before they were tried. Each works, or answers in one line with the right
call.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import imaging, inverse, limits, psf, study, transient, views
from nlosoptics.errors import NlosError

SCENES = Path(__file__).parents[1] / "examples" / "scenes"

#: Lines by task, each with the right call that its error names; empty if the line works.
LINES = {
    "load a scene": {
        "nlos.Scene.load(file)": "",
        "nlos.Scene.load(str(file))": "",
        "nlos.load_scene(file)": "",
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
        "scene.with_values({'camera.fnumber': 8})": "",
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
        "psf.fwhm(scene)": "",
        "psf.exit_pupil(scene).f_number": "",
        "result.point_spread.intensity": "",
    },
    "MTF and encircled energy": {
        "psf.mtf(scene)": "",
        "psf.mtf(result)": "",
        "psf.mtf(wave)": "",
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
        "study.sweep(scene, {'camera.f_number': [4, 8]}, figures=['mtf'])": "",
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
        "transient.load_capture('capture.hdf5')": "",
        "transient.phasor_image(capture)": "",
        "transient.backprojection(capture, volume)": "",
        "transient.depth_map(transient.phasor_image(capture, volume))": "",
    },
    "plot, save, export": {
        "result.plot()": "",
        "result.point_spread.plot()": "",
        "views.image(result)": "",
        "result.save('run')": "",
        "np.asarray(result.point_spread)": "",
        "psf.to_prysm(wave)": "",
    },
}
