"""Which file is which bone: by its name, or by a mapping file (docs/your-own-anatomy.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from spinestiff.anatomy.importing.reading import SUFFIXES
from spinestiff.anatomy.names import BONES
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.files import read_text
from spinestiff.formats import parse_json

SKIN = "skin"
MOST_FILES = 500
MOST_MAPPING_BYTES = 2**20
HEIGHTS_CM = (90.0, 230.0)
KEYS = ("bones", "ignore", "skin", "unit", "axes", "height_cm")
_SIDES = {"l": "L", "left": "L", "r": "R", "right": "R"}
_SIDED = {
    "clavicle": "clavicle", "clavicula": "clavicle", "scapula": "scapula", "humerus": "humerus", "hip": "pelvis",
    "pelvis": "pelvis", "ilium": "pelvis", "innominate": "pelvis", "hip_bone": "pelvis", "os_coxae": "pelvis",
}  # fmt: skip
_MIDDLE = {
    "pelvis": "pelvis", "sacrum": "pelvis", "coccyx": "pelvis", "sternum": "sternum", "manubrium": "sternum",
    "costal_cartilages": "sternum", "skin": SKIN,
}  # fmt: skip
_VERTEBRA = re.compile(r"(?:vertebrae?_?)?(t|th|thoracic|l|lumbar)_?0?(\d{1,2})")
_RIB = re.compile(r"(?:(l|left|r|right)_)?(?:rib|costa|r)_?(?:(l|left|r|right)_?)?0?(\d{1,2})(?:_?(l|left|r|right))?")


@dataclass(frozen=True)
class BoneFiles:
    """The files of an anatomy.

    Attributes
    ----------
    bones : for each of the 49 bones the files that make it up.
    skin : the skin's file, if there is one.
    ignored : names of files left out on request.
    unit, axes, height_cm : what the mapping file says of them.
    """

    bones: Mapping[str, tuple[Path, ...]]
    skin: Path | None = None
    ignored: tuple[str, ...] = ()
    unit: str | None = None
    axes: str | None = None
    height_cm: float | None = field(default=None)


def find_files(folder: Path, mapping: Path | None = None, skin: Path | None = None) -> BoneFiles:
    """The files of all 49 bones in a folder; hidden files are passed by.

    Parameters
    ----------
    skin : the skin's file, wherever it lies; then no other file is the skin.

    Raises
    ------
    TorsoError : no such folder; a file of unknown name; a bone's file as the skin; a bone with no file, or with two
        that are no parts of it; a mapping that names what isn't there.
    """
    try:
        meshes = (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
        inside = sorted(path for path in meshes if not path.name.startswith("."))
    except OSError as error:
        raise TorsoError(f"{folder}: {(error.strerror or 'unreadable').lower()}; wanted a folder of meshes") from None
    except ValueError:  # a zero byte
        raise TorsoError(f"{str(folder)!r}: no name of a folder") from None
    if not inside:
        raise TorsoError(f"{folder} holds no mesh; wanted files that end in {', '.join(SUFFIXES)}")
    if len(inside) > MOST_FILES:
        raise TorsoError(f"{folder} holds {len(inside)} meshes; at most {MOST_FILES}")
    bone = None if skin is None or mapping is not None else bone_of_name(skin.stem)
    if skin is not None and bone not in (None, SKIN) and skin.resolve() in {path.resolve() for path in inside}:
        raise TorsoError(f"--skin {skin}: has the name of a bone, {bone}; wanted the file of the skin, or another name")
    known = {path.name: path for path in inside if skin is None or path.resolve() != skin.resolve()}
    found = _by_name(folder, known) if mapping is None else _by_mapping(folder, known, mapping)
    return found if skin is None else replace(found, skin=skin)


def bone_of_name(stem: str) -> str | None:
    """The bone (or "skin") that a file name without its ending means; of a pelvis or sternum in parts, the whole.

    Understood: the package's own names, TotalSegmentator's, and those of the thoracolumbar OpenSim models.
    """
    if stem in BONES:
        return stem
    word = re.sub(r"[\s.\-_]+", "_", stem.strip()).lower()
    if word in _MIDDLE:
        return _MIDDLE[word]
    if found := _VERTEBRA.fullmatch(word):
        name = f"{found[1][0].upper()}{int(found[2])}"
        return name if name in BONES else None
    if found := _RIB.fullmatch(word):
        sides = {_SIDES[side] for side in (found[1], found[2], found[4]) if side}
        name = f"R{int(found[3])}_{sides.pop()}" if len(sides) == 1 else ""
        return name if name in BONES else None
    for side, letter in _SIDES.items():
        for bone in (word.removeprefix(f"{side}_"), word.removesuffix(f"_{side}")):
            if bone != word and bone in _SIDED:
                whole = _SIDED[bone]
                return whole if whole == "pelvis" else f"{whole}_{letter}"
    return None


def _part(stem: str) -> str | None:
    # Which part of a pelvis or a sternum, of which these have several, a name means; None for a whole bone.
    word = re.sub(r"[\s.\-_]+", "_", stem.strip()).lower()
    if word == "pelvis" or bone_of_name(stem) not in ("pelvis", "sternum"):
        return None
    # Of a hip bone, which has many names, its side.
    return word if word in _MIDDLE else _SIDES.get(word.split("_")[0]) or _SIDES[word.split("_")[-1]]


def _by_name(folder: Path, known: Mapping[str, Path]) -> BoneFiles:
    found, strange = _named(known)
    if strange:
        raise TorsoError(
            f"{_listed(strange)}: no bone of the torso by {'this name' if len(strange) == 1 else 'these names'}; "
            'give a mapping file, which may list it under "ignore"'
        )
    _refuse_doubles(found, "keep one, or give a mapping file")
    skin = found.pop(SKIN, [None])[0]
    _complete(folder, found)
    return BoneFiles({bone: tuple(found[bone]) for bone in BONES}, skin)


def _named(known: Mapping[str, Path]) -> tuple[dict[str, list[Path]], list[str]]:
    # What the files' names mean, and the files whose names mean nothing.
    found: dict[str, list[Path]] = {}
    strange = []
    for path in known.values():
        bone = bone_of_name(path.stem)
        if bone is None:
            strange.append(path.name)
        else:
            found.setdefault(bone, []).append(path)
    return found, strange


def _refuse_doubles(found: Mapping[str, list[Path]], advice: str) -> None:
    for bone, paths in found.items():
        parts = [_part(path.stem) for path in paths]
        if len(paths) > 1 and (None in parts or len(set(parts)) < len(parts)):
            raise TorsoError(f"{_listed([path.name for path in paths])} would all be {bone}; {advice}")


def _complete(folder: Path, found: Mapping[str, Any]) -> None:
    missing = [bone for bone in BONES if not found.get(bone)]
    if missing:
        raise TorsoError(f"{folder}: no mesh for {_listed(missing)}; all 49 bones are needed")


def _by_mapping(folder: Path, known: Mapping[str, Path], mapping: Path) -> BoneFiles:
    record = _read_mapping(mapping)

    def file(name: object, what: str) -> Path:
        if not isinstance(name, str) or name not in known:
            raise TorsoError(f"{mapping.name}: {what}: no mesh {str(name)[:80]!r} in {folder}")
        return known[name]

    bones: dict[str, tuple[Path, ...]] = {}
    entries = record.get("bones", {})
    if not isinstance(entries, dict):
        raise TorsoError(f'{mapping.name}: "bones" is no object of bone: file')
    for bone, names in entries.items():
        if bone not in BONES:
            raise TorsoError(
                f"{mapping.name}: bones: no bone {bone[:40]!r} in the torso; bones are T1 ... R12_R, see docs"
            )
        listed = names if isinstance(names, list) else [names]
        if not listed:
            raise TorsoError(f"{mapping.name}: bones: {bone}: no file named")
        bones[bone] = tuple(file(name, bone) for name in listed)
    ignored = record.get("ignore", [])
    if not isinstance(ignored, list):
        raise TorsoError(f'{mapping.name}: "ignore" is no list of files')
    left_out = [file(name, "ignore") for name in ignored]
    skin = file(record["skin"], "skin") if record.get("skin") is not None else None
    used: dict[Path, str] = {}
    for what, paths in [*bones.items(), ("ignore", left_out), (SKIN, [skin] if skin else [])]:
        for path in paths:
            if path in used:
                raise TorsoError(f"{mapping.name}: {path.name} stands for both {used[path]} and {what}")
            used[path] = what
    # What the mapping leaves out goes by its name, as without a mapping.
    found, strange = _named({name: path for name, path in known.items() if path not in used})
    if skin is not None:
        found.pop(SKIN, None)
    for bone, paths in found.items():
        if bone in bones:
            both = f"{paths[0].name} and {bones[bone][0].name}"
            raise TorsoError(f"{both} would both be {bone}; ignore one in {mapping.name}")
    _refuse_doubles(found, f"ignore one in {mapping.name}")
    skin = found.pop(SKIN, [skin])[0]
    if strange:
        raise TorsoError(f'{_listed(strange)}: not in {mapping.name}; name its bone there, or list it under "ignore"')
    bones |= {bone: tuple(paths) for bone, paths in found.items()}
    _complete(folder, bones)
    return BoneFiles(
        {bone: bones[bone] for bone in BONES},
        skin,
        tuple(path.name for path in left_out),
        _word(mapping, record, "unit"),
        _word(mapping, record, "axes"),
        _height(mapping, record),
    )


def _word(mapping: Path, record: Mapping[str, Any], key: str) -> str | None:
    value = record.get(key)
    if value is not None and not isinstance(value, str):
        raise TorsoError(f'{mapping.name}: "{key}" is no text')
    return value


def _height(mapping: Path, record: Mapping[str, Any]) -> float | None:
    value = record.get("height_cm")
    if value is None:
        return None
    low, high = HEIGHTS_CM
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise TorsoError(f'{mapping.name}: "height_cm" is no number from {low:g} to {high:g}')
    return float(value)


def _read_mapping(path: Path) -> dict[str, Any]:
    try:
        record = parse_json(read_text(path, MOST_MAPPING_BYTES), path.name)
    except SubjectError as error:
        raise TorsoError(str(error)) from None
    if not isinstance(record, dict) or (unknown := [key for key in record if key not in KEYS]):
        found = f"unknown key {unknown[0][:40]!r}" if isinstance(record, dict) else "no object"
        raise TorsoError(f"{path.name}: {found}; wanted an object with the keys {', '.join(KEYS)}")
    return record


def _listed(names: list[str], most: int = 6) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
