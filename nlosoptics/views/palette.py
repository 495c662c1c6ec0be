"""Okabe and Ito's colours for lines and markers, distinct to every kind of colour vision."""

from __future__ import annotations

from typing import Final

BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
GREEN: Final = "#009E73"
PURPLE: Final = "#CC79A7"
ORANGE: Final = "#E69F00"
SKY: Final = "#56B4E9"
BLACK: Final = "#000000"
BROWN: Final = "#7A3E00"  # as far from these, to every kind of vision, as they are from each other
GREY: Final = "#767676"  # of what is beside the matter, readable on white

SERIES: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")
