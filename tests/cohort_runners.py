"""Quick runners of a cohort, and cohorts of tiny subjects for them; workers import this file by its name."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

from spinestiff.cohort.row import Row, Stiffness, write_row
from spinestiff.errors import FitError, SubjectError
from spinestiff.files import write_json, write_text
from spinestiff.study.wording.titles import TIMES_DEFAULT

QUICK = "cohort_runners:quick"


def cohort_of(folder: Path, count: int, **trouble: str) -> tuple[str, ...]:
    """A cohort of so many participants; ``trouble`` by participant, with _ for -, says what its runner is to do."""
    names = [f"sub-{number:03d}" for number in range(1, count + 1)]
    for number, name in enumerate(names):
        (folder / name / "rest").mkdir(parents=True)
        content = {"number": number, "trouble": trouble.get(name.replace("-", "_"), "")}
        (folder / name / "subject.json").write_text(json.dumps(content), encoding="utf-8")
        (folder / name / "rest" / "frontal.dcm").write_bytes(bytes([number % 251]) * 2000)
    (folder / "participants.tsv").write_text("participant_id\n" + "\n".join(names) + "\n", encoding="utf-8")
    return tuple(names)


def row(participant: str, number: int) -> Row:
    """A row that its number decides."""
    sd = 0.1 + 0.02 * (number % 5)
    value = 0.1 * 1.05 ** (number % 7)
    ends = {"low": value * 0.8, "high": value * 1.25}
    stiffness = Stiffness(value=value, unit=TIMES_DEFAULT, **ends, sd_log=sd, visit_sd_log=0.5 * sd)
    return Row(
        participant=participant, id=participant, age=10.0 + number % 8, sex="male" if number % 3 == 0 else "female",
        height_cm=150.0 + number % 30, cobb_deg=-30.0 + number % 61, curve="main thoracic", status="CONVERGED",
        determined="determined", stiffness={"tissue": stiffness}, training_rmse_mm=0.5, largest_force_n=60.0,
        report="report.html",
    )  # fmt: skip


def quick(folder: Path, participant: str, settings: dict, say) -> None:
    """Stands in for the steps: a few files from the inputs alone, or the trouble that the inputs ask for."""
    content = json.loads((folder / "subject.json").read_text(encoding="utf-8"))
    trouble = content["trouble"]
    say(f"track: {content['number']}")
    if "count" in settings:
        with open(settings["count"], "a", encoding="utf-8") as log:
            log.write(f"{participant}\n")
    if trouble == "refuse":
        raise FitError(f"{participant} can't be estimated")
    if trouble == "wrong":
        raise SubjectError(f"{folder / 'subject.json'}: wrong")
    if trouble == "bug":
        raise ValueError("no such thing")
    if trouble == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if trouble == "die once" and not (flag := Path(settings["flags"]) / participant).exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGSEGV)
    if trouble == "hang":
        time.sleep(600.0)
    if trouble == "fill":
        held = []
        while True:
            held.append(bytearray(os.urandom(1 << 20)) * 20)
            time.sleep(0.01)
    if trouble == "full":
        raise_full(folder)
    if trouble == "half" and not (flag := Path(settings["flags"]) / participant).exists():
        (folder / "results" / ".estimate.json.0000.tmp").write_text("half", encoding="utf-8")
        (folder / "results" / "estimate.json").write_text("half", encoding="utf-8")
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    write_json(folder / "results" / "estimate.json", {"n": content["number"], **settings.get("say", {})})
    write_text(folder / "results" / "figures" / "one.svg", f"<svg>{content['number']}</svg>")
    write_text(folder / "results" / "report.html", f"<p>{participant}</p>")
    write_row(folder / "results" / "row.json", row(participant, content["number"]))


def raise_full(folder: Path) -> None:
    """As a full disk is met by what writes results."""
    import errno

    from spinestiff import files

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    files.os.fsync = full  # type: ignore[attr-defined]
    write_text(folder / "results" / "estimate.json", "x")


def misnamed(folder: Path, participant: str, settings: dict, say) -> None:
    """Leaves the row of somebody else."""
    write_row(folder / "results" / "row.json", row("sub-009", 0))
