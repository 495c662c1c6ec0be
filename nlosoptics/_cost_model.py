"""How fast this machine is, measured once and kept, for predictions of run time."""

from __future__ import annotations


def seconds(calls: float = 0.0, arrays: float = 0.0, transforms: float = 0.0) -> float:
    """Seconds here of what took so many on the machine that the constants were fitted on."""
    return calls + arrays + transforms
