"""
Where the light goes
====================

Laser, wall, object, wall, lens: light that the camera can use meets three surfaces on its way.
Traced rays show these paths in the room, and how little of the light takes them.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import pyvista

import nlosoptics as nlos
from nlosoptics import raytrace, views

plt.style.use("tableau-colorblind10")

# %%
# Traced light
# ------------
# `raytrace.trace` follows light from the laser until it is detected, absorbed or gone. With
# ``keep_paths`` the detected paths are kept with their vertices.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_wavy.toml")
paths = raytrace.trace(scene, n_rays=8192, max_bounces=3, keep_paths=True, seed=0)

# %%
# The room
# --------
# 300 of the paths, drawn as densely as the light they carry, coloured by their length. The beam
# comes from the laser on the right, and the letter stands behind it. ``views.save(plotter,
# "room.html")`` writes a page in which the room can be turned.

plotter = pyvista.Plotter(window_size=(1100, 800))
views.ray_paths(paths, scene, colour="path_length", most=300, plotter=plotter)
plotter.show()

# %%
# The ledger
# ----------
# Where the laser's power went, on a logarithmic scale.

shares = {fate: power / scene.laser.power for fate, power in paths.ledger.items() if power > 0}
figure, axis = plt.subplots(figsize=(7.5, 3.8), layout="constrained")
bars = axis.barh(list(shares), list(shares.values()))
axis.bar_label(bars, fmt="%.2g", padding=3)
axis.set(xscale="log", xlim=(1e-9, 30), xlabel="share of the laser's power")
axis.set_title("fates of the light within three reflections")
plt.show()

# %%
# What to see:

print(
    f"Of {1e3 * scene.laser.power:g} mW the detector gets {paths.flux:.2g} +- "
    f"{paths.standard_error:.1g} W by way of the letter, one part in "
    f"{scene.laser.power / paths.flux:.1g}. Those paths are {paths.mean_path_length:.2f} m long on "
    "average."
)
