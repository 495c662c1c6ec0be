"""
Hybrid point spread function of a rough wall
============================================

The light from one object point reaches the lens in three parts. The coherent core is reflected
specularly and interferes. The halo is scattered around the core by the small heights of a rough
surface. The diffuse part has been scattered inside the wall and arrives from all of it. Each part
has its own method: wave optics, the statistical mean over rough walls, and ray tracing.
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm

import nlosoptics as nlos
from nlosoptics import psf

plt.style.use("nlosoptics.views.palette")

# %%
# One wall, three parts
# ---------------------
# The wall reflects diffusely and, with a reflectance of 5 %, like a mirror whose surface heights
# have an rms of 60 nm. Most of the diffuse part is outside the window shown; inside, it is uniform.

scenes = Path(__file__).parent / "scenes"
scene = nlos.Scene.load(scenes / "letter_speckle.toml")


def hybrid(height: float, **options: Any) -> psf.HybridPointSpread:
    """Point spread function of the object's centre; ``height`` is the rms height, m."""
    rough = psf.Roughness(height, correlation_length=100e-6) if height else None
    return psf.hybrid_point_spread(
        scene, roughness=rough, pitch=9e-6, normalisation="flux", n_rays=8192, **options
    )


example = hybrid(60e-9, shape=65, tol=5e-5)
figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
peak = example.intensity.max()
for axis, part in zip(axes, ("coherent", "halo", "diffuse"), strict=True):
    shown = axis.imshow(getattr(example, part), norm=LogNorm(1e-6 * peak, peak, clip=True))
    axis.set(xlabel="x (samples)", ylabel="y (samples)")
    axis.set_title(f"{part} part, total {getattr(example, f'{part}_flux'):.3g}")
figure.colorbar(shown, ax=axes, label="flux per sample")
plt.show()

# %%
# Flux against roughness
# ----------------------
# With increasing heights, energy moves from the core to the halo, while the diffuse part is
# constant. The unit is the flux that a smooth wall of reflectance 1 would send through the lens.

heights = np.linspace(0.0, 120e-9, 13)
parts = [hybrid(height, shape=9, check=False) for height in heights]
figure, axis = plt.subplots(figsize=(5.1, 4.2), layout="constrained")
axis.stackplot(
    1e9 * heights,
    [p.coherent_flux for p in parts],
    [p.halo_flux for p in parts],
    [p.diffuse_flux for p in parts],
    labels=["core, wave optics", "halo, mean over walls", "diffuse, ray tracing"],
)
axis.set(xlabel="rms height of the specular lobe (nm)", ylabel="flux / flux of a perfect mirror")
axis.set_ylim(0.0, 0.4)
axis.legend(loc="upper right")
axis.set_title("one point, wall with a 5 % specular lobe")
plt.show()

# %%
# Result:

total = example.coherent_flux + example.halo_flux + example.diffuse_flux
apart = abs(total - example.traced_flux) / np.hypot(
    example.diffuse_flux_error, example.traced_flux_error
)
print(
    f"At 60 nm the flux is {example.coherent_flux:.4f} in the core, {example.halo_flux:.4f} in the "
    f"halo and {example.diffuse_flux:.4f} +- {example.diffuse_flux_error:.4f} in the diffuse part. "
    f"Ray tracing of all lobes gives {example.traced_flux:.4f} +- {example.traced_flux_error:.4f}, "
    f"which differs from the sum by {apart:.1f} standard errors. Most of the flux is diffuse, but "
    f"it covers the whole sensor: the mean diffuse flux per pixel is {example.diffuse.mean():.1g}, "
    f"and the peak of the core is {example.coherent.max():.1g}."
)
