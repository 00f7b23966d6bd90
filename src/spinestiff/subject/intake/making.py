"""``subject.json`` and the folder around it, from sorted radiographs; what is known stays, what is open is filled."""

from __future__ import annotations

import copy
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spinestiff.errors import OptionError, RadiographError, SubjectError
from spinestiff.files import copy_known, read_json, trouble, whole_folder, write_json
from spinestiff.imaging.dicom.export import Exported
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.dicom.reading import check_given
from spinestiff.subject.gaps import PERSON, PUSH, check_open_record, gaps_of
from spinestiff.subject.geometry import geometry_without_scale
from spinestiff.subject.image_names import LATERAL, frame_image, view_image
from spinestiff.subject.intake.sorting import PushFiles, Sorting
from spinestiff.subject.record_reading import IDENTIFIER, WANTED_ID, parse_record
from spinestiff.subject.records import REST_IMAGES, SCHEMA_VERSION, SUBJECT_FILE, SubjectRecord, XRayRecord
from spinestiff.words import push_named

LOG_AGAIN = f"to read a force log again, write null for each of the push's forces_n in {SUBJECT_FILE}"


@dataclass(frozen=True)
class Given:
    """What the user says: of the person, of all pushes for which nothing else is told, of the X-ray geometry of all
    pictures, and of single ones: for each value of ``ImageXRayRecord`` the pictures by name; the trunk's sizes by the
    level, as ``TrunkRecord`` has them.
    """

    person: Mapping[str, Any] = field(default_factory=dict)
    pushes: Mapping[str, Any] = field(default_factory=dict)
    xray: Mapping[str, Any] = field(default_factory=dict)
    images: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    trunk: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def identifier_of(out: Path, given: str | None) -> str:
    """The subject's id: as given, else the folder's name.

    Raises
    ------
    OptionError : it can be no id.
    """
    name = out.resolve().name if given is None else given
    if not re.fullmatch(IDENTIFIER, name):
        asked = "--id" if given is not None else "the folder's name can be no id; give --id: found"
        raise OptionError(f"{asked} {name[:64]!r}: wanted {WANTED_ID}")
    return name


def person_of(files: Sequence[Exported]) -> tuple[dict[str, Any], dict[str, str]]:
    """Age and sex as the headers tell them, and a line each that says so; no value where they contradict each other."""
    told: dict[str, Any] = {}
    notes: dict[str, str] = {}
    aged = sorted((one for one in files if one.tags.age is not None), key=lambda one: one.tags.moment or 0.0)
    if aged:
        ages = [one.tags.age or 0.0 for one in aged]
        if max(ages) - min(ages) > 1.0:
            notes["age"] = f"age: not taken from the DICOM headers, which tell {min(ages):g} to {max(ages):g} years"
        else:
            told["age"] = ages[0]
            notes["age"] = f"age: {ages[0]:g} years, from the DICOM header ({aged[0].tags.age_source})"
    sexes = {one.tags.sex for one in files if one.tags.sex is not None}
    if len(sexes) == 1:
        told["sex"] = sexes.pop()
        notes["sex"] = f"sex: {told['sex']}, from the DICOM header (PatientSex)"
    elif sexes:
        notes["sex"] = "sex: not taken from the DICOM headers, which tell both"
    return told, notes


def subject_data(identifier: str, sorting: Sorting) -> dict[str, Any]:
    """``subject.json`` with all that is open as None; pushes are named by ``name_pushes`` once more is known."""
    pushes = [push_data(push) for push in sorting.pushes]
    data = {"schema_version": SCHEMA_VERSION, "id": identifier, **dict.fromkeys(PERSON), "pushes": pushes}
    name_pushes(data, sorting)
    return data


def push_data(push: PushFiles) -> dict[str, Any]:
    """A push of ``subject.json``, still without a name and a place of its frames; None for what is open."""
    record: dict[str, Any] = {key: push.shared.get(key) for key in PUSH}
    record["forces_n"] = list(push.forces_n)
    if push.roles is not None:
        record["roles"] = list(push.roles)
    return record


def name_pushes(data: dict[str, Any], sorting: Sorting, taken: Iterable[str] = ()) -> None:
    """Give the last pushes of ``data``, those that were sorted, their ids and the places of their frames: the user's
    name, else side and rib where they are known, else a number; each once.

    Parameters
    ----------
    taken : further names that none may have, as of files that are there.
    """
    before = len(data["pushes"]) - len(sorting.pushes)
    names = {name.casefold() for name in (*taken, *(record["id"] for record in data["pushes"][:before]))}
    for number, (push, record) in enumerate(zip(sorting.pushes, data["pushes"][before:]), before + 1):
        name = push.name
        if name is None and record["side"] is not None and record["level"] is not None:
            name = f"{record['side']}-{record['level']:g}"
        first = name or f"push-{number}"
        name, count = first, 1
        while name.casefold() in names:
            count += 1
            name = f"{first}-{count}"
        names.add(name.casefold())
        _rename_geometry(data, record.get("id"), name)
        record |= {"id": name, "frames": f"pushes/{name}" + (".dcm" if len(push.files) == 1 else "")}


def _rename_geometry(data: dict[str, Any], before: str | None, name: str) -> None:
    """A push's X-ray geometry of its own stays with it under another name."""
    images = data.get("xray", {}).get("images") or {}
    if before is not None and before != name and frame_image(before) in images:
        images[frame_image(name)] = images.pop(frame_image(before))


def fill(data: dict[str, Any], given: Given) -> list[str]:
    """Put what the user says where ``data`` has None.

    Returns a line for each thing that was told otherwise already, and for each that several pushes take alike.
    """
    notes = []
    for key, value in given.person.items():
        if data.get(key) is None:
            data[key] = value
        elif data[key] != value:
            notes.append(f"{key}: stays {data[key]}, {value} was given; change it in {SUBJECT_FILE}")
    for level, sizes in given.trunk.items():
        there = _put(_put(data, "trunk", {}), level, dict(sizes))
        if there != sizes:
            notes.append(
                f"trunk.{level}: stays {_sizes(there)}, {_sizes(sizes)} was given; change it in {SUBJECT_FILE}"
            )
    for key, value in given.pushes.items():
        count = sum(push.get(key) is None for push in data["pushes"])
        if count > 1:
            notes.append(f"{key}: {value} for {count} pushes alike; where one differs, correct it in {SUBJECT_FILE}")
    for push in data["pushes"]:
        for key, value in given.pushes.items():
            if push.get(key) is None:
                push[key] = value
            elif push[key] != value:
                notes.append(f"{push_named(push['id'])}, {key}: stays {push[key]}, {value} was given for all pushes")
    for key, value in given.xray.items():
        there = data.setdefault("xray", {})
        if _put(there, key, value) != value:
            notes.append(f"xray.{key}: stays {there[key]}, {value} was given; change it in {SUBJECT_FILE}")
    return notes


def fill_images(data: dict[str, Any], given: Given) -> list[str]:
    """Put the geometry of single pictures where ``data`` has none; returns a line for each that was told otherwise.

    Raises
    ------
    OptionError : a picture that the subject has not.
    """
    known, notes = [*REST_IMAGES, *(image for push in data["pushes"] for image in _geometry_images(push))], []
    for key, lengths in given.images.items():
        for image, value in lengths.items():
            if image not in known:
                option = f"--{key.removesuffix('_mm').replace('_', '-')} {image[:80]}={value:g}"
                raise OptionError(f"{option}: no such picture; wanted one of {', '.join(known)}")
            there = _put(data.setdefault("xray", {}), "images", {}).setdefault(image, {})
            if _put(there, key, value) != value:
                place = f"xray.images.{image}.{key}"
                notes.append(f"{place}: stays {there[key]}, {value} was given; change it in {SUBJECT_FILE}")
    return notes


def check_geometry(before: Mapping[str, Any], data: Mapping[str, Any], files: Mapping[str, Sequence[Path]]) -> None:
    """Refuse X-ray geometry that was put into ``data`` where a picture contradicts it: ``fill`` changes nothing later.

    Parameters
    ----------
    before : the JSON without it; a picture that contradicts that, too, is left to ``spinestiff inspect``.
    files : of each picture, by its name in the annotation.

    Raises
    ------
    SubjectError : picture, file, found and wanted.
    """
    for image, paths in files.items():
        old, new = (_geometry(one, image) for one in (before, data))
        for path in paths if new != old else ():
            try:
                check_given(path, new)
            except RadiographError as problem:
                with suppress(RadiographError):
                    check_given(path, old)
                    raise SubjectError(f"{image}: {problem}; nothing is written") from None


def _geometry(data: Mapping[str, Any], image: str) -> Geometry:
    xray = XRayRecord.model_validate(data.get("xray") or {})
    return geometry_without_scale(xray, image, "lateral" if image == LATERAL else "frontal")


def _sizes(trunk: Mapping[str, Any]) -> str:
    return f"{trunk.get('breadth_mm')} by {trunk.get('depth_mm')} mm"


def _put(there: dict[str, Any], key: str, value: Any) -> Any:
    """Put a value where a key is left out or None; returns what is there then."""
    if there.get(key) is None:
        there[key] = value
    return there[key]


def _geometry_images(push: Mapping[str, Any]) -> list[str]:
    """As ``PushRecord.geometry_images``, of a push with gaps."""
    views = push.get("views") or ()
    return [frame_image(push["id"]), *(view_image(push["id"], view["frames"][0], view["id"]) for view in views)]


def check_place(out: Path, sources: Sequence[Path]) -> None:
    """Raise SubjectError unless a new folder can be made there, outside of what is read."""
    if os.path.lexists(out) and not (out.is_dir() and not any(out.iterdir())):
        what = f"a subject folder, with {SUBJECT_FILE}" if (out / SUBJECT_FILE).exists() else "not empty"
        raise SubjectError(
            f"{out}: is there already ({what}); nothing is overwritten, name a new folder, or delete this one if it "
            "was a try; spinestiff serve adds radiographs to a subject"
        )
    place = Path(os.path.realpath(out))
    for source in sources:
        if source.is_dir() and place.is_relative_to(Path(os.path.realpath(source))):
            raise SubjectError(f"{out}: lies in {source}, which is read; name a folder outside of it")


def make_folder(out: Path, data: dict[str, Any], sorting: Sorting) -> None:
    """Write ``subject.json`` and copies of the radiographs: all of it, or nothing.

    Raises
    ------
    SubjectError : values that the schema does not allow, a file that can't be read or written.
    """
    check_open_record(data)
    with whole_folder(out, SubjectError) as draft:
        copy_radiographs(draft, data, sorting)
        write_json(draft / SUBJECT_FILE, data)


def copy_radiographs(folder: Path, data: Mapping[str, Any], sorting: Sorting) -> list[str]:
    """Copy what was sorted to where it belongs, the pushes being the last of ``data``; returns the places, relative to
    the folder: files, and folders of single frames. Raises SubjectError for a file that can't be read or written.
    """
    places = []
    for image, one in sorting.rest.items():
        copy_file(one, folder / REST_IMAGES[image])
        places.append(REST_IMAGES[image])
    for push, record in zip(sorting.pushes, data["pushes"][len(data["pushes"]) - len(sorting.pushes) :]):
        copy_frames(push.files, folder / record["frames"])
        places.append(record["frames"])
    return places


def copy_frames(files: Sequence[Exported], place: Path) -> None:
    """Copy one file to a place, or several into a folder of that name, in their order. Raises as ``copy_file``."""
    if len(files) == 1:
        copy_file(files[0], place)
    else:
        for number, one in enumerate(files):
            copy_file(one, place / f"{number:03d}.dcm")


def copy_file(one: Exported, place: Path) -> None:
    """Copy a radiograph. Raises SubjectError where it can't be read or written, or is no longer what was looked at."""
    place.parent.mkdir(parents=True, exist_ok=True)
    try:
        copy_known(one.path, place, one.scan.sha256, one.name)
    except OSError as problem:
        raise SubjectError(f"{one.name}: can't be copied ({trouble(problem)})") from None


def read_open_data(folder: Path, given: Given, log: bool = False) -> dict[str, Any]:
    """The JSON of a subject, to be filled: one that is not complete, or lacks some of the X-ray geometry given.

    Parameters
    ----------
    log : whether a force log is given, for the message.

    Raises
    ------
    SubjectError : no such file, nothing is open in it that could be filled, or the schema does not allow it for another
        reason.
    """
    path = folder / SUBJECT_FILE
    if not path.is_file():
        raise SubjectError(f"{path}: no such file; name the DICOM files or folders from which to make the subject")
    data = read_json(path)
    if not gaps_of(data):
        parse_record(json.dumps(data), str(path), SubjectRecord)
        filled = copy.deepcopy(data)
        stays = fill(filled, given) + fill_images(filled, given)
        if filled == data and log:
            raise SubjectError(f"{path}: nothing is missing in it; {LOG_AGAIN}")
        if filled == data:
            told = f", and nothing changes ({'; '.join(stays)})" if stays else ""
            raise SubjectError(
                f"{path}: nothing is missing in it{told} (spinestiff inspect tells what its radiographs lack); to make "
                "another subject, name a new folder and DICOM files"
            )
    check_open_record(data)
    return dict(data)


def write_filled(folder: Path, data: dict[str, Any]) -> None:
    """Write ``subject.json`` anew. Raises SubjectError for what the schema does not allow."""
    check_open_record(data)
    write_json(folder / SUBJECT_FILE, data)
