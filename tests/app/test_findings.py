"""What commands tell of a result, in which order."""

from __future__ import annotations

from spinestiff.app.findings import print_estimate
from spinestiff.curves.pushes import push_responses
from spinestiff.study.visit import open_visit
from spinestiff.study.wording.estimate import combination_lines, headline
from spinestiff.study.wording.steps import response_lines
from spinestiff.subject import run_record
from spinestiff.subject.estimate_outcome import Check, CombinationRecord, Estimate
from spinestiff.subject.folder import read_subject


def test_the_estimate_begins_with_what_needs_no_model_and_what_the_data_fix_best(capsys, subject, monkeypatch):
    """Also where the step ``response`` has not run; then each ratio, and what it rests on in two tables."""
    estimate = run_record.read_outcome(read_subject(subject), Estimate)
    best = CombinationRecord(exponents={"lateral_bending": 0.4, "tissue": 1.0}, value=0.02, sd_log=0.05)
    failed = Check(name="rest and push", value=None, limit=None, passed=False, text="they differ")
    changed = estimate.model_copy(update={"best_known": best, "checks": (failed,)})
    monkeypatch.setattr(run_record, "read_outcome", lambda subject, kind: changed)
    (subject / "results" / "response.json").unlink()
    print_estimate(open_visit(subject))
    lines = capsys.readouterr().out.splitlines()
    first = [*response_lines(push_responses(read_subject(subject))), "DOUBTFUL: rest and push: they differ"]
    first += [*combination_lines(changed), *headline(changed)]
    assert len(first) == 6 + 1 + 1 + 3 and lines[1 : 1 + len(first)] == first
    rest = lines[1 + len(first) :]
    heads = ("Estimate: ", "lateral_bending: known within", "Uncertainty: factor (95 %)")
    heads += ("With a prior's standard deviation", "pelvis in the training frames")
    places = [next(i for i, line in enumerate(rest) if line.startswith(head)) for head in heads]
    assert places == sorted(places)
    table = rest[places[2] : places[4]]
    assert max(map(len, table)) <= 80
