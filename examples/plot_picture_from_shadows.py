"""
A picture from shadows
======================

A matt wall forms no image of a hidden object. Occluders between object and wall throw shadows on
the wall, and each point of the object throws them elsewhere. `inverse.shadow_fit` reads the object
off these shadows in one photograph.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import nlosoptics as nlos
from nlosoptics import imaging, limits

plt.style.use("nlosoptics.views.palette")

# %%
# Three discs before a letter
# ---------------------------
# A laser lights a letter by way of the wall, and the camera is focused on the wall. Without
# occluders, only a few patterns of the letter exceed the noise.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_discs.toml").resized(64)
bare = replace(scene, occluders=())
for count, one in ((0, bare), (3, scene)):
    forecast = limits.feasibility(one)
    print(f"{count} discs: {forecast.diffuse_modes} modes, correlation {forecast.relay_score:.2f}")

# %%
# Image, shadows and letter
# -------------------------
# The shadows are faint: the second picture is the light on the wall over that of the same scene
# without discs. Penumbrae overlap and hide the letter from the eye, but not from the fit, which
# knows the discs. It is shown as a viewer at the wall sees it.

result = nlos.simulate(scene, reconstruct=True)
lit, unshaded = (imaging.form_image(one, None).background for one in (scene, bare))
fit = result.reconstruction

pictures = {
    "photograph of the wall": result.image.electrons,
    "light with over without discs": np.where(unshaded > unshaded.max() / 20, lit / unshaded, 0.0),
    f"from its shadows: {fit.status}": fit.object,
    "letter": scene.hidden.reflectance,
}
figure, axes = plt.subplots(1, 4, figsize=(12, 3.4), layout="constrained")
for axis, (title, picture) in zip(axes, pictures.items(), strict=True):
    axis.imshow(picture, vmin=0.0)
    axis.set(title=title, xticks=[], yticks=[])
plt.show()

# %%
# Result:

values = fit.physical_parameters
print(f"{values['modes']:.0f} modes, expected correlation {values['expected_correlation']:.2f}")
