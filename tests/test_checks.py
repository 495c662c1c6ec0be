"""Phrases that error messages share."""

from __future__ import annotations

import pytest

from nlosoptics._checks import counted, lasting, reason, vector
from nlosoptics.errors import SceneError


@pytest.mark.parametrize(
    ("count", "words", "text"),
    [
        (0, ("pair",), "0 pairs"),
        (1, ("pair",), "1 pair"),
        (2, ("pair",), "2 pairs"),
        (1, ("index", "indices"), "1 index"),
        (3, ("index", "indices"), "3 indices"),
    ],
)
def test_counts_agree_with_their_nouns(count: int, words: tuple[str, ...], text: str) -> None:
    assert counted(count, *words) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(7.88e-6, "0.00788 ms"), (0.52, "0.52 s"), (119, "119 s"), (1040, "17.3 min"), (9e3, "2.5 h")],
)
def test_times_are_in_readable_units(seconds: float, text: str) -> None:
    assert lasting(seconds) == text


def test_vectors_whose_square_overflows_are_refused() -> None:
    with pytest.raises(SceneError, match=r"aim\[z\] = -1e\+308 is out of range"):
        vector("aim", (0.0, 0.0, -1e308))


def test_texts_of_foreign_errors_are_short_and_printable() -> None:
    told = reason(ValueError("bad\n\x00header " + "x" * 500))
    assert told.startswith("ValueError: bad header xxx")
    assert len(told) < 150
    assert reason(KeyError()) == "KeyError"
