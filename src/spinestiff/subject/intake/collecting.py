"""What is in an export: every file of nested folders, whose radiograph it is, and why another is none."""

from __future__ import annotations

import math
import os
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import combinations
from pathlib import Path, PurePosixPath

from spinestiff.errors import OptionError, RadiographError, SubjectError
from spinestiff.files import listed, regular_file
from spinestiff.imaging.dicom.export import Exported, read_exported
from spinestiff.imaging.dicom.identity import Identity
from spinestiff.subject.intake.pictures import Album
from spinestiff.words import counted

MOST_FILES = 20_000
MOST_DEPTH = 16
SAID_EVERY = 20
"""Files."""


@dataclass(frozen=True)
class Refused:
    """A file that is left out, and why; ``twin``: the name of the same image that is kept, "" where there is none."""

    name: str
    why: str
    twin: str = ""


@dataclass(frozen=True)
class Study:
    """Radiographs of one patient and one study; ``label`` names it in messages and options, e.g. A1."""

    label: str
    files: tuple[Exported, ...]

    @property
    def patient(self) -> str:
        """The letter that stands for its patient."""
        return self.label.rstrip("0123456789")

    @property
    def kinds(self) -> str:
        """How many radiographs it has of which kind; "" where none is told."""
        singles = [sum(one.view == view and one.frames == 1 for one in self.files) for view in ("frontal", "lateral")]
        kinds = [f"{count} {view}" for count, view in zip(singles, ("frontal", "lateral")) if count]
        several = sum(one.frames > 1 for one in self.files)
        return ", ".join([*kinds, f"{several} of several frames"] if several else kinds)

    @property
    def first(self) -> str:
        """The first of its files by name."""
        return min(one.name for one in self.files)

    @property
    def words(self) -> str:
        """What is in it, without anything of the patient."""
        inside = f": {self.kinds}" if self.kinds else ""
        return f"{self.label} ({counted(len(self.files), 'file')}{inside}; {self.first})"

    @property
    def when(self) -> str:
        """Day of its first exposure, with its time if told, as "2025-06-12 10:15"; "" if no header tells."""
        told = [(one.tags.day, one.tags.moment) for one in self.files if one.tags.day is not None]
        if not told:
            return ""
        day, moment = min(told, key=lambda one: (one[0], math.inf if one[1] is None else one[1]))
        minutes = "" if moment is None else f" {int(moment % 86400) // 3600:02d}:{int(moment % 3600) // 60:02d}"
        return date.fromordinal(day).isoformat() + minutes

    @property
    def description(self) -> str:
        """What the hospital calls it; "" if no header tells."""
        return next((one.tags.description for one in self.files if one.tags.description), "")


def collect(
    sources: Sequence[Path], say: Callable[[str], None] = lambda line: None
) -> tuple[tuple[Exported, ...], tuple[Refused, ...]]:
    """The radiographs in files and nested folders, in the order of their names, and what else is there.

    Below one folder names are told without it; of several sources each name begins with enough of its source's path to
    tell them apart, or with the source's number where none does. A source that is named twice is read once. Links to
    folders are not followed, nor links that lead out of the folder; hidden files are passed by.

    Raises
    ------
    RadiographError : no such file or folder, more files or deeper folders than are read, no radiograph at all.
    """
    found: list[Exported] = []
    refused: list[Refused] = []
    seen = Album()
    apart = list({source.resolve(): source for source in sources}.values())
    for source, top in zip(apart, _tops(apart)):
        files = _files(source, top)
        for number, (path, name) in enumerate(files):
            if number % SAID_EVERY == 0:
                say(f"init: reading file {number + 1} of {len(files)}")
            try:
                if path.is_dir():
                    raise RadiographError("a link to a folder, which is not followed; name that folder itself")
                within = source if source.is_dir() else source.parent
                regular_file(path, RadiographError, within=within, name=path.name)
                one = read_exported(path, name, within)
            except RadiographError as problem:
                refused.append(Refused(name, str(problem).removeprefix(f"{path.name}: ")))
                continue
            if (twin := seen.same(one)) is not None:
                refused.append(Refused(name, f"the same image as {twin.name}", twin.name))
            else:
                seen.add(one)
                found.append(one)
    if not found:
        what = counted(len(refused), "file")
        first = f"; {refused[0].name}: {refused[0].why}" if refused else ""
        raise RadiographError(f"found no radiograph in {what} of {', '.join(map(str, sources))}, wanted some{first}")
    return tuple(found), tuple(refused)


def _tops(sources: Sequence[Path]) -> list[PurePosixPath]:
    """What the names of each source's files begin with; none of them is the beginning of another."""
    if len(sources) == 1:
        return [PurePosixPath("" if sources[0].is_dir() else sources[0].name)]
    paths = [Path(os.path.abspath(source)).parts[1:] for source in sources]
    for depth in range(1, min(map(len, paths)) + 1):
        tops = [path[-depth:] for path in paths]
        if len(set(tops)) == len(tops):
            return [PurePosixPath(*top) for top in tops]
    return [PurePosixPath(str(number), *path[-1:]) for number, path in enumerate(paths, 1)]


def _files(source: Path, top: PurePosixPath) -> list[tuple[Path, str]]:
    """Files of a source and their names, in the order of names; links to folders are among them."""
    if not source.is_dir():
        regular_file(source, RadiographError)
        return [(source, top.as_posix())]
    found, todo = [], [(source, 0)]
    while todo:
        folder, depth = todo.pop()
        for path in listed(folder, RadiographError):
            if path.name.startswith("."):
                continue
            if path.is_dir() and not path.is_symlink():
                if depth == MOST_DEPTH:
                    raise RadiographError(f"{source}: folders more than {MOST_DEPTH} deep; name one of those inside")
                todo.append((path, depth + 1))
            else:
                found.append((path, (top / path.relative_to(source).as_posix()).as_posix()))
        if len(found) > MOST_FILES:
            raise RadiographError(f"{source}: more than {MOST_FILES} files; name the folder of the study")
    return sorted(found, key=lambda one: one[1])


def studies(found: Sequence[Exported]) -> tuple[Study, ...]:
    """Radiographs by patient (A, B, ...) and study (1, 2, ... in order of time)."""
    order = sorted(found, key=lambda one: (math.inf if one.tags.moment is None else one.tags.moment, one.name))
    groups: list[Study] = []
    for number, mine in enumerate(_by_patient(order)):
        for count, study in enumerate(dict.fromkeys(one.tags.study for one in mine), 1):
            files = tuple(one for one in mine if one.tags.study == study)
            groups.append(Study(f"{_letters(number)}{count}", files))
    return tuple(groups)


def _by_patient(found: Sequence[Exported]) -> list[list[Exported]]:
    """Radiographs of one patient together, as far as headers tell; those that tell nothing of theirs are together."""
    patients: list[list[tuple[Identity, str]]] = []
    for one in dict.fromkeys((one.scan.whose, one.tags.study) for one in found):
        mine = next((patient for patient in patients if _is_among(*one, patient)), None)
        if mine is None:
            patients.append([one])
        else:
            mine.append(one)
    return [[one for one in found if (one.scan.whose, one.tags.study) in patient] for patient in patients]


def _is_among(whose: Identity, study: str, patient: Sequence[tuple[Identity, str]]) -> bool:
    # Without a number, what a file of another study says may be of anybody.
    tells = bool(whose.marks[0]) or any(
        whose.is_of(other) or whose.marks == other.marks or (study and study == of) for other, of in patient
    )
    return tells and all(whose.may_be_of(other) for other, _ in patient)


def _letters(number: int) -> str:
    """A to Z, then AA, AB and so on."""
    return ("" if number < 26 else _letters(number // 26 - 1)) + chr(ord("A") + number % 26)


def chosen_studies(found: Sequence[Exported], wanted: str | None) -> tuple[tuple[Exported, ...], tuple[Study, ...]]:
    """The radiographs of the one study, or of those that were asked for, and the studies that are left out.

    Parameters
    ----------
    wanted : labels separated by commas; None where there is one study only.

    Raises
    ------
    SubjectError : several patients or studies, and none chosen.
    OptionError : no study of that label, studies of several patients.
    """
    groups = studies(found)
    labels = [group.label for group in groups]
    listing = ", ".join(group.words for group in groups)
    patients = len({group.patient for group in groups})
    if wanted is None:
        if len(groups) == 1:
            return groups[0].files, ()
        what = f"{counted(patients, 'patient')} and {counted(len(groups), 'study', 'studies')}"
        several = next((f", or several of one patient, as --study {a.label},{b.label}"
                        for a, b in zip(groups, groups[1:]) if a.patient == b.patient), "")  # fmt: skip
        raise SubjectError(f"found {what}, wanted one: {listing}; choose with --study {labels[0]}{several}")
    asked = [label.strip().upper() for label in wanted.split(",")]
    for label in asked:
        if label not in labels:
            raise OptionError(f"--study {label[:20]}: no such study; there are {listing}")
    mine = [group for group in groups if group.label in asked]
    whose = {one.scan.whose for group in mine for one in group.files}
    if not all(one.may_be_of(other) for one, other in combinations(whose, 2)):
        raise OptionError(f"--study {wanted[:40]}: studies of several patients; wanted those of one: {listing}")
    files = tuple(one for group in mine for one in group.files)
    return files, tuple(group for group in groups if group not in mine)


def by_name(
    text: str, found: Sequence[Exported], where: str, others: Sequence[Study] = (), refused: Sequence[Refused] = ()
) -> tuple[Exported, ...]:
    """The file of that name, or the files of a folder of that name: a path in the export, or the end of one.

    Parameters
    ----------
    others, refused : studies that were not chosen and files that are left out, so that they are told from what is not
        there.

    Raises
    ------
    SubjectError : none, or several that the text does not tell apart.
    """
    wanted, _ = _names(text.replace("\\", "/"))
    files = [one for one in found if _names(one.name)[0][-len(wanted) :] == wanted]
    exact = [one for one in files if _names(one.name)[0] == wanted]
    if len(files) == 1 or len(exact) == 1:
        return tuple(exact or files)
    if files:
        raise SubjectError(
            f"{where}: '{text[:80]}' is the name of {len(files)} radiographs ({_some(files)}); write more of the path"
        )
    folders: dict[tuple[str, ...], list[Exported]] = {}
    for one in found:
        _, folder = _names(one.name)
        if wanted and folder[-len(wanted) :] == wanted:
            folders.setdefault(folder, []).append(one)
    if len(folders) == 1:
        return tuple(*folders.values())
    if folders:
        names = ", ".join("/".join(folder) for folder in folders)
        raise SubjectError(f"{where}: '{text[:80]}' is the name of several folders ({names}); write more of the path")
    for study in others:
        ends = {parts[-len(wanted) :] for one in study.files for parts in _names(one.name)}
        if wanted and wanted in ends:
            raise SubjectError(
                f"{where}: '{text[:80]}' is of study {study.label}, which --study leaves out; choose it, too, if it is "
                "the same patient's, or leave the file out"
            )
    for left in refused:
        if wanted and wanted in {parts[-len(wanted) :] for parts in _names(left.name)}:
            instead = f"; name {left.twin}" if left.twin else ""
            raise SubjectError(f"{where}: {left.name} can't be taken: {left.why}{instead}")
    raise SubjectError(f"{where}: no radiograph '{text[:80]}' in the sources; there are {_some(found)}")


def _names(name: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Parts of the paths of a file and of its folder, an umlaut being one character: a Mac's paths have two."""
    parts = PurePosixPath(unicodedata.normalize("NFC", name)).parts
    return parts, parts[:-1]


def _some(found: Sequence[Exported]) -> str:
    return ", ".join(one.name for one in found[:6]) + (", ..." if len(found) > 6 else "")
