"""Subjects that were removed lie in a trash until somebody deletes them for good; until then they can be put back."""

from __future__ import annotations

import re
import secrets
import shutil
from pathlib import Path
from typing import Any

from spinestiff.errors import NotThere, SubjectError
from spinestiff.files import listed, trouble
from spinestiff.subject.lock import sole_run
from spinestiff.workbench.rooms import KEY, Root


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
        with sole_run(folder):
            key = secrets.token_hex(8)
            place = self.folder / key
            try:
                place.mkdir(parents=True)
                folder.rename(place / folder.name)
            except OSError as problem:
                raise SubjectError(f"the subject can't be removed ({trouble(problem)})") from None
            return key

    def listed(self) -> list[dict[str, Any]]:
        """What is in the trash, the latest first."""
        found = []
        for place in listed(self.folder, SubjectError) if self.folder.is_dir() else []:
            inside = listed(place, SubjectError) if re.fullmatch(KEY, place.name) and place.is_dir() else []
            if inside:
                found.append({"key": place.name, "name": inside[0].name, "removed": place.stat().st_mtime})
        return sorted(found, key=lambda one: -float(one["removed"]))

    def restore(self, key: str) -> str:
        """Put a subject back; returns its key. Raises NotThere, or SubjectError where its name is taken."""
        inside = self._inside(key)
        target = self.root.new_subject(inside.name)
        inside.rename(target)
        inside.parent.rmdir()
        return self.root.key_of(target.name)

    def delete(self, key: str) -> None:
        """Delete a subject for good. Raises NotThere."""
        shutil.rmtree(self._inside(key).parent)

    def _inside(self, key: str) -> Path:
        place = self.folder / key
        inside = listed(place, SubjectError) if re.fullmatch(KEY, key) and place.is_dir() else []
        if len(inside) != 1:
            raise NotThere("this subject is not in the trash, or no longer")
        return inside[0]
