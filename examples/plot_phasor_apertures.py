"""
Aperture of a virtual camera
============================

Phasor-field imaging treats time-resolved light on the relay wall as a wave with a virtual
wavelength of centimetres, and the wall as the lens of a virtual camera. As with any lens, the
resolution is proportional to wavelength times distance over aperture: a larger scan of the wall
resolves finer detail.
"""

import matplotlib.pyplot as plt
import numpy as np
import trimesh

from nlosoptics import scene, transient

plt.style.use("nlosoptics.views.palette")

# %%
# A small target
# --------------
# The target is a white square of 2 cm, 1 m from the wall. The confocal scan has 49 x 49 points over
# 1.96 m.

distance = 1.0
square = trimesh.creation.box((0.02, 0.02, 1e-3))
square.apply_translation((0.0, 0.0, distance))
points = transient.wall_grid(1.96, 49)
capture = transient.render(
    [(square, scene.Lambert(0.8))],
    transient.Scan(
        laser_points=points,
        sensor_points=points,
        pairing="confocal",
        t_start=1.9,
        delta_t=0.01,
        n_bins=220,
    ),
    max_bounces=3,
    tol=1e-2,
)

# %%
# Four apertures
# --------------
# One capture is used throughout; ``aperture`` crops the scan to a square. Each point of the scan
# represents a square of 4 cm, and the apertures contain whole squares. The virtual wavelength is 16
# cm, four times the pitch of the scan, which avoids aliased copies of the target.

wl_mean = 0.16
axis = np.linspace(-0.2, 0.2, 81)
volume = transient.Volume(axis, axis, np.array([distance]))
apertures = [0.36, 0.76, 1.16, 1.96]
images = [
    transient.phasor_image(capture, volume, wl_mean=wl_mean, aperture=aperture)
    for aperture in apertures
]


def width_at_half(values: np.ndarray) -> float:
    """Full width at half maximum of a profile over ``axis``, m, interpolated linearly."""
    above = np.flatnonzero(values >= values.max() / 2)
    ends = []
    for inside, outside in ((above[0], above[0] - 1), (above[-1], above[-1] + 1)):
        share = (values[inside] - values.max() / 2) / (values[inside] - values[outside])
        ends.append(axis[inside] + share * (axis[outside] - axis[inside]))
    return float(ends[1] - ends[0])


# %%
# Resolution
# ----------
# In a confocal scan the signal travels from each wall point to the target and back, which doubles
# every phase. The spot is therefore that of a lens at half the wavelength. The line is the theory,
# where a is the half angle that the aperture subtends at the target.

middle = len(axis) // 2
widths = [width_at_half(image.intensity[0, middle]) for image in images]
figure, axes = plt.subplot_mosaic("ab;cd;ee", figsize=(8.5, 10), layout="constrained")
maps = [axes[name] for name in "abcd"]
for aperture, image, drawn_on in zip(apertures, images, maps, strict=True):
    seen = image.intensity[0] / image.intensity.max()
    shown = drawn_on.pcolormesh(1e2 * axis, 1e2 * axis, seen, cmap="inferno", shading="nearest")
    drawn_on.invert_xaxis()
    drawn_on.set(xlabel="x (cm)", ylabel="y (cm)", aspect="equal")
    drawn_on.set_title(f"aperture {aperture:.2f} m")
figure.colorbar(shown, ax=maps, label="intensity of the image / its peak", shrink=0.8)
line = np.linspace(apertures[0], apertures[-1], 100)
law = 0.443 * wl_mean / (2.0 * np.sin(np.arctan(line / 2 / distance)))
axes["e"].plot(apertures, 1e2 * np.array(widths), "o", label="measured")
axes["e"].plot(line, 1e2 * law, label="theory, 0.443 wavelength / (2 sin a)")
axes["e"].set(xlabel="aperture (m)", ylabel="full width at half maximum (cm)", ylim=(0, None))
axes["e"].set_title("width of the spot")
axes["e"].legend()
plt.show()

# %%
# Result:

print(
    f"From {apertures[0]} to {apertures[-1]} m aperture the spot shrinks from "
    f"{1e2 * widths[0]:.1f} to {1e2 * widths[-1]:.1f} cm, by a factor of "
    f"{widths[0] / widths[-1]:.1f}. The theory gives "
    f"{law[0] / law[-1]:.1f}. This is less than the ratio of the apertures, "
    f"{apertures[-1] / apertures[0]:.1f}, because the largest one subtends a half angle of "
    f"{np.degrees(np.arctan(apertures[-1] / 2 / distance)):.0f} degrees. The measured gain is "
    "smaller still, because distant parts of the wall receive and return less light."
)
