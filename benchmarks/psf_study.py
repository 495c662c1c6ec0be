"""Random waves by method="auto" against references: python benchmarks/psf_study.py --json FILE.

Judged: the error within tol, the estimate above it, how far above, and what is refused, by regime.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import math
import re
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import psf_references as references

from nlosoptics import _checks, psf
from nlosoptics.errors import NlosError

WAVELENGTH, RADIUS = 632.8e-9, 12.5e-3
#: Pixels a side of the widest window.
WIDEST = 400
#: Rounding of a reference, relative to the peak.
ROUNDING = 1e-12
KINDS = ("polar", "cells", "grid", "scattered", "map", "rough")
SHARES = (0.4, 0.12, 0.13, 0.13, 0.12, 0.1)
#: Seconds up to which a remedy that asks for more of them is tried.
LONGEST = 60.0
#: Seconds of a call below which it is timed once more, its tables at hand.
SHORT = 0.5
MIXES = {
    "defocus": (4,),
    "astigmatism": (5, 6),
    "coma": (7, 8),
    "spherical": (11,),
    "caustic": (4, 7, 11),
    "low": tuple(range(4, 12)),
    "high": tuple(range(4, 37)),
}
AMPLITUDES = {
    "uniform": lambda x, y: np.ones(np.broadcast(x, y).shape),
    "gaussian": lambda x, y: np.exp(-(x**2 + y**2) / 1.3),
    "slanted": lambda x, y: 1 + 0.6 * x - 0.2 * y,
}


@dataclass
class Case:
    """What is computed, and what it is compared with."""

    facts: dict
    wave: references.Wave
    front: psf.Wavefront
    options: dict
    rough: dict | None = None


def wave_of(rng, waves, kind):
    """A continuous wave of given peak to valley, waves."""
    mix = str(rng.choice(list(MIXES)))
    obscuration = 0.0 if rng.random() < 0.5 else float(rng.uniform(0.1, 0.6))
    name = str(rng.choice(list(AMPLITUDES), p=(0.6, 0.2, 0.2))) if kind != "rough" else "uniform"
    distance = float(rng.choice((-1, 1)) * 10 ** rng.uniform(-1, 0.5))
    raw = {j: float(rng.normal()) / (1 + j / 8) for j in MIXES[mix]}
    wave = references.Wave(raw, AMPLITUDES[name], WAVELENGTH, RADIUS, distance, obscuration)
    r, t = np.linspace(obscuration, 1, 60)[:, None], np.linspace(0, 2 * math.pi, 120)
    height = wave.waves(r * np.cos(t), r * np.sin(t))
    factor = waves / float(np.ptp(height))
    wave.coefficients = {j: c * factor for j, c in raw.items()}
    if waves and rng.random() < 0.3:  # a tilt that moves the spot by some Airy units
        wave.coefficients |= {2: float(rng.uniform(-1, 1)), 3: float(rng.uniform(-1, 1))}
    return wave, {"mix": mix, "amplitude": name, "obscuration": round(obscuration, 3)}


def outline_of(rng, wave):
    """An outline as the references know it, the library's, and its name."""
    name = str(rng.choice(("ellipse", "polygon", "hexagons")))
    angle = float(rng.uniform(0, 2 * math.pi))
    if name == "ellipse":
        b = float(rng.uniform(0.4, 1))
        known = references.Ellipse(b, angle, wave.obscuration)
        axes = RADIUS, b * RADIUS, angle
        return known, psf.Aperture.ellipse(*axes, obscuration=wave.obscuration), name
    wave.obscuration = 0.0
    if name == "polygon":
        sides = int(rng.integers(3, 9))
        turn = angle + 2 * math.pi * np.arange(sides) / sides
        corners = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        known = references.Triangles(references.fan(corners))
        return known, psf.Aperture.regular(sides, RADIUS, angle), name
    width, gap = 0.6, float(rng.uniform(0, 0.03))
    turn = angle + math.pi / 3 * np.arange(6)
    corners = width / math.sqrt(3) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ring = (width + gap) * np.stack([np.cos(turn + math.pi / 6), np.sin(turn + math.pi / 6)], 1)
    fans = [references.fan(corners + c, c) for c in ((0.0, 0.0), *ring)]
    known = references.Triangles(np.concatenate(fans))
    return known, psf.Aperture.hexagons(1, width * RADIUS, gap * RADIUS, angle=angle), name


def cells_front(wave, aperture):
    """The wave's library counterpart on the nodes of an aperture's cells."""
    front = psf.Wavefront.from_zernike(
        {j: c * WAVELENGTH for j, c in wave.coefficients.items()},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=wave.distance,
        aperture=aperture,
    )
    return replace(front, amplitude=wave.amplitude(front.u / RADIUS, front.v / RADIUS))


def polar_front(wave):
    """Its library counterpart on polar nodes."""
    coefficients = {j: c * WAVELENGTH for j, c in wave.coefficients.items()}
    front = psf.Wavefront.from_zernike(
        coefficients,
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=wave.distance,
        obscuration=wave.obscuration,
        samples=(32, 128),
    )
    return replace(front, amplitude=wave.amplitude(front.u / RADIUS, front.v / RADIUS))


def grid_front(wave, samples):
    """The same on cells cut by the rim."""
    u, v, weights = psf.grid_nodes(RADIUS, samples, wave.obscuration)
    return _front(wave, u, v, weights, "grid")


def scattered_front(rng, wave, count):
    """The same on a sunflower's nodes, some of them astray."""
    share = (np.arange(count) + 0.5) / count
    inner = wave.obscuration**2
    r = RADIUS * np.sqrt(inner + (1 - inner) * share)
    angle = np.arange(count) * math.pi * (3 - math.sqrt(5))
    u, v = r * np.cos(angle), r * np.sin(angle)
    if rng.random() < 0.5:
        side = RADIUS * math.sqrt(math.pi * (1 - inner) / count)
        u, v = (a + 0.1 * side * rng.normal(size=count) * (share < 0.9) for a in (u, v))
    weights = np.full(count, math.pi * RADIUS**2 * (1 - inner) / count)
    return _front(wave, u, v, weights, "scattered")


def _front(wave, u, v, weights, layout):
    x, y = u / RADIUS, v / RADIUS
    return psf.Wavefront(
        u=u,
        v=v,
        aberration=wave.waves(x, y) * WAVELENGTH,
        amplitude=np.maximum(wave.amplitude(x, y), 0.0),
        weights=weights,
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=wave.distance,
        obscuration=wave.obscuration,
        layout=layout,
    )


def screen_front(rng, wave, samples, rms, length):
    """A map with a correlated random screen on top of the wave."""
    front = grid_front(wave, samples)
    fx = np.fft.fftfreq(samples)
    noise = np.fft.fft2(rng.normal(size=(samples, samples)))
    noise *= np.exp(-((math.pi * length * samples / 2) ** 2) * (fx[:, None] ** 2 + fx**2))
    screen = np.fft.ifft2(noise).real
    screen *= rms * WAVELENGTH / screen.std()
    return psf.Wavefront.from_map(
        front.aberration + screen,
        (front.weights > 0.5 * front.weights.max()) * front.amplitude,
        wavelength=WAVELENGTH,
        pupil_pitch=front.pupil_pitch,
        image_distance=wave.distance,
        pupil_radius=RADIUS,
    )


def draw(seed, index, max_seconds, kind=None):
    """One case, the same for the same numbers."""
    rng = np.random.default_rng((seed, index))
    drawn = str(rng.choice(KINDS, p=SHARES))
    kind = kind or drawn
    waves = 0.0 if rng.random() < 0.1 else float(10 ** rng.uniform(-3, 3))
    if kind == "rough":
        waves = min(waves, float(10 ** rng.uniform(-1, 0.7)))
    # nodes without a rim take few waves to few pixels; one case in five asks for more than that
    fair = kind in ("grid", "scattered") and rng.random() < 0.8
    if fair:
        waves = min(waves, float(10 ** rng.uniform(-2, 1 if kind == "scattered" else 1.5)))
    wave, facts = wave_of(rng, waves, kind)
    slope = wave.steepest() / (2 * math.pi)  # waves per radius
    screen = 0.0, 1.0
    if kind == "map":
        screen = float(10 ** rng.uniform(-2, 0)), float(rng.uniform(0.1, 0.4))
        slope += 4 * screen[0] / screen[1]
    unit = WAVELENGTH * abs(wave.distance) / (2 * RADIUS)
    reach = 2 * slope * unit + 4 * unit
    widest = 80 if kind == "rough" else WIDEST
    wide = 10 if fair and kind == "scattered" else 100
    pitch = max(float(10 ** rng.uniform(-1, math.log10(wide))) * unit, 2 * reach / widest)
    integrated = bool(pitch > 0.45 * unit or rng.random() < 0.5)
    n = 2 * math.ceil(reach * rng.uniform(1, 1.5) / pitch + 2) + 1
    tol = float(10 ** rng.uniform(-8, -2))
    if fair:
        tol = float(10 ** rng.uniform(-2.5, -1))  # what nodes that lost their rim are for
    # cells across that keep the repeats off the window
    across = 1.1 * ((n + 1) / 2 * pitch + reach) / unit * rng.uniform(1, 2)
    if kind == "cells":
        wave.outline, aperture, facts["outline"] = outline_of(rng, wave)
        front = cells_front(wave, aperture)
    else:
        front = front_of(rng, kind, wave, max(4.4 * slope, across), screen)
    facts |= {"kind": kind, "waves": _short(waves), "pixel": _short(pitch / unit), "shape": n}
    facts |= {"integrated": integrated, "tol": _short(tol), "nodes": front.u.size}
    options = {"pitch": pitch, "shape": n, "pixel_integrated": integrated, "tol": tol}
    options["normalisation"] = str(rng.choice(("unit-sum", "ideal-peak", "flux")))
    if kind == "rough":
        return Case(facts, wave, front, options, _roughness(rng, facts, wave))
    options["max_seconds"] = max_seconds
    return Case(facts, wave, front, options)


def front_of(rng, kind, wave, across, screen):
    """The wave in a layout, with so many cells across where they count and are not too many."""
    if kind in ("polar", "rough"):
        return polar_front(wave)
    if kind == "grid":
        return grid_front(wave, int(np.clip(across, 128, 700)))
    if kind == "scattered":
        return scattered_front(rng, wave, int(np.clip(0.8 * across**2, 2000, 30000)))
    return screen_front(rng, wave, int(np.clip(across, 64, 400)), *screen)


def _roughness(rng, facts, wave):
    s = 0.0 if rng.random() < 0.1 else float(10 ** rng.uniform(-1, 1.48))
    m = float(rng.uniform(0.3, 0.8))
    length = float(rng.uniform(0.15, 1.0)) * RADIUS * m
    name = str(rng.choice(("gaussian", "exponential")))
    # the steeper walls are, the longer, or their halos would not fit a reference
    length *= max(1.0, s / 2 if name == "gaussian" else s**2 / 4)
    facts |= {"s": _short(s), "length": _short(length / (2 * RADIUS * m)), "correlation": name}
    cos_sum = float(rng.uniform(1.0, 2.0))
    height = s * WAVELENGTH / (2 * math.pi * cos_sum)
    footprint = (m, m * float(rng.uniform(0.8, 1.2)))
    halo = 0.0
    if s:
        level = length * (1 / max(s, 1.0) if name == "gaussian" else 1 / max(s, 1.0) ** 2)
        halo = WAVELENGTH * abs(wave.distance) * max(footprint) / (math.pi * level) * 2
    return {
        "s": s,
        "roughness": psf.Roughness(height, length, name),
        "view": {"footprint": np.diag(footprint), "cos_sum": cos_sum},
        "footprint": footprint,
        "halo": halo,
        "correlation": (lambda r: np.exp(-((r / length) ** 2)))
        if name == "gaussian"
        else (lambda r: np.exp(-r / length)),
    }


def run(case):
    """The library's point spread, or its refusal, and seconds."""
    start = time.process_time()  # of one thread: other work on the machine is left out
    try:
        if case.rough is None:
            spread = psf.point_spread(case.front, **case.options, model="scalar")
        else:
            spread = psf.mean_point_spread(
                case.front, case.rough["roughness"], **case.rough["view"], **case.options
            )
        refusal = ""
    except NlosError as error:
        spread, refusal = None, f"{type(error).__name__}: {error}"
    return spread, refusal, time.process_time() - start


def true_error(rng, case, spread):
    """Error relative to the peak, and the reference's doubt in the same units."""
    peak = float(spread.intensity.max())
    if case.rough is not None:
        found, doubt = references.rough(
            case.wave,
            spread,
            case.rough["s"],
            case.rough["correlation"],
            case.rough["footprint"],
            case.rough["halo"],
        )
        level = {"unit-sum": 1.0, "flux": case.front.flux}.get(spread.normalisation)
        if level is None:
            unit = WAVELENGTH * abs(case.wave.distance) / (2 * RADIUS)
            clear = math.pi / 4 * (1 - case.wave.obscuration**2)
            level = 1 / (clear * (spread.pitch / unit) ** 2)
        worst = float(np.abs(found * level - spread.intensity).max())
        return worst / peak, doubt * level / peak
    if case.facts["kind"] == "map":
        found = references.sampled(case.front, case.wave, spread)
        return float(np.abs(found - spread.intensity).max()) / peak, 0.0
    return _continuous_error(rng, case, spread, peak)


def _continuous_error(rng, case, spread, peak):
    """The same of a wave known everywhere: of the brightest pixels, the middle and some others."""
    ny, nx = spread.shape
    each = len(references.pixel_points(case.wave, spread.pitch, spread.pixel_integrated)[0]) ** 2
    count = int(max(8, references.MOST_POINTS // each))
    flat = spread.intensity.ravel()
    if count >= flat.size:
        chosen = np.arange(flat.size)
    else:
        brightest = np.argsort(flat)[-count // 3 :]
        middle = (ny // 2) * nx + nx // 2
        chosen = np.unique(np.append(brightest, [middle, *rng.integers(0, flat.size, count // 2)]))
    try:
        rows, columns = np.unravel_index(chosen, spread.shape)
        found, doubt = references.continuous(case.wave, spread, rows, columns)
    except references.OutOfReachError:
        order = np.argsort(flat)
        middle = (ny // 2) * nx + nx // 2
        chosen = np.array([order[-1], middle, rng.choice(order[-flat.size // 3 :])])
        rows, columns = np.unravel_index(chosen, spread.shape)
        found, doubt = references.single(case.wave, spread, rows, columns)
    return float(np.abs(found - flat[chosen]).max()) / peak, doubt / peak


def remedied(rng, case, refusal):
    """The case with what a refusal asks for, or None."""
    better = re.search(r"use tol = ([0-9.e+-]+)", refusal)
    if better:
        return replace(case, options={**case.options, "tol": float(better[1])})
    wider = re.search(r"use shape = \((\d+),", refusal)
    if wider:
        return replace(case, options={**case.options, "shape": int(wider[1])})
    longer = re.search(r"use max_seconds = ([0-9.e+-]+)", refusal)
    if longer and float(longer[1]) <= LONGEST:
        return replace(case, options={**case.options, "max_seconds": float(longer[1])})
    rays = re.search(r"tol well above ([0-9.e+-]+), so that", refusal)
    if rays and float(rays[1]) < 0.3:
        return replace(case, options={**case.options, "tol": 3 * float(rays[1])})
    more = re.search(r"use (\d+) or more pupil samples", refusal)
    if not more:
        return None
    count = int(1.02 * int(more[1])) + 1
    if case.facts["kind"] == "grid" and count <= 2100:
        return replace(case, front=grid_front(case.wave, count))
    if case.facts["kind"] == "scattered" and count <= 250000:
        return replace(case, front=scattered_front(rng, case.wave, count))
    return None


def study(case, seed, index):
    """Facts, method, seconds, estimate and error of a case, refusals' remedies tried."""
    spread, refusal, seconds = run(case)
    if seconds < SHORT and spread is not None:
        seconds = min(seconds, run(case)[2])
    row = {**case.facts, "seconds": _short(seconds)}
    rng = np.random.default_rng((seed, index, 2))
    for _ in range(4):
        if spread is not None:
            break
        row |= {"refusal": refusal} if "refusal" not in row else {"again": refusal}
        case = remedied(rng, case, refusal)
        if case is None:
            return row
        row |= {"remedy": _remedy(case)}
        spread, refusal, _ = run(case)
    if spread is None:
        return {**row, "again": refusal}
    row |= {"asked": _short(case.options["tol"])}
    predicted = re.search(r"about ([0-9.e+-]+) s", spread.reason)
    if predicted and case.rough is None and "refusal" not in row:
        row |= {"predicted": float(predicted[1])}
    row |= {"method": spread.method, "estimate": _short(spread.error_estimate)}
    try:
        error, doubt = true_error(np.random.default_rng((seed, index, 1)), case, spread)
    except references.OutOfReachError as reason:
        return {**row, "no_reference": str(reason)}
    return {**row, "error": _short(error), "doubt": _short(doubt)}


def _remedy(case):
    allowed = case.options.get("max_seconds", 0.0)
    return f"tol {case.options['tol']:g}, {len(case.front.u)} nodes, {allowed:g} s"


def _short(value):
    return float(f"{value:.4g}")


def judge(rows):
    """Shares of what is judged."""
    known = [r for r in rows if "error" in r]
    slack = [max(3 * r["doubt"], ROUNDING) for r in known]
    within = [r["error"] <= r["asked"] + d for r, d in zip(known, slack, strict=True)]
    bounded = [r["error"] <= r["estimate"] + d for r, d in zip(known, slack, strict=True)]
    # below their own doubt references cannot tell by how much an estimate overstates
    over = [
        r["estimate"] / r["error"] for r, d in zip(known, slack, strict=True) if r["error"] > 3 * d
    ]
    refused = [r for r in rows if "refusal" in r]
    timed = [r["seconds"] / r["predicted"] for r in rows if "predicted" in r]
    easy = [r for r in rows if _is_easy(r)]
    return {
        "cases": len(rows),
        "compared": len(known),
        "within_tol": sum(within) / max(len(known), 1),
        "bounded": sum(bounded) / max(len(known), 1),
        "median_overstatement": float(np.median(over)) if over else None,
        "refused": len(refused) / len(rows),
        **{f"refused_for_{name}": sum(w in r["refusal"] for r in refused) for name, w in CAUSES},
        "refusals_without_remedy": sum("; " not in r["refusal"] for r in refused),
        "remedies_tried": sum("remedy" in r for r in refused),
        "remedies_failed": sum("remedy" in r and "method" not in r for r in refused),
        "easy_cases": len(easy),
        "easy_refused": sum("refusal" in r for r in easy) / max(len(easy), 1),
        "without_reference": sum("no_reference" in r for r in rows),
        "median_seconds_over_predicted": float(np.median(timed)) if timed else None,
        "seconds_within_three": sum(1 / 3 <= t <= 3 for t in timed) / max(len(timed), 1),
        "longest_seconds": max(r["seconds"] for r in rows),
        "by_regime": {name: _group(rows, test) for name, test in GROUPS.items()},
    }


def _is_easy(row):
    """Few waves on polar nodes, or a map, at a tolerance short of rounding."""
    return row["kind"] in ("polar", "map") and row["waves"] <= 30 and row["tol"] >= 1e-7


#: What refusals say, by what they are for.
CAUSES = (
    ("tol", " tol = "),
    ("nodes", "aberration jumps"),
    ("repeats", "repeat the spot"),
    ("seconds", "would take about"),
    ("memory", "GiB"),
)
GROUPS = {
    **{kind: (lambda r, k=kind: r["kind"] == k) for kind in KINDS},
    "0 to 0.1 waves": lambda r: r["waves"] <= 0.1,
    "0.1 to 1": lambda r: 0.1 < r["waves"] <= 1,
    "1 to 20": lambda r: 1 < r["waves"] <= 20,
    "20 to 100": lambda r: 20 < r["waves"] <= 100,
    "100 to 1000": lambda r: r["waves"] > 100,
    "tol 1e-8 to 1e-6": lambda r: r["tol"] < 1e-6,
    "tol 1e-6 to 1e-4": lambda r: 1e-6 <= r["tol"] < 1e-4,
    "tol 1e-4 to 1e-2": lambda r: r["tol"] >= 1e-4,
}


def _group(rows, test):
    part = [r for r in rows if test(r)]
    known = [r for r in part if "error" in r]
    over = [r["estimate"] / r["error"] for r in known if r["error"] > 3 * max(r["doubt"], ROUNDING)]
    return {
        "cases": len(part),
        "refused": sum("refusal" in r for r in part),
        "median_overstatement": _short(np.median(over)) if over else None,
    }


def _row(wanted):
    """Case and findings of one index, in a process of the pool."""
    options, index = wanted
    _checks.available_memory = lambda: options.gib * 2**30
    case = draw(options.seed, index, options.max_seconds)
    return {"case": index, **study(case, options.seed, index)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--max-seconds", type=float, default=5.0, help="of each auto call")
    parser.add_argument("--gib", type=float, default=8.0, help="of memory that a call finds free")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--verbose", action="store_true", help="a line for every case")
    options = parser.parse_args()
    if options.cases < 1:
        parser.error(f"--cases = {options.cases}; at least 1")
    start = time.perf_counter()
    rows = []
    wanted = ((options, index) for index in range(options.cases))
    with ProcessPoolExecutor(options.jobs) as pool:
        for row in pool.map(_row, wanted):
            rows.append(row)
            if options.verbose:
                print(json.dumps(row), f"{time.perf_counter() - start:.0f} s", flush=True)
    found = judge(rows)
    for name, value in found.items():
        if name != "by_regime":
            print(f"{name:26} {value:.4g}" if value is not None else f"{name:26} none")
    print(f"\n{'regime':20} {'cases':>6} {'refused':>8} {'estimate/error':>15}")
    for name, group in found["by_regime"].items():
        print(f"{name:20} {group['cases']:6} {group['refused']:8} {group['median_overstatement']}")
    print(f"\n{time.perf_counter() - start:.0f} s")
    if options.json:
        head = {
            "seed": options.seed,
            "max_seconds": options.max_seconds,
            "gib": options.gib,
            **found,
        }
        lines = ",\n  ".join(json.dumps(row) for row in rows)
        text = json.dumps(head, indent=1)[:-2] + f',\n "rows": [\n  {lines}\n ]\n}}\n'
        options.json.write_text(text)


if __name__ == "__main__":
    main()
