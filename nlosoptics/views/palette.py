"""Colours and markers of the figures: the Okabe-Ito palette, which is safe for colour blindness."""

from __future__ import annotations

from typing import Final

BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
GREEN: Final = "#009E73"
PURPLE: Final = "#CC79A7"
ORANGE: Final = "#E69F00"
SKY: Final = "#56B4E9"
BLACK: Final = "#000000"
BROWN: Final = "#7A3E00"  # not by Okabe and Ito; as distinct from their colours as those are
PALE_GREEN: Final = "#8FCFBA"  # mirror images of what is GREEN
PALE_SKY: Final = "#9FD3F5"  # glass
TEAL: Final = "#26828E"  # middle of the viridis colour map, for legends
INK: Final = "#222222"  # text in 3-D views
GREY: Final = "#767676"  # secondary information; contrast 4.5:1 on white
PALE_GREY: Final = "#A8A8A8"  # grid lines in 3-D views

SERIES: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BROWN)
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")
