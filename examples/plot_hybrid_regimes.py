"""
Waves for the core, rays for the rest
=====================================

What reaches the lens from one object point has three parts. The core is light that a smooth mirror
would reflect, and interferes. The halo is what small heights scatter about it. The diffuse light
has been inside the wall and comes from everywhere. Each part has a method of its own: exact waves,
a mean over all walls, and traced rays.
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import nlosoptics as nlos
from nlosoptics import psf, views

plt.style.use("tableau-colorblind10")

# %%
# One wall, three parts
# ---------------------
# The wall has a matt body and a 5 % gloss. The gloss is rough, with heights of 60 nm rms.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_speckle.toml")


def hybrid(height: float, **options: Any) -> psf.HybridPointSpread:
    """Image of the object's centre by a gloss of this height rms, m."""
    rough = psf.Roughness(height, correlation_length=100e-6) if height else None
    return psf.hybrid_point_spread(
        scene, roughness=rough, pitch=9e-6, normalisation="flux", n_rays=8192, **options
    )


example = hybrid(60e-9, shape=65, tol=5e-5)
figure, axes = plt.subplots(1, 3, figsize=(14, 4.2), layout="constrained")
views.hybrid_parts(example, decades=6, axes=axes)
plt.show()

# %%
# The regimes
# -----------
# As the heights grow, light moves from the core to the halo; the diffuse part does not care. 1 is
# what a smooth wall of reflectance 1 would send through the lens.

heights = np.linspace(0.0, 120e-9, 13)
parts = [hybrid(height, shape=9, check=False) for height in heights]
figure, axis = plt.subplots(figsize=(7, 4.4), layout="constrained")
axis.stackplot(
    1e9 * heights,
    [p.coherent_flux for p in parts],
    [p.halo_flux for p in parts],
    [p.diffuse_flux for p in parts],
    labels=["core, by waves", "halo, mean over walls", "diffuse, by rays"],
)
axis.set(xlabel="height rms of the gloss (nm)", ylabel="light through the lens, mirror 1")
axis.legend(loc="upper right")
axis.set_title("one object point by a matt wall with a 5 % gloss")
plt.show()

# %%
# What to see:

total = example.coherent_flux + example.halo_flux + example.diffuse_flux
apart = abs(total - example.traced_flux) / np.hypot(
    example.diffuse_flux_error, example.traced_flux_error
)
print(
    f"At 60 nm the core has {example.coherent_flux:.4f}, the halo {example.halo_flux:.4f} and the "
    f"diffuse light {example.diffuse_flux:.4f} +- {example.diffuse_flux_error:.4f}. All lobes "
    "traced "
    f"by rays alone bring {example.traced_flux:.4f} +- {example.traced_flux_error:.4f}, which is "
    f"{apart:.1f} standard errors from the sum. Most of the light is "
    f"diffuse, but it covers the whole sensor: a pixel has {example.diffuse.mean():.1g} of it, the "
    f"peak of the core {example.coherent.max():.1g}."
)
