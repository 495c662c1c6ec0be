"""Walls found from random starts: objects x walls x strengths, one or two frames, one line a case.

    python benchmarks/inverse/evidence.py --frames 2 --rms 0.25 0.5 1.0 --json results.jsonl
    python benchmarks/inverse/evidence.py --frames 1 --jobs 2 --json results.jsonl

Data are those of cases.py, not of the fitted model. The second frame has a known defocus of half a
wave, of one wave for walls of a wave and more. The wall's strength is not told. A case that the
file holds is not run again, so a run that was cut off goes on where it stopped. Walls 1 to 9 were
used in tuning; by default those from 101 on are run.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np


def solved(key: dict[str, Any], folder: Path | None) -> dict[str, Any]:
    """One case, solved; its object is a picture of a folder, if there is one."""
    from cases import MODES, WAVELENGTH, case

    from nlosoptics import inverse

    extra = 1.0 if key["rms"] >= 1.0 else 0.5
    defocus = (0.0, extra * WAVELENGTH)[: key["frames"]]
    data = case(
        str(folder / f"{key['object']}.png") if folder else key["object"],
        key["wall"],
        rms_waves=key["rms"],
        size=key["size"],
        noise=key["noise"],
        defocus=defocus,
    )
    pupil = inverse.PupilPSF.from_zernike(
        MODES, **data.pupil, shape=key["size"], pixel_integrated=True
    )
    before = time.process_time()
    images = spoilt(data.images, key.get("spoilt"), key["wall"])
    found = inverse.evidence_fit(
        images, pupil, defocus=data.defocus, strength=key["strength"], seed=key["seed"]
    )
    settled = found.physical_parameters
    return {
        **key,
        "correlation": inverse.registered_correlation(found, data.truth),
        "image_correlation": inverse.registered_correlation(data.images[0], data.truth),
        "status": found.status,
        "score": found.score,
        **{k: finite(settled[k]) for k in ("margin", "sharp_margin")},
        "bad_pixels": settled.get("bad_pixels", 0),
        "model_error": settled["model_error"],
        "length": float(np.linalg.norm(settled["coefficients"])),
        "rounds": len(found.history["objective"]),
        "seconds": found.seconds,
        "cpu_seconds": time.process_time() - before,
    }


def spoilt(images: np.ndarray, kind: str | None, seed: int) -> np.ndarray:
    """Images with ten hot pixels each, of up to six times the maximum, or with unequal gains."""
    images, random = images.copy(), np.random.default_rng([seed, 3])
    if kind == "hot":
        for image in images:
            places = random.choice(image.size, 10, replace=False)
            image.flat[places] = image.max() * random.uniform(1.0, 6.0, 10)
    elif kind == "gains":
        images[1:] *= 1.25 if seed % 2 else 0.8
    return images


def finite(value: float) -> float | None:
    """A number, or None where there is none."""
    return float(value) if np.isfinite(value) else None


def keys(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """What is asked for."""
    first, last = options.walls
    common = {k: getattr(options, k) for k in ("frames", "noise", "size", "strength", "seed")}
    for rms, wall in product(options.rms, range(first, last + 1)):
        for name in options.objects:
            case = {"object": name, "wall": wall, "rms": rms, **common}
            yield case | ({"spoilt": options.spoilt} if options.spoilt else {})


def finished(path: Path | None) -> list[dict[str, Any]]:
    """Cases that a file holds."""
    lines = path.read_text().splitlines() if path and path.exists() else []
    return [json.loads(line) for line in lines]


def main() -> None:
    """Run what is not there yet and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, choices=(1, 2), default=2)
    parser.add_argument("--rms", type=float, nargs="+", default=[0.25, 0.5, 1.0], help="waves")
    parser.add_argument("--walls", type=int, nargs=2, default=(101, 112), help="first and last")
    parser.add_argument("--objects", nargs="+", default=["F", "arrow", "hanzi_zhong"])
    parser.add_argument("--folder", type=Path, help="of the objects' PNG files, see cases.py")
    parser.add_argument("--noise", type=float, default=0.01, help="over the image's maximum")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--strength", type=float, help="rms waves to tell the fit; default none")
    parser.add_argument("--spoilt", choices=("hot", "gains"), help="hot pixels, or gains 25 %% off")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file of one line a case, taken up again")
    options = parser.parse_args()
    wanted = list(keys(options))
    held = {json.dumps({k: row.get(k) for k in wanted[0]}): row for row in finished(options.json)}
    rows = [held[json.dumps(key)] for key in wanted if json.dumps(key) in held]
    left = [key for key in wanted if json.dumps(key) not in held]
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(options.jobs) as pool:
        for task in as_completed([pool.submit(solved, key, options.folder) for key in left]):
            rows.append(task.result())
            print(json.dumps(rows[-1]), flush=True)
            if options.json is not None:
                with options.json.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    print(sum(row["correlation"] > 0.95 for row in rows), "of", len(rows), "above 0.95")


if __name__ == "__main__":
    main()
