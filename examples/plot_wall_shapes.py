"""
One letter and four wall shapes
===============================

The hidden letter, the camera and the laser are fixed; only the shape of the relay wall changes.
Every wall gives another wavefront, another point spread function and another image. All four have
a faint gloss, which makes the image; a matt wall of any shape makes none.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import nlosoptics as nlos
from nlosoptics import psf, views
from nlosoptics.scene import ConcaveWall, ConvexWall, FlatWall, WavyWall

# %%
# Four scenes
# -----------
# A small letter is 1 m from the wall, and the camera has a stop of 8 mm. ``resized`` reduces the
# number of pixels and keeps the field of view.

scenes = Path(__file__).parent / "scenes"
small = nlos.Scene.load(scenes / "letter_speckle.toml").resized(128)
small = replace(small, camera=replace(small.camera, stop_diameter=8e-3, exposure=0.5))
size = small.wall.size
walls = {
    "flat": FlatWall(size=size),
    "concave, R = 3 m": ConcaveWall(3.0, size=size),
    "convex, R = 3 m": ConvexWall(3.0, size=size),
    "wavy, 0.2 mm": WavyWall(0.2e-3, 0.25, phase=np.radians(60), size=size),
}
results = {
    name: nlos.simulate(replace(small, wall=wall), tol=1e-2, seed=0) for name, wall in walls.items()
}

# %%
# Wavefronts, point spread functions and images
# ---------------------------------------------
# The rows show the wave aberration at the lens, the point spread function of the object's centre at
# a pitch that resolves diffraction, and one exposure with noise. The letter is mirror-reversed,
# because the wall acts as a mirror.

figure, axes = plt.subplots(3, 4, figsize=(15.5, 9), layout="constrained")
spots = {}
for (name, result), column in zip(results.items(), axes.T, strict=True):
    views.wavefront(result.wavefront, axes=column[0])
    spots[name] = psf.point_spread(result.wavefront, pitch=1e-6, shape=361)
    views.point_spread(spots[name], decades=4, axes=column[1])
    views.image(result.image, axes=column[2])
    for axis, title in zip(column, (name, "point spread function", "camera image"), strict=True):
        axis.set_title(title)
plt.show()

# %%
# Result:

for name, result in results.items():
    image = result.image
    lit = image.ideal > 0.5 * image.ideal.max()
    height = 1e3 * image.pitch * np.ptp(np.flatnonzero(lit.any(axis=1)))
    print(
        f"{name:17s}{spots[name].regime.peak_to_valley:4.1f} waves peak to valley; PSF peak "
        f"{spots[name].intensity.max() / spots['flat'].intensity.max():.3f} of that of the flat "
        f"wall; height of the letter in the image {height:.2f} mm"
    )
