"""Each number of the search for walls put out of action once, on a fixed set of small cases.

    python benchmarks/inverse/ablation.py [NAME ...]

A line shows for one changed setting the cases whose correlation with the truth moves by more than
0.01 or whose status changes, and the CPU time over that of the usual settings. Cases are those of
cases.py with 32 x 32 pixels: two images, two with much noise, one with proposals of the network,
one without, and one with a roughly known wall; those that use the setting are run.
"""

import sys
import time
from dataclasses import replace
from functools import cache

from cases import MODES, WAVELENGTH, case, start

from nlosoptics import inverse
from nlosoptics.inverse.blind import evidence, evidence_search, search_settings

SIZE, S = 32, search_settings.SETTINGS
# Object, wall, rms waves and noise of the cases of each group.
CASES = {
    "two": (("F", 131, 0.5, 0.01),),
    "noisy": (("F", 134, 0.5, 0.05),),
    "one": (("F", 741, 0.25, 0.01), ("arrow", 742, 0.5, 0.01)),
    "alone": (("F", 745, 0.5, 0.01),),
    "near": (("F", 747, 0.5, 0.01),),
}
CHANGES = (
    ("two", {"finish": S.settle}),
    ("two", {"gather_slowly": S.gather}),
    ("two", {"tops": ()}),
    ("two", {"near_several": replace(S.near_several, generations=0)}),
    ("near", {"near": (*S.near[:2], replace(S.near[2], iterations=1))}),
    ("near", {"near": (replace(S.near[0], iterations=1), *S.near[1:])}),
    ("near", {"near_starts": 1}),
    ("one", {"proposed": S.proposed[1:]}),
    ("one", {"too_sharp": 0.0}),
    ("one", {"trivial": S.compare}),
    ("one", {"free": S.compare}),
    ("one", {"near_one": replace(S.near_one, flips=0.03, noise=0.25)}),
    ("one", {"repeats": 1}),
    ("noisy", {"gather_noisy": S.gather}),
    ("noisy", {"near_noisy": S.near_several}),
    ("alone", {"noises": S.noises[:1]}),
    ("alone", {"lengths": (1.2, 1.2)}),
    ("alone", {"release": S.compare}),
    ("alone", {"kept": S.pool}),
)


@cache
def solved(group, number, change):
    """Return correlation, status and CPU seconds of a case with one changed setting or none."""
    label, wall, rms, noise = CASES[group][number]
    extra = (0.0, (1.0 if rms >= 1.0 else 0.5) * WAVELENGTH)
    defocus = extra if group in ("two", "noisy") else extra[:1]
    data = case(label, wall, rms_waves=rms, size=SIZE, noise=noise, defocus=defocus)
    modes, options, proposals = MODES, {}, evidence.wall_proposals
    if group == "near":
        first = start(data.coefficients, 0.2, wall) * WAVELENGTH
        modes, options = dict(zip(MODES, first.tolist(), strict=True)), {"start_error": 0.2}
    elif group == "alone":
        evidence.wall_proposals, options = (lambda *_: None), {"max_iterations": 2}
    pupil = inverse.PupilPSF.from_zernike(modes, **data.pupil, shape=SIZE, pixel_integrated=True)
    evidence_search.SETTINGS = replace(S, **dict(change))
    began = time.process_time()
    answer = inverse.evidence_fit(data.images, pupil, defocus=data.defocus, **options)
    evidence.wall_proposals = proposals
    value = inverse.registered_correlation(answer, data.truth)
    return value, answer.status, time.process_time() - began


for group, change in CHANGES:
    (name,) = change
    if name in (sys.argv[1:] or [name]):
        moved, seconds = [], [0.0, 0.0]
        for number in range(len(CASES[group])):
            pair = [solved(group, number, ()), solved(group, number, tuple(change.items()))]
            seconds = [sum(pair_) for pair_ in zip(seconds, (p[2] for p in pair), strict=True)]
            if abs(pair[0][0] - pair[1][0]) > 0.01 or pair[0][1] != pair[1][1]:
                moved.append(f"{number}: " + " -> ".join(f"{p[0]:.3f} {p[1]}" for p in pair))
        share = seconds[1] / seconds[0]
        print(f"{group:6s} {name:14s} {share:5.2f}  {'; '.join(moved) or 'none'}", flush=True)
