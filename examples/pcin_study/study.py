"""The experiments of Wu et al. 2024 as one study.

python examples/pcin_study/study.py --setting small --out pcin_study [--report]

One line of JSON for each finished case in OUT/SETTING.jsonl; started again, it goes on where it was
cut off. Then tables (tables.md) and pictures. "small" takes some minutes on one core, "full" is the
whole grid at 128 x 128 pixels and takes hours: give it --jobs.
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

EXPOSURES = (10, 20, 30, 40)  # ms
KNOWN = ("image", "inverse_filter", "tv")
UNTRAINED = ("phase_retrieval", "hio")
SETTINGS = ("smallest", "small", "full")


def keys(setting: str) -> list[Key]:
    """All cases of a setting, those that share data beside each other."""
    if setting == "smallest":
        fast = ("image", "inverse_filter", "tv", "hio", "wu2024", "evidence_2frames")
        return list(_cases("wall", ["letter"], ["concave"], [40], fast, 48, iterations=20))
    if setting == "full":
        blind = [m for m in methods.NAMES if m not in methods.FAST and m != "evidence"]
        everything = (*methods.FAST, *blind, "evidence")
        names = list(data.OBJECTS)
        cases = _cases("wall", names, data.WALLS, EXPOSURES, everything, 128, pairs=2000)
        known = _cases("paper", names, data.WALLS, EXPOSURES, KNOWN, 256)
        return [*cases, *known]
    return list(itertools.chain(*_small()))


def _small() -> Iterator[Iterator[Key]]:
    """A part of the grid: each question of the paper on one or two objects."""
    fast = (*methods.FAST, "cnn")
    flat, concave = ["flat"], ["concave"]
    yield _cases("wall", ["letter", "hanzi"], data.WALLS, [10, 40], (*fast, "evidence_2frames"), 64)
    yield _cases("wall", ["letter", "hanzi"], concave, [20, 30], (*fast, "evidence_2frames"), 64)
    more = ["posed", "cartoon", "tilted"]
    yield _cases("wall", more, concave, [40], (*fast, "evidence_2frames"), 64)
    yield _cases("paper", ["letter"], flat, EXPOSURES, KNOWN, 192)
    yield _cases("paper", ["hanzi"], flat, [10, 40], KNOWN, 192)
    yield _cases("paper", ["letter"], ["concave", "convex", "wavy"], [10, 40], KNOWN, 192)
    yield _cases("wall", ["letter"], ["flat", "concave"], [40], ("wu2024",), 64)
    yield _cases("wall", ["letter"], concave, [40], ("wu2024_warm", "evidence_2frames_warm"), 64)
    yield _cases("wall", ["tilted"], concave, [40], ("wu2024",), 64)
    yield _cases("wall", ["letter"], concave, [40], ("evidence",), 64)


def _cases(
    scale: str,
    names: Any,
    walls: Any,
    exposures: Any,
    chosen: Any,
    size: int,
    *,
    pairs: int = 400,
    iterations: int = methods.COLD,
) -> Iterator[Key]:
    for name, wall, exposure, method in itertools.product(names, walls, exposures, chosen):
        key: Key = {
            "scale": scale,
            "object": name,
            "wall": wall,
            "exposure_ms": exposure,
            "method": method,
            "size": size,
        }
        if method == "cnn":
            key["pairs"] = pairs
        if method.startswith("wu2024"):
            key["iterations_asked"] = iterations
        if method == "evidence":
            key["max_seconds"] = 45.0 if size == 64 else 600.0
        yield key


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
    report.write(lines, options.out)


def feasibility() -> str:
    """What `limits.feasibility` says of the letter's scenes, as a table."""
    rows = [
        "| scale | wall | ms | electrons | noise | veil | blur passes at two strokes | predicted"
        " correlation | Z4 one frame | Z4 two frames |",
        "|---" * 10 + "|",
    ]
    for scale, size in (("wall", 64), ("paper", 192)):
        for wall, exposure in itertools.product(data.WALLS, (10, 40)):
            scene = data.study_scene(scale, "letter", wall, size, exposure * 1e-3)
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
