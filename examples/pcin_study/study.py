"""The experiments of Wu et al. 2024 as one study.

python examples/pcin_study/study.py --setting small --out pcin_study [--report]

One line of JSON for each finished case in OUT/SETTING.jsonl; started again, it goes on where it was
cut off. Then tables (tables.md) and pictures of what is finished.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pcin_data as data
import pcin_methods as methods
import pcin_report as report
from numpy.typing import NDArray

from nlosoptics import limits

Key = dict[str, Any]

SEEDS = (1, 2, 3)  # of the noise, and of the facets
SIZES = {"smooth": 64, "rough": 128, "paper": 192}
BASE = {"smooth": "concave", "rough": "flat"}  # behind a smooth flat wall the image is the object
KNOWN = ("image", "inverse_filter", "tv")
FAST = (*KNOWN, "phase_retrieval", "hio", "cnn")
SETTINGS = ("smallest", "small")
SECONDS = 30.0  # limit of a fit by evidence
ITERATIONS, FEW = methods.COLD, 20  # of PCIN as published


def figures(scale: str) -> dict[int, list[tuple[str, str, int]]]:
    """Objects, walls and exposures, ms, of the paper's figures."""
    base, exposures = BASE[scale], (10, 20, 30, 40)
    return {
        5: [("letter", base, ms) for ms in exposures],
        6: [("posed", base, ms) for ms in exposures],
        7: [(name, base, ms) for name in ("cartoon", "hanzi") for ms in exposures],
        8: [("letter", wall, 40) for wall in ("flat", "concave", "convex", "wavy")],
        9: [("letter", base, 40)],
        10: [("tilted", base, 40)],
        11: [("letter", base, 20)],
    }


def keys(setting: str) -> list[Key]:
    """All cases of a setting, the most telling first, so that a run may be cut off anywhere."""
    if setting == "smallest":
        fast = ("image", "inverse_filter", "tv", "hio", "wu2024", "evidence_2frames")
        return [_key("smooth", ("letter", "concave", 40), m, 1, 48, FEW) for m in fast]
    both = ("smooth", "rough")
    every = tuple(figures("smooth"))
    found = [key for seed in SEEDS for scale in both for key in _rows(scale, every, FAST, seed)]
    fits = ("wu2024", "evidence_2frames", "evidence")
    walls = [("letter", wall, 40) for wall in data.WALLS]
    paper = [*walls, *(("letter", "flat", ms) for ms in (10, 20, 30))]
    found += [key for s in both for key in _rows(s, (9,), fits[:1], 1)]
    found += _rows("smooth", (9, 11, 10, 8), fits[1:2], 1)
    found += [_key("paper", row, m, 1) for row in paper for m in KNOWN]
    found += [key for s in both for key in _rows(s, (11, 10), fits[:1], 1)]
    found += [key for s in both for key in _rows(s, (9,), fits[1:], 1)]
    found += [_key("paper", row, m, seed) for seed in SEEDS for row in paper for m in KNOWN]
    warm = [(s, ("letter", BASE[s], 40), "wu2024_warm", seed) for seed in SEEDS for s in both]
    found += [_key(*row) for row in warm]
    for seed in SEEDS:
        found += [key for m in fits for s in both for key in _rows(s, every, (m,), seed)]
    return list({report.name_of(key, key["method"]): key for key in found}.values())


def _rows(scale: str, chosen: tuple[int, ...], used: tuple[str, ...], seed: int) -> list[Key]:
    rows = dict.fromkeys(row for figure in chosen for row in figures(scale)[figure])
    return [_key(scale, row, method, seed) for row in rows for method in used]


def _key(
    scale: str,
    row: tuple[str, str, int],
    method: str,
    seed: int,
    size: int = 0,
    iterations: int = ITERATIONS,
) -> Key:
    key: Key = dict(zip(("object", "wall", "exposure_ms"), row, strict=True))
    key = {"scale": scale, **key, "method": method, "seed": seed, "size": size or SIZES[scale]}
    if method == "cnn":
        key["pairs"] = 400 if scale == "smooth" else 200
    if method.startswith("wu2024"):
        key["iterations_asked"] = iterations
    if method.startswith("evidence"):
        key["max_seconds"] = SECONDS
    return key


def work(job: tuple[Key, Path]) -> dict[str, Any]:
    """One case, its pictures kept in a folder."""
    key, folder = job
    os.environ[methods.CNN_FOLDER] = str(folder)
    with warnings.catch_warnings():
        # a random wave of a literal fit may be steeper than its pupil's cells, which it says
        warnings.simplefilter("ignore", UserWarning)
        line, pictures = methods.solved(key)
    for name, picture in pictures.items():
        keep(folder / "objects" / f"{report.name_of(key, name)}.npy", picture)
    return line


def keep(path: Path, picture: NDArray[np.float64]) -> None:
    """A picture as 16-bit floats of its own range."""
    low, high = float(np.min(picture)), float(np.max(picture))
    scaled = (np.asarray(picture) - low) / (high - low if high > low else 1.0)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, scaled.astype(np.float16))


def finished(path: Path) -> list[dict[str, Any]]:
    """Lines of a file; one that was cut off does not count."""
    lines = []
    for text in path.read_text().splitlines() if path.exists() else []:
        try:
            lines.append(json.loads(text))
        except json.JSONDecodeError:
            continue
    return lines


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--setting", choices=SETTINGS, default="small")
    parser.add_argument("--out", type=Path, default=Path("pcin_study"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--feasibility", action="store_true", help="what the scenes can show at all, and no fit"
    )
    parser.add_argument("--report", action="store_true", help="tables and pictures alone")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.feasibility:
        print(feasibility())
        return
    path = options.out / f"{options.setting}.jsonl"
    lines = finished(path)
    done = {report.name_of(line, line["method"]) for line in lines}
    todo = [k for k in keys(options.setting) if report.name_of(k, k["method"]) not in done]
    if todo and not options.report:
        with path.open("a") as file:
            for line in _results([(key, options.out) for key in todo], options.jobs):
                lines.append(line)
                file.write(json.dumps(line) + "\n")
                file.flush()
                told = (report.name_of(line, line["method"]), line.get("correlation"))
                print(*told, line["status"], line.get("seconds"), flush=True)
    report.write(lines, figures, options.out)


def feasibility() -> str:
    """What `limits.feasibility` says of the letter's scenes, as a table."""
    rows = [
        "| scale | wall | ms | electrons | noise | veil | blur passes at two strokes | predicted"
        " correlation | Z4 one frame | Z4 two frames |",
        "|---" * 10 + "|",
    ]
    for scale in data.TOL:
        for wall, exposure in itertools.product(data.WALLS, (10, 40)):
            place = (scale, "letter", wall, SIZES[scale], 1)
            scene = data.study_scene(place, exposure * 1e-3)
            told = limits.feasibility(scene)
            # a period of two strokes is what tells a stroke from its neighbour
            passed = np.interp(0.5 / told.stroke, told.frequency, told.modulation)
            rows.append(
                f"| {scale} | {wall} | {exposure} | {told.brightest:.0f} | "
                f"{told.noise['total']:.1f} | {told.veil:.2g} | {passed:.2f} | {told.score:.3f} | "
                f"{told.wave_bounds[4]:.2g} | {told.two_frame_bounds[4]:.2g} |"
            )
    return "\n".join(rows)


def _results(jobs: list[tuple[Key, Path]], processes: int) -> Iterator[dict[str, Any]]:
    if processes == 1:
        yield from map(work, jobs)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap_unordered(work, jobs, chunksize=8)


if __name__ == "__main__":
    sys.exit(main())
