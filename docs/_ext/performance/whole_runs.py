"""Whole tasks: commands from start to exit, tolerances, growth with size."""

from .cells import Row
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
)
