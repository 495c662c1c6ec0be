"""One-line messages about faults in a scene file: key, value, limit and remedy."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pydantic import ValidationError

from ...errors import NlosError, SceneError
from . import tables


@contextmanager
def located(place: str, inner: str = "") -> Iterator[None]:
    """Prefix the message of an `NlosError` with ``place``, which replaces the prefix ``inner``."""
    try:
        yield
    except NlosError as error:
        raise type(error)(place + str(error).removeprefix(inner)) from None


def validated(model: Any, raw: dict[str, Any], *, si: bool = False) -> Any:
    """Return ``raw`` validated as the pydantic class ``model``; ``si`` allows bare numbers."""
    try:
        return model.model_validate(raw, context={"si": si})
    except ValidationError as error:
        raise SceneError(_first_problem(error, model)) from None


def _first_problem(error: ValidationError, model: Any) -> str:
    """Return one line about the first problem and the number of the others.

    An unknown key comes first: if a required key is misspelt, that explains the missing one.
    """
    problems = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return _problem(problems[0], model) + more


def _problem(problem: Any, model: Any) -> str:
    """Return the message for one problem that pydantic found."""
    location, kind = problem["loc"], problem["type"]
    owner = model
    for element in location[:-1]:
        owner = tables.OWNERS.get(element, owner)
    keys = [element for element in location if ":" not in str(element)]
    name = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in keys).lstrip(".")
    value = _shown(problem["input"])
    if kind == "extra_forbidden":
        return _unknown_key(name, str(keys[-1]), value, owner)
    if kind == "missing":
        what = f"the table [{name}]" if len(keys) == 1 else name
        return f"{what} is missing; add it"
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        return _unknown_choice(name, str(keys[0]), problem["input"])
    if kind == "list_type" and isinstance(problem["input"], dict):
        return f"{name} = {value} is one table; write [[{name}]] for each of them"
    if kind == "value_error":
        return f"{name} = {value} {problem['ctx']['error']}"
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        return f"{name} = {value} is not a table; write [{name}] and its keys below"
    return f"{name} = {value}: {problem['msg'].replace('Input should', 'it should')}"


def _unknown_key(name: str, key: str, value: str, owner: Any) -> str:
    """Return the message for a key that the table ``owner`` does not have."""
    known = list(owner.model_fields)
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"the keys here are {', '.join(known)}"
    if key in known:  # of the whole file
        section = name.rpartition(".")[0]
        hint = f"did you mean {key}? Write it at the top of the file, before [{section}]"
    return f"{name} = {value} is an unknown key; {hint}"


def _unknown_choice(name: str, section: str, value: Any) -> str:
    """Return the message for a table of unclear kind: its shape, lobe, model, image or mesh."""
    if section == "hidden" and "material" not in name:
        return "hidden.mesh and hidden.image are both given, limit is one of them; remove the other"
    key, choices = ("lobe", tables.LOBES) if "material" in name else ("shape", tables.SHAPES)
    if "roughness" in name:
        key, choices = "model", tables.ROUGHNESSES
    if not isinstance(value, dict):
        return f"{name} = {_shown(value)} is not a table; write [{name}] and its keys below"
    if key not in value:
        return f"{name}.{key} is missing; add one of {', '.join(choices)}"
    near = difflib.get_close_matches(str(value[key]), choices, n=1, cutoff=0.5)
    hint = f'; did you mean "{near[0]}"?' if near else ""
    known = ", ".join(choices)
    return f"{name}.{key} = {_shown(value[key])} is unknown, must be one of {known}{hint}"


def _shown(value: Any) -> str:
    """Return a value as JSON of at most 60 characters; a table as ``{...}``."""
    text = "{...}" if isinstance(value, dict) else json.dumps(value, default=str)
    return text if len(text) <= 60 else text[:57] + "..."
