"""Frequencies on the object at which `Feasibility` is given, and its table as lines of text."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pair = tuple[Array, Array]


def frequencies(stroke: float, top: float) -> Array:
    """Return the spatial frequencies, cycles/m, at which `Feasibility` gives its curves, (n,).

    They are evenly spaced from 0 to ``top``, with octaves of the strokes' frequency added. The
    octaves resolve a modulation that vanishes far below ``top``.
    """
    return np.union1d(np.linspace(0.0, top, 33), _octaves(stroke, top))


def needed(stroke: float) -> float:
    """Return the frequency whose period is two stroke widths, cycles/m; 0 for a dark object.

    ``stroke`` is the stroke width of the object, m.
    """
    return 0.5 / stroke if stroke > 0.0 else 0.0


def _octaves(stroke: float, top: float) -> Array:
    """Return the octaves of the strokes' frequency up to ``top``, which is included; cycles/m."""
    anchor = needed(stroke) or top
    above = max(0, int(np.ceil(np.log2(top / anchor))))
    octaves = anchor * 2.0 ** np.arange(-8, above + 1)
    return np.append(octaves[octaves < top], top)


def lines(stroke: float, frequency: Array, picture: Pair, matt_wall: Pair) -> list[str]:
    """Return a table of modulation and signal-to-noise ratio against frequency, as text."""
    rows = _rows(stroke, frequency, picture[0], matt_wall[0])
    columns = [np.interp(rows, frequency, values) for values in (*picture, *matt_wall)]
    told = ["cycles/m  modulation  signal/noise  matt wall  signal/noise"]
    for f, m, s, r, d in zip(rows, *columns, strict=True):
        line = f"{f:8.3g}  {_cell(m):>10}  {_cell(s):>12}  {_cell(r):>9}  {_cell(d):>12}"
        told.append(f"{line}  needed by the strokes" if f == needed(stroke) > 0.0 else line)
    if needed(stroke) > frequency[-1]:
        told.append(f"the strokes need {needed(stroke):.3g} cycles/m, which pixels do not resolve")
    return told


def _rows(stroke: float, frequency: Array, *modulations: Array) -> Array:
    """Return the frequencies of the table's lines, cycles/m.

    They begin where image and matt wall pass half the contrast and end where both are below 1e-3.
    """
    top = float(frequency[-1])
    rows = _octaves(stroke, top)
    strokes = min(needed(stroke) or top, top)
    passed = [np.interp(rows, frequency, values) for values in modulations if values.any()]
    low = np.flatnonzero((rows <= strokes / 4) & (np.min(passed, axis=0) >= 0.5))
    lost = np.flatnonzero((rows >= strokes) & (np.max(passed, axis=0) < 1e-3))
    first = int(low[-1]) if len(low) else 0
    last = int(lost[0]) if len(lost) else len(rows) - 1
    return np.concatenate([[0.0], rows[first : last + 1]])


def _cell(value: float) -> str:
    """Format a value with three digits, or as an upper bound if it is negligible."""
    return f"{value:.3g}" if value >= 1e-12 or value == 0.0 else "< 1e-12"
