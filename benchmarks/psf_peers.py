"""Point spreads: error against seconds, beside prysm, HCIPy, POPPY and Optiland.

python benchmarks/psf_peers.py [--peers-python PATH ...] [--json FILE]

Four waves on a round and clear pupil: no aberration, and a mix of defocus, astigmatism, coma and
spherical of 1, 10 and 100 waves from peak to valley, as rms coefficients of Noll's Zernikes. Image
samples are points: 256 x 256 over +-12.8 lambda N for the first two, 512 x 512 over +-102 and
+-1024 lambda N, which hold the spot, for the others. Two more pupils have 1 wave of the mix: a ring
with four vanes ("spider") and 19 hexagons. The peers get them as fractions of their samples,
averaged over up to 16 x 16 points of each, which is set-up; Optiland takes no part.

The error is max |dI|/max I, each image over its own peak, against the closed form and else against
quadrature at full precision; that is held against direct sums over other nodes at a few samples,
and no error is printed below their difference. Seconds are those from coefficients to intensity on
one thread, least of several. The peers' apertures, polynomials and matrices are kept between runs,
and so are the nodes, polynomials and rims that nlosoptics keeps by itself; `first` is with the
set-up.

Peers run in environments of their own, see requirements-peers.txt; --peers-python may be given
several times, and each peer runs in the first that has it. What their best is, is said in
peers/psf_*.py. Optiland's point spreads begin with the trace of a lens and take no coefficients:
the wave is written in place of that of a perfect lens, and its trace counts as set-up.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["NUMEXPR_NUM_THREADS"] = "1"

import argparse
import json
import subprocess
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from scipy.special import j1

from nlosoptics import psf
from nlosoptics.errors import NlosError
from nlosoptics.psf.aperture import cell_nodes
from nlosoptics.psf.aperture import quadrature_nodes as keepers
from nlosoptics.psf.transform import antialiased_fft, quadrature
from nlosoptics.psf.wave import (
    cell_series,
    detilted,
    polar_series,
    pupil_polynomials,
    zernikes,
)
from nlosoptics.psf.wave import (
    wavefront as wavefronts,
)
from nlosoptics.psf.wave.zernikes import zernike_order

HERE = Path(__file__).parent
WAVELENGTH = 632.8e-9
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
UNIT = 2 * WAVELENGTH  # lambda N
# Waves rms of Noll's polynomials; from peak to valley 1 wave.
MIX = {4: 0.0859, 5: 0.0429, 6: 0.0859, 7: 0.0515, 8: 0.0859, 11: 0.0429}
GOALS = (1e-2, 1e-3, 4e-4, 1e-4, 2e-5, 1e-6, 1e-9, 1e-12)
TOLS = (1e-3, 1e-6, 1e-9, 1e-12)
ENOUGH = 1.0  # s of runs after which no more are timed, as in peers/psf_common.py
PEERS = ("prysm", "hcipy", "poppy", "optiland")
# Names of the peers that an interpreter has, without importing them.
HAS = "import sys; from importlib.util import find_spec; print(*filter(find_spec, sys.argv[1:]))"


def case(name, waves, size, pitch, pupil=None):
    """A case as the peers read it: orders (n, m), m below 0 for sines; pitch in lambda N.

    ``pupil`` is that of `psf_common.transmission`, in pupil radii; None for a clear disc.
    """
    return {
        "name": name,
        "indices": list(waves),
        "orders": [zernike_order(j, "noll") for j in waves],
        "waves": list(waves.values()),
        "size": size,
        "pitch": pitch,
        "pupil": pupil,
    }


def scaled(factor):
    return {j: factor * w for j, w in MIX.items()}


def hexagons():
    """Corners of 19 hexagons in the unit disc, counterclockwise."""
    mirror = psf.Aperture.hexagons(2, flat_to_flat=0.4, gap=4e-3)
    rims = [[side.base for side in cell.outline] for cell in mirror.cells]
    return (np.array(rims) / mirror.bounding_radius).tolist()


SPIDER = {"inner": 0.2, "vanes": 4, "width": 0.04}
CASES = [
    case("no aberration", {}, 256, 0.1),
    case("1 wave", MIX, 256, 0.1),
    case("10 waves", scaled(10), 512, 0.4),
    case("100 waves", scaled(100), 512, 4.0),
    case("spider", MIX, 256, 0.1, SPIDER),
    case("19 hexagons", MIX, 256, 0.1, {"polygons": hexagons()}),
]
# Nothing in it is symmetric, so every flip and shift of an image shows.
CONVENTIONS = case("conventions", {2: 0.4, 3: -0.7, 5: 0.1, 8: 0.1, 9: 0.05}, 128, 0.1)


def aperture(pupil):
    """Our outline of a pupil."""
    radius = SYSTEM["pupil_radius"]
    if "polygons" in pupil:
        rims = (radius * np.array(corners) for corners in pupil["polygons"])
        return psf.Aperture.union(*map(psf.Aperture.polygon, rims))
    return psf.Aperture.round(
        radius, pupil["inner"], vanes=pupil["vanes"], vane_width=radius * pupil["width"]
    )


APERTURES = {one["name"]: aperture(one["pupil"]) for one in CASES if one["pupil"]}


def wavefront(given, **nodes):
    coefficients = {
        j: w * WAVELENGTH for j, w in zip(given["indices"], given["waves"], strict=True)
    }
    outline = APERTURES.get(given["name"])
    return psf.Wavefront.from_zernike(coefficients, **SYSTEM, aperture=outline, **nodes)


def spread(given, method, tol, **nodes):
    """Intensity, from the coefficients on."""
    return psf.point_spread(
        wavefront(given, **nodes),
        method=method,
        model="scalar",  # as the other programs
        tol=tol,
        pitch=given["pitch"] * UNIT,
        shape=given["size"],
        normalisation="ideal-peak",
    ).intensity


def direct(given, rows, columns):
    """Intensity at a few samples, by direct sums over a denser set of nodes."""
    # Phase slopes across the radius by the farthest sample and the aberration's own.
    reach = np.hypot(1, 1) * given["size"] / 2 * given["pitch"]
    slope = np.pi * reach + 2 * np.pi * 9 * sum(np.abs(given["waves"]))
    n_r, n_theta = int(0.35 * slope) + 40, int(1.15 * slope) + 120
    wave = wavefront(given, samples=n_r if given["pupil"] else (n_r, n_theta))
    k = 2 * np.pi / WAVELENGTH
    pupil = np.exp(1j * k * wave.aberration) * wave.weights
    x, y = (
        (index - given["size"] // 2) * given["pitch"] * UNIT / SYSTEM["image_distance"]
        for index in (columns, rows)
    )
    fields = [
        np.sum(pupil * np.exp(-1j * k * (a * wave.u + b * wave.v)))
        for a, b in zip(x, y, strict=True)
    ]
    return np.abs(np.array(fields) / wave.weights.sum()) ** 2


def truth(given):
    """Exact image over its peak, and what direct sums say of its error."""
    image = spread(given, "quadrature", 1e-13)
    if not given["indices"]:
        x = (np.arange(given["size"]) - given["size"] // 2) * given["pitch"]
        v = np.pi * np.hypot(x[:, None], x)
        v[v == 0] = 1e-9
        return (2 * j1(v) / v) ** 2, 0.0
    rows, columns = np.unravel_index(np.argsort(image, axis=None)[::-1], image.shape)
    many = 4 if given["pitch"] > 1 else 64
    chosen = np.unique(np.geomspace(1, image.size, many).astype(int)) - 1
    found = direct(given, rows[chosen], columns[chosen])
    peak = image.max()
    doubt = float(np.abs(found - image[rows[chosen], columns[chosen]]).max() / peak)
    return image / peak, doubt


def timed(run, repeats):
    """Result and least seconds of a few runs, the first one as warm-up."""
    start = time.perf_counter()
    result, best = run(), np.inf
    slow = time.perf_counter() - start > 1
    begin = time.perf_counter()
    for _ in range(1 if slow else repeats):
        start = time.perf_counter()
        result = run()
        best = min(best, time.perf_counter() - start)
        if time.perf_counter() - begin > ENOUGH:
            break
    return result, best


def forget():
    """Drop all that nlosoptics keeps between calls."""
    kept = (
        keepers,
        pupil_polynomials,
        detilted,
        antialiased_fft,
        quadrature,
        cell_nodes,
        cell_series,
        polar_series,
        wavefronts,
        zernikes,
    )
    for module in kept:
        for function in vars(module).values():
            if hasattr(function, "cache_clear"):
                function.cache_clear()


def our_rows(given, repeats, samples):
    """Rows of our transforms, those that refuse left out."""
    jobs = [("auto", tol, {}) for tol in (1e-2, 1e-3, 1e-4, 2e-5, 1e-6, 1e-9)]
    jobs += [("quadrature", tol, {}) for tol in TOLS]
    jobs += [("fft", tol, {}) for tol in TOLS]
    jobs += [("airy", 1e-3, {})]
    jobs += [("mdft", 1e-3, {"nodes": "grid", "samples": n}) for n in samples if n <= 2048]
    rows = []
    for method, tol, nodes in jobs:
        run = partial(spread, given, method, tol, **nodes)
        try:
            image, seconds = timed(run, repeats)
            forget()
            start = time.perf_counter()
            run()
            first = time.perf_counter() - start
        except NlosError:
            continue
        rows.append(
            {
                "case": given["name"],
                "name": f"nlosoptics, {method}{', grid' if nodes else ''}",
                "samples": nodes.get("samples"),
                "tol": tol,
                "seconds": seconds,
                "first": first,
                "image": image,
            }
        )
    return rows


def serving(pythons):
    """Interpreter of each peer: the first that has it."""
    found = {}
    for python in pythons:
        if not Path(python).is_file():
            raise SystemExit(f"there is no {python}")
        run = subprocess.run(
            [python, "-c", HAS, *PEERS], capture_output=True, text=True, env=clean(), check=True
        )
        for name in run.stdout.split():
            found.setdefault(name, python)
    if not pythons:
        print("no --peers-python PATH: nlosoptics alone")
    elif len(found) < len(PEERS):
        print(f"no interpreter has {', '.join(name for name in PEERS if name not in found)}")
    return {name: found[name] for name in PEERS if name in found}


def clean():
    """Environment without our own path of modules."""
    return {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}


def peer_rows(python, name, job):
    """Rows of a peer with images in place of files, or none and a line that says why."""
    with tempfile.TemporaryDirectory() as folder:
        run = subprocess.run(
            [python, HERE / "peers" / f"psf_{name}.py"],
            input=json.dumps({**job, "folder": folder}),
            capture_output=True,
            text=True,
            env=clean(),
            check=False,
        )
        if run.returncode:
            lines = run.stderr.strip().splitlines() or [f"exit status {run.returncode}"]
            print(f"{name} did not run: {lines[-1]}")
            return []
        found = json.loads(run.stdout)
        return [
            {
                **row,
                "version": found["version"],
                "note": found["note"],
                "image": np.load(row["image"]),
            }
            for row in found["rows"]
        ]


def error_of(image, exact):
    """Largest difference of images, each over its own peak."""
    return float(np.abs(image / image.max() - exact).max())


def check_conventions(rows):
    """Stop where a peer's image is flipped or shifted against ours."""
    exact, _ = truth(CONVENTIONS)
    for name in dict.fromkeys(row["name"] for row in rows):
        error = min(error_of(row["image"], exact) for row in rows if row["name"] == name)
        print(f"{name}: {error:.1e} from ours where nothing is symmetric")
        if not error < 1e-2:
            raise SystemExit(f"{name} has other signs or samples than ours")
    for note in dict.fromkeys(row["note"] for row in rows if row["note"]):
        print(note)


def compare(options):
    """Print and return the rows of everyone."""
    cases = [given for given in CASES if given["name"] in options.case]
    peers = serving(options.peers_python)
    job = {"repeats": options.repeats, "samples": [256], "cases": [CONVENTIONS]}
    check_conventions([row for name in peers for row in peer_rows(peers[name], name, job)])
    samples = [2**k for k in range(5, 13) if 2**k <= options.samples]
    rows = []
    print(f"{'case':14s} {'by':28s} {'samples':>8s} {'ms':>9s} {'first':>9s} {'error':>8s}")
    for given in cases:
        exact, doubt = truth(given)
        job = {"repeats": options.repeats, "samples": samples, "cases": [given]}
        found = our_rows(given, options.repeats, samples)
        for name in peers:
            found += peer_rows(peers[name], name, job)
        for row in found:
            row.pop("note", None)
            row["error"] = max(error_of(row.pop("image"), exact), doubt)
            print(
                f"{row['case']:14s} {row['name']:28s} {row['samples'] or row.get('tol', 0):8g} "
                f"{1e3 * row['seconds']:9.2f} {1e3 * row['first']:9.1f} {row['error']:8.1e}",
                flush=True,
            )
        rows += found
        print(f"{given['name']:14s} the exact image is known to {doubt:.0e}")
    return rows


def summary(rows):
    """Print the least time to each error, ours and the best peer's; nothing is extrapolated."""
    for key, meaning in (("seconds", "set-up kept"), ("first", "with set-up")):
        print(f"\nleast ms to an error, {meaning}: ours, the best peer, the peer's over ours")
        for name in dict.fromkeys(row["case"] for row in rows):
            part = [row for row in rows if row["case"] == name]
            for goal in GOALS:
                best = [fastest(part, key, goal, ours) for ours in (True, False)]
                said = [
                    f"{1e3 * row[key]:9.2f} {row['name']:26s}" if row else f"{'none':36s}"
                    for row in best
                ]
                ratio = f"{best[1][key] / best[0][key]:8.2f}" if all(best) else ""
                print(f"{name:14s} {goal:6.0e} {said[0]} {said[1]} {ratio}")


def fastest(rows, key, goal, ours):
    """Row of least time to an error, among ours or the peers', or None."""
    reached = [
        row for row in rows if row["error"] <= goal and row["name"].startswith("nlosoptics") == ours
    ]
    return min(reached, key=lambda row: row[key], default=None)


def main():
    """Print the tables, write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--peers-python",
        metavar="PATH",
        action="append",
        default=[],
        help="interpreter that has peers; may be given several times",
    )
    parser.add_argument("--samples", type=int, default=4096, help="most pupil samples a side")
    parser.add_argument("--repeats", type=int, default=100, help="most, of runs that are short")
    every = [given["name"] for given in CASES]
    parser.add_argument("--case", action="append", choices=every, help="by default all")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    options.case = options.case or every
    rows = compare(options)
    summary(rows)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
