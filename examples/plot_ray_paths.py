"""
Light paths and power budget
============================

On its way from the laser to the lens, the signal is reflected three times: by the wall, the hidden
object and the wall again. Ray tracing shows these paths in 3-D, and how little of the laser power
follows them.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import pyvista

import nlosoptics as nlos
from nlosoptics import raytrace, views

plt.style.use("nlosoptics.views.palette")

# %%
# Ray tracing
# -----------
# `raytrace.trace` traces rays from the laser until they are detected, absorbed or leave the scene.
# ``keep_paths=True`` keeps the vertices of the detected paths.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_wavy.toml")
paths = raytrace.trace(scene, n_rays=8192, max_bounces=3, keep_paths=True, seed=0)

# %%
# Paths in 3-D
# ------------
# The view shows 300 of the paths via the letter, sampled in proportion to power and coloured by
# path length. Stray light is drawn only if there are fewer such paths. The beam of the laser on the
# right passes behind the plane of the letter, which faces the wall and is seen here from its back.
# ``views.save(plotter, "room.html")`` writes an interactive web page.

plotter = pyvista.Plotter(window_size=(1100, 800))
views.ray_paths(paths, scene, colour="path_length", most=300, plotter=plotter)
plotter.show()

# %%
# Power budget
# ------------
# The bars show where the laser power ends, as fractions on a logarithmic scale. "still travelling"
# is the power after the third reflection; "escaped" is light that leaves the scene.

shares = {fate: power / scene.laser.power for fate, power in paths.ledger.items() if power > 0}
figure, axis = plt.subplots(figsize=(5.1, 3.4), layout="constrained")
names = ["still travelling" if fate == "left" else fate for fate in shares]
bars = axis.barh(names, list(shares.values()))
axis.bar_label(bars, fmt="%.2g", padding=3)
axis.set(xscale="log", xlim=(1e-9, 300), xlabel="fraction of the laser power")
axis.set_title("power budget, three reflections")
plt.show()

# %%
# Result:

print(
    f"Of {1e3 * scene.laser.power:g} mW laser power, {paths.flux:.2g} +- "
    f"{paths.standard_error:.1g} W reach the detector via the letter, one part in "
    f"{scene.laser.power / paths.flux:.1g}. The mean length of these paths is "
    f"{paths.mean_path_length:.2f} m."
)
