"""The runner of checks, and what one of them found."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from inspect import isfunction
from pathlib import Path
from typing import Any

from .._checks import positive
from .._progress import Progress
from ..errors import SceneError
from ..psf import read_zernikes
from . import light, reconstructions, timed, waves


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Parameters
    ----------
    name : str
        What is compared.
    source : str
        Where the expected value comes from.
    error : float
        Largest difference from the expected value, in the unit of `limit`; inf if the check could
        not run.
    limit : float
        Largest difference that rounding, quadrature or chance may cause.
    seconds : float
        Run time, s.
    reason : str
        The error's text, if the check could not run.

    See Also
    --------
    verify : Run all checks.
    """

    name: str
    source: str
    error: float
    limit: float
    seconds: float
    reason: str = ""

    @property
    def passed(self) -> bool:
        """Whether the error is within the limit."""
        return self.error <= self.limit


def verify(
    progress: Progress | None = None,
    *,
    zernikes: str | Path | None = None,
    rms: float | None = None,
) -> list[Check]:
    """Run all checks of the library against what is known without it.

    They need no network and no file, and take a quarter of a minute; the first run also compiles.

    Parameters
    ----------
    progress : callable, optional
        Called as ``progress(name, fraction)`` before each check.
    zernikes : str or Path, optional
        Table of Zernike coefficients from a design program, see `nlosoptics.psf.read_zernikes`.
    rms : float, optional
        Rms aberration that this program states for the table, waves, with all its digits.

    Returns
    -------
    list of Check
        In the order of the light's way. A check that raises an error has failed. Without PyTorch
        those of the reconstruction are left out.

    Raises
    ------
    SceneError
        If `zernikes` or `rms` is given without the other, or the table cannot be
        read, or `rms` is not above 0.

    See Also
    --------
    nlosoptics.psf.write_zernikes : Write a table for another program.

    Examples
    --------
    >>> from nlosoptics import verification
    >>> checks = verification.verify()  # doctest: +SKIP
    >>> [check.name for check in checks if not check.passed]  # doctest: +SKIP
    []
    """
    checks: list[tuple[Callable[..., tuple[float, float]], tuple[Any, ...]]]
    checks = [(check, ()) for check in _all()]
    if (zernikes is None) != (rms is None):
        raise SceneError("zernikes and rms belong together; give both or none")
    if zernikes is not None and rms is not None:
        stated = positive("rms", rms, unit="waves")
        checks.append((waves._design_program, (read_zernikes(zernikes), stated)))
    found = []
    for k, (check, arguments) in enumerate(checks):
        name, source = (check.__doc__ or "").rstrip(".").split(": ", 1)
        if progress is not None:
            progress(name, k / len(checks))
        start = time.perf_counter()
        error, limit, reason = math.inf, 0.0, ""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                error, limit = map(float, check(*arguments))
        except Exception as failure:  # a check that cannot run has failed, and the next one runs
            reason = f"{type(failure).__name__}: {failure}"
        error = math.inf if math.isnan(error) else error
        found.append(Check(name, source, error, limit, time.perf_counter() - start, reason))
    return found


def _all() -> Iterator[Callable[[], tuple[float, float]]]:
    """Yield the checks of each file, in the order in which they are written."""
    for module in (waves, light, reconstructions, timed):
        if module is reconstructions and not find_spec("torch"):
            continue
        for name, check in vars(module).items():
            if (
                isfunction(check)
                and not name.startswith("_")
                and check.__module__ == module.__name__
            ):
                yield check
