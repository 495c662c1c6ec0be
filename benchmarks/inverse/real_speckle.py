"""Measured speckle: objects from measured autocorrelations.

python benchmarks/inverse/real_speckle.py [--restarts 16] [--json FILE]

Objects F and 7 of Metzler et al., Optica 7, 63 (2020), real exposures around a corner: means over
50 frames, over 2 frames in 25 patches, and single exposures. There is no ground truth; what is told
is whether two independent halves of the restarts find one picture. NLOSOPTICS_DATA names the folder
that holds deep_inverse_correlography.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

import numpy as np

CORRELOGRAPHY = "deep_inverse_correlography/datasets"
# Name, file, and rows and columns of the box that holds the object: half the extent of its lags.
# A tight box is what tells an object from itself with its twin laid over it.
OBJECTS = (
    ("F, 50 frames", "SubsampledData/test/F_n50_corr_x100_nzero1.png", (25, 52)),
    ("7, 50 frames", "SubsampledData/test/7_n50_corr_x100_nzero1.png", (28, 44)),
    ("F, 2 frames", "SubsampledData/test/F_n2_corr_x100_nzero1_npatch25.png", (25, 52)),
    ("7, 2 frames", "SubsampledData/test/7_n2_corr_x100_nzero1_npatch25.png", (28, 44)),
    (
        "F, 1 s",
        "ShortExposureData/test/lowExp_F_1000016usec_n2_corr_x100_nzero1_npatch64.png",
        (25, 50),
    ),
    (
        "7, 1 s",
        "ShortExposureData/test/lowExp_7_2_1000016usec_n2_corr_x100_nzero1_npatch64.png",
        (26, 56),
    ),
)
METHODS = ("alternating", "hio", "raar")


def measured_lags(path):
    """Autocorrelation in the left half of a picture; the right half is its copy."""
    from PIL import Image

    with Image.open(path) as opened:
        both = np.asarray(opened, dtype=np.float64)
    return both[:, : both.shape[1] // 2]


def retrieved(data, restarts):
    """Rows of the table."""
    from nlosoptics import inverse

    rows = []
    for name, file, size in OBJECTS:
        lags = measured_lags(data / CORRELOGRAPHY / file)
        for method in METHODS:
            found = inverse.object_from_autocorrelation(
                lags, method=method, object_size=size, restarts=restarts
            )
            row = {
                "object": name,
                "method": method,
                "halves": found.score,
                "status": found.status,
                "fourier_error": found.physical_parameters["fourier_error"],
                "seconds": found.seconds,
            }
            rows.append(row)
            print(
                f"{name:14s} {method:12s} halves {found.score:6.3f} {found.status:12s} "
                f"error {row['fourier_error']:.3f} {found.seconds:6.2f} s",
                flush=True,
            )
    return rows


def main():
    """Print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--restarts", type=int, default=16)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    folder = os.environ.get("NLOSOPTICS_DATA")
    if not folder:
        parser.error("NLOSOPTICS_DATA names no data folder")
    rows = retrieved(Path(folder), options.restarts)
    if options.json:
        options.json.write_text(json.dumps({"retrieved": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
