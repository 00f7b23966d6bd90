"""A subject as one zip file: everything, or without what tells whose it is."""

from __future__ import annotations

import os
import secrets
import shutil
import threading
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from spinestiff.annotate.draft import DRAFT_FILE
from spinestiff.errors import InUseError, RadiographError, SubjectError
from spinestiff.files import read_json, trouble
from spinestiff.formats import json_text
from spinestiff.imaging.deidentification.deidentify import deidentify
from spinestiff.imaging.deidentification.pseudonyms import Key, random_key
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.radiograph import read_scans
from spinestiff.loopback.asking import sendable
from spinestiff.subject.folder import MOST_INPUT_BYTES, read_annotation, read_unannotated
from spinestiff.subject.image_names import PushImage, frame_image, view_image
from spinestiff.subject.lock import sole_run
from spinestiff.subject.record_reading import Record
from spinestiff.subject.records import (
    ANNOTATION_FILE,
    REST_IMAGES,
    SUBJECT_FILE,
    FurtherViewRecord,
    PushRecord,
    SubjectRecord,
)
from spinestiff.workbench.marks import XRAY_KEYS
from spinestiff.workbench.rooms import room_bytes

PARCEL_S, MOST_PARCELS = 600.0, 10
"""How many seconds a zip file waits to be fetched, and how many wait at once; of more, the oldest go."""
LEFT_OUT = {
    "torso": "a torso of the subject's own bones",
    "skin_scan": "a scan of the skin",
    "markers": "markers on the skin",
    DRAFT_FILE: "marks that are not complete yet",
}
README = "README.txt"
KEPT = {
    SubjectRecord: frozenset({
        "age", "sex", "height_cm", "mass_kg", "xray", "trunk", "pelvis", "wall", "priors", "parameters", "population",
    }),
    PushRecord: frozenset({"side", "level", "d21_mm", "d31_mm", "forces_n", "roles"}),
    FurtherViewRecord: frozenset({"kind", "frames", "turned_deg"}),
}  # fmt: skip
"""What leaves a house as it is; names of people, pushes and files are new."""


class Parcels:
    """Zip files of one server that wait to be fetched.

    Parameters
    ----------
    common : folder in which each server has a folder of its own, which the system holds for it as long as it lives.

    Attributes
    ----------
    folder : this server's.
    """

    def __init__(self, common: Path) -> None:
        self._common, self.folder = common, common / secrets.token_hex(8)
        self._lock, self._held = threading.Lock(), ExitStack()

    def pack(self, parcel: Callable[[Path], Path]) -> Path:
        """What ``parcel`` makes in the folder, one at a time; zip files that nobody fetched are removed first.

        Raises
        ------
        SubjectError : the folder can't be made; what ``parcel`` raises.
        """
        with self._lock:
            self.clear()
            self._hold()
            there = sorted((one.stat().st_mtime, one) for one in self.folder.glob("*.zip"))
            late = time.time() - PARCEL_S
            for number, (made, one) in enumerate(there):
                if made <= late or number <= len(there) - MOST_PARCELS:
                    with suppress(OSError):  # some systems keep a file that is being sent
                        one.unlink()
            return parcel(self.folder)

    def _hold(self) -> None:
        if self.folder.is_dir():
            return
        try:
            # Nobody else's to read, also where a server that changes nothing has not made ``.workbench`` so.
            self.folder.mkdir(mode=0o700, parents=True)
            self._held.enter_context(sole_run(self.folder))
        except OSError as problem:
            raise SubjectError(f"the zip file can't be made ({trouble(problem)})") from None

    def clear(self) -> None:
        """Remove those of servers that have ended: nobody has a ticket for them."""
        there = list(self._common.iterdir()) if self._common.is_dir() else []
        for one in there:
            if one != self.folder:
                with suppress(OSError, InUseError), sole_run(one):
                    shutil.rmtree(one) if one.is_dir() else one.unlink()

    def close(self) -> None:
        """Remove those of this server, which ends."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self._held.close()


def whole_parcel(folder: Path, place: Path) -> Path:
    """All files of a subject, but hidden ones and links, as a zip file in a folder; returns its path.

    Bytes of a name that are no UTF-8 stand in it as the page shows them (``sendable``).

    Raises
    ------
    SubjectError : there is no room for it, or it can't be written.
    """
    return _zipped(place, [(sendable(path.relative_to(folder).as_posix()), path) for path in _files(folder)])


def _files(folder: Path) -> Iterator[Path]:
    for base, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and not Path(base, name).is_symlink())
        for name in sorted(names):
            path = Path(base, name)
            if not name.startswith(".") and path.is_file() and not path.is_symlink():
                yield path


def nameless_parcel(folder: Path, place: Path, burned_in_ok: bool) -> Path:
    """Radiographs without their patients, values and annotation under new names, as a zip file; returns its path.

    Results are left out: they can be made again from these, and show the subject's name.

    Parameters
    ----------
    burned_in_ok : somebody has looked, and there is no name in the pictures.

    Raises
    ------
    RadiographError, SubjectError : a radiograph that can't be freed of its patient, or as ``whole_parcel``; nothing is
        written then.
    """
    subject = read_unannotated(folder)
    key, values = random_key(), read_json(folder / SUBJECT_FILE)
    content: dict[str, bytes] = {}
    for image, file in REST_IMAGES.items():
        if (subject.folder / file).exists():
            content[file] = _freed(subject.folder / file, folder, key, burned_in_ok, image)
    left_out, names = set(), {}
    pushes: list[dict[str, Any]] = []
    for number, push in enumerate(values["pushes"], 1):
        name = f"push-{number}"
        names[push["id"]] = name
        new = {**_kept(push, PushRecord), "id": name}
        left_out |= {key for key in ("markers",) if push.get(key) is not None}
        views = []
        for count, view in enumerate(push.get("views", ()), 1):
            files = _copied(folder / view["files"], folder, f"views/{name}-{count}", key, burned_in_ok)
            content |= files[1]
            names[f"{push['id']}/{view['id']}"] = f"view-{count}"
            views.append({**_kept(view, FurtherViewRecord), "id": f"view-{count}", "files": files[0]})
        if views:
            new["views"] = views
        new["frames"], files_ = _copied(folder / push["frames"], folder, f"pushes/{name}", key, burned_in_ok)
        content |= files_
        pushes.append(new)
    left_out |= {key for key in ("torso", "skin_scan") if values.get(key) is not None}
    if (folder / DRAFT_FILE).exists():
        left_out.add(DRAFT_FILE)
    # Of its own: visits with one id are taken for visits of one person.
    name = f"subject-{secrets.token_hex(4)}"
    record = {**_kept(values, SubjectRecord), "schema_version": values["schema_version"], "id": name, "pushes": pushes}
    for told in XRAY_KEYS:
        if of_images := (record.get("xray") or {}).get(told):
            record["xray"] = {**record["xray"], told: _renamed(of_images, names)}
    content[SUBJECT_FILE] = json_text(record).encode()
    if (folder / ANNOTATION_FILE).is_file():
        read_annotation(folder / ANNOTATION_FILE)
        annotation = read_json(folder / ANNOTATION_FILE)
        marked = _renamed(annotation["images"], names)
        content[ANNOTATION_FILE] = json_text({**annotation, "images": marked}).encode()
    lines = [
        "Made by spinestiff: radiographs without their patients, values and annotation under new names.",
        "Age, sex, height and, where they are given, mass and sizes of the trunk are those of the person.",
        "Pixels are unchanged: look for text that is burned in.",
    ]
    lines += [f"Left out: {LEFT_OUT[one]}." for one in sorted(left_out)]
    content[README] = ("\n".join(lines) + "\n").encode()
    return _zipped(place, sorted(content.items()))


def _kept(values: Mapping[str, Any], kind: type[Record]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name in KEPT[kind]}


def _copied(path: Path, folder: Path, name: str, key: Key, burned_in_ok: bool) -> tuple[str, dict[str, bytes]]:
    """Radiographs of a file or folder under a new name; of a folder those that are read, in their order."""
    if not path.is_dir():
        return f"{name}.dcm", {f"{name}.dcm": _freed(path, folder, key, burned_in_ok, name)}
    # What is odd about their order is told to whoever reads the subject, too.
    scans, _ = read_scans(path, Geometry(), within=folder)
    inside = [path / scan.name for scan in scans]
    return name, {
        f"{name}/{number:03d}.dcm": _freed(one, folder, key, burned_in_ok, name) for number, one in enumerate(inside)
    }


def _freed(path: Path, folder: Path, key: Key, burned_in_ok: bool, name: str) -> bytes:
    if not path.resolve().is_relative_to(folder.resolve()) or not path.is_file():
        raise RadiographError(f"{name}: no file in the subject's folder")
    if path.stat().st_size > MOST_INPUT_BYTES:
        raise RadiographError(f"{name}: too large")
    try:
        return deidentify(path.read_bytes(), key, burned_in_ok=burned_in_ok).content
    except RadiographError as problem:
        raise RadiographError(f"{name}: {problem}") from None


def _renamed(images: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """What is said of images under their new names; one of a push, or view, that is no longer there is left out."""
    return {new: one for image, one in images.items() if (new := _new_name(image, names)) is not None}


def _new_name(image: str, names: Mapping[str, str]) -> str | None:
    if image in REST_IMAGES:
        return image
    found = PushImage.named(image)
    if found is None or (push := names.get(found.push)) is None:
        return None
    if found.view is None:
        return frame_image(push, found.frame)
    view = names.get(f"{found.push}/{found.view}")
    return None if view is None else view_image(push, found.frame, view)


def _zipped(place: Path, content: Sequence[tuple[str, bytes | Path]]) -> Path:
    target = place / f"{secrets.token_hex(8)}.zip"
    try:
        place.mkdir(parents=True, exist_ok=True)
        size = sum(len(what) if isinstance(what, bytes) else what.stat().st_size for _, what in content)
        if room_bytes(place) < size:
            raise SubjectError(f"there is no room on the disk for a zip file of {size / 2**20:.0f} MB")
        with zipfile.ZipFile(target, "x", zipfile.ZIP_DEFLATED, compresslevel=3, strict_timestamps=False) as zipped:
            for name, what in content:
                if isinstance(what, bytes):
                    # The same date for all: when they were packed tells nothing of the person.
                    zipped.writestr(zipfile.ZipInfo(name), what, zipfile.ZIP_DEFLATED)
                else:
                    zipped.write(what, name)
    except BaseException as problem:
        target.unlink(missing_ok=True)
        if isinstance(problem, OSError):
            raise SubjectError(f"the zip file can't be made ({trouble(problem)})") from None
        raise
    return target
