"""Counted nouns."""

from __future__ import annotations

import pytest

from spinestiff.words import counted


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0, "frame"), "0 frames"),
        ((1, "frame"), "1 frame"),
        ((2, "coded frame"), "2 coded frames"),
        ((1, "vertebra", "vertebrae"), "1 vertebra"),
        ((17, "vertebra", "vertebrae"), "17 vertebrae"),
    ],
)
def test_a_count_and_its_noun_agree(arguments, words):
    assert counted(*arguments) == words
