"""Public functions name what they take, for first arguments of other types."""

from __future__ import annotations

import importlib
import inspect
import re

import pytest

import nlosoptics as nlos
from nlosoptics.errors import SceneError

ROOMS = ("imaging", "limits", "psf", "raytrace", "study", "transient", "views")
#: Kinds of first arguments by their annotation.
NOUNS = re.compile(
    r"(Scene|SceneOptics|Wavefront|PointSpread|TransientCapture|VolumeImage|Results|Study|DepthMap)"
    r"( \| (SceneOptics|Wavefront|PointSpread|VolumeImage|PupilField))*"
)


def functions():
    for room in ROOMS:
        package = importlib.import_module(f"nlosoptics.{room}")
        for name in package.__all__:
            function = getattr(package, name)
            if inspect.isfunction(function):
                first = next(iter(inspect.signature(function).parameters.values()), None)
                if first is not None and NOUNS.fullmatch(str(first.annotation)):
                    yield pytest.param(function, id=f"{room}.{name}")


@pytest.mark.parametrize("function", list(functions()))
def test_a_wrong_type_is_told_with_what_is_taken(function) -> None:
    needed = [
        p
        for p in inspect.signature(function).parameters.values()
        if p.default is p.empty and p.kind is not p.VAR_KEYWORD and p.kind is not p.VAR_POSITIONAL
    ]
    for wrong in (None, "text", nlos.errors):
        positional = [wrong] + [1.0 for p in needed[1:] if p.kind is not p.KEYWORD_ONLY]
        named = {p.name: 1.0 for p in needed[1:] if p.kind is p.KEYWORD_ONLY}
        with pytest.raises(SceneError, match=rf"is a {type(wrong).__name__}; "):
            function(*positional, **named)
