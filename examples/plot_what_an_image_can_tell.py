"""
What an image can tell
======================

A wall scatters light by its slopes: the rougher its gloss, the wider the blur. Before any fit,
`limits.feasibility` says from photons, noise and blur up to which frequency an image holds the
object, and whether a reconstruction can be expected to succeed.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import nlosoptics as nlos
from nlosoptics import limits, views
from nlosoptics.scene import OrenNayar, SpecularMicrofacet, SumMaterial

plt.style.use("tableau-colorblind10")

# %%
# One wall, rougher and rougher
# -----------------------------
# A matt body with a gloss of 5 %, whose slopes have an rms of 0 to 0.08 rad.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_flat.toml").resized(64)
slopes = [0.0, 0.01, 0.02, 0.04, 0.08]
body = OrenNayar(0.75, 0.3)
found = {
    slope: limits.feasibility(
        replace(scene, wall_material=SumMaterial((body, SpecularMicrofacet(0.05, slope_rms=slope))))
    )
    for slope in slopes
}

# %%
# Look
# ----
# Left and middle: modulation against frequency on the object; what lies above the dashed line of
# its noise can be told, and the grey line is the frequency of the letter's strokes. Right: the
# expected correlation of a reconstruction, against the slopes.

figure, axes = plt.subplots(1, 3, figsize=(15, 4.4), layout="constrained")
for axis, slope in zip(axes, (0.01, 0.04), strict=False):
    views.feasibility(found[slope], axes=axis)
    axis.set_title(f"slopes {slope:g} rad: {found[slope].verdict.split(':')[0]}")
axes[2].plot(slopes, [one.score for one in found.values()], "o-")
axes[2].axhline(0.9, color="0.5", lw=1, label="recoverable above")
axes[2].set(xlabel="slope rms (rad)", ylabel="expected correlation", ylim=(0, 1.05))
axes[2].legend()
plt.show()

# %%
# What to see:

for slope, one in found.items():
    print(f"{slope:5.2f} rad: up to {one.limit:4.1f} cycles/m, {one.modes} modes; {one.verdict}")
