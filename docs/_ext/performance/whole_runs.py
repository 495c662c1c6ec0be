"""Whole tasks: commands from start to exit, tolerances, growth with size."""

from .cells import Row
from .figures import curves
from .page import Section


def longest_stages(row: Row) -> str:
    """Return a cell: the three longest stages of a command."""
    stages = {k: v for k, v in row.get("stages", {}).items() if k not in ("total", "outside")}
    longest = sorted(stages, key=lambda name: -stages[name])[:3]
    return ", ".join(f"{name} {stages[name]:.2g} s" for name in longest)


SECTIONS = (
    Section(
        "whole_run.json",
        "Whole commands",
        "Run time of commands from start to exit, on two idle cores. In the first case all "
        "functions must be compiled; in the others, their compiled code is on the disk. The last "
        "case is one call in a Python process that is already running. Processor time is summed "
        "over all cores.",
        "python benchmarks/whole_run.py --repeats 3 --json {file}",
        table={
            "command": "{case}",
            "wall time": "{wall:time}",
            "processor time": "{cpu:time}",
            "memory": lambda row: f"{row['peak_mib']:.0f} MiB" if "peak_mib" in row else "",
            "longest stages": longest_stages,
        },
    ),
    Section(
        "tolerances.json",
        "What a tolerance costs",
        "How much longer does a more accurate result take? Point spreads over the object (fields) "
        "and traced light were computed with two tolerances `tol`. The estimate is the error that "
        "the result states, the error its difference from an accurate reference.",
        "python benchmarks/tolerances.py --json {file}",
        table={
            "stage": "{stage}",
            "tol": "{tol:n}",
            "run time": "{seconds:time}",
            "error estimate": "{estimate:n2}",
            "error": "{error:n2}",
            "work": "{work}",
        },
        figure=curves("{stage}", lambda row: row["error"], "relative error"),
        alternative="Seconds against error of fields of point spreads and of traces at two "
        "tolerances",
    ),
    Section(
        "growth.json",
        "Growth with pixels and field points",
        "How do time and memory grow with the size of a task? The table has the processor time of "
        "all threads and the memory of numpy's arrays, for one call after all functions are "
        "compiled. The exponents are fitted to four sizes. If an exponent is below 1, a part of "
        "the work does not depend on the size.",
        "python benchmarks/growth.py --json {file}",
        table={
            "stage": "{stage}",
            "number n": "{numbers:first} to {numbers:last} {against}",
            "processor time": "{seconds:first time} to {seconds:last time}",
            "time grows as": "n^{seconds_exponent:.2f}",
            "memory": "{bytes:first MiB .3g} to {bytes:last MiB .3g} MiB",
            "memory grows as": "n^{bytes_exponent:.2f}",
        },
    ),
)
