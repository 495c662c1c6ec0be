"""Numeric codes of wall terms and material lobes, and sizes of ray groups."""

from __future__ import annotations

import math
from typing import Final

GROUPS: Final = 32  # independent randomisations; their spread gives the standard error
# Rays whose contributions are summed together first. The order of additions is then the same for
# every number of threads and rays per call.
UNIT: Final = 1024

PLANE, SPHERE, CYLINDER, WAVE, GRID, FACETS, BUMPS = range(7)  # kinds of wall term
# Largest magnitude of a relief's normal draw; its least uniform number is 2^-54.
EXTREME: Final = math.sqrt(108.0 * math.log(2.0))

# kinds of material lobe
LAMBERT, OREN_NAYAR, OREN_NAYAR_FULL, RETROREFLECTOR, BECKMANN, GGX = range(6)
WARD_1992, WARD_DUER, WARD_BOUNDED = range(6, 9)
