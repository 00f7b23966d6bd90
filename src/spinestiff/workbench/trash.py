"""Subjects and pushes that were removed and rest radiographs that were replaced lie in a trash until somebody deletes
them for good; until then they can be put back.

A place in the trash holds a subject's folder; or a radiograph beside ``radiograph.json``, which says whose it was and
what was marked in it; or ``push.json``, which says the same of a push, whose radiographs stay in the subject.
"""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spinestiff.annotate.session import writing
from spinestiff.errors import NotThere, RadiographError, SpinestiffError, SubjectError
from spinestiff.files import file_digest, listed, read_json, trouble, write_json
from spinestiff.imaging.dicom.export import read_exported
from spinestiff.subject.intake.adding import check_patient, read_standing
from spinestiff.subject.lock import sole_run
from spinestiff.subject.records import REST_IMAGES, SUBJECT_FILE
from spinestiff.workbench.marks import Marks
from spinestiff.workbench.owner import Owner
from spinestiff.workbench.push_removal import RemovedPush, read_removed, record_of, remove_push, return_push
from spinestiff.workbench.replacing import exchange
from spinestiff.workbench.rooms import KEY, Root

RECORD, PUSH_RECORD = "radiograph.json", "push.json"


@dataclass(frozen=True)
class Replaced:
    """A rest radiograph in the trash: whose it was, which image, what was marked in it."""

    owner: Owner
    image: str
    marks: Marks


class Trash:
    """The trash of a served folder."""

    def __init__(self, root: Root) -> None:
        self.root, self.folder = root, root.own / "trash"

    def remove(self, folder: Path) -> str:
        """Move a subject here; returns its key in the trash.

        Raises
        ------
        InUseError : a run is at work on it. SubjectError : it can't be moved.
        """
        # Marks that are being saved are written before, or not at all: they would make the folder anew.
        with sole_run(folder), writing(folder):
            key = secrets.token_hex(8)
            place = self.folder / key
            try:
                place.mkdir(parents=True)
                folder.rename(place / folder.name)
            except OSError as problem:
                with suppress(OSError):
                    place.rmdir()
                raise SubjectError(f"the subject can't be removed ({trouble(problem)})") from None
            return key

    def replace(self, folder: Path, image: str, source: Path, sha256: str, marks: Marks | None = None) -> str | None:
        """Put a copy of a file in the place of a subject's rest radiograph, with what was marked in it.

        Parameters
        ----------
        sha256 : of the file that was looked at.

        Returns
        -------
        The key of the radiograph that was there, which moves here with its own marks; None where there was none.

        Raises
        ------
        SpinestiffError : as ``replacing.exchange``; all is as it was then.
        """
        owner = Owner.of(folder)
        with self._new_place() as place:

            def keep(gone: Marks) -> Path:
                write_json(place / RECORD, {**owner.record, "image": image, "marks": asdict(gone)})
                return place / Path(REST_IMAGES[image]).name

            exchange(folder, image, source, sha256, marks or Marks(), keep)
        return place.name if place.is_dir() else None

    def remove_push(self, folder: Path, push: str) -> tuple[str, list[str]]:
        """Take a push out of a subject; returns its key in the trash, and what that entails, a line each.

        Raises
        ------
        SpinestiffError : as ``push_removal.remove_push``; all is as it was then.
        """
        owner = Owner.of(folder)
        with self._new_place() as place:

            def keep(removed: RemovedPush) -> None:
                write_json(place / PUSH_RECORD, record_of(owner, removed))

            return place.name, remove_push(folder, push, keep)

    @contextmanager
    def _new_place(self) -> Iterator[Path]:
        """Where something may be put, by a key of its own; what lies there goes if something fails."""
        place = self.folder / secrets.token_hex(8)
        try:
            yield place
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise

    def listed(self) -> list[dict[str, Any]]:
        """What is in the trash, the latest first."""
        places = [one for one in listed(self.folder, SubjectError) if self._holds(one)] if self.folder.is_dir() else []
        found = [{"key": place.name, "removed": place.stat().st_mtime, **self._told(place)} for place in places]
        return sorted(found, key=lambda one: -float(one["removed"]))

    def _told(self, place: Path) -> dict[str, Any]:
        bare = {"image": None, "push": None, "vertebrae": 0}
        try:
            if (place / PUSH_RECORD).is_file():
                owner, removed = self._push(place)
                return {**bare, "name": owner.subject, "push": removed.name, "vertebrae": removed.vertebrae}
            if (place / RECORD).is_file():
                replaced = self._replaced(place)
                vertebrae = replaced.marks.vertebrae
                return {**bare, "name": replaced.owner.subject, "image": replaced.image, "vertebrae": vertebrae}
        except SpinestiffError:
            what = "push" if (place / PUSH_RECORD).is_file() else "radiograph"
            return {**bare, "name": f"a {what} that can't be put back"}
        return {**bare, "name": self._subject(place).name}

    def restore(self, key: str) -> tuple[str, str | None]:
        """Put back a subject, a push, or a radiograph in the place of the present one, which comes here.

        Returns
        -------
        The key of the subject, and of what came here.

        Raises
        ------
        NotThere : nothing of this key.
        SubjectError : the name of the subject is taken; the subject of a radiograph or push is not there, or another
            one is there; otherwise as ``replace`` and ``push_removal.return_push``.
        """
        place = self._place(key)
        if (place / PUSH_RECORD).is_file():
            owner, removed = self._push(place)
            return_push(self._standing(owner), removed)
            shutil.rmtree(place)
            return self.root.key_of(owner.subject), None
        if not (place / RECORD).is_file():
            inside = self._subject(place)
            target = self.root.free(inside.name)
            inside.rename(target)
            place.rmdir()
            return self.root.key_of(target.name), None
        replaced = self._replaced(place)
        folder = self._standing(replaced.owner)
        file = place / Path(REST_IMAGES[replaced.image]).name
        digest = _checked(folder, replaced.image, file)
        gone = self.replace(folder, replaced.image, file, digest, replaced.marks)
        shutil.rmtree(place)
        return self.root.key_of(replaced.owner.subject), gone

    def subject_of(self, key: str) -> str | None:
        """The key of the subject that a radiograph or push belonged to; None for a subject. Raises NotThere,
        SubjectError."""
        place = self._place(key)
        if (place / PUSH_RECORD).is_file():
            return self.root.key_of(self._push(place)[0].subject)
        return self.root.key_of(self._replaced(place).owner.subject) if (place / RECORD).is_file() else None

    def delete(self, key: str) -> None:
        """Delete a subject, a radiograph or what is known of a push for good. Raises NotThere."""
        shutil.rmtree(self._place(key))

    def _holds(self, place: Path) -> bool:
        """Whether it is a place of the trash with something whole in it."""
        if not re.fullmatch(KEY, place.name) or not place.is_dir():
            return False
        inside = listed(place, SubjectError)
        if (place / RECORD).is_file():
            return len(inside) == 2
        if (place / PUSH_RECORD).is_file():
            return len(inside) == 1
        return len(inside) == 1 and inside[0].is_dir()

    def _place(self, key: str) -> Path:
        place = self.folder / key
        if not self._holds(place):
            raise NotThere("this is not in the trash, or no longer")
        return place

    def _subject(self, place: Path) -> Path:
        return listed(place, SubjectError)[0]

    def _standing(self, owner: Owner) -> Path:
        """The folder of a subject that something belonged to. Raises SubjectError."""
        folder = self.root.path / owner.subject
        if not (folder / SUBJECT_FILE).is_file() or folder.is_symlink():
            raise SubjectError(f"the subject {owner.subject} is not there, or no longer; put it back first")
        owner.require(folder)
        return folder

    def _push(self, place: Path) -> tuple[Owner, RemovedPush]:
        """Raises SubjectError where the record is not as ``remove_push`` wrote it."""
        return read_removed(read_json(place / PUSH_RECORD))

    def _replaced(self, place: Path) -> Replaced:
        """Raises SubjectError where the record is not as ``replace`` wrote it."""
        record = read_json(place / RECORD)
        try:
            found = Replaced(Owner.of_record(record), record["image"], Marks(**record["marks"]))
            whole = (place / Path(REST_IMAGES[found.image]).name).is_file()
        except (KeyError, TypeError, AttributeError, SubjectError):
            whole = False
        if not whole:
            raise SubjectError("this radiograph's record in the trash is damaged; it can't be put back")
        return found


def _checked(folder: Path, image: str, file: Path) -> str:
    """A radiograph's SHA-256. Raises SubjectError where it tells of another patient than those that stay."""
    standing = read_standing(folder)
    try:
        one = read_exported(file, file.name, file.parent)
    except RadiographError:
        return file_digest(file)  # as when it was replaced: whatever it is, it was the subject's
    # It was the subject's, under whatever pseudonym.
    staying = [other for other in standing.files if standing.images[other.name] != image]
    check_patient(staying, [one], pseudonyms=False)
    return one.scan.sha256
