"""
Speckle statistics
==================

In coherent light, a single rough wall gives a speckle pattern instead of the smooth mean over all
walls. If the wall is rough enough, the intensity has an exponential distribution, whose standard
deviation equals its mean. The contrast of a sum of N independent patterns falls as one over the
square root of N.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import nlosoptics as nlos
from nlosoptics import psf, views

plt.style.use("nlosoptics.views.palette")

# %%
# One wall, and the mean over all walls
# -------------------------------------
# `psf.sample_point_spread` draws a random wall from a seed and propagates the wave via this wall.
# `psf.mean_point_spread` computes the mean over all seeds.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_flat.toml")
rough = psf.Roughness(300e-9, correlation_length=1e-3)
window = {"pitch": 0.6e-6, "shape": 128}
mean = psf.mean_point_spread(scene, rough, **window)
walls = [psf.sample_point_spread(scene, rough, seed=seed, **window) for seed in range(32)]

# %%
# Contrast and histogram
# ----------------------
# Intensities are divided by the mean at the same position, so that the slope of the halo does not
# contribute to the contrast.

relative = np.array([wall.intensity / mean.intensity for wall in walls])
counts = 2 ** np.arange(6)
contrasts = [
    float(np.mean([relative[k : k + n].mean(axis=0).std() for k in range(0, 32, n)]))
    for n in counts
]

figure, axes = plt.subplots(1, 3, figsize=(14, 4.2), layout="constrained")
views.point_spread(walls[0], scale="linear", axes=axes[0])
axes[0].set_title("point spread function of one rough wall")
bins = np.linspace(0.0, 8.0, 41)
axes[1].hist(relative.ravel(), bins, density=True, color="0.67", label="32 rough walls")
axes[1].semilogy(bins, np.exp(-bins), label="exponential, exp(−I/mean)")
axes[1].set(xlabel="intensity / mean", ylabel="probability density", ylim=(1e-4, 2))
axes[1].set_title("distribution of the intensity")
axes[1].legend()
axes[2].loglog(counts, contrasts, "o", label="measured")
axes[2].loglog(counts, counts**-0.5, label=r"$1/\sqrt{N}$")
axes[2].set(xlabel="number N of patterns", ylabel="contrast, standard deviation / mean")
axes[2].set_xticks(counts, [str(n) for n in counts])
axes[2].set_yticks([0.2, 0.4, 0.6, 1.0], ["0.2", "0.4", "0.6", "1"])
axes[2].minorticks_off()
axes[2].set_title("contrast of the sum of N patterns")
axes[2].legend()
plt.show()

# %%
# Result:

dark = float((relative < 0.1).mean())
print(
    f"With s = {mean.rayleigh_parameter:.1f} rad no core is left. The contrast of one pattern is "
    f"{contrasts[0]:.3f}; fully developed speckle has 1. For {counts[-1]} patterns it is "
    f"{contrasts[-1]:.3f}; theory gives {counts[-1] ** -0.5:.3f}. {100 * dark:.1f} % of the "
    f"samples are below a tenth of the mean; the exponential distribution gives "
    f"{100 * (1 - np.exp(-0.1)):.1f} %."
)
