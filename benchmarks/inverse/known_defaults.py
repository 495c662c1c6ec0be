"""Known point spread, default settings: random objects and noise, beside deepinv and scikit-image.

    PEER/bin/python benchmarks/inverse/known_defaults.py [--cases 24] [--first 0] [--json FILE]

Needs an interpreter with this package, deepinv and scikit-image. Each case draws an object (letters
of several fonts, strokes, grey shapes, dots, clouds; `pictures.fine_picture`), a wall of
`known_psf.py` and noise between 0.5 and 10 % of the brightest pixel. `tv_deconvolve` sees image and
model only; `told` is the same with the true noise. The others know more than a user can:
scikit-image's Richardson-Lucy and Wiener filter, and deepinv's FISTA with total variation (1,200
steps of the inverse norm), each take, of several settings, the one that comes nearest to the truth
(`best`); deepinv's also the one whose residual comes nearest to the true noise (`told`), as the
discrepancy principle asks. A step of 1 and 300 steps of `PGD` leave residuals of 15 sigma.
With --json each finished case is a line of the file, and cases that it holds are not done again.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from known_psf import fine_point_spread, measured, their_richardson_lucy, their_wiener
from pictures import SIDE, fine_picture

STRENGTHS = tuple(10.0 ** np.arange(-4.0, -1.9, 0.5))  # weights of deepinv's total variation
STEPS = 1200  # of its accelerated proximal gradient
COLUMNS = ("ours", "ours_told", "deepinv_told", "deepinv_best", "lucy_best", "wiener_best")


def loaded():
    """deepinv; where torchvision is built for another torch, with stand-ins for two operators."""
    import torch

    probe = [sys.executable, "-c", "import torchvision"]
    run = subprocess.run(probe, capture_output=True, text=True, check=False)
    library = None
    if "torchvision::nms does not exist" in run.stderr:
        library = torch.library.Library("torchvision", "DEF")
        for name in ("nms", "qnms"):
            library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    import deepinv

    return deepinv, library


def physics_of(deepinv, model):
    """A model of one point spread as a linear physics of deepinv."""
    import torch

    class Physics(deepinv.physics.LinearPhysics):
        def A(self, x, **_):
            return torch.from_numpy(model.forward(x.numpy())).float()

        def A_adjoint(self, y, **_):
            return torch.from_numpy(model.adjoint(y.numpy())).float()

    return Physics(img_size=(1, *model.shape))


def by_deepinv(deepinv, data, model):
    """Correlations of deepinv's total variation: told the true noise, and the best."""
    import torch

    from nlosoptics import inverse

    physics, tried = physics_of(deepinv, model), []
    peak = data.image.max()
    image = torch.from_numpy(data.image / peak).float()[None, None]
    torch.manual_seed(0)
    norm = physics.compute_norm(torch.rand_like(image), max_iter=500, tol=1e-6, verbose=False)
    for strength in STRENGTHS:
        solver = deepinv.optim.FISTA(
            data_fidelity=deepinv.optim.data_fidelity.L2(),
            prior=deepinv.optim.prior.TVPrior(n_it_max=20),
            lambda_reg=float(strength),
            stepsize=0.99 / float(norm),
            max_iter=STEPS,
        )
        with torch.no_grad():
            found = solver(image, physics)
            rest = float((physics.A(found) - image).std()) * peak
        picture = found[0, 0].double().numpy().clip(0.0)
        surplus = abs(math.log(rest / data.noise_sigma))
        tried.append((surplus, inverse.registered_correlation(picture, data.truth)))
    return min(tried)[1], max(correlation for _surplus, correlation in tried)


def compared(deepinv, number):
    """One case, as a line of JSON."""
    from nlosoptics import imaging, inverse

    rng = np.random.default_rng([61, number])
    noise = float(np.exp(rng.uniform(math.log(0.005), math.log(0.1))))
    wall = ("smooth", "speckle")[number % 2]
    kind, fine = fine_picture(61, number)
    spread = fine_point_spread(wall, 1000 + number, SIDE)
    data = measured(fine / fine.max(), spread, noise=noise, seed=number)
    model = imaging.ForwardModel(data.kernel, shape=data.image.shape)
    row = {"case": number, "kind": kind, "wall": wall, "noise": noise}
    answer = inverse.tv_deconvolve(data.image, model)
    row["ours"] = inverse.registered_correlation(answer, data.truth)
    row["status"] = answer.status
    told = inverse.tv_deconvolve(
        inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
    )
    row["ours_told"] = inverse.registered_correlation(told, data.truth)
    row["deepinv_told"], row["deepinv_best"] = by_deepinv(deepinv, data, model)
    row["lucy_best"] = their_richardson_lucy(data)[0]
    row["wiener_best"] = their_wiener(data)[0]
    return row


def main():
    """Compare all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--json", type=Path, help="finished cases, a line each")
    options = parser.parse_args()
    deepinv, _library = loaded()
    done = {}
    if options.json and options.json.exists():
        rows = map(json.loads, options.json.read_text().splitlines())
        done = {row["case"]: row for row in rows}
    found = []
    print(f"{'case':>6s} {'kind':8s} {'wall':8s} noise " + " ".join(f"{c:>12s}" for c in COLUMNS))
    for number in range(options.first, options.first + options.cases):
        row = done.get(number)
        if row is None:
            row = compared(deepinv, number)
            if options.json:
                with options.json.open("a") as file:
                    file.write(json.dumps(row) + "\n")
        found.append(row)
        figures = " ".join(f"{row[column]:12.3f}" for column in COLUMNS)
        print(
            f"{number:6d} {row['kind']:8s} {row['wall']:8s} {row['noise']:.3f} {figures}",
            flush=True,
        )


if __name__ == "__main__":
    main()
