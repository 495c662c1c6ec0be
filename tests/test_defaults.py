"""Default values of the public functions, methods and nouns of the five rooms of optics, on record.

A default is part of what a caller relies on, and no computed number may show that one has changed.
"""

from __future__ import annotations

import importlib
import inspect

import pytest

ROOMS = ("psf", "raytrace", "transient", "inverse", "imaging")


def public(room):
    """Names and callables of a room, with the public methods of its classes."""
    module = importlib.import_module(f"nlosoptics.{room}")
    for name in sorted(module.__all__):
        found = getattr(module, name)
        if callable(found):
            yield name, found
        for method in sorted(vars(found)) if isinstance(found, type) else ():
            if not method.startswith("_") and callable(getattr(found, method)):
                yield f"{name}.{method}", getattr(found, method)


@pytest.mark.parametrize("room", ROOMS)
def test_defaults(room, on_record):
    told = {}
    for name, call in public(room):
        try:
            parameters = inspect.signature(call).parameters
        except (TypeError, ValueError):  # a type of values
            continue
        given = {key: one.default for key, one in parameters.items()}
        told[name] = {
            key: repr(value) for key, value in given.items() if value is not inspect.Parameter.empty
        }
    assert sum(map(len, told.values())) > 10
    on_record(told)
