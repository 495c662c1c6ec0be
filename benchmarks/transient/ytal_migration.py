"""y-tal's f-k migration of a confocal capture, started by measured.py in y-tal's interpreter.

python ytal_migration.py JOB.npz ANSWER.npz REPEATS: `H` [t, y, x], `points` [y, x], `delta_t` in;
`image` [z, y, x] from depth 0 on, the least seconds, the processor's seconds a run and y-tal's
version out.
"""

from __future__ import annotations

import sys
import time
from importlib.metadata import version

import numpy as np
from tal.enums import GridFormat, HFormat
from tal.io.capture_data import NLOSCaptureData
from tal.reconstruct import fk

job, answer, repeats = sys.argv[1], sys.argv[2], int(sys.argv[3])
with np.load(job) as given:
    light, points, delta_t = given["H"], given["points"], float(given["delta_t"])
data = NLOSCaptureData()
data.H = light.transpose(0, 2, 1)
data.H_format = HFormat.T_Sx_Sy
points = points.transpose(1, 0, 2)
data.sensor_grid_xyz = data.laser_grid_xyz = points
data.sensor_grid_format = data.laser_grid_format = GridFormat.X_Y_3
data.delta_t, data.t_start = delta_t, 0.0
seconds, busy = [], time.process_time()
for _ in range(repeats):
    start = time.perf_counter()
    found = fk.solve(data)
    seconds.append(time.perf_counter() - start)
image = found.transpose(0, 2, 1)
cpu = (time.process_time() - busy) / repeats
np.savez(answer, image=image, seconds=min(seconds), cpu=cpu, version=version("y-tal"))
