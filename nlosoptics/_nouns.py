"""Values that travel: they pickle and copy by their fields, and stay read-only."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Self

from .errors import SceneError


class Noun:
    """Base of frozen dataclasses that hold arrays, mappings or what is computed once and kept.

    A pickle and a deep copy hold the fields alone: what a property keeps is computed again where it
    is asked for. numpy forgets that an array was read-only, pickle knows no read-only mapping:
    both are read-only again in what comes back. The constructor's checks are not repeated.
    """

    def __getstate__(self) -> dict[str, Any]:
        return field_values(self)

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, _closed(value))

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # by the fields and not by __getstate__, which packs them for a file and may refuse some
        copied = object.__new__(type(self))
        memo[id(self)] = copied
        Noun.__setstate__(copied, deepcopy(field_values(self), memo))
        return copied


def check_pickles(name: str, value: Any) -> None:
    """Refuse a function that pickle cannot name, such as a lambda.

    Raises
    ------
    SceneError
    """
    try:
        pickle.dumps(value)
    # objects raise what they like
    except Exception as error:
        raise SceneError(
            f"{name} = {value!r} cannot be pickled ({type(error).__name__}); define it at the top "
            "level of a module"
        ) from None


def field_values(noun: Any) -> dict[str, Any]:
    """Fields of a dataclass by their names, read-only mappings as what `Noun` closes again."""
    return {field.name: _opened(getattr(noun, field.name)) for field in fields(noun)}


class _Sealed(dict[Any, Any]):
    """Entries of a read-only mapping on their way."""


def _opened(value: Any) -> Any:
    if isinstance(value, MappingProxyType):
        return _Sealed((key, _opened(inner)) for key, inner in value.items())
    if type(value) is dict:
        return {key: _opened(inner) for key, inner in value.items()}
    if type(value) in (tuple, list):
        return type(value)(map(_opened, value))
    return value


def _closed(value: Any) -> Any:
    # numpy is not imported for this: only its arrays have such flags
    flags: Any = getattr(value, "flags", None)
    if getattr(flags, "writeable", False):
        flags.writeable = False
    if isinstance(value, _Sealed):
        return MappingProxyType({key: _closed(inner) for key, inner in value.items()})
    if type(value) is dict:
        return {key: _closed(inner) for key, inner in value.items()}
    if type(value) in (tuple, list):
        return type(value)(map(_closed, value))
    return value
