"""Blind fits with prior knowledge: correlation with the truth, verdict and seconds, case by case.

python benchmarks/inverse/known_start.py --json known_start.jsonl [--groups near10 ...] [--walls 6]
    [--objects F arrow hanzi_zhong] [--sizes 64 128] [--jobs 1]

One line of JSON for each finished case; started again, it goes on where it was cut off. Groups:
near10, near25: the start is 0.10, 0.25 wave rms off, one image; diversity3: nothing is known, three
images at defoci 0 and +-0.5 wave; calibrate: the wall from one image of a known R, then another
object; noise5: as near10 at 5 % noise.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from cases import MODES, WAVELENGTH, Case, case, start

FIRST_WALL = 1  # the fit was tuned on walls 101 to 104
RMS = 0.5  # waves
GROUPS = ("near10", "near25", "diversity3", "calibrate", "noise5")
DIVERSITY = (0.0, 0.5 * WAVELENGTH, -0.5 * WAVELENGTH)


def pupil(data: Case, coefficients: np.ndarray) -> Any:
    """Point spread with a wave that starts at given coefficients, waves."""
    import torch

    from nlosoptics.inverse import PupilPSF

    optics = dict(data.pupil)
    # the camera's pixels are wider than Nyquist's by 1e-4, which shifts nothing that can be seen
    nyquist = data.pupil["wavelength"] * data.pupil["image_distance"]
    optics["pitch"] = min(optics["pitch"], nyquist / (4.0 * data.pupil["pupil_radius"]))
    spread = PupilPSF.from_zernike(MODES, **optics, shape=data.truth.shape)
    spread.coefficients = torch.nn.Parameter(torch.tensor(coefficients, dtype=torch.float32))
    return spread


def solved(group: str, name: str, wall: int, size: int) -> dict[str, Any]:
    """Figures of one case."""
    from nlosoptics.inverse import registered_correlation

    common = {"rms_waves": RMS, "size": size, "noise": 0.05 if "noise5" in group else 0.01}
    data = case(name, wall, **common, **({"defocus": DIVERSITY} if group == "diversity3" else {}))
    known = group not in ("diversity3", "calibrate")
    options: dict[str, Any] = {}
    extra: dict[str, Any] = {}
    first = np.zeros(len(MODES))
    if known:
        error = int(group[4:]) / 100 if group.startswith("near") else 0.10
        first = start(data.coefficients, error, wall)
        options["start_error"] = error
    elif group == "calibrate":
        first, extra = _calibrated(wall, size)
        options["start_error"] = 0.1
    found = _fit(data, first, **options)
    correlation = registered_correlation(found, data.truth)
    margin = found.physical_parameters["margin"]
    return {
        **{"group": group, "object": name, "wall": wall, "size": size},
        "correlation": correlation,
        "image": registered_correlation(data.images[0], data.truth),
        "status": found.status,
        "score": found.score,
        "margin": None if math.isnan(margin) else margin,
        "answers": len(found.history["objective"]),
        "seconds": found.seconds,
        **extra,
    }


def _fit(data: Case, first: np.ndarray, **options: Any) -> Any:
    from nlosoptics.inverse import pcin

    return pcin(data.images, pupil(data, first), defocus=data.defocus, **options)


def _calibrated(wall: int, size: int) -> tuple[np.ndarray, dict[str, Any]]:
    """Coefficients of a wall from one image of a known letter."""
    data = case("R", wall, rms_waves=RMS, size=size)
    found = _fit(data, np.zeros(len(MODES)), known_object=data.truth)
    coefficients = found.physical_parameters["coefficients"]
    return coefficients, {
        "calibration_score": found.score,
        "calibration_seconds": found.seconds,
        "calibration_error": float(np.linalg.norm(coefficients - data.coefficients)),
    }


def main() -> None:
    """Run what is not in the file yet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="lines are added to it")
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--walls", type=int, default=6)
    parser.add_argument("--objects", nargs="+", default=["F", "arrow", "hanzi_zhong"])
    parser.add_argument("--sizes", nargs="+", type=int, default=[64, 128])
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    lines = []
    if options.json.exists():
        lines = [json.loads(line) for line in options.json.read_text().splitlines()]
    done = {(x["group"], x["object"], x["wall"], x["size"]) for x in lines}
    keys = [
        (group, name, wall, size)
        for size in options.sizes
        for wall in range(FIRST_WALL, FIRST_WALL + options.walls)
        for group in options.groups
        for name in options.objects
    ]
    todo = [key for key in keys if key not in done]
    with ProcessPoolExecutor(options.jobs) as pool, options.json.open("a") as file:
        for future in as_completed([pool.submit(solved, *key) for key in todo]):
            line = future.result()
            lines.append(line)
            file.write(json.dumps(line) + "\n")
            file.flush()
            short = {k: round(v, 4) if isinstance(v, float) else v for k, v in line.items()}
            print(" ".join(f"{k}={v}" for k, v in short.items()), flush=True)


if __name__ == "__main__":
    main()
