"""Measured speckle: objects from measured autocorrelations, and the statistics of real frames.

python benchmarks/inverse/real_speckle.py [--restarts 16] [--json FILE] [--plot FILE.png]

Objects F and 7 of Metzler et al., Optica 7, 63 (2020), real exposures around a corner: means over
50 frames, over 2 frames in 25 patches, and single exposures. There is no ground truth; what is told
is whether two independent halves of the restarts find one picture. Frames of letters and digits by
thin diffusers of Li, Xue and Tian, Optica 5, 1181 (2018): contrast, moments of the intensity
(fully developed speckle has k! mean^k), width of a grain, and what two diffusers have in common.

NLOSOPTICS_DATA names the folder that holds deep_inverse_correlography and bu_deep_speckle.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

import numpy as np
from scipy import fft

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
FRAMES = ("letter_E", "letter_S", "number_8", "number_9")
METHODS = ("alternating", "hio", "raar")


def measured_lags(path):
    """Autocorrelation in the left half of a picture; the right half is its copy."""
    from PIL import Image

    with Image.open(path) as opened:
        both = np.asarray(opened, dtype=np.float64)
    return both[:, : both.shape[1] // 2]


def speckle_statistics(frames):
    """Contrast, moments and grain of (n, H, W) frames of one object by n diffusers."""
    scaled = frames / frames.mean(axis=(1, 2), keepdims=True)
    centred = scaled - 1.0
    lags = fft.ifft2(np.abs(fft.fft2(centred)) ** 2).real
    lags = fft.fftshift(lags / lags[:, :1, :1], axes=(1, 2))
    middle = lags.shape[1] // 2
    pairs = np.triu_indices(len(frames), 1)
    near = np.s_[:, middle - 24 : middle + 25, middle - 24 : middle + 25]
    flat, near_lags = centred.reshape(len(frames), -1), lags[near].reshape(len(frames), -1)
    return {
        "contrast": np.sqrt((centred**2).mean(axis=(1, 2))).tolist(),
        "second_moment": float((scaled**2).mean()),
        "third_moment": float((scaled**3).mean()),
        "above_mean": float((scaled > 1.0).mean()),
        "grain_pixels": float(half_width(lags.mean(axis=0)[middle, middle:])),
        "frames_alike": float(np.corrcoef(flat)[pairs].mean()),
        "autocorrelations_alike": float(np.corrcoef(near_lags)[pairs].mean()),
    }


def half_width(falling):
    """Full width at half maximum of an even curve from its centre on, pixels."""
    first = int(np.argmax(falling < 0.5))
    before, after = falling[first - 1], falling[first]
    return 2.0 * (first - 1 + (before - 0.5) / (before - after))


def retrieved(data, restarts):
    """Rows of the table, and the pictures."""
    from nlosoptics import inverse

    rows, pictures = [], []
    for name, file, size in OBJECTS:
        lags = measured_lags(data / CORRELOGRAPHY / file)
        pictures.append([(name, lags, size)])
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
            pictures[-1].append((f"{method} {found.score:.2f}", found.object, size))
            print(
                f"{name:14s} {method:12s} halves {found.score:6.3f} {found.status:12s} "
                f"error {row['fourier_error']:.3f} {found.seconds:6.2f} s",
                flush=True,
            )
    return rows, pictures


def draw(pictures, file):
    """Autocorrelations beside what each method finds, the objects with a square-root scale."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(
        len(pictures), len(pictures[0]), figsize=(9.0, 1.7 * len(pictures)), layout="constrained"
    )
    for row, line in zip(axes, pictures, strict=True):
        for column, (axis, (title, picture, size)) in enumerate(zip(row, line, strict=True)):
            reach = size if column == 0 else [length // 2 + 2 for length in size]
            shown = picture[
                tuple(
                    slice(n // 2 - r, n // 2 + r) for n, r in zip(picture.shape, reach, strict=True)
                )
            ]
            axis.imshow(np.sqrt(np.clip(shown, 0.0, None)), cmap="gray")
            axis.set_title(title, fontsize=8)
            axis.set_axis_off()
    figure.savefig(file, dpi=100)


def main():
    """Print both tables; write JSON and picture where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--restarts", type=int, default=16)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    folder = os.environ.get("NLOSOPTICS_DATA")
    if not folder:
        parser.error("NLOSOPTICS_DATA names no data folder")
    rows, pictures = retrieved(Path(folder), options.restarts)
    statistics = {}
    for name in FRAMES:
        frames = np.load(Path(folder) / "bu_deep_speckle" / f"{name}.npy")[..., 0]
        statistics[name] = speckle_statistics(frames)
        found = statistics[name]
        print(
            f"{name}: contrast {min(found['contrast']):.2f} to {max(found['contrast']):.2f}, "
            f"<I^2> {found['second_moment']:.2f} (2), <I^3> {found['third_moment']:.2f} (6), "
            f"above mean {found['above_mean']:.3f} (0.368), grain {found['grain_pixels']:.1f} px, "
            f"alike: frames {found['frames_alike']:.3f}, "
            f"autocorrelations {found['autocorrelations_alike']:.3f}"
        )
    if options.json:
        options.json.write_text(
            json.dumps({"retrieved": rows, "statistics": statistics}, indent=1) + "\n"
        )
    if options.plot:
        draw(pictures, options.plot)


if __name__ == "__main__":
    main()
