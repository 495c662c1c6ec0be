"""Type of the progress callback used by long computations."""

from collections.abc import Callable

# Arguments: text that names the current step, and the completed fraction of the whole, 0 to 1.
Progress = Callable[[str, float], object]
