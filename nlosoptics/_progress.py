"""Type of the progress callback used by long computations."""

from collections.abc import Callable

# What is being done, and the share of the whole that is done, 0 to 1.
Progress = Callable[[str, float], object]
