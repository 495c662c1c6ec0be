"""
One letter off four walls
=========================

The same hidden letter, the same camera, the same light: only the shape of the relay wall changes.
Each wall gives the light another wave, each wave another point spread, and each point spread
another image.
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
# A small letter, 1 m from the wall, seen by a camera with a stop of 8 mm. ``resized`` keeps the
# field of view and makes the image smaller.

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
# Waves, point spreads and images
# -------------------------------
# Above, the wave aberration at the lens; in the middle, the image of the object's centre, with
# diffraction resolved; below, one exposure with its noise. The mirror writing is right: a wall
# shows the letter as a mirror does.

figure, axes = plt.subplots(3, 4, figsize=(16, 11), layout="constrained")
spots = {}
for (name, result), column in zip(results.items(), axes.T, strict=True):
    views.wavefront(result.wavefront, axes=column[0])
    spots[name] = psf.point_spread(result.wavefront, pitch=1e-6, shape=361)
    views.point_spread(spots[name], decades=4, axes=column[1])
    views.image(result.image, axes=column[2])
    for axis, title in zip(column, (name, "point spread", "image"), strict=True):
        axis.set_title(title)
plt.show()

# %%
# What to see:

for name, result in results.items():
    image = result.image
    lit = image.ideal > 0.5 * image.ideal.max()
    height = 1e3 * image.pitch * np.ptp(np.flatnonzero(lit.any(axis=1)))
    print(
        f"{name:17s}{spots[name].regime.peak_to_valley:4.1f} waves peak to valley; peak of the "
        "spot "
        f"{spots[name].intensity.max() / spots['flat'].intensity.max():.3f} of the flat wall's; "
        f"letter {height:.2f} mm high in the image"
    )
