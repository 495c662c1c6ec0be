"""Base class of result objects: pickling and copying by fields, with read-only contents."""

from __future__ import annotations

import copyreg
import math
import pickle
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Self

from .errors import SceneError


class Noun:
    """Base of frozen dataclasses with arrays, mappings or cached properties.

    Pickles and deep copies contain only the fields; cached properties are computed again when
    needed. Pickling loses numpy's read-only flag, which is restored on loading. The constructor's
    checks are not repeated. ``repr`` gives large arrays by shape and type, long tuples by their
    length, and large parts by their class.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):  # before the dataclass decorator would add its own
            cls.__repr__ = Noun.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        shown = (
            f"{f.name}={_shown(getattr(self, f.name))}"
            for f in fields(self)  # type: ignore[arg-type]
            if f.repr
        )
        return f"{type(self).__qualname__}({', '.join(shown)})"

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, _closed(value))

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # not via __getstate__: a subclass may prepare its state for a file or reject values there
        copied = object.__new__(type(self))
        memo[id(self)] = copied
        Noun.__setstate__(copied, deepcopy(Noun.__getstate__(self), memo))
        return copied


def _shown(value: Any) -> str:
    """Return the representation of a field's value, shortened where it is large."""
    shape = getattr(value, "shape", ())
    if shape and hasattr(value, "dtype") and math.prod(shape) > 12:
        return f"<{'x'.join(map(str, shape))} {value.dtype}>"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_shown(inner)}' for key, inner in value.items())}}}"
    if type(value) in (tuple, list):
        if len(value) > 12:
            return f"<{type(value).__name__} of {len(value)}>"
        listed = ", ".join(map(_shown, value))
        return f"[{listed}]" if type(value) is list else f"({listed})"
    text = repr(value)
    return text if len(text) <= 300 else f"{type(value).__qualname__}(...)"


def check_pickles(name: str, value: Any) -> None:
    """Check that a function can be pickled, unlike for example a lambda.

    Raises
    ------
    SceneError
        If it cannot be pickled.
    """
    try:
        pickle.dumps(value)
    # __reduce__ of an object may raise any exception
    except Exception as error:
        raise SceneError(
            f"{name} = {value!r} cannot be pickled ({type(error).__name__}); define it at the top "
            "level of a module"
        ) from None


def _closed(value: Any) -> Any:
    """Return a value with read-only arrays, found without importing numpy."""
    flags: Any = getattr(value, "flags", None)
    if getattr(flags, "writeable", False):
        flags.writeable = False
    if isinstance(value, MappingProxyType):
        return MappingProxyType({key: _closed(inner) for key, inner in value.items()})
    if type(value) is dict:
        return {key: _closed(inner) for key, inner in value.items()}
    if type(value) in (tuple, list):
        return type(value)(map(_closed, value))
    return value


def _sealed(mapping: dict[Any, Any]) -> Any:
    """Return a read-only mapping; pickle does not find its class by name."""
    return MappingProxyType(mapping)


copyreg.pickle(MappingProxyType, lambda mapping: (_sealed, (dict(mapping),)))
