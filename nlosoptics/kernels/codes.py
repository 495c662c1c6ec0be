"""Codes of wall terms and material lobes, and group sizes, shared by kernels and shells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    pass

GROUPS: Final = 32  # independent randomisations, whose spread is the standard error
UNIT: Final = 1024  # rays whose sums are added up first, however many are traced at once

PLANE, SPHERE, CYLINDER, WAVE, GRID = range(5)  # kinds of term

# kinds of lobe
LAMBERT, OREN_NAYAR, OREN_NAYAR_FULL, BECKMANN, GGX, WARD_1992, WARD_DUER, WARD_BOUNDED = range(8)
