"""Exceptions and warnings of nlosoptics.

Each message states in one line the value, the limit, the place and the remedy. Each class also
derives from a suitable builtin exception, so that either can be caught:

- `SceneError`: a scene, a scene file or an argument is invalid.
- `SamplingError`: a grid is too coarse or too small, or does not fit the transform.
- `CausticError`: several rays or none reach a pupil point, so that W is undefined.
- `NotWaveGradeError`: a surface is not known accurately enough for interference.
- `MemoryLimitError`: an array would not fit in memory; raised before it is allocated.
- `MissingExtraError`: an optional dependency is not installed.

Two warnings are not errors. `ValidityWarning` marks a result from samples that are too coarse or
too few. `PerformanceWarning` marks a computation that takes much longer than an equivalent one.
"""

from __future__ import annotations

__all__ = [
    "CausticError",
    "MemoryLimitError",
    "MissingExtraError",
    "NlosError",
    "NotWaveGradeError",
    "PerformanceWarning",
    "SamplingError",
    "SceneError",
    "ValidityWarning",
]


class NlosError(Exception):
    """Base class of all errors that nlosoptics raises deliberately."""


class SceneError(NlosError, ValueError):
    """A scene, a scene file or an argument is invalid."""


class SamplingError(NlosError, ValueError):
    """A sampling grid is too coarse or too small, or does not fit the requested transform."""


class CausticError(NlosError, ArithmeticError):
    """The wave aberration is undefined: several rays or none reach a pupil point."""


class NotWaveGradeError(NlosError, ValueError):
    """A surface is not known accurately enough, to a fraction of the wavelength."""


class MemoryLimitError(NlosError, MemoryError):
    """An array would exceed the memory limit."""


class MissingExtraError(NlosError, ImportError):
    """An optional dependency is not installed."""


class ValidityWarning(UserWarning):
    """The samples limit the accuracy of a result."""


class PerformanceWarning(UserWarning):
    """A computation takes much longer than one with slightly different input would."""


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return __all__
