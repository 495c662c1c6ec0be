"""
From specular to diffuse reflection
===================================

A smooth wall images a point to a sharp core. Random surface heights scatter energy from the core
into a halo, until no core is left. The remaining energy depends only on s, the rms phase that the
heights add: the core keeps a fraction :math:`e^{-s^2}`.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import nlosoptics as nlos
from nlosoptics import psf

plt.style.use("nlosoptics.views.palette")

# %%
# Walls from smooth to rough
# --------------------------
# `psf.mean_point_spread` computes the mean over all walls with the same statistics in closed form:
# the transfer function of the smooth wall is multiplied by :math:`\exp(-s^2 [1 - C])`, where C is
# the autocorrelation of the heights. No random wall is needed.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_speckle.toml")
heights = np.array([0.0, 30e-9, 60e-9, 100e-9, 200e-9])
found = [
    psf.mean_point_spread(
        scene, psf.Roughness(height, correlation_length=200e-6), shape=512, pitch=4.5e-6
    )
    for height in heights
]

# %%
# Core and halo
# -------------
# Left: cuts through the centre. With increasing roughness the core, an Airy disc for the smooth
# wall, decreases and the halo increases. Right: the energy fraction of the core against s.

figure, axes = plt.subplots(1, 2, figsize=(11.5, 4.4), layout="constrained")
shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(heights)))
peak = found[0].intensity.max()
for height, spread, shade in zip(heights, found, shades, strict=True):
    row = spread.intensity[spread.shape[0] // 2] / peak
    s = spread.rayleigh_parameter
    label = f"{1e9 * height:.0f} nm, s = {s:.2f}"
    axes[0].semilogy(spread.x * 1e3, row, color=shade, lw=1.2, label=label)
axes[0].set(
    xlabel="x (mm)", ylabel="energy per sample / smooth peak", xlim=(-0.4, 0.4), ylim=(1e-5, 2)
)
axes[0].set_title("cuts through mean PSFs")
axes[0].legend(title="rms height", fontsize=8, loc="upper right")

s = np.array([spread.rayleigh_parameter for spread in found])
core = [float(p.coherent.sum() / found[0].coherent.sum()) for p in found]
line = np.linspace(0.0, s.max(), 200)
axes[1].plot(line, np.exp(-(line**2)), label=r"$e^{-s^2}$")
axes[1].plot(s, core, "o", label="sum of the core's samples")
axes[1].set(xlabel="s = k (cos i + cos o) rms height (rad)", ylabel="energy fraction of the core")
axes[1].set_title("energy of the core")
axes[1].legend()
plt.show()

# %%
# Result:

half = np.sqrt(np.log(2.0)) / (s[-1] / heights[-1])
print(
    f"With an rms height of {1e9 * half:.0f} nm, {half / scene.laser.wavelength:.3f} wavelengths, "
    f"the core keeps half of the energy. At {1e9 * heights[-1]:.0f} nm, s = {s[-1]:.1f}, it keeps "
    f"{core[-1]:.1g}: the wall is a diffuser."
)
