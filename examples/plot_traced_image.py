"""
An image by rays and by waves
=============================

The same camera image is computed by two independent methods: with point spread functions, and by
tracing rays from the laser to the pixels. Within the standard errors they agree in every pixel. The
same rays also give the lengths of the light's paths.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import nlosoptics as nlos
from nlosoptics import imaging, psf, raytrace, views

plt.style.use("nlosoptics.views.palette")

# %%
# Image by waves
# --------------
# `imaging.form_image` multiplies the radiance of the letter, as each pixel sees it by way of the
# wall, with the reflectance of the wall's mirror-like lobe, and convolves it with the point spread
# function. The diffuse light of the wall is added. The camera reads out the middle of its sensor.
# The image is computed with pixels of a quarter of the side, which are then summed, because the
# convolution treats the light of a pixel as if it came from the pixel's centre.

room = nlos.Scene.load(Path(__file__).parent / "scenes" / "letter_wavy.toml")
room = replace(room, camera=replace(room.camera, pixels=(1536, 1536), binning=48))
fine = replace(room, camera=replace(room.camera, binning=12))
spread = psf.scene_point_spread(fine, tol=1e-2).point_spread
waves = imaging.form_image(fine, spread).expected.reshape(32, 4, 32, 4).sum(axis=(1, 3))

# %%
# Image by rays
# -------------
# `raytrace.trace_image` follows the light from the laser over wall, letter and wall to random
# points of the lens, which images it onto the pixels. Each pixel has a standard error. The same
# rays also fill bins of path length.

bins = {"t_start": 4.2, "delta_t": 0.005, "n_bins": 40}
rays = raytrace.trace_image(room, n_rays=1 << 20, max_bounces=3, seed=0, **bins)

# %%
# Comparison
# ----------
# The third map shows the differences in standard errors, in colours that end at four of them. They
# look like noise of unit variance. A few pixels differ by more, mostly where the edge of the letter
# barely touches a pixel, so that few rays contribute to it.

off = (rays.expected - waves) / rays.expected_error
figure, axes = plt.subplots(1, 3, figsize=(14, 3.9), layout="constrained")
side = 16 * 1e3 * rays.pitch
style = {"extent": (-side, side, -side, side)}
for axis, values, title in (
    (axes[0], waves, "camera image by waves"),
    (axes[1], rays.expected, f"camera image by {rays.paths.n_rays / 1e6:.1f} million rays"),
):
    drawn = axis.imshow(values, cmap="gray", vmin=0.0, vmax=waves.max(), **style)
    figure.colorbar(drawn, ax=axis, shrink=0.9, label="electrons per pixel")
    axis.set(title=title, xlabel="x (mm)", ylabel="−y, up (mm)")
drawn = axes[2].imshow(off, cmap="RdBu_r", vmin=-4.0, vmax=4.0, **style)
label = "difference (standard errors)"
figure.colorbar(drawn, ax=axes[2], shrink=0.9, extend="both", label=label)
axes[2].set(title="rays minus waves", xlabel="x (mm)", ylabel="−y, up (mm)")
plt.show()

# %%
# Path lengths
# ------------
# `views.path_lengths` draws the power against the length of the path from the laser to the lens. A
# camera with time resolution would measure this curve. `transient.render` computes it for each
# point of a matt wall.

figure, axis = plt.subplots(figsize=(5.1, 4), layout="constrained")
views.path_lengths(rays.histogram, axes=axis)
plt.show()

# %%
# Result:

print(
    f"{100 * np.mean(abs(off) < 2):.0f} % of the pixels differ by less than two standard errors, "
    f"whose median is {100 * np.median(rays.expected_error / waves):.1f} % of the pixel's light."
)
