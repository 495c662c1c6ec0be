"""
From mirror to diffuse
======================

A smooth wall images a point as a sharp core. Heights at random scatter light out of the core into
a halo, until no core is left. How much stays depends on one number: s, the rms of the phase that
the heights give. The core keeps :math:`e^{-s^2}` of the light.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import nlosoptics as nlos
from nlosoptics import psf

plt.style.use("tableau-colorblind10")

# %%
# Walls from smooth to rough
# --------------------------
# `psf.mean_point_spread` is the mean over all walls with the same statistics, in closed form: the
# smooth wall's transfer function times :math:`\exp(-s^2 [1 - C])`, C the heights'
# autocorrelation. No wall is drawn at random.

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
# Left: cuts through the centre. The core of the smooth wall, an Airy disc, sinks and the halo rises
# beside it. Right: the share of the light in the core against s.

figure, axes = plt.subplots(1, 2, figsize=(11.5, 4.4), layout="constrained")
shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(heights)))
peak = found[0].intensity.max()
for height, spread, shade in zip(heights, found, shades, strict=True):
    row = spread.intensity[spread.shape[0] // 2] / peak
    s = spread.rayleigh_parameter
    label = f"{1e9 * height:.0f} nm, s = {s:.2f}"
    axes[0].semilogy(spread.x * 1e3, row, color=shade, lw=1.2, label=label)
axes[0].set(
    xlabel="x (mm)", ylabel="energy per sample, smooth peak 1", xlim=(-0.4, 0.4), ylim=(1e-5, 2)
)
axes[0].set_title("mean point spread")
axes[0].legend(title="height rms", fontsize=8)

s = np.array([spread.rayleigh_parameter for spread in found])
core = [float(p.coherent.sum() / found[0].coherent.sum()) for p in found]
line = np.linspace(0.0, s.max(), 200)
axes[1].plot(line, np.exp(-(line**2)), label=r"$e^{-s^2}$")
axes[1].plot(s, core, "o", label="sum of the core's samples")
axes[1].set(xlabel="s = k (cos i + cos o) height rms (rad)", ylabel="share of light in the core")
axes[1].set_title("what the core keeps")
axes[1].legend()
plt.show()

# %%
# What to see:

half = np.sqrt(np.log(2.0)) / (s[-1] / heights[-1])
print(
    f"Heights of {1e9 * half:.0f} nm rms, {half / scene.laser.wavelength:.3f} of the wavelength, "
    "take "
    f"half of the light out of the core. At {1e9 * heights[-1]:.0f} nm, s = {s[-1]:.1f}, the core "
    f"holds {core[-1]:.1g} of the light: the wall is a diffuser."
)
