"""
Feasibility of a reconstruction
===============================

The slopes of a rough wall blur the image: the wider the specular lobe, the larger the blur.
`limits.feasibility` predicts from signal, noise and blur up to which spatial frequency an image
contains information about the object, and whether a reconstruction will succeed.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import nlosoptics as nlos
from nlosoptics import limits, views
from nlosoptics.scene import OrenNayar, SpecularMicrofacet, SumMaterial

plt.style.use("nlosoptics.views.palette")

# %%
# A wall of increasing roughness
# ------------------------------
# The wall reflects most light diffusely and 5 % like a mirror (specular lobe). The slopes of the
# mirror-like surface have an rms of 0 to 0.08 rad.

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
# Modulation and score
# --------------------
# Top: the modulation against the spatial frequency on the object. Only frequencies with a
# modulation above the dashed noise limit are detectable. The grey line is the frequency of the
# strokes of the letter. Bottom: the predicted correlation of a reconstruction, with the expected
# scatter of single fits, against the rms slope.

figure, axes = plt.subplot_mosaic("ab;cc", figsize=(10, 8), layout="constrained")
for axis, slope in zip((axes["a"], axes["b"]), (0.01, 0.04), strict=True):
    views.feasibility(found[slope], axes=axis)
    axis.set_title(f"rms slope {slope:g} rad: {found[slope].verdict.split(':')[0]}")
scores, spreads = zip(*((one.score, one.score_spread) for one in found.values()), strict=True)
axes["c"].errorbar(slopes, scores, spreads, fmt="o-", capsize=3)
axes["c"].axhline(0.9, color="0.5", lw=1, label="recoverable above")
axes["c"].set(xlabel="rms slope (rad)", ylabel="predicted correlation", ylim=(0, 1.05))
axes["c"].set_title("correlation of a reconstruction against slope")
axes["c"].legend()
plt.show()

# %%
# Result:

for slope, one in found.items():
    print(f"{slope:5.2f} rad: up to {one.limit:4.1f} cycles/m, {one.modes} modes; {one.verdict}")
