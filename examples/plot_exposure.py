"""
Exposure: photons, noise and what they leave
============================================

A longer exposure brings more photons, and their noise grows only as the root of their number. Four
exposures of one letter show how the image clears up, and the reconstruction with it.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import nlosoptics as nlos
from nlosoptics import imaging, inverse, psf, views
from nlosoptics.scene import WavyWall

plt.style.use("tableau-colorblind10")

# %%
# The scene
# ---------
# A wavy wall, a stop of 8 mm and incoherent light, so that photons and the camera's own noise are
# all the noise there is. The laser has 20 mW; only the product of its power and the exposure
# counts. The point spread does not depend on the exposure, so it is computed once.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_speckle.toml").resized(128)
scene = replace(
    scene,
    laser=replace(scene.laser, power=20e-3),
    wall=WavyWall(0.5e-3, 0.25, phase=1.0, size=scene.wall.size),
    camera=replace(scene.camera, stop_diameter=8e-3),
)
spread = psf.scene_point_spread(scene).point_spread
model = imaging.ForwardModel(spread, shape=scene.camera.shape)

# %%
# Images and reconstructions
# --------------------------
# Above, the exposures; below, what total variation with the known point spread makes of them. The
# truth is known here, so that each can be scored by its correlation.

exposures = [10e-3, 20e-3, 30e-3, 40e-3]
figure, axes = plt.subplots(2, 4, figsize=(16, 7.4), layout="constrained")
scores, peaks = [], []
for exposure, column in zip(exposures, axes.T, strict=True):
    image = imaging.form_image(scene, spread, exposure=exposure, seed=1)
    found = inverse.tv_deconvolve(image.electrons, model)
    views.image(image, axes=column[0])
    views.reconstruction(found, axes=[column[1]])
    scores.append(inverse.registered_correlation(found, image.ideal))
    peaks.append(image.signal.max() / image.noise_sigma.max())
    column[0].set_title(f"image, {1e3 * exposure:.0f} ms")
    column[1].set_title(f"found, correlation {scores[-1]:.3f}")
plt.show()

# %%
# What to see:

print(
    f"From {1e3 * exposures[0]:.0f} to {1e3 * exposures[-1]:.0f} ms the brightest pixel goes from "
    f"{peaks[0]:.1f} to {peaks[-1]:.1f} times its noise, {peaks[-1] / peaks[0]:.2f}-fold for four "
    f"times the light. The reconstruction's correlation with the truth goes from {scores[0]:.3f} "
    f"to {scores[-1]:.3f}."
)
