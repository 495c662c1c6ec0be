"""JSON schema of scene files, with descriptions from the docstrings of the parts."""

from __future__ import annotations

from typing import Any

from . import tables


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of scene files, for editors that complete and check TOML.

    Returns
    -------
    dict
        Schema after draft 2020-12, with a description of every key.
    """
    schema = tables.SceneFile.model_json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "nlosoptics scene",
        **_tidy(schema),
    }


def _tidy(schema: Any) -> Any:
    """Return a schema without titles of keys and null types, which TOML does not have."""
    if isinstance(schema, list):
        return [_tidy(inner) for inner in schema]
    if not isinstance(schema, dict):
        return schema
    choices = [choice for choice in schema.get("anyOf", ()) if choice != {"type": "null"}]
    if len(choices) == 1:
        schema = {**choices[0], **{k: v for k, v in schema.items() if k != "anyOf"}}
    elif choices:
        schema = schema | {"anyOf": choices}
    return {
        key: _tidy(value)
        for key, value in schema.items()
        if not (key == "title" and isinstance(value, str))
        and not (key == "default" and value is None)
    }
