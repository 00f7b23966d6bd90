"""The table of participants."""

from __future__ import annotations

import pytest

from spinestiff.cohort.participants import read_participants
from spinestiff.errors import SubjectError


def test_participants_come_in_the_order_of_the_table(tmp_path):
    text = "age\tparticipant_id \tgroup\n12\tsub-02\ta\n\n13\t sub-01\tb\n"
    (tmp_path / "participants.tsv").write_text(text, encoding="utf-8")
    assert read_participants(tmp_path) == ("sub-02", "sub-01")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"row 1: found columns none, wanted one participant_id"),
        ("participant_id,age\nsub-01,12\n", r"row 1: found columns participant_id,age, wanted .* by tabs"),
        ("participant_id\tparticipant_id\na\tb\n", r"wanted one participant_id"),
        ("participant_id\tage\nsub-01\n", r"row 2: 1 field, wanted 2"),
        ("participant_id\n\n", r"names nobody"),
        ("participant_id\nsub-01\nSUB-01\n", r"row 3: 'SUB-01' is in row 2, too"),
        ("participant_id\n../sub-01\n", r"row 2: participant_id '\.\./sub-01': wanted 1 to 64 letters"),
        ("participant_id\n.\n", r"wanted 1 to 64 letters"),
        ("participant_id\nsub.\n", r"wanted 1 to 64 letters"),
        ("participant_id\nNUL\n", r"wanted 1 to 64 letters"),
        ("participant_id\ncohort.csv\n", r"is the name of a file of the cohort itself"),
        ("participant_id\nledger.sqlite\n", r"is the name of a file of the cohort itself"),
        (f"participant_id\tnotes\nsub-01\t{'x' * 200_000}\n", r"row 2: no table \(field larger than field limit"),
        (f"{'x' * 200_000}\n", r"row 1: no table \(field larger than field limit"),
    ],
)  # fmt: skip
def test_a_table_that_is_wrong_is_refused(tmp_path, text, words):
    (tmp_path / "participants.tsv").write_text(text, encoding="utf-8")
    with pytest.raises(SubjectError, match=words):
        read_participants(tmp_path)


def test_a_missing_table_is_refused(tmp_path):
    with pytest.raises(SubjectError, match=r"participants\.tsv: no such file; wanted the table of participants"):
        read_participants(tmp_path)
    with pytest.raises(SubjectError, match=r"no such folder"):
        read_participants(tmp_path / "none")
