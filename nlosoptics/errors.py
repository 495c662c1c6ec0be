"""The kinds of error that nlosoptics raises.

Every message names the value, the limit, the place and the remedy, in one line. Each kind
also derives from the builtin that fits, so that either can be caught:

- `SceneError`: a scene, a scene file or an argument that describes hardware is wrong.
- `SamplingError`: a grid is too coarse, too narrow or does not fit the transform.
- `CausticError`: a pupil point is reached by several rays or by none; W is undefined.
- `NotWaveGradeError`: a surface is known too roughly for interference.
- `MemoryLimitError`: an array would not fit; raised before it is allocated.
- `MissingExtraError`: an optional dependency is not installed.

`ValidityWarning` is no error: a result is made from samples that are too coarse or too few for it.
"""

from __future__ import annotations


class NlosError(Exception):
    """Base of every error that nlosoptics raises on purpose."""


class SceneError(NlosError, ValueError):
    """A description of the scene is wrong."""


class SamplingError(NlosError, ValueError):
    """Samples are too few, or do not fit the transform that was asked for."""


class CausticError(NlosError, ArithmeticError):
    """The wave aberration has several values, or none, at a pupil point."""


class NotWaveGradeError(NlosError, ValueError):
    """A surface is not known to a fraction of the wavelength."""


class MemoryLimitError(NlosError, MemoryError):
    """An array would need more memory than there is."""


class MissingExtraError(NlosError, ImportError):
    """An optional dependency is not installed."""


class ValidityWarning(UserWarning):
    """A result is limited by the samples that it is made from."""
