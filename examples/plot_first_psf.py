"""
A first point spread function
=============================

A relay wall that is hollow by a hair bends the light of one object point before the lens gathers
it. What the camera makes of that point is the point spread function. Three calls lead there: a
scene, the wave that arrives at the lens, and its point spread.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import nlosoptics as nlos
from nlosoptics import psf, views
from nlosoptics.scene import ConcaveWall

plt.style.use("tableau-colorblind10")

# %%
# The scene
# ---------
# The file describes laser, wall, object and camera with their units. Its wall is flat; here it
# becomes a part of a sphere of 6 m radius, and the lens is stopped down to 4 mm. The camera is
# focused on the object's mirror image in the flat wall.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_speckle.toml")
flat = replace(scene, camera=replace(scene.camera, stop_diameter=4e-3))
concave = replace(flat, wall=ConcaveWall(6.0, size=flat.wall.size))

# %%
# Wave and point spread
# ---------------------
# `psf.wavefront` aims a ray from the object point by way of the wall to every node of the pupil
# and measures its path. Piston and tilt are taken out, because they only move the image.
# `psf.point_spread` chooses the transform that reaches the wanted error in the least time, and says
# why.

wave = psf.wavefront(concave)
spread = psf.point_spread(wave, tol=1e-6, pitch=1e-6, shape=201)
perfect = psf.point_spread(psf.wavefront(flat), tol=1e-6, pitch=1e-6, shape=201)
print(f"transform: {spread.reason}")
print(f"estimated error: {spread.error_estimate:.1g} of the peak")

# %%
# Look
# ----
# Over the pupil the wave is defocused, and astigmatic: the wall is met aslant, so that it focuses
# along one axis more than along the other. The last panel cuts through the reference point.

figure, axes = plt.subplots(1, 3, figsize=(13.5, 4.2), layout="constrained")
views.wavefront(wave, axes=axes[0])
views.point_spread(spread, decades=4, half_width=60e-6, axes=axes[1])
middle = spread.shape[0] // 2
for found, label in ((perfect, "flat wall"), (spread, "concave wall")):
    axes[2].plot(found.x * 1e6, found.intensity[middle] / perfect.intensity.max(), label=label)
axes[2].set(xlabel="x (µm)", ylabel="intensity, flat wall's peak 1", xlim=(-60, 60))
axes[2].set_title("cut through the centre")
axes[2].legend(loc="upper left")
plt.show()

# %%
# What to see:

peak_to_valley = spread.regime.peak_to_valley
across, up = (1e6 * width for width in psf.fwhm(spread))
airy = 1e6 * psf.fwhm(perfect)[0]
print(
    f"The concave wall adds {peak_to_valley:.2f} waves from peak to valley. At half maximum the "
    "spot "
    f"is {across:.1f} um wide and {up:.1f} um high, {airy:.1f} um off the flat wall; its peak is "
    f"{100 * spread.intensity.max() / perfect.intensity.max():.0f} % of the flat wall's."
)
