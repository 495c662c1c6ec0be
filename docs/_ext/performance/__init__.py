"""The performance page: every file of ``benchmarks/results`` as a table, some as a figure."""

from pathlib import Path

from . import forecasts, inverse, point_spreads, rays, studies, transient, whole_runs
from .page import Section, write

#: Sections of the page below their headings, in its order.
ROOMS: dict[str, tuple[Section, ...]] = {
    "Point spreads": point_spreads.SECTIONS,
    "Ray tracing": rays.SECTIONS,
    "Whole tasks": whole_runs.SECTIONS,
    "Reconstruction": inverse.SECTIONS,
    "Forecasts": forecasts.SECTIONS,
    "Time-resolved light": transient.SECTIONS,
    "Design studies": studies.SECTIONS,
}


def pages(target: Path) -> None:
    """Write the tables and figures into a folder."""
    write(ROOMS, target)
