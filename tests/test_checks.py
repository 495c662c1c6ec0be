"""Phrases that error messages share."""

from __future__ import annotations

import pytest

from nlosoptics._checks import counted


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
