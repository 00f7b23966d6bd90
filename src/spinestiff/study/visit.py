"""A visit: a subject folder, what the steps are asked to do with it, and what the earlier ones left for the later."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.regions import check_parameters, parameter_groups
from spinestiff.anatomy.template import MESHES, Mesh, template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import FitError, SubjectError
from spinestiff.estimation.fitted import METHODS, Method
from spinestiff.estimation.ratio_priors import POPULATIONS, ratio_prior
from spinestiff.imaging.features import ORIENTATIONS, Orientation
from spinestiff.study.trials import PushSet, known_of, push_set, rig_of
from spinestiff.study.truth import read_truth
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import Subject, read_subject
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcomes import Tracked
from spinestiff.subject.records import SUBJECT_FILE
from spinestiff.subject.run_record import read_outcome, recorded_steps, result_path

USUAL = ("lateral_bending", "tissue")
"""Ratios that are estimated unless others are asked for."""
NOBODY = "none"
START = "torso_coarse.npz"
"""The coarse torso, in ``results/``."""


@dataclass(frozen=True)
class Settings:
    """What the steps are asked.

    Attributes
    ----------
    mesh : of the estimator: "fine", begun on the coarse one, or "coarse" alone, a quick look.
    method : "weighed" or "paper". orientation : "procrustes" or "covariance".
    parameters : ratios to estimate, by name (``anatomy.regions``); None: those of ``subject.json``, else ``USUAL``.
    population : whose ratios are held as a prior; "none": nobody's; None: as ``subject.json`` says.
    redo : make everything anew, also what a run that was stopped has left.
    """

    mesh: Mesh = "fine"
    method: Method = "weighed"
    orientation: Orientation = "procrustes"
    parameters: tuple[str, ...] | None = None
    population: str | None = None
    redo: bool = False

    def as_record(self) -> dict[str, Any]:
        """As JSON, but for ``redo``, which is no matter of results."""
        return {key: value for key, value in asdict(self).items() if key != "redo"}

    def __post_init__(self) -> None:
        if self.parameters is not None:
            check_parameters(self.parameters)
        for what, found, known in (
            ("mesh", self.mesh, MESHES),
            ("method", self.method, METHODS),
            ("orientation", self.orientation, ORIENTATIONS),
            ("population", self.population or NOBODY, (*POPULATIONS, NOBODY)),
        ):
            if found not in known:
                raise SubjectError(f"unknown {what} '{found}'; wanted one of {', '.join(known)}")


@dataclass(frozen=True)
class Manner:
    """How an estimate is made.

    Attributes
    ----------
    orientation : of a vertebra in the picture. method : the paper's holds the pelvis level and knows no population.
    population : whose ratios are held as a prior; None: nobody's.
    """

    orientation: Orientation = "procrustes"
    method: Method = "weighed"
    population: str | None = None

    @classmethod
    def of(cls, estimate: Estimate) -> Manner:
        """How an estimate was made."""
        return cls(estimate.orientation, estimate.method, estimate.population)


@dataclass(frozen=True)
class Visit:
    """A subject with what is asked of it; ``truth`` is the truth file of a synthetic one."""

    subject: Subject
    settings: Settings
    truth: Path | None = None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Ratios to estimate."""
        return self.settings.parameters or self.subject.record.parameters or USUAL

    @property
    def population(self) -> str | None:
        """Whose ratios are held as a prior; None: nobody's."""
        asked = self.settings.population or self.subject.record.population
        return None if asked == NOBODY else asked

    @property
    def manner(self) -> Manner:
        """How the estimate is to be made."""
        return Manner(self.settings.orientation, self.settings.method, self.population)

    def file(self, name: str) -> Path:
        """Path of a result, there or not."""
        return self.subject.results / name

    def torso(self) -> TorsoModel:
        """The subject's torso at rest.

        Raises
        ------
        SubjectError : there is none, or it is not as its step left it.
        """
        return read_torso(result_path(self.subject, "torso.npz", "personalise"))


def open_visit(folder: str | Path, settings: Settings | None = None, truth: str | Path | None = None) -> Visit:
    """Read and check a subject folder (and the truth file) for the steps. Raises SubjectError."""
    truth = None if truth is None else Path(truth)
    if truth is not None:
        read_truth(truth)
    subject = read_subject(folder)
    try:
        known_of(subject.record, None)
    except SubjectError as error:
        raise SubjectError(f"{subject.folder / SUBJECT_FILE}: {error}") from None
    visit = Visit(subject, settings or Settings(), truth)
    if visit.population is not None and visit.settings.method == "paper":
        raise SubjectError(
            f"population '{visit.population}' with the paper's method, which knows no priors; leave one of them out"
        )
    if visit.population is not None:
        _check_prior(visit)
    return visit


def _check_prior(visit: Visit) -> None:
    """Whether the population has a prior for these ratios; the template's joints are every torso's."""
    template = template_torso(157.0)
    try:
        ratio_prior(parameter_groups(template, visit.parameters), template.joints.kinds, 0.0, visit.population)
    except FitError as error:
        raise SubjectError(f"{error}; estimate the whole spine's bending, or ask for no population") from None


def load_start(visit: Visit, manner: Manner) -> PushSet | None:
    """The same trials on the coarse torso that an estimate on the fine one starts on; None where there is none.

    Raises
    ------
    SubjectError : as ``load_pushes``.
    """
    return pushes_on(visit, torso_on(visit, "coarse"), manner) if has_start(visit) else None


def has_start(visit: Visit) -> bool:
    """Whether the subject was shaped on two meshes, fine and coarse."""
    recorded = recorded_steps(visit.subject).get("personalise")
    return recorded is not None and any(name.endswith(f"/{START}") for name in recorded.outputs)


def torso_on(visit: Visit, mesh: str) -> TorsoModel:
    """The subject's torso at rest on a mesh; one of the subject's own bones has but its own.

    Raises
    ------
    SubjectError : there is none, or it is not as its step left it; or it was shaped on the coarse mesh alone.
    """
    if has_start(visit):
        return visit.torso() if mesh == "fine" else read_torso(result_path(visit.subject, START, "personalise"))
    if mesh == "fine" and visit.subject.torso_path is None:
        raise SubjectError(
            f"{visit.file('torso.npz')}: was shaped on the coarse mesh alone; run spinestiff personalise and "
            "spinestiff estimate again, or ask for the coarse mesh"
        )
    return visit.torso()


def load_pushes(visit: Visit, manner: Manner) -> PushSet:
    """Trials of a visit that has been tracked and personalised.

    Raises
    ------
    SubjectError : an earlier step has not run, or its results are not as it left them.
    """
    return pushes_on(visit, visit.torso(), manner)


def pushes_on(visit: Visit, torso: TorsoModel, manner: Manner) -> PushSet:
    """The same on a given torso."""
    tracked = read_outcome(visit.subject, Tracked)
    lacking = [push.id for push in visit.subject.pushes if push.id not in tracked.pushes]
    if lacking:
        raise SubjectError(f"{visit.file(Tracked.FILE)}: no push '{lacking[0]}'; run spinestiff track again")
    record, population = visit.subject.record, manner.population
    if manner.method == "paper":
        record, population = record.model_copy(update={"pelvis": "level", "wall": "bilateral"}), None
    known = known_of(record, read_outcome(visit.subject, GeometryRecord).matrix, population)
    return push_set(torso, visit.subject.pushes, tracked.pushes, manner.orientation, rig_of(record), known)
