"""
A first point spread function
=============================

The image of one object point is the point spread function. A slightly concave relay wall aberrates
it. Three steps compute it: load a scene, compute the wavefront at the pupil, and transform it to
the point spread function.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import nlosoptics as nlos
from nlosoptics import psf, views
from nlosoptics.scene import ConcaveWall

plt.style.use("nlosoptics.views.palette")

# %%
# The scene
# ---------
# The scene file describes laser, wall, object and camera, with units. Its wall is flat. Here it is
# replaced by part of a sphere of 6 m radius, and the lens is stopped down to 4 mm. The camera is
# focused on the mirror image of the object in the flat wall.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_speckle.toml")
flat = replace(scene, camera=replace(scene.camera, stop_diameter=4e-3))
concave = replace(flat, wall=ConcaveWall(6.0, size=flat.wall.size))

# %%
# Wavefront and point spread function
# -----------------------------------
# `psf.wavefront` traces a ray from the object point via the wall to every sample point of the pupil
# and computes its optical path. The constant part (piston) has no effect on the image, and the
# linear part (tilt) only shifts it; both are removed. `psf.point_spread` selects the transform that
# reaches the requested error in the least time, and states the reason.

wave = psf.wavefront(concave)
spread = psf.point_spread(wave, tol=1e-3, pitch=1e-6, shape=201)
perfect = psf.point_spread(psf.wavefront(flat), tol=1e-3, pitch=1e-6, shape=201)
print(f"transform: {spread.reason}")
print(f"estimated error: {spread.error_estimate:.1g} of the peak")
print(f"error of the scalar model: {spread.model_error:.1g} of the peak")

# %%
# Results
# -------
# The wavefront shows defocus and astigmatism. The astigmatism is due to the oblique incidence on
# the wall, which focuses more strongly along one axis. The last panel is a cut through the
# reference point, where a wave without aberration would have its peak.

figure, axes = plt.subplots(1, 3, figsize=(13.5, 4), layout="constrained")
views.wavefront(wave, axes=axes[0])
views.point_spread(spread, decades=4, half_width=60e-6, axes=axes[1])
middle = spread.shape[0] // 2
for found, label in ((perfect, "flat wall"), (spread, "concave wall")):
    axes[2].plot(found.x * 1e6, found.intensity[middle] / perfect.intensity.max(), label=label)
axes[2].set(xlabel="x (µm)", ylabel="intensity / peak of the flat wall", xlim=(-60, 60))
axes[2].set_title("cut along x")
axes[2].set_box_aspect(1)
axes[2].legend(loc="upper left")
plt.show()

# %%
# Result:

peak_to_valley = spread.regime.peak_to_valley
across, up = (1e6 * width for width in psf.fwhm(spread))
airy = 1e6 * psf.fwhm(perfect)[0]
print(
    f"The concave wall adds an aberration of {peak_to_valley:.2f} waves peak to valley. The full "
    f"width at half maximum is {across:.1f} um along x and {up:.1f} um along y; with the flat wall "
    f"it is {airy:.1f} um. The peak is "
    f"{100 * spread.intensity.max() / perfect.intensity.max():.0f} % of that with the flat wall."
)
