"""
From rough facets to the point spread function
==============================================

A rough wall is a mirror with aberrations. This page follows the light of one object point: from the
facets of the wall to the wave in the exit pupil, by an FFT to the point spread function (PSF), and
to the mean over many walls. A single call of `psf.scene_point_spread` does all steps. It chooses
among four methods and states which one it used.
"""

# %%
# One wall
# --------
# The relief is a surface of plane triangles. Its heights are determined by the seed alone, so that
# rays, waves and every object point see the same wall.
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from nlosoptics import Scene, psf, views
from nlosoptics.scene import FacetWall, GaussianWall, SpecularMicrofacet, WallRoughness

plt.style.use("nlosoptics.views.palette")
scene = Scene.load(Path(__file__).parent / "scenes" / "letter_flat.toml")
scene = replace(scene, wall_material=SpecularMicrofacet(0.05, 0.0))
wall = FacetWall(cell=1e-3, slope_rms=5e-4, seed=1)
x, y = np.meshgrid(*[np.linspace(-5e-3, 5e-3, 400)] * 2)
_, axes = plt.subplots(figsize=(5, 4), layout="constrained")
drawn = axes.pcolormesh(x * 1e3, y * 1e3, wall.height(x, y) * 1e9, cmap="viridis", rasterized=True)
axes.set(xlabel="x (mm)", ylabel="y (mm)", title="heights of the rough wall", aspect="equal")
plt.colorbar(drawn, label="height (nm)")

# %%
# Gentle slopes: a wave aberration
# --------------------------------
# If the relief deflects rays so little that diffraction between wall and pupil does not matter,
# rays give the amplitude A and the wave aberration W. The pupil function is then ``A exp(ikW)``,
# with the wavenumber k.


def seen(heights, realisation="pattern", parts=16, shape=81):
    rough = replace(scene, wall_roughness=WallRoughness(heights, realisation))
    pitch = scene.camera.image_pitch / parts
    return psf.scene_point_spread(rough, tol=1e-2, pitch=pitch, shape=shape)


gentle = seen(GaussianWall(height_rms=3e-7, correlation_length=8e-3, seed=1), parts=64)
print(gentle.point_spread.reason)
_, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
views.wavefront(gentle.wavefront, axes=left)
views.point_spread(gentle.point_spread, scale="linear", half_width=20e-6, axes=right)

# %%
# Facets: a field propagated to the pupil
# ---------------------------------------
# The facets send light to neighbouring parts of the pupil, where it interferes. The wall is then a
# phase screen, and its field is propagated from the wall to the pupil by a Fresnel integral. Its
# amplitude and phase are the pupil function.
facets = seen(wall)
print(facets.point_spread.reason)
_, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
views.wavefront(facets.pupil_field, axes=left)
views.point_spread(facets.point_spread, scale="linear", axes=right)

# %%
# The mean over walls
# -------------------
# The mean over all walls of this roughness is computed without random walls. The average over
# random walls approaches it; with eight walls the difference is about a third.
mean = seen(wall, "mean")
some = np.mean([seen(replace(wall, seed=n)).point_spread.intensity for n in range(8)], axis=0)
_, axes = plt.subplots(figsize=(5.1, 3.9), layout="constrained")
row, pixel = 40, mean.point_spread.pitch * 1e6
for intensity, label in (
    (facets.point_spread.intensity, "this wall"),
    (some, "average of 8 walls"),
    (mean.point_spread.intensity, "mean of all walls"),
):
    axes.plot((np.arange(81) - 40) * pixel, intensity[row] * 1e3, label=label)
axes.set(xlabel="x (µm)", ylabel="energy per pixel (‰ of all)", title="PSFs along x")
axes.legend()

# %%
# Another object point sees the same field, displaced
# ----------------------------------------------------
# Displacing the object point shifts the wall's field across the pupil. The pattern therefore keeps
# its shape over some millimetres only: the memory effect. An image of a small object is formed with
# patterns of several object points, that of a large one with the mean; `plan` says which.
bright = mean.point_spread.intensity > 0.1 * mean.point_spread.intensity.max()


def speckle(spread):
    """Return the pattern relative to the mean, where that is bright."""
    return spread.intensity[bright] / mean.point_spread.intensity[bright]


rough = replace(scene, wall_roughness=WallRoughness(wall))
steps, found = (1e-3, 3e-3, 10e-3), []
for step in steps:
    point = scene.object_point + np.array([step, 0.0, 0.0])
    other = psf.scene_point_spread(
        rough, tol=1e-2, object_point=point, pitch=mean.point_spread.pitch, shape=81
    )
    pair = speckle(facets.point_spread), speckle(other.point_spread)
    found.append(np.corrcoef(*pair)[0, 1])
plt.show()

# %%
# Result:

shown = ", ".join(
    f"{value:.2f} at {1e3 * step:.0f} mm" for step, value in zip(steps, found, strict=True)
)
print(f"The correlation of this wall's pattern with that of a displaced object point is {shown}.")
