"""Numeric codes of wall terms and material lobes, and sizes of ray groups."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    pass

GROUPS: Final = 32  # independent randomisations; their spread gives the standard error
# Rays whose contributions are summed together first. The order of additions is then the same for
# every number of threads and rays per call.
UNIT: Final = 1024

PLANE, SPHERE, CYLINDER, WAVE, GRID = range(5)  # kinds of wall term

# kinds of material lobe
LAMBERT, OREN_NAYAR, OREN_NAYAR_FULL, BECKMANN, GGX, WARD_1992, WARD_DUER, WARD_BOUNDED = range(8)
