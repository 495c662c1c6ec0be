"""Three bounces off a flat letter Z: seconds against error, beside mitransient.

python benchmarks/transient/rendering.py [--peer-python PATH] [--json FILE] [--count 32]

A letter Z of 0.7 m by 0.8 m stands 1 m before a wall of 2 m with 32 x 32 sensor points and 200 bins
of 1 cm; the laser lights the wall's middle. Errors are L1 over the bins of each sensor, in the mean
and at worst, against a run with a tenth of the strictest tolerance. The peer runs in an interpreter
of its own (mitransient 1.3.1, Mitsuba 3.9.1), with the same scene and its own ways to sample such
scenes. As its errors fall with the root of its samples, the time to 1 % is drawn out from the last
of them. Compiling is left out on both sides.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from nlosoptics import scene, transient

PEER = Path(__file__).parents[1] / "peers" / "mitransient_scene.py"
SIDE, LASER, ORIGIN = 2.0, (0.0, 0.0, 0.0), (-0.5, 0.0, 0.25)
BINS = {"t_start": 1.8, "delta_t": 0.01, "n_bins": 200}
TOLERANCES = (0.3, 0.1, 0.03, 0.01, 0.003, 1e-3, 1e-4)
SAMPLES = (1000, 4000, 16000, 64000)
WANTED = 0.01  # relative L1 that times are compared at
LAMP = 100.0  # the peer's, W/sr


def letter() -> trimesh.Trimesh:
    """Two bars and the stroke between them, six triangles, 1 m before the wall."""
    x, y, s, c = 0.35, 0.4, 0.24, 0.25
    bars = [(-x, y), (x, y), (x, s), (-x, s), (-x, -s), (x, -s), (x, -y), (-x, -y)]
    stroke = [(x, s), (-x + c, -s), (-x, -s), (x - c, s)]  # faces the wall, as the bars do
    corners = [(*point, 1.0) for point in bars + stroke]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [8, 9, 10], [8, 10, 11]]
    return trimesh.Trimesh(corners, faces, process=False)


def ours(mesh: trimesh.Trimesh, count: int, tol: float, repeats: int = 1) -> tuple[Any, float]:
    """A capture in the peer's units and the least seconds that it took."""
    least = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        capture = transient.render(
            [(mesh, scene.Lambert(1.0))],
            laser_points=LASER,
            sensor_points=transient.wall_grid(SIDE, count),
            max_bounces=3,
            quantity="radiosity",
            keep_laser_cosine=True,
            laser_origin=ORIGIN,
            tol=tol,
            **BINS,
        )
        least = min(least, time.perf_counter() - start)
    return LAMP * capture.H, least


def errors(found: Any, true: Any) -> dict[str, float]:
    """Relative L1 over the bins of a sensor, mean and largest, and the largest error in total."""
    each = np.abs(found - true).sum(axis=0) / true.sum(axis=0)
    total = np.abs(found.sum(axis=0) / true.sum(axis=0) - 1.0)
    return {
        "l1": float(each.mean()),
        "l1_worst": float(each.max()),
        "total_worst": float(total.max()),
    }


def peer(
    python: str, mesh: trimesh.Trimesh, count: int, samples: int, repeats: int
) -> tuple[Any, float]:
    """A capture by mitransient, as its best for three bounces, and the least seconds it took."""
    with tempfile.TemporaryDirectory() as folder:
        job = {
            "triangles": {"letter": np.asarray(mesh.triangles).tolist()},
            "albedos": {"letter": 1.0},
            "half_side": SIDE / 2,
            "laser": ORIGIN,
            "target": LASER,
            "size": count,
            "bins": BINS["n_bins"],
            "bin_width": BINS["delta_t"],
            "start": BINS["t_start"],
            "bounces": 3,
            "samples": samples,
            "seeds": repeats,
            "aimed": True,
            "wall_aimed": False,
            "out": str(Path(folder) / "captures.npz"),
        }
        run = subprocess.run(
            [python, str(PEER)],
            input=json.dumps(job),
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode:
            raise SystemExit(f"{python} {PEER.name} failed: {run.stderr.strip()[-400:]}")
        seconds = json.loads(run.stdout.splitlines()[-1])["seconds"]
        with np.load(job["out"]) as file:
            return np.moveaxis(file["light"][0].astype(float), 2, 0), min(seconds)


def within(rows: list[dict[str, Any]]) -> float:
    """Seconds of the quickest row whose mean error is at most what is wanted."""
    return min((row["seconds"] for row in rows if row["l1"] <= WANTED), default=np.inf)


def show(row: dict[str, Any]) -> None:
    """One line of the table."""
    print(
        f"{row['who']:12s} {row['setting']:14s} {row['seconds']:9.3f} s   L1 {row['l1']:.2e} "
        f"(worst {row['l1_worst']:.2e}), total {row['total_worst']:.1e}",
        flush=True,
    )


def main() -> None:
    """Print the table and what the time to 1 % is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peer-python", metavar="PATH", help="interpreter that has mitransient")
    parser.add_argument("--json", type=Path, metavar="FILE", help="one JSON line for each row")
    parser.add_argument("--count", type=int, default=32, help="sensor points along a side")
    parser.add_argument(
        "--repeats", type=int, default=3, help="runs of which the least time counts"
    )
    options = parser.parse_args()
    mesh, rows = letter(), []
    ours(mesh, 2, 0.1)  # compiles
    true, _ = ours(mesh, options.count, TOLERANCES[-1] / 10)
    for tol in TOLERANCES:
        found, seconds = ours(mesh, options.count, tol, options.repeats)
        row = {"who": "nlosoptics", "setting": f"tol {tol:g}", "seconds": seconds}
        rows.append(row | errors(found, true))
        show(rows[-1])
    own = within(rows)
    summary = {"who": "nlosoptics", "wanted": WANTED, "seconds_to_wanted": own}
    print(f"nlosoptics to {WANTED:g}: {own:.3f} s")
    summaries = [summary]
    if options.peer_python:
        last: dict[str, Any] = {}
        for samples in SAMPLES:
            found, seconds = peer(
                options.peer_python, mesh, options.count, samples, options.repeats
            )
            last = {
                "who": "mitransient",
                "setting": f"{samples} samples",
                "seconds": seconds,
                **errors(found, true),
            }
            rows.append(last)
            show(last)
        there = last["seconds"] * (last["l1"] / WANTED) ** 2
        print(f"mitransient to {WANTED:g}, drawn out: {there:.1f} s, {there / own:.0f} times ours")
        summaries.append(
            {
                "who": "mitransient",
                "wanted": WANTED,
                "seconds_to_wanted": there,
                "ratio": there / own,
            }
        )
    if options.json:
        options.json.write_text("".join(json.dumps(r) + "\n" for r in rows + summaries))


if __name__ == "__main__":
    main()
