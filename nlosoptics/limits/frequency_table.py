"""Frequencies on the object at which `Feasibility` is given, and its table as lines of text."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pair = tuple[Array, Array]

POINTS = 33  # evenly spaced, from 0 to the frequency of two pixels a period
OCTAVES = 8  # below the frequency of the strokes
#: The table begins where the picture and the matt wall pass this modulation ...
HIGH = 0.5
LOST = 1e-3  # ... and ends where both pass less than this
LEAST = 1e-12  # smallest value that the table prints


def frequencies(stroke: float, top: float) -> Array:
    """Even frequencies from 0 to ``top`` together with octaves of the strokes' frequency.

    Parameters
    ----------
    stroke : float
        Width of the object's strokes, m; 0 where the object is dark.
    top : float
        Frequency of two pixels a period, cycles/m.

    Returns
    -------
    ndarray, (n,)
        Rising, cycles/m. The octaves resolve the modulation where it falls far below ``top``.
    """
    return np.union1d(np.linspace(0.0, top, POINTS), _octaves(stroke, top))


def needed(stroke: float) -> float:
    """Frequency with one period on two strokes, cycles/m; 0 where the object is dark."""
    return 0.5 / stroke if stroke > 0.0 else 0.0


def _octaves(stroke: float, top: float) -> Array:
    """Octaves about the strokes' frequency up to ``top``, which is the last; cycles/m."""
    anchor = needed(stroke) or top
    above = max(0, int(np.ceil(np.log2(top / anchor))))
    octaves = anchor * 2.0 ** np.arange(-OCTAVES, above + 1)
    return np.append(octaves[octaves < top], top)


def lines(stroke: float, frequency: Array, picture: Pair, matt_wall: Pair) -> list[str]:
    """Table of modulation and signal-to-noise ratio against frequency.

    Parameters
    ----------
    stroke : float
        Width of the object's strokes, m; 0 where the object is dark.
    frequency : ndarray, (n,)
        Rising from 0, cycles/m, at which the values are known.
    picture, matt_wall : (ndarray, ndarray), both (n,)
        Modulation and signal-to-noise ratio of the picture and of a matt wall.

    Returns
    -------
    list of str
        A heading, and one line for 0 and each octave of the strokes' frequency up to where the
        modulation is lost, and at least up to the strokes' frequency.
    """
    rows = _rows(stroke, frequency, picture[0], matt_wall[0])
    columns = [np.interp(rows, frequency, values) for values in (*picture, *matt_wall)]
    told = ["cycles/m  modulation  signal/noise  matt wall  signal/noise"]
    for f, m, s, r, d in zip(rows, *columns, strict=True):
        line = f"{f:8.3g}  {_cell(m):>10}  {_cell(s):>12}  {_cell(r):>9}  {_cell(d):>12}"
        told.append(f"{line}  needed by the strokes" if f == needed(stroke) > 0.0 else line)
    return told


def _rows(stroke: float, frequency: Array, *modulations: Array) -> Array:
    """Frequencies of the table, cycles/m."""
    top = float(frequency[-1])
    rows = _octaves(stroke, top)
    strokes = min(needed(stroke) or top, top)
    passed = [np.interp(rows, frequency, values) for values in modulations if values.any()]
    low = np.flatnonzero((rows <= strokes / 4) & (np.min(passed, axis=0) >= HIGH))
    lost = np.flatnonzero((rows >= strokes) & (np.max(passed, axis=0) < LOST))
    first = int(low[-1]) if len(low) else 0
    last = int(lost[0]) if len(lost) else len(rows) - 1
    return np.concatenate([[0.0], rows[first : last + 1]])


def _cell(value: float) -> str:
    """Return a value to three digits, or a bound where it is too small to matter."""
    return f"{value:.3g}" if value >= LEAST or value == 0.0 else f"< {LEAST:g}"
