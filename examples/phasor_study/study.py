"""Reflectance and phasor fields (Guillen et al. 2020) as one study, rendered and imaged here.

python examples/phasor_study/study.py --setting small --out phasor_study [--report]

One line of JSON for each finished case in OUT/SETTING.jsonl; started again, it goes on where it was
cut off. Then RESULTS.md and pictures. "small" takes some minutes on two cores; "full" has the
paper's points and five bounces, and takes hours.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import phasor_cases as cases
import phasor_report as report
import phasor_scenes as scenes

from nlosoptics.errors import ValidityWarning

Key = dict[str, Any]

SETTINGS = ("smallest", "small", "full")


def keys(setting: str) -> list[Key]:
    """All cases of a setting, those of one capture beside each other."""
    if setting == "smallest":
        return list(
            _cases(
                "letters",
                8,
                (0.448,),
                seeds=1,
                materials=("lambert", "ward-0.2"),
                apertures=(0.9, 1.792),
                finer=(4,),
                offsets=1,
                max_bounces=4,
                tol=0.05,
                n_rays=1 << 12,
            )
        )
    if setting == "small":
        both = (0.112, 0.224)  # 2 and 4 pitches
        small: Key = {"max_bounces": 4, "tol": 1e-2, "n_rays": 1 << 14, "cell": 0.05}
        letters = _cases("letters", 32, both, **small)
        # seeds of one material tell what seeds do, and the dragon has many triangles
        diffuse = _cases("dragon", 32, both, materials=scenes.MATERIALS[:1], **small)
        glossy = _cases("dragon", 32, both, materials=scenes.MATERIALS[1:], seeds=1, **small)
        forms: Key = {"materials": scenes.VARIANTS, "seeds": 1, "apertures": (1.792,), **small}
        others = [key for name in scenes.DEPTHS for key in _cases(name, 32, both, **forms)]
        return [*letters, *diffuse, *glossy, *(key for key in others if key["bounces"] > 3)]
    fine = {"max_bounces": 5, "tol": 3e-3, "n_rays": 1 << 18}
    letters = _cases("letters", 64, (0.056, 0.112), **fine)
    dragon = _cases("dragon", 128, (0.028, 0.056), cell=0.02, **fine)
    return [*letters, *dragon]


def _cases(
    name: str,
    points: int,
    wavelengths: tuple[float, ...],
    *,
    max_bounces: int,
    tol: float,
    n_rays: int,
    seeds: int = 3,
    materials: tuple[str, ...] = scenes.MATERIALS,
    apertures: tuple[float, ...] = scenes.APERTURES,
    finer: tuple[int, ...] = (1, 2),
    offsets: int = len(cases.OFFSETS),
    cell: float = 0.025,
) -> Iterator[Key]:
    """Each material, seed, wavelength, voxel of a wavelength or a part of it, and aperture."""
    for material, seed in itertools.product(materials, range(seeds)):
        # the last of three bounces alone has nothing drawn at random
        for bounces in (max_bounces, 3) if seed == 0 else (max_bounces,):
            for wavelength, part, aperture in itertools.product(wavelengths, finer, apertures):
                yield {
                    "scene": name,
                    "material": material,
                    "points": points,
                    "wavelength": wavelength,
                    "voxel": wavelength / part,
                    "aperture": aperture,
                    "bounces": bounces,
                    "seed": seed,
                    "offsets": offsets,
                    "max_bounces": max_bounces,
                    "bin": min(wavelengths) / 8.0,
                    "longest": max(wavelengths),
                    "tol": tol,
                    "n_rays": n_rays,
                    "cell": cell,
                }


def work(key: Key, folder: Path) -> dict[str, Any]:
    """One case, its pictures kept in a folder."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)  # the line has them as notes
        line, pictures = cases.solved(key, folder)
    if pictures:
        path = folder / "pictures" / f"{cases.name_of(key)}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **{k: v.astype(np.float32) for k, v in pictures.items()})
    return line


def rounded(value: Any) -> Any:
    """Numbers to six digits, which is more than they mean, so that lines are short."""
    if isinstance(value, dict):
        return {name: rounded(item) for name, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


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
    parser.add_argument("--out", type=Path, default=Path("phasor_study"))
    parser.add_argument("--report", action="store_true", help="page and pictures alone")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / f"{options.setting}.jsonl"
    lines = finished(path)
    done = {cases.name_of(line) for line in lines}
    todo = [key for key in keys(options.setting) if cases.name_of(key) not in done]
    if todo and not options.report:
        if path.exists() and not path.read_text().endswith("\n"):
            path.write_text("".join(json.dumps(line) + "\n" for line in lines))
        with path.open("a") as file:
            for key in todo:
                line = rounded(work(key, options.out))
                lines.append(line)
                file.write(json.dumps(line) + "\n")
                file.flush()
                told = np.round(line.get("mae", []), 4).tolist()
                print(cases.name_of(line), line["status"], told, flush=True)
    done = {cases.name_of(line) for line in lines}
    left = [key for key in todo if cases.name_of(key) not in done]
    report.write(lines, options.out, options.setting, left)


if __name__ == "__main__":
    sys.exit(main())
