"""Solvers called by the names of all options, those of the measurement among them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from nlosoptics.inverse import Measurement

NAMES = {one.name for one in fields(Measurement)} - {"image"}


def called(solver: Callable[..., Any], image: Any, *rest: Any, **options: Any) -> Any:
    """Call a solver with a measurement of an image, and the other options as its own."""
    known = {name: options.pop(name) for name in NAMES & options.keys()}
    return solver(Measurement(image, **known), *rest, **options)
