"""
Transient signal on the relay wall
==================================

A short laser pulse illuminates one spot of a diffuse wall. The scattered light reaches the hidden
letter and returns to the wall, with a different delay at every point. Time-resolved methods
reconstruct the hidden object from these arrivals.
"""

import matplotlib.pyplot as plt
import numpy as np
import trimesh

from nlosoptics import scene, transient, views

plt.style.use("nlosoptics.views.palette")

# %%
# A letter of four triangles
# --------------------------
# The letter is an L of two bars, 0.8 m high and 1 m from the wall. Seen from the wall, +x is on the
# left.


def bar(left: float, low: float, width: float, height: float) -> trimesh.Trimesh:
    """Rectangle at z = 1 m; ``left`` and ``low`` are its edges as seen from the wall, m."""
    corners = [(0, 0), (width, 0), (width, height), (0, height)]
    points = [(-left - x, low + y, 1.0) for x, y in corners]
    return trimesh.Trimesh(points, [(0, 1, 2), (0, 2, 3)], process=False)


letter = [bar(-0.25, -0.4, 0.15, 0.8), bar(-0.1, -0.4, 0.35, 0.15)]

# %%
# The capture
# -----------
# `transient.render` integrates the three bounces (wall, letter, wall) to a requested error. Times
# are given as optical path: 1 m is 3.3 ns. The laser illuminates the centre of the wall.

capture = transient.render(
    [(part, scene.Lambert(0.8)) for part in letter],
    transient.Scan(
        laser_points=(0.0, 0.0, 0.0),
        sensor_points=transient.wall_grid(2.0, 48),
        t_start=1.9,
        delta_t=0.01,
        n_bins=100,
    ),
    max_bounces=3,
    tol=1e-2,
)
bins, rows, columns = capture.H.shape
print(f"{rows} x {columns} points on the wall, {bins} bins of {1e2 * capture.delta_t:.1f} cm")

# %%
# Streak image and frames
# -----------------------
# The streak image shows the signal along one line of the wall over time. The frames show the wall
# at three times, as seen from the room. Each bar of the letter produces its own wavefront on the
# wall; the wavefronts cross.

figure, axes = plt.subplots(2, 2, figsize=(9.5, 8.5), layout="constrained")
views.transient(capture, at=(2.1, 2.25, 2.4), axes=axes.ravel())
plt.show()

# %%
# Result:

total = capture.H.sum(axis=(1, 2))
lit = np.flatnonzero(total > 1e-2 * total.max())
first, last = lit[0], lit[-1]
arrivals = capture.times[(capture.H > 0).argmax(axis=0)]
nearest = np.unravel_index(arrivals.argmin(), arrivals.shape)
x, y, _ = capture.sensor_points[nearest]
print(
    f"The signal first arrives after an optical path of {arrivals.min():.2f} m, at x = {x:.2f} m "
    f"and y = {y:.2f} m; at the corners of the wall it starts at up to {arrivals.max():.2f} m. It "
    f"lasts {capture.times[last] - capture.times[first]:.2f} m, or "
    f"{1e9 * (capture.times[last] - capture.times[first]) / 299792458.0:.1f} ns."
)
