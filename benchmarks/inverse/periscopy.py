"""Picture on a hidden screen from one published photograph of a matt wall.

    NLOSOPTICS_DATA=FOLDER python benchmarks/inverse/periscopy.py [STARTS]

The photograph and its scene are those of Saunders, Murray-Bruce and Goyal, Nature 565, 472 (2019):
a chair stands between a screen and a wall. FOLDER holds `computational_periscopy/chair.npz`, with
the photograph (126, 126, 3), rows downward, and the screen (29, 36, 3) in blocks. Correlations of
red, green and blue are printed for the chair where it was measured, and for a chair whose place is
fitted from up to five starts 5 cm away.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numba
import numpy as np

from nlosoptics.inverse import occluder_fit, registered_correlation, shadow_fit

CORNER = np.array([0.506, 0.594, 0.242])  # of the chair's seat, m
STARTS = np.array([[1, 1, 1], [-1, 1, -1], [1, -1, 0], [-1, -1, 1], [0, 1, 1]])
WALL = (0.543, 1.03, 0.064, 0.401)  # corner and side of the photographed part, m
COARSE = (15, 18)  # blocks of the search
SCREEN = (0.027375, 36 * 0.01115625, 0.13871143, 29 * 0.01054443)  # left, width, low, height, m


def chair(corner, side=0.075, width=0.015, board=0.004, legs=0.008):
    """Boxes of a chair, rows of (x0, x1, y0, y1, z0, z1): seat, back, bar and legs.

    The depth of the legs was not published. Of 4, 8 and 12 mm, the evidence prefers 8 mm.
    """
    x, y, z = corner
    boxes = [
        (x, x + side, y, y + side, z - board / 2, z + board / 2),
        (x, x + side, y + side, y + side, z, z + side),
        (x, x + side, y, y, z - side, z - side + width),
    ]
    for left in (x, x + side - width):
        for front in (y, y + side - legs):
            boxes.append((left, left + width, front, front + legs, 0.0, z))
    return np.array(boxes)


@numba.njit(cache=True)
def response(boxes, n, rows, columns, points, lines, wall, screen):
    """Light in n x n pixels of the wall from each block of the screen, (n n, rows columns).

    Shares of a block that the boxes hide are exact along x, and averages over ``lines`` along z and
    over ``points`` x ``points`` in a pixel. The screen's light falls as cos^18 of the vertical and
    as the cosine of the horizontal angle.
    """
    x_wall, depth, z_wall, side = wall
    left, wide, low, high = screen
    matrix = np.zeros((n * n, rows * columns))
    starts, ends = np.zeros(len(boxes)), np.zeros(len(boxes))
    step = wide / columns
    for sample in range(n * n * points * points):
        pixel, part = sample // points**2, sample % points**2
        x = x_wall + side * (pixel % n + (part % points + 0.5) / points) / n
        z = z_wall + side * (1.0 - (pixel // n + (part // points + 0.5) / points) / n)
        for line in range(rows * lines):
            rise = low + high * (1.0 - (line + 0.5) / (rows * lines)) - z
            count = 0
            for b in range(len(boxes)):
                # the share of the path from wall to screen at which the box is crossed
                near, far = 1.0 - boxes[b, 3] / depth, 1.0 - boxes[b, 2] / depth
                one, other = (boxes[b, 4] - z) / rise, (boxes[b, 5] - z) / rise
                near, far = max(near, min(one, other)), min(far, max(one, other))
                if near > far:
                    continue
                low_x, high_x = boxes[b, 0] - x, boxes[b, 1] - x
                start = max(x + min(low_x / near, low_x / far), left)
                end = min(x + max(high_x / near, high_x / far), left + wide)
                if start >= end:
                    continue
                place = count
                while place > 0 and starts[place - 1] > start:
                    starts[place], ends[place] = starts[place - 1], ends[place - 1]
                    place -= 1
                starts[place], ends[place] = start, end
                count += 1
            upward = depth**2 / (depth**2 + rise**2)
            for column in range(columns):
                right = left + wide - column * step  # columns run along -x
                reached, dark = right - step, 0.0
                for k in range(count):
                    start, end = max(starts[k], reached), min(ends[k], right)
                    if end > start:
                        dark, reached = dark + end - start, end
                across = right - step / 2 - x
                lobe = upward**9 * depth / np.sqrt(depth**2 + across**2)
                light = depth**2 / (depth**2 + across**2 + rise**2) ** 2 * lobe
                cell = (line // lines) * columns + column
                matrix[pixel, cell] += (1.0 - dark / step) * light / (lines * points**2)
    return matrix


def operator(shift, pixels=63, blocks=(29, 36), lines=3):
    """Return the operator for a chair that is moved from its measured place, m."""
    return response(chair(CORNER + shift), pixels, *blocks, 2, lines, WALL, SCREEN)


def coarse(shift):
    """Return the operator of the search, for fewer pixels and blocks of twice the size."""
    return operator(shift, 42, COARSE, 2)


def main() -> None:
    """Print correlations, places and CPU seconds."""
    starts = STARTS[: int(sys.argv[1])] if len(sys.argv) > 1 else STARTS
    path = Path(os.environ["NLOSOPTICS_DATA"]) / "computational_periscopy" / "chair.npz"
    with np.load(path) as data:
        photograph, screen = data["photograph"].astype(float), data["screen"].astype(float)
    operator(np.zeros(3), 3)

    def shown(fit):
        scores = [registered_correlation(fit.object[..., c], screen[..., c]) for c in range(3)]
        ratio = fit.physical_parameters["noise_ratio"]
        return f"{' '.join(f'{s:.3f}' for s in scores)}, {fit.status}, {ratio:.1f} times the noise"

    begun = time.process_time()
    fit = shadow_fit(photograph, operator(np.zeros(3)), cells=(29, 36))
    print(f"place as measured: {shown(fit)}, {time.process_time() - begun:.1f} CPU s")
    for direction in starts:
        start = 0.05 * direction / np.linalg.norm(direction)
        begun = time.process_time()
        found = occluder_fit(photograph, coarse, start=start, cells=COARSE)
        place = found.physical_parameters["place"]
        fit = shadow_fit(photograph, operator(place), cells=(29, 36))
        seconds = time.process_time() - begun
        error = np.sqrt(np.diag(found.physical_parameters["place_covariance"]))
        print(
            f"start {1e3 * start} mm: {1e3 * np.linalg.norm(place):.1f} mm off, at "
            f"{np.round(1e3 * place, 1)} +- {np.round(1e3 * error, 1)} mm, {found.status}; "
            f"{shown(fit)}, {found.physical_parameters['evaluations']} places, {seconds:.1f} CPU s"
        )


if __name__ == "__main__":
    np.set_printoptions(precision=1, suppress=True)
    main()
