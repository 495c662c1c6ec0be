"""Ray tracing: other programs, and how often standard errors hold."""

import math
from collections import defaultdict
from typing import Any

from tables import figure, number, table

from .cells import WORDS, Row, by
from .figures import Series, errors_against_seconds, legend
from .page import Section


def against_mitsuba(found: Row) -> str:
    """Return a table: what each program takes to each error, scene by scene."""
    goals = (f"time to {100 * goal:g} %" for goal in found["scenes"][0]["goals"])
    body = (
        [scene["scene"], name, *map(WORDS["time"], times)]
        for scene in found["scenes"]
        for name, times in scene["seconds_to"].items()
    )
    return table(["scene", "program", *goals], body)


def ratios(found: Row) -> str:
    """Return a paragraph: ratios of the times, and how far apart the fluxes are."""
    scenes = found["scenes"]
    spans = []
    for i, goal in enumerate(scenes[0]["goals"]):
        there = [scene["ratios"][i] for scene in scenes]
        spans.append(
            f"{number(min(there))} to {number(max(there))} times the time to {100 * goal:g} %"
        )
    apart = max(abs(a) for scene in scenes for a in scene["standard_errors_apart"].values())
    return (
        f"Mitsuba in its better way takes {' and '.join(spans)}. The mean fluxes of the two "
        f"programs differ by at most {number(apart, 2)} standard errors."
    )


def panels(found: Row) -> Any:
    """Draw a panel for each scene, with a line for each program."""
    drawn = figure(8.5, 7.0)
    axes = drawn.subplots(2, 2, sharex=True, sharey=True)
    for axis, scene in zip(axes.flat, by("scene")(found["rows"]), strict=True):
        series: Series = defaultdict(list)
        for row in scene["rows"]:
            series[row["name"]].append((row["seconds"], row["relative_error"]))
        errors_against_seconds(axis, series, "relative standard deviation")
        axis.set(title=scene["scene"], xlabel="processor time (s)")
        axis.label_outer()
    legend(drawn, 3)
    return drawn


SECTIONS = (
    Section(
        "traces.json",
        "Ray tracing compared with Mitsuba 3",
        "Processor time to compute the light that reaches the lens from a hidden object by way of "
        "a wall, with three reflections. The error is the standard deviation of the detected flux "
        "over independent runs, relative to its mean; it falls with the number of rays. Both "
        "programs ran on one thread, in turns. Mitsuba has two ways: paths from the camera that "
        "are connected to the lit spot, and light from a projector that is aimed at the object. "
        "Times follow from a power law fitted to the runs; those beyond the longest run are "
        "extrapolated.",
        "python benchmarks/traces.py --peers-python PEER/bin/python --json {file}",
        table=against_mitsuba,
        note=ratios,
        figure=panels,
        alternative="Processor time against error of traced flux by nlosoptics and Mitsuba, in "
        "four scenes",
    ),
    Section(
        "trace_coverage.jsonl",
        "Intervals of traced light",
        "Are the standard errors of traced light right? Each scene was traced 300 times with "
        "1,024 rays. The table states how often the true flux lies within one and two standard "
        "errors, which should be 68 % and 95 % of the traces; the true flux is that of a trace "
        "with 262,144 rays. With 300 traces, a share near 95 % has a standard error of 1.3 %. The "
        "table also states how often a trace calls its own error uncertain. The last two columns "
        "are for the light with the least reliable error: its number of reflections, and how "
        "often it lies within two standard errors.",
        "python benchmarks/trace_coverage.py --json {file}",
        table={
            "scene": "{scene}",
            "standard error of the flux": "{relative_error:percent .3g} %",
            "within 1 standard error": "{within_68:percent .3g} %",
            "within 2": "{within_95:percent .3g} %",
            "called uncertain": "{flux_uncertain:percent .3g} %",
            "least reliable reflection": "{worst_bounce}",
            "within 2 for this one": "{worst_95:percent .3g} %",
        },
    ),
    Section(
        "random_traces.jsonl",
        "Traces of random scenes",
        "Does a trace that connects paths to the lens agree with the plain walk of light, in "
        "scenes that nobody chose? Each random scene has a wall, materials, a picture or a mesh, "
        "and often an occluder. It was traced with 4,096 rays, and with a hundred times as many "
        "by the plain walk (`analog`), whose rays meet the lens by chance. The table states the "
        "largest and the rms difference of the fluxes, in standard errors of both. Scenes in which "
        "the walk met no light at all are left out.",
        "python benchmarks/random_traces.py --json {file}",
        table={
            "wall": "{wall}",
            "scenes": "{count}",
            "largest difference": lambda group: f"{max(map(abs, group['off'])):.2f}",
            "rms difference": lambda group: (
                f"{math.hypot(*group['off']) / group['count'] ** 0.5:.2f}"
            ),
            "median error of the trace": "{relative_error:median percent .2g} %",
            "of the plain walk": "{walk_relative_error:median percent .2g} %",
        },
        rows=by("wall", keep=lambda row: row["walk_relative_error"] is not None),
    ),
)
