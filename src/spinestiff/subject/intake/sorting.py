"""Which radiographs of an export are the rest ones and which the pushes, and why: by view, frames, series and time.

What a picture looks like is a suggestion (``imaging.shown_view``). It counts only where nothing states a view, for the
one radiograph that can be at rest by it, and the reason says so; where it contradicts what is stated, that is said.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any

from spinestiff.errors import RadiographError, SubjectError
from spinestiff.imaging.dicom.export import SERIES_WORDS, Exported
from spinestiff.imaging.dicom.ordering import times_told
from spinestiff.imaging.radiograph import in_order, times_of
from spinestiff.subject.image_names import FRONTAL, LATERAL, described
from spinestiff.subject.intake.push_table import SHARED, TablePush, TableRow
from spinestiff.words import counted, push_named

LONGEST_PAUSE_S = 60.0
"""Between radiographs of one frame each that are taken for one push."""
FEW_FRAMES = 3
"""Up to so many single radiographs in a row may be something else than a push."""
NO_REST = ("push", "bending")
"""What a series is called whose radiographs are not at rest (``ExportTags.use``)."""


@dataclass(frozen=True)
class PushFiles:
    """The radiographs of one push.

    Attributes
    ----------
    files : one of several frames, or several of one frame each, in order of time.
    shared : what is known of side, level, d21_mm and d31_mm.
    forces_n, roles : a value a frame; None: not known.
    name : given by the user; None if not.
    why : they are taken for a push.
    """

    files: tuple[Exported, ...]
    shared: dict[str, Any] = field(default_factory=dict)
    forces_n: tuple[float | None, ...] = ()
    roles: tuple[str, ...] | None = None
    name: str | None = None
    why: str = ""

    @property
    def frames(self) -> int:
        return self.files[0].frames if len(self.files) == 1 else len(self.files)

    @property
    def times_s(self) -> tuple[float | None, ...]:
        """Since the first frame."""
        return times_of(tuple(one.scan for one in self.files))


@dataclass(frozen=True)
class Sorting:
    """What every radiograph is taken for.

    Attributes
    ----------
    frontal, lateral : the rest radiographs; None if there is none.
    pushes : in order of time.
    reasons : why, by name of the file.
    """

    frontal: Exported | None
    lateral: Exported | None
    pushes: tuple[PushFiles, ...]
    reasons: dict[str, str]

    @property
    def rest(self) -> dict[str, Exported]:
        """The rest radiographs there are, by the names of their images."""
        both = {FRONTAL: self.frontal, LATERAL: self.lateral}
        return {image: one for image, one in both.items() if one is not None}


def uses_of(sorting: Sorting, names: Sequence[str]) -> dict[str, str]:
    """What each radiograph becomes, in words, by name of the file; ``names`` are those of the pushes."""
    uses = {}
    for name, push in zip(names, sorting.pushes):
        for number, one in enumerate(push.files):
            uses[one.name] = push_named(name) + (f", frame {number}" if len(push.files) > 1 else "")
    return uses | {one.name: described(image) for image, one in sorting.rest.items()}


def sort_files(
    found: Sequence[Exported],
    table: Sequence[TablePush] | None = None,
    frontal: Exported | None = None,
    lateral: Exported | None = None,
    joined: Sequence[Sequence[Exported]] = (),
) -> Sorting:
    """Rest radiographs and pushes.

    Parameters
    ----------
    table : the pushes, as the user's table tells them; None: they are found.
    frontal, lateral : what the user says of the rest radiographs.
    joined : radiographs of one frame each that the user says are one push, beside those of the table or found.

    Raises
    ------
    SubjectError : a radiograph that is said to be two things, or one at rest that states the other view; files of a
        push that are no sequence.
    """
    if frontal is not None and frontal is lateral:
        raise SubjectError(f"{frontal.name}: named as frontal and as lateral rest radiograph; wanted two")
    reasons: dict[str, str] = {}
    for one, view in ((frontal, "frontal"), (lateral, "lateral")):
        if one is not None:
            # Words of a series are no more than words.
            if one.view not in (None, view) and one.view_source != SERIES_WORDS:
                raise SubjectError(
                    f"{one.name}: named as the {view} radiograph at rest, but it states that it is {_seen(one)}; name "
                    "another file"
                )
            reasons[one.name] = f"named by --{view}"
    together = [_joined(files) for files in joined]
    for one in [one for push in together for one in push.files]:
        if one.name in reasons:
            raise SubjectError(f"{one.name}: chosen for a push and for something else; wanted it in one place")
        reasons[one.name] = ""
    rest = [one for one in found if one.name not in reasons]
    if table is None:
        pushes, taken = _found_pushes(rest)
    else:
        pushes, taken = [_ordered(push) for push in table], {one.name for push in table for one in push.files}
        for push in table:
            for one in push.files:
                if one.name in reasons:
                    what = "named as a rest radiograph" if one in (frontal, lateral) else "chosen for a push"
                    raise SubjectError(f"{one.name}: {what} and in the table of pushes; keep one")
    pushes += together
    reasons |= {one.name: push.why for push in pushes for one in push.files}
    left = [one for one in rest if one.name not in taken]
    singles = [one for one in left if one.frames == 1]
    if table is not None:
        forgotten = _forgotten(singles, pushes)
        reasons |= forgotten
        singles = [one for one in singles if one.name not in forgotten]
    chosen = {"frontal": frontal, "lateral": lateral}
    days = {one.tags.day for push in pushes for one in push.files if one.tags.day is not None}
    for view in ("frontal", "lateral"):
        mine = [one for one in singles if one.view == view]
        if chosen[view] is None and mine:
            chosen[view], why = _at_rest(mine, view, days)
            for one in mine:
                reasons[one.name] = why if one is chosen[view] else _another(one, view, chosen[view])
        else:
            reasons |= {one.name: f"single {view} radiograph, but --{view} names another" for one in mine}
        unstated = [one for one in singles if one.view is None and one.looks is not None]
        alike = [one for one in unstated if one.looks and one.looks.view == view and one.tags.use not in NO_REST]
        if chosen[view] is None and not mine and len(alike) == 1:
            chosen[view] = alike[0]
            reasons[alike[0].name] = f"{_looks(alike[0])}; a suggestion, since nothing states its view: look at it"
        rest_view = chosen[view]
        if rest_view is None:
            continue
        if rest_view.looks is not None and rest_view.looks.view != view:
            reasons[rest_view.name] += f"; but it {_looks(rest_view)}: check that it is the {view} one"
        found_here = view == "frontal" and frontal is None and table is not None
        if found_here and rest_view.tags.moment is None and _of_its_series(rest_view, pushes):
            reasons[rest_view.name] += (
                "; but it is of a push's series, and nothing tells its time: check that it is at rest"
            )
        if view == "frontal" and frontal is None and _is_after(rest_view, pushes):
            reasons[rest_view.name] += "; but it was taken after a push began: check that it is at rest"
    for one in left:
        if one.name not in reasons:
            reasons[one.name] = _left_out(one, table is not None)
    pushes.sort(key=lambda push: _moment(push.files[0]))
    return Sorting(chosen["frontal"], chosen["lateral"], tuple(pushes), reasons)


def _moment(one: Exported) -> tuple[float, str]:
    return one.tags.moment or 0.0, one.name


def _joined(files: Sequence[Exported]) -> PushFiles:
    """Radiographs that the user says are one push, in the order in which their folder will be read."""
    if len(files) < 2:
        raise SubjectError("a push of single pictures has 2 or more; choose another one beside it")
    for one in files:
        if one.frames > 1:
            raise SubjectError(
                f"{one.name}: {counted(one.frames, 'frame')}; a push is one such file, or single pictures"
            )
        if one.view == "lateral":
            raise SubjectError(f"{one.name}: {_seen(one)}; pushes are seen from the front")
    try:
        ordered = _in_time(files)
    except RadiographError as problem:
        raise SubjectError(f"these pictures can't be one push: {str(problem).removeprefix('the push: ')}") from None
    why = f"chosen, with {len(ordered) - 1} more, as one push; in order of {_order_words(ordered)}"
    return PushFiles(ordered, forces_n=(None,) * len(ordered), why=why)


def _found_pushes(found: Sequence[Exported]) -> tuple[list[PushFiles], set[str]]:
    """Files of several frames that are not lateral, and radiographs of one frontal series one shortly after another."""
    pushes = [
        PushFiles((one,), forces_n=(None,) * one.frames, why=f"{counted(one.frames, 'frame')}, {_seen(one)}")
        for one in found
        if one.frames > 1 and one.view != "lateral"
    ]
    runs: list[list[Exported]] = []
    singles = [one for one in found if one.frames == 1 and one.view == "frontal" and one.tags.series]
    for one in sorted(singles, key=lambda one: (one.tags.series, *_moment(one))):
        if one.tags.use not in ("rest", "bending") and runs and _follows(one, runs[-1][-1]):
            runs[-1].append(one)
        else:
            runs.append([one])
    for run in runs:
        if len(run) > 1:
            try:
                files = _in_time(run)
            except RadiographError:
                continue
            why = f"frontal, one of {len(run)} of a series within {LONGEST_PAUSE_S:g} s of each other"
            if len(run) <= FEW_FRAMES:
                why += "; a suggestion: parts of one long picture follow each other so, too"
            pushes.append(PushFiles(files, forces_n=(None,) * len(run), why=why))
    return pushes, {one.name for push in pushes for one in push.files}


def _follows(one: Exported, last: Exported) -> bool:
    same = one.tags.series == last.tags.series and one.size == last.size and last.tags.use not in ("rest", "bending")
    if not same or one.tags.moment is None or last.tags.moment is None:
        return False
    return one.tags.moment - last.tags.moment <= LONGEST_PAUSE_S


def _in_time(files: Sequence[Exported]) -> tuple[Exported, ...]:
    """In the order in which a folder of them will be read. Raises RadiographError if they are no sequence."""
    # Files of several folders may have one name; their paths tell them apart. What is odd about the order is said of
    # the folder that is made.
    scans, _ = in_order("the push", [replace(one.scan, name=one.name) for one in files])
    by_name = {one.name: one for one in files}
    return tuple(by_name[scan.name] for scan in scans)


def _order_words(files: Sequence[Exported]) -> str:
    """By what files of a push are ordered, as ``in_order`` does."""
    tags = [one.scan.tags for one in files]
    clocks, numbers = [one.clock for one in tags], [one.instance for one in tags]
    times = times_told(clocks, numbers, [one.content_clock for one in tags])
    if None not in times:
        return "time" if None not in clocks or None not in numbers else "the times of their content: check it"
    if None not in numbers:
        return "the numbers in their headers"
    return "the files' names, since no header has an acquisition time or a number: check it"


def _seen(one: Exported) -> str:
    if one.view is not None:
        return f"{one.view} ({one.view_source})"
    return "its view is not told" + (f", but it {_looks(one)}" if one.looks else "")


def _looks(one: Exported) -> str:
    return one.looks.words if one.looks else ""


def _at_rest(mine: Sequence[Exported], view: str, days: Set[int]) -> tuple[Exported | None, str]:
    """Which of the single radiographs of a view is the one at rest, and why; ``days`` of the pushes."""
    if len(mine) == 1 and mine[0].tags.use not in NO_REST:
        return mine[0], f"the only single {_seen(mine[0])} radiograph"
    said = [one for one in mine if one.tags.use == "rest"]
    if len(said) == 1:
        return said[0], f"single {_seen(said[0])} radiograph whose series is called one at rest"
    open_ = [one for one in said or mine if one.tags.use not in NO_REST]
    if len(open_) == 1:
        return open_[0], f"the only single {_seen(open_[0])} radiograph that is not called a push"
    same_day = [one for one in open_ if one.tags.day in days]
    if len(same_day) == 1:
        return same_day[0], f"the only single {_seen(same_day[0])} radiograph of the day of a push"
    of_day = " of the day of a push" if same_day and len(same_day) < len(mine) else ""
    open_ = same_day or open_
    moments = sorted(one.tags.moment for one in open_ if one.tags.moment is not None)
    if open_ and len(moments) == len(open_) and moments[0] < moments[1]:
        first = min(open_, key=_moment)
        count = len(open_) if of_day else len(mine)
        return first, f"the first of {count} single {view} radiographs{of_day} ({first.view_source})"
    return None, ""


def _is_after(one: Exported, pushes: Sequence[PushFiles]) -> bool:
    """Whether a radiograph is later than the first of a push; one with a date can't be put beside one without."""
    files = [file.tags for push in pushes for file in push.files]
    dated = one.tags.day is not None
    begun = [tags.moment for tags in files if tags.moment is not None and (tags.day is not None) == dated]
    return one.tags.moment is not None and bool(begun) and one.tags.moment > min(begun)


def _another(one: Exported, view: str, chosen: Exported | None) -> str:
    if one.tags.use == "bending":
        rest = f"if it is at rest name it with --{view}, if it shows a push in --pushes"
        return f"single {view} radiograph whose series is called a bending film, which has no force on the ribs; {rest}"
    if chosen is None and one.tags.use == "push":
        return f"single {view} radiograph whose series is called a push; name it in --pushes"
    if chosen is None:
        return f"one of several single {view} radiographs of unknown order; say which is at rest with --{view}"
    moments = one.tags.moment, chosen.tags.moment
    when = "beside" if None in moments else "before" if moments < moments[::-1] else "after"  # type: ignore[operator]
    if view == "frontal":
        return f"single frontal radiograph {when} the one at rest; if it shows a push, name it in --pushes"
    return f"single lateral radiograph {when} the one at rest"


def _forgotten(singles: Sequence[Exported], pushes: Sequence[PushFiles]) -> dict[str, str]:
    """Why frontal ones are not taken for the one at rest that are of a push's series and of after its beginning: no row
    of the table names them."""
    found = {}
    for one in singles:
        for push in _of_its_series(one, pushes):
            moments = [file.tags.moment for file in push.files]
            known = [moment for moment in moments if moment is not None]
            late = one.tags.moment is not None and len(known) == len(moments) and one.tags.moment > min(known)
            if late and one.tags.use != "rest" and not _is_lateral(one):
                found[one.name] = (
                    f"of the series of {push.files[0].name} and after its beginning, but in no row of the table of "
                    "pushes; name it there or, if it is at rest, with --frontal"
                )
    return found


def _of_its_series(one: Exported, pushes: Sequence[PushFiles]) -> list[PushFiles]:
    return [push for push in pushes if one.tags.series and one.tags.series in {file.tags.series for file in push.files}]


def _is_lateral(one: Exported) -> bool:
    """Whether it states so; words of a series are no more than words."""
    return one.view == "lateral" and one.view_source != SERIES_WORDS


def _left_out(one: Exported, has_table: bool) -> str:
    if one.frames > 1 and one.view == "lateral":
        return f"{counted(one.frames, 'frame')}, but {_seen(one)}; pushes are seen from the front"
    if one.frames > 1 and has_table:
        return f"{counted(one.frames, 'frame')}, {_seen(one)}, but not in the table of pushes"
    looks = f"; it {_looks(one)}" if one.looks else ""
    return f"nothing tells its view{looks}; name it with --frontal or --lateral, or in --pushes"


def _ordered(push: TablePush) -> PushFiles:
    """A push of the table with its frames in order of time."""
    row = next(iter(push.rows.values()))
    where = f"row {row.line} of the table of pushes"
    for one in push.files:
        if _is_lateral(one):
            raise SubjectError(f"{where}: {one.name}: {_seen(one)}; pushes are seen from the front")
    if len(push.files) == 1 and push.files[0].frames == 1 and row.force_n == 0.0:
        raise SubjectError(
            f"{where}: {push.files[0].name} is one radiograph without force, and no push; if it is a push's frame, "
            "give it that push's name (column push), if it is the one at rest, leave the row out and name it with "
            "--frontal"
        )
    try:
        files = _in_time(push.files) if len(push.files) > 1 else push.files
    except RadiographError as problem:
        raise SubjectError(f"{where}: {problem}") from None
    if len(files) == 1:
        count = files[0].frames
        rows = [push.rows.get((files[0].name, frame)) for frame in range(count)]
    else:
        rows = [push.rows.get(("", frame), push.rows.get((one.name, 0))) for frame, one in enumerate(files)]
    forces = tuple(None if row is None else row.force_n for row in rows)
    told: list[TableRow] = [one for one in rows if one is not None]
    roles = tuple("unused" if row is None else row.role or "unused" for row in rows)
    why = f"in the table of pushes, row{'s' if len(told) > 1 else ''} " + ", ".join(str(row.line) for row in told[:4])
    why += ", ..." if len(told) > 4 else ""
    why += f"; in order of {_order_words(files)}" if len(files) > 1 else ""
    shared = {name: push.shared[name] for name in SHARED if name in push.shared}
    return PushFiles(files, shared, forces, roles if any(row.role for row in told) else None, push.name, why)
