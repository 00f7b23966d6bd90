"""Radiographs and a table of pushes for a subject that is there already: what is new, where it goes, what it fills.

Nothing that is there is overwritten: a value that is known stays, and so does every file.
"""

from __future__ import annotations

import copy
import itertools
import json
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spinestiff.anatomy.importing.reading import SUFFIXES
from spinestiff.errors import ChangedElsewhere, RadiographError, SubjectError
from spinestiff.files import file_digest, read_json, regular_files, trouble, write_json, write_text
from spinestiff.imaging.dicom.export import Exported, read_exported
from spinestiff.imaging.dicom.identity import read_identity
from spinestiff.subject.folder import MOST_INPUT_BYTES
from spinestiff.subject.gaps import PUSH, check_open_record
from spinestiff.subject.image_names import FRONTAL, LATERAL, frame_image, view_image
from spinestiff.subject.intake.making import Given, copy_frames, copy_radiographs, fill, name_pushes, push_data
from spinestiff.subject.intake.pictures import Album
from spinestiff.subject.intake.push_table import TablePush, TableRow, pushes_of
from spinestiff.subject.intake.sorting import PushFiles, Sorting, sort_files
from spinestiff.subject.lock import sole_run
from spinestiff.subject.marker_table import marker_names
from spinestiff.subject.record_reading import parse_record
from spinestiff.subject.records import REST_IMAGES, SUBJECT_FILE, FurtherViewRecord, MarkersRecord, ScanRecord
from spinestiff.words import counted, push_named

TABLE = "the table of pushes"
"""What messages call a table that comes without a file."""
PUSHES = "pushes"
"""The folder of what was taken under a push."""
SCAN_PLACE = rf"skin-scan(-[0-9]+)?({'|'.join(map(re.escape, SUFFIXES))})"
"""Where skin scans lie, relative to the subject."""


@dataclass(frozen=True)
class Standing:
    """A subject that is there already.

    Attributes
    ----------
    folder : of it. data : ``subject.json``, complete or not. digest : of that file.
    files : its radiographs, those that can be read, each by its name in the folder, in the order of ``image``.
    images : what each of them belongs to, by name; a push and a further view by the image of its first frame.
    """

    folder: Path
    data: Mapping[str, Any]
    digest: str
    files: tuple[Exported, ...]
    images: Mapping[str, str]

    def has(self, image: str) -> bool:
        """Whether there is a radiograph at rest, "rest/frontal" or "rest/lateral", one that can't be read included."""
        return os.path.lexists(self.folder / REST_IMAGES[image])


@dataclass(frozen=True)
class Addition:
    """What is added to a subject.

    Attributes
    ----------
    sorting : what is new; ``reasons`` are of every radiograph that was looked at.
    held : the same image in the subject, by the name of a radiograph that was looked at.
    fills : what the table tells of pushes that are in the subject, by their numbers.
    """

    sorting: Sorting
    held: Mapping[str, str]
    fills: Mapping[int, PushFiles]


def read_standing(folder: Path) -> Standing:
    """A subject and its radiographs.

    Raises
    ------
    SubjectError : ``subject.json`` is missing, or the schema allows it neither as it is nor for want of values.
    """
    path = folder / SUBJECT_FILE
    digest, data = file_digest(path), read_json(path)
    check_open_record(data)
    files, images = [], {}
    for image, place in _places(data):
        for one in _inside(folder / place, folder):
            name = one.relative_to(folder).as_posix()
            try:
                files.append(read_exported(one, name, folder))
            except RadiographError:
                continue  # ``inspect`` says why
            images[name] = image
    return Standing(folder, data, digest, tuple(files), images)


def inputs_of(folder: Path) -> list[Path]:
    """``subject.json`` and the files at its side that may be a subject's radiographs, as far as they are there."""
    places = [folder / SUBJECT_FILE, *(one for name in ("rest", PUSHES) for one in sorted((folder / name).rglob("*")))]
    return [one for one in places if one.is_file()]


def _places(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield from REST_IMAGES.items()
    for push in data["pushes"]:
        yield frame_image(push["id"]), push["frames"]
        for view in push.get("views", ()):
            yield view_image(push["id"], view["frames"][0], view["id"]), view["files"]


def _inside(place: Path, folder: Path) -> Iterable[Path]:
    if place.is_dir():
        return regular_files(place, SubjectError, within=folder, cap_bytes=MOST_INPUT_BYTES)
    return [place] if place.is_file() else []


def sort_addition(
    standing: Standing,
    found: Sequence[Exported],
    rows: Sequence[TableRow] | None = None,
    frontal: Exported | None = None,
    lateral: Exported | None = None,
    joined: Sequence[Sequence[Exported]] = (),
) -> Addition:
    """What radiographs are to a subject, by the rules of ``sort_files``.

    Parameters
    ----------
    found : radiographs of one patient; an image that the subject has is left out.
    rows : of a table of pushes. Its files are those of ``found`` and of the subject, each by its own name.
    frontal, lateral, joined : what the user says of the rest radiographs and of single ones that are one push.

    Raises
    ------
    SubjectError : radiographs of another patient; one of a joined push is in the subject already; a rest radiograph is
        named where the subject has one; a push of the table that is partly in the subject; otherwise as ``pushes_of``
        and ``sort_files``.
    """
    own = Album(standing.files)
    twins = {one.name: twin for one in found if (twin := own.same(one)) is not None}
    held = {name: twin.name for name, twin in twins.items()}
    fresh = [one for one in found if one.name not in held]
    # A copy of what is there may name another patient, or none.
    check_patient(standing.files, fresh)
    for image, named in ((FRONTAL, frontal), (LATERAL, lateral)):
        if named is not None and (standing.has(image) or named.name in held):
            raise SubjectError(
                f"{named.name}: the subject has {REST_IMAGES[image]} already, and nothing is overwritten"
            )
    for name in [one.name for files in joined for one in files if one.name in held]:
        raise SubjectError(f"{name}: the same image as {held[name]}, which the subject has; leave it out of the push")
    table, numbers = None, dict[Path, int]()
    if rows is not None:
        # A radiograph that the subject has may be called by either name.
        also = [replace(twin, name=name) for name, twin in twins.items()]
        table = pushes_of(TABLE, rows, [*fresh, *also, *(one for one in standing.files if one.name not in held)])
        numbers = {
            one.path: number
            for push in table
            if (number := _number_of(standing, push)) is not None
            for one in push.files
        }
    sorting = sort_files(fresh, table, frontal, lateral, joined)
    fills = {numbers[push.files[0].path]: push for push in sorting.pushes if push.files[0].path in numbers}
    reasons = dict(sorting.reasons) | {
        one.name: f"the same image as {held[one.name]}, which the subject has" for one in found if one.name in held
    }
    rest = sorting.rest
    for image in [image for image in rest if standing.has(image)]:
        reasons[rest.pop(image).name] = f"the subject has {REST_IMAGES[image]} already, and nothing is overwritten"
    pushes = tuple(push for push in sorting.pushes if push.files[0].path not in numbers)
    return Addition(Sorting(rest.get(FRONTAL), rest.get(LATERAL), pushes, reasons), held, fills)


def check_patient(own: Sequence[Exported], found: Sequence[Exported], pseudonyms: bool = True) -> None:
    """Raise SubjectError where radiographs tell of another patient than those of a subject, or, with ``pseudonyms``,
    where patients were taken out and their pseudonyms differ; the first of each is asked, since each are of one."""
    if own and found:
        mine, other = (read_identity(files[0].path) for files in (own, found))
        if mine.is_of(other) is False:
            raise SubjectError("the radiographs are of another patient than the subject's; make a new subject of them")
        if pseudonyms and mine.removed and other.removed and not mine.may_be_of(other):
            raise SubjectError(
                "the radiographs have another pseudonym, or none, than the subject's; make a new subject of them or, "
                "for the same patient, de-identify them with the key of the others"
            )


def _number_of(standing: Standing, push: TablePush) -> int | None:
    """The push of the subject that a push of the table is, counted from 0; None if all its files are new.

    Raises
    ------
    SubjectError : files of the subject beside new ones, or not all of a push.
    """
    row = next(iter(push.rows.values())).line
    images = {one.path: standing.images[one.name] for one in standing.files}
    mine = {one.path for one in push.files if one.path in images}
    if not mine:
        return None
    for number, record in enumerate(standing.data["pushes"]):
        whole = {path for path, image in images.items() if image == frame_image(record["id"])}
        if mine & whole:
            if mine == whole and len(mine) == len(push.files):
                return number
            raise SubjectError(
                f"{TABLE}: row {row}: push '{record['id']}' of the subject has {counted(len(whole), 'file')}, and the "
                f"table's {counted(len(push.files), 'file')}, not the same; wanted a row for each of the subject's"
            )
    name = next(one.name for one in push.files if one.path in mine)
    raise SubjectError(f"{TABLE}: row {row}: {name} is in the subject, but as no push's frame; leave out the row")


def added_data(standing: Standing, addition: Addition, person: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """``subject.json`` with what is added, and a line for each value that was told otherwise already, which stays.

    Parameters
    ----------
    person : age and sex as the headers tell them.

    Raises
    ------
    SubjectError : the schema does not allow it; a name of the user that can be no id.
    """
    data = copy.deepcopy(dict(standing.data))
    notes = [line for number, push in addition.fills.items() for line in _fill_push(data["pushes"][number], push)]
    fill(data, Given({key: value for key, value in person.items() if data.get(key) is None}))
    data["pushes"] += [push_data(push) for push in addition.sorting.pushes]
    name_pushes(data, addition.sorting, taken_names(standing.folder))
    check_open_record(data)
    return data, notes


def taken_names(folder: Path) -> list[str]:
    """Names that a further push or view of a subject can't have: of what lies among its pushes, without endings."""
    place = folder / PUSHES
    return [one.stem if one.is_file() else one.name for one in place.iterdir()] if place.is_dir() else []


def _fill_push(record: dict[str, Any], push: PushFiles) -> Iterator[str]:
    """Put what a table tells of a push where it is open. Raises SubjectError where its forces are not one a frame."""
    name = push_named(record["id"])
    if len(record["forces_n"]) != push.frames:
        raise SubjectError(
            f"{name} has {len(record['forces_n'])} forces_n, but {counted(push.frames, 'frame')}; put that right first"
        )
    for key in PUSH:
        told = push.shared.get(key)
        if told is not None and record.get(key) is None:
            record[key] = told
        elif told is not None and record[key] != told:
            yield f"{name}, {key}: stays {record[key]}, the table has {told}"
    for frame, told in enumerate(push.forces_n):
        known = record["forces_n"][frame]
        if told is not None and known is None:
            record["forces_n"][frame] = told
        elif told is not None and known != told:
            yield f"{name}, frame {frame}: stays {known:g} N, the table has {told:g} N"
    if push.roles is not None and record.get("roles") is None:
        record["roles"] = list(push.roles)
    elif push.roles is not None and list(record["roles"]) != list(push.roles):
        yield f"{name}: the use of its frames stays as it is, the table has another"


def write_addition(standing: Standing, data: Mapping[str, Any], addition: Addition) -> None:
    """Write copies of the new radiographs and ``subject.json``: all of it, or nothing.

    Raises
    ------
    ChangedElsewhere : ``subject.json`` has changed since it was read. InUseError : a run is at work on the subject.
    SubjectError : a file that can't be read or written, or is there already.
    """
    _write(standing, data, lambda draft: copy_radiographs(draft, data, addition.sorting))


def side_places(push: str, view: Any) -> tuple[str, str]:
    """Where a view of a push from another side lies, relative to the subject: a file, or a folder of single ones."""
    return f"{PUSHES}/{push}-{view}.dcm", f"{PUSHES}/{push}-{view}"


def markers_place(push: str) -> str:
    """Where the table of a push's skin markers lies, relative to the subject."""
    return f"{PUSHES}/{push}-markers.csv"


def is_scan_place(folder: Path, place: Any) -> bool:
    """Whether it is where ``add_scan`` has put a skin scan, relative to the subject, and a file is there."""
    return isinstance(place, str) and re.fullmatch(SCAN_PLACE, place) is not None and (folder / place).is_file()


def is_place(place: str, usual: str) -> bool:
    """Whether something whose usual place is ``usual`` may have been put there: beside it, if that was taken."""
    return re.fullmatch(r"(-[0-9]+)?".join(map(re.escape, _parted(usual))), place) is not None


def _free_place(folder: Path, usual: str) -> str:
    """``usual``, or with "-2" and so on before its ending: what was taken out of the subject stays where it was."""
    (stem, ending), count, place = _parted(usual), itertools.count(2), usual
    while os.path.lexists(folder / place):
        place = f"{stem}-{next(count)}{ending}"
    return place


def _parted(place: str) -> tuple[str, str]:
    """A place without its ending, of letters, and that ending, which may be empty."""
    ending = re.search(r"(\.[A-Za-z]+)?$", place)
    assert ending is not None
    return place[: ending.start()], ending.group()


def add_scan(standing: Standing, scan: Mapping[str, Any], source: Path) -> dict[str, Any]:
    """Add a copy of a surface scan of the trunk; returns ``subject.json`` as it is then.

    Parameters
    ----------
    scan : ``unit`` and ``axes``. source : STL, OBJ, PLY or VTP file.

    Raises
    ------
    SubjectError : a scan that the schema does not allow, another kind of file, or the subject has a scan; otherwise as
        ``write_addition``.
    """
    if standing.data.get("skin_scan") is not None:
        raise SubjectError("the subject has a skin scan already; take that out first")
    place = _free_place(standing.folder, f"skin-scan{source.suffix.lower()}")
    if not re.fullmatch(SCAN_PLACE, place):
        raise SubjectError(f"the skin scan: found a file '{source.suffix[:20]}', wanted {', '.join(SUFFIXES)}")
    parse_record(json.dumps({**scan, "file": place}), "the skin scan", ScanRecord)
    data = {**copy.deepcopy(dict(standing.data)), "skin_scan": {**scan, "file": place}}

    def put(draft: Path) -> list[str]:
        shutil.copyfile(source, draft / place)
        return [place]

    _write(standing, data, put)
    return data


def add_view(standing: Standing, number: int, view: Mapping[str, Any], files: Sequence[Exported]) -> dict[str, Any]:
    """Add radiographs of a push's frames from another side; returns ``subject.json`` as it is then.

    Parameters
    ----------
    number : of the push, counted from 0. view : ``id``, ``kind``, ``frames`` and perhaps ``turned_deg``.
    files : one radiograph for each of ``frames``, in their order, or a file that holds all of them.

    Raises
    ------
    SubjectError : no such push, another number of radiographs, a view that the schema does not allow, radiographs of
        another patient or that the subject has; otherwise as ``write_addition``.
    """
    push = _push_of(standing, number)
    place = _free_place(standing.folder, side_places(push["id"], view.get("id"))[len(files) > 1])
    record = parse_record(json.dumps({**view, "files": place}), "the view", FurtherViewRecord)
    own = Album(standing.files)
    for one in files:
        check_patient(standing.files, [one])
        if (twin := own.same(one)) is not None:
            raise SubjectError(f"{one.name}: the same image as {twin.name}, which the subject has")
    count, wanted = sum(one.frames for one in files), len(record.frames)
    if count != wanted or (len(files) > 1 and any(one.frames > 1 for one in files)):
        raise SubjectError(
            f"the view has {counted(count, 'radiograph')} in {counted(len(files), 'file')}, but names "
            f"{counted(wanted, 'frame')} of the push; wanted one radiograph a frame, alone in its file, or all in one"
        )
    other = next((one for one in files if one.view not in (None, record.kind)), None)
    if other is not None:
        raise SubjectError(f"{other.name}: a {other.view} radiograph, wanted a {record.kind} one")
    data = copy.deepcopy(dict(standing.data))
    data["pushes"][number].setdefault("views", []).append({**view, "files": place})

    def put(draft: Path) -> list[str]:
        copy_frames(files, draft / place)
        return [place]

    _write(standing, data, put)
    return data


def add_markers(standing: Standing, number: int, markers: Mapping[str, Any], table: str) -> dict[str, Any]:
    """Add the table of a push's skin markers; returns ``subject.json`` as it is then.

    Parameters
    ----------
    number : of the push, counted from 0. markers : ``unit``, ``axes``, ``side`` and ``shown``.
    table : the text of the CSV file (``marker_table``).

    Raises
    ------
    SubjectError : no such push, markers that the schema does not allow; otherwise as ``write_addition``.
    """
    push = _push_of(standing, number)
    place = _free_place(standing.folder, markers_place(push["id"]))
    record = parse_record(json.dumps({**markers, "file": place}), "the markers", MarkersRecord)
    data = copy.deepcopy(dict(standing.data))
    if data["pushes"][number].get("markers") is not None:
        raise SubjectError(f"push {push['id']} has markers already; remove those first")
    data["pushes"][number]["markers"] = {**markers, "file": place}

    def put(draft: Path) -> list[str]:
        write_text(draft / place, table)
        names = marker_names(draft / place, len(push["forces_n"]))
        if other := next((name for name in record.shown if name not in names), None):
            raise SubjectError(f"{place} has no marker '{other}', which is said to be shown; it has {', '.join(names)}")
        return [place]

    _write(standing, data, put)
    return data


def _push_of(standing: Standing, number: int) -> Mapping[str, Any]:
    if not 0 <= number < len(standing.data["pushes"]):
        raise SubjectError(
            f"no push {number}; the subject has {counted(len(standing.data['pushes']), 'push', 'pushes')}"
        )
    push: Mapping[str, Any] = standing.data["pushes"][number]
    return push


def _write(standing: Standing, data: Mapping[str, Any], put: Callable[[Path], list[str]]) -> None:
    """Have files written into a draft, put them in their places and write ``subject.json``, or leave all as it was."""
    check_open_record(dict(data))
    folder = standing.folder
    with sole_run(folder):
        if file_digest(folder / SUBJECT_FILE) != standing.digest:
            raise ChangedElsewhere(f"{SUBJECT_FILE} was changed meanwhile; look at the radiographs again")
        with _draft(folder) as draft:
            places, done = _put(put, draft), list[Path]()
            try:
                for place in places:
                    target = folder / place
                    if os.path.lexists(target):
                        raise SubjectError(f"{place}: is in the subject already, and nothing is overwritten")
                    target.parent.mkdir(parents=True, exist_ok=True)
                    (draft / place).rename(target)
                    done.append(target)
                write_json(folder / SUBJECT_FILE, data)
            except BaseException:
                for target in done:
                    target.rename(draft / target.relative_to(folder))
                raise


def _put(put: Callable[[Path], list[str]], draft: Path) -> list[str]:
    """What ``put`` returns; its errors name the draft's files by their places in the subject."""
    try:
        return put(draft)
    except SubjectError as problem:
        raise type(problem)(str(problem).replace(f"{draft}{os.sep}", "")) from None


@contextmanager
def _draft(folder: Path) -> Iterator[Path]:
    """A hidden folder in the subject's, gone afterwards."""
    draft = folder / f".adding-{secrets.token_hex(4)}"
    try:
        draft.mkdir()
        yield draft
    except OSError as problem:
        raise SubjectError(f"the files can't be added ({trouble(problem)}); nothing was changed") from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
