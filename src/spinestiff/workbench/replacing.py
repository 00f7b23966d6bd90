"""A rest radiograph of a subject replaced by another file: what takes its place, and the exchange of both.

Pixels that were marked in one picture say nothing of another. So everything that was marked in a radiograph goes where
it goes, and comes back with it.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spinestiff.annotate.session import writing
from spinestiff.errors import SubjectError
from spinestiff.files import copy_known, trouble
from spinestiff.imaging.dicom.export import Exported
from spinestiff.subject.image_names import described, rest_view
from spinestiff.subject.intake.adding import Standing, check_patient
from spinestiff.subject.intake.collecting import studies
from spinestiff.subject.intake.pictures import Album
from spinestiff.subject.lock import sole_run
from spinestiff.subject.records import REST_IMAGES, RESULTS
from spinestiff.subject.run_record import RUN_FILE
from spinestiff.words import counted
from spinestiff.workbench.marks import Marks, contents_of, joined, marks_of, parted, put_back, texts_of, write_changed
from spinestiff.workbench.newcomer import Export, Wish, look_record


@dataclass(frozen=True)
class Choice:
    """Which radiograph takes the place of one at rest, None where that is not told yet, and why, by name of the file.

    ``notes`` : what is odd about it.
    """

    one: Exported | None
    reasons: dict[str, str]
    notes: tuple[str, ...] = ()


def choose(standing: Standing, found: Sequence[Exported], image: str, named: Exported | None) -> Choice:
    """The radiograph that takes the place of one at rest, "rest/frontal" or "rest/lateral".

    Parameters
    ----------
    found : radiographs of one patient. named : what the user says; None: the only one that can be meant.

    Raises
    ------
    SubjectError : the subject has none of this view; the named one is another view, or the very same image; it is of
        another patient than the radiographs that stay.
    """
    if not standing.has(image):
        raise SubjectError(f"the subject has no {REST_IMAGES[image]} that could be replaced; add one instead")
    present = Album(one for one in standing.files if standing.images[one.name] == image)
    reasons = {one.name: why for one in found if (why := _unfit(one, image, present))}
    fit = [one for one in found if one.name not in reasons]
    told = [one for one in fit if one.view is not None] or fit
    if named is not None and named.name in reasons:
        raise SubjectError(f"{named.name}: {reasons[named.name]}")
    one = named or (told[0] if len(told) == 1 else None)
    for other in fit:
        reasons[other.name] = "another was chosen" if one else "one of several; choose below which takes its place"
    if one is None:
        return Choice(None, reasons)
    reasons[one.name] = f"takes the place of {REST_IMAGES[image]}"
    staying = [other for other in standing.files if standing.images[other.name] != image]
    check_patient(staying, [one])
    twin = Album(staying).same(one)
    notes = () if twin is None else (f"{one.name} is the same image as {twin.name}, which the subject has besides.",)
    return Choice(one, reasons, notes)


def _unfit(one: Exported, image: str, present: Album) -> str:
    """Why a radiograph can't take the place of one at rest; "" where it can."""
    wanted = rest_view(image)
    if (twin := present.same(one)) is not None:
        return f"the same image as {twin.name}, which is to be replaced"
    if one.frames > 1:
        return f"{counted(one.frames, 'frame')}; a radiograph at rest has one"
    if one.view not in (None, wanted):
        return f"{one.view} ({one.view_source}), wanted a {wanted} radiograph"
    return ""


def looked_at_instead(standing: Standing, export: Export, wish: Wish, image: str) -> dict[str, Any]:
    """What of an export takes the place of a rest radiograph, and what that entails, as JSON."""
    groups = studies(export.found)
    if wish.study is None and len(groups) > 1:
        return {**look_record(export), "study": None, "changes": []}
    chosen = export.study(wish)
    choice = _chosen(standing, export, wish, image)
    uses = {} if choice.one is None else {choice.one.name: described(image)}
    record = look_record(export, chosen, uses, choice.reasons)
    changes = [] if choice.one is None else _entails(standing.folder, image)
    label = wish.study or (groups[0].label if groups else None)
    return {**record, "study": label, "notes": list(choice.notes), "changes": changes}


def _entails(folder: Path, image: str) -> list[str]:
    """What the exchange of a rest radiograph does to the rest of the subject, a line each."""
    marks, kind = marks_of(folder, image), rest_view(image)
    lines = [f"{REST_IMAGES[image]} moves to the trash, from where it can be put back."]
    if marks.annotation is not None or marks.draft is not None:
        vertebrae = counted(marks.vertebrae, "marked vertebra", "marked vertebrae")
        lines.append(f"Its {vertebrae} go with it: the new {kind} radiograph has to be annotated from the start.")
    else:
        lines.append(f"The new {kind} radiograph has to be annotated; nothing is marked in the present one.")
    if marks.scale is not None:
        lines.append(
            "The known length that was marked in it (xray.scale in subject.json) goes with it, too. If the new file "
            "has no pixel spacing of its own, a length has to be measured in it."
        )
    if marks.geometry is not None:
        lines.append(
            "The distances or pixel that were given for it alone (xray.images in subject.json) go with it, too; give "
            "those of the new one if its file lacks them."
        )
    lines.append("Annotations of all other radiographs stay.")
    if (folder / RESULTS / RUN_FILE).is_file():
        lines.append("Results that came from the present one count as out of date until the next run.")
    return lines


def chosen_instead(standing: Standing, export: Export, wish: Wish, image: str) -> Exported:
    """The radiograph that takes the place of one at rest. Raises SpinestiffError; also where it is not told which."""
    one = _chosen(standing, export, wish, image).one
    if one is None:
        raise SubjectError(f"none of these files is told to take the place of {REST_IMAGES[image]}; choose one")
    return one


def _chosen(standing: Standing, export: Export, wish: Wish, image: str) -> Choice:
    chosen = export.study(wish)
    named = dict(zip(REST_IMAGES, wish.rest(chosen)))[image]
    return choose(standing, chosen, image, named)


def exchange(folder: Path, image: str, source: Path, sha256: str, marks: Marks, keep: Callable[[Marks], Path]) -> None:
    """Put a copy of a file in the place of a rest radiograph, with what was marked in it: all of it, or nothing.

    What was marked in a picture goes after it and before the next one comes, so that at no time marks of one belong to
    the other, and whoever is killed meanwhile leaves both where they can be put back.

    Parameters
    ----------
    sha256 : of the file that was looked at, which the copy has to be.
    keep : called before anything changes, unless there is no picture: takes down what is marked in it, and returns
        where it goes, a path that is not there yet, on the same file system.

    Raises
    ------
    InUseError : a run is at work on the subject.
    ChangedElsewhere : the file is no longer what was looked at.
    SubjectError : a file that can't be read or written, or is a link; a known length that the schema does not allow.
    """
    target = folder / REST_IMAGES[image]
    draft = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    with sole_run(folder):
        if target.is_symlink() or target.parent.is_symlink():
            raise SubjectError(f"{REST_IMAGES[image]}: is a link, which is not replaced; put a file there by hand")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            copy_known(source, draft, sha256, "the radiograph")
            # Marks may be saved while a large file is copied, and none from here on.
            with writing(folder):
                _exchange(folder, image, draft, marks, keep)
        except OSError as problem:
            raise SubjectError(f"the radiograph can't be replaced ({trouble(problem)}); nothing was changed") from None
        finally:
            draft.unlink(missing_ok=True)


def _exchange(folder: Path, image: str, draft: Path, marks: Marks, keep: Callable[[Marks], Path]) -> None:
    """The same with the copy, ``draft``, whoever else would write the marks kept out."""
    target = folder / REST_IMAGES[image]
    texts = texts_of(folder)
    before = contents_of(texts)
    bare, gone = parted(before, image)
    after = joined(bare, image, marks)
    there = target.exists()
    place: Path | None = None
    try:
        if there:
            place = keep(gone)
            target.rename(place)
        write_changed(folder, before, bare)
        draft.rename(target)
        write_changed(folder, bare, after)
    except BaseException:
        if not there:
            target.unlink(missing_ok=True)
        elif place is not None and place.exists():
            place.replace(target)
        draft.unlink(missing_ok=True)  # on a full disk the marks need its room
        put_back(folder, texts)
        raise
