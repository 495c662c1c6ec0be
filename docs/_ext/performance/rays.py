"""Ray tracing: other programs, and how often standard errors hold."""

from collections.abc import Callable

from tables import seconds

from .cells import Row, by
from .figures import curves
from .page import Section


def time_to(goal: float) -> Callable[[Row], str]:
    """Return a cell: the least time to an error, of all runs of a program and setting."""

    def cell(program: Row) -> str:
        times = [row.get("seconds_to", {}).get(str(goal)) for row in program["rows"]]
        times += [r["seconds"] for r in program["rows"] if r.get("relative_error", 1.0) <= goal]
        known = [time for time in times if time is not None]
        return seconds(min(known)) if known else "not reached"

    return cell


SECTIONS = (
    Section(
        "traces.json",
        "Ray tracing compared with Mitsuba 3 and Optiland",
        "Time to compute the light that reaches the lens from a letter by way of a matt wall. The "
        "error is the relative standard deviation of the detected flux; it falls with the number "
        "of rays. All programs ran with two threads, except Optiland, which uses one core; its "
        "time is extrapolated from its number of rays per second. Values have two digits, because "
        "they were read off a figure.",
        "python benchmarks/traces.py --peers-python PEER/bin/python --json {file}",
        table={"program": "{name}", "time to 1 %": time_to(0.01), "time to 0.1 %": time_to(0.001)},
        rows=by("name", keep=lambda row: row.get("reflections", 3) == 3),
        figure=curves(
            "{name}",
            lambda row: row["relative_error"],
            "relative standard deviation of the flux",
            keep=lambda row: row.get("reflections") == 3 and "seconds" in row,
        ),
        alternative="Seconds against error of traced flux: nlosoptics has the least error at any "
        "time",
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
)
