"""
Propagating a field
===================

`psf.propagate` computes the light field on a plane from its samples on a parallel plane. It selects
the method, and states bounds of two errors: of the numerical error and of the Fresnel
approximation.
"""

import matplotlib.pyplot as plt
import numpy as np

from nlosoptics import psf

plt.style.use("nlosoptics.views.palette")

# %%
# A bright spot behind a disc
# ---------------------------
# A wide Gaussian beam passes an opaque disc of 1 mm. On the axis, the waves from its whole rim
# arrive in phase.

wavelength, radius, pitch = 633e-9, 0.5e-3, 12e-6


def behind_disc(x, y):
    r = np.hypot(x, y)
    covered = np.clip((r - radius) / pitch + 0.5, 0.0, 1.0)  # cells on the rim transmit in part
    return covered * np.exp(-((r / 1.1e-3) ** 2))


field = psf.ScalarField.from_function(behind_disc, pitch=pitch, shape=300, wavelength=wavelength)
distances = (0.05, 0.2, 0.8)
found = [psf.propagate(field, z, tol=5e-3) for z in distances]
figure, axes = plt.subplots(
    2, 2, figsize=(8.6, 7.6), sharex=True, sharey=True, layout="constrained"
)
for each, plane in zip(axes.flat, [field, *found], strict=True):
    edges = 1e3 * np.array([plane.x[0], plane.x[-1], plane.y[0], plane.y[-1]])
    shown = each.imshow(plane.intensity, origin="lower", extent=edges, vmin=0, vmax=0.8)
    each.set_title(f"{plane.z:g} m behind the disc" if plane.z else "at the disc")
    each.set(xlabel="x (mm)", ylabel="y (mm)")
    each.label_outer()
figure.colorbar(shown, ax=axes, shrink=0.6, label="intensity / that of the beam's centre")

for plane in found:
    print(
        f"z = {plane.z:g} m: {plane.method}, numerical error {plane.error_estimate:.0e}, "
        f"model error {plane.model_error:.0e}"
    )

# %%
# Through the focus of a lens
# ---------------------------
# The output may have any pitch. Here a beam passes a soft aperture and a lens with a focal length
# of 200 mm. The output samples near the focus are 1 um apart.

focal_length = 0.2
lens = psf.ScalarField.from_function(
    lambda x, y: (
        np.exp(-((np.hypot(x, y) / 1e-3) ** 8))
        * np.exp(-1j * np.pi * (x**2 + y**2) / (wavelength * focal_length))
    ),
    pitch=12e-6,
    shape=256,
    wavelength=wavelength,
)
planes = np.linspace(0.17, 0.23, 61)
rows = [psf.propagate(lens, z, pitch=1e-6, shape=(1, 301)) for z in planes]
figure, each = plt.subplots(figsize=(5.1, 3.4), layout="constrained")
shown = each.pcolormesh(
    1e3 * planes,
    1e6 * rows[0].x,
    np.sqrt(np.array([row.intensity[0] for row in rows])).T,
    shading="nearest",
)
figure.colorbar(shown, label="amplitude / that at the lens")
each.set(xlabel="z, distance from the lens (mm)", ylabel="x (µm)", title="focus of a lens, y = 0")

# %%
# A grating repeats itself
# ------------------------
# With ``periodic=True`` the samples are one period of an infinite field, and the sums over its
# frequencies are exact. The grating appears again at the Talbot distance, 2 period² / wavelength.
# Between these Talbot images there are others with finer periods.

period = 80e-6
grating = psf.ScalarField.from_function(
    lambda x, y: (np.abs(x) < period / 8) * np.ones_like(y),
    pitch=period / 160,
    shape=(1, 160),
    wavelength=wavelength,
    periodic=True,
)
talbot = 2 * period**2 / wavelength
planes = np.linspace(0.0, talbot, 241)
carpet = [psf.propagate(grating, z, method="fresnel_transfer").intensity[0] for z in planes]
figure, each = plt.subplots(figsize=(5.1, 3.4), layout="constrained")
shown = each.pcolormesh(planes / talbot, 1e6 * grating.x, np.array(carpet).T, shading="nearest")
each.set(xlabel="z / Talbot distance", ylabel="x (µm)", title="one period of a grating")
figure.colorbar(shown, label="intensity / that in the slits")
plt.show()

# %%
# Result
# ------
# The bright spot exists at every distance and becomes wider with it. The picture of the focus
# consists of 61 planes, of which one row each was computed. At half the Talbot distance the grating
# is shifted by half a period.

half = psf.propagate(grating, talbot / 2, method="fresnel_transfer")
shifted = np.roll(grating.intensity, 80, axis=1)
print(f"largest deviation from the shifted grating: {np.abs(half.intensity - shifted).max():.0e}")
