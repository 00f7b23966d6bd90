"""Counted nouns, paths and what files hold."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from spinestiff.subject.annotation_record import Annotation
from spinestiff.words import counted, pasted, printable, push_named, sentence


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


@pytest.mark.parametrize(
    ("name", "words"),
    [("a", "push a"), ("left-5", "push left-5"), ("push-1", "push-1"), ("Push2", "Push2"), ("pushed", "push pushed")],
)
def test_a_push_is_called_push_once(name, words):
    assert push_named(name) == words


def test_a_sentence_keeps_the_letters_of_its_names():
    assert sentence("push A") == "Push A" and sentence("") == ""


def test_a_path_with_a_blank_is_quoted_for_a_terminal():
    assert pasted(Path("a") / "b") == str(Path("a") / "b")
    assert pasted(Path("Mueller, Anna")) == '"Mueller, Anna"'
    assert pasted(Path("Müller_1.2")) == "Müller_1.2"


@pytest.mark.parametrize("name", ["a&b", "a;b", "$HOME", "a $b", "it's", "a`b`", "a(1)", "~a", "a\tb", "a\\b"])
def test_a_path_with_signs_of_the_shell_is_one_word_of_a_command(name):
    if os.name == "nt":
        assert pasted(Path(name)) == f'"{name}"'
    else:
        told = subprocess.run(["sh", "-c", f"printf %s {pasted(Path(name))}"], capture_output=True, check=True)
        assert told.stdout.decode() == name


def test_a_message_about_one_vertebra_says_so():
    square = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]]
    images = {"rest/frontal": {"vertebrae": {"T5": square}}}
    with pytest.raises(ValueError, match="found 1 vertebra, wanted at least 8"):
        Annotation.model_validate({"schema_version": 1, "images": images})


@pytest.mark.parametrize(
    ("text", "most", "shown"),
    [
        ("Kraft in N", 60, "Kraft in N"),
        ("a\x1b[31mb\n", 60, "a?[31mb?"),
        ("abcdefgh", 8, "abcdefgh"),
        ("abcdefghi", 8, "abcde..."),
        ("", 8, ""),
    ],
)
def test_what_a_file_holds_is_shown_without_what_a_terminal_obeys(text, most, shown):
    assert printable(text, most) == shown
