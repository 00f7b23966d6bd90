"""Is whatever a user may hand over read rightly, or refused in one clear line?

``python benchmarks/bad_inputs.py [--inputs 12000] [--seed 0] [--only CLASS] [--json] [--write]``: bad inputs in
classes (``CLASSES``), each made from its number and the seed alone and read in a child process under a time limit.
Each outcome is one of

    right        accepted, and nothing speaks against it by the rule of the class
    refused      one clear line
    unclear      refused otherwise: no line or several, over 300 characters, without the name of the file, key or option
                 that is at fault, or in words of the programming language
    traceback    any exception that is no SpinestiffError, or the end of the process
    hang         more than 20 s
    overwritten  a file that was there has other bytes or is gone
    wrong        accepted, though the rule of the class speaks against it

The rules are the docstrings of the classes. They are stated from the documents, not from the code: what the reader
itself holds for impossible plays no part in them.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import datetime
import hashlib
import io
import json
import math
import multiprocessing
import multiprocessing.connection
import os
import re
import shutil
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from damaged_dicom import WAYS as DICOM_WAYS
from damaged_dicom import Seed, damaged, judged, quantities, seeds

from spinestiff.anatomy.files import read_torso, write_torso
from spinestiff.anatomy.importing.naming import find_files
from spinestiff.anatomy.importing.reading import read_surface
from spinestiff.anatomy.names import BONES, VERTEBRAE
from spinestiff.anatomy.template import template_torso
from spinestiff.app import cli
from spinestiff.curves.cobb import read_cobb
from spinestiff.curves.corner_files import ImageCorners, read_corner_file, write_corners
from spinestiff.errors import RadiographError, SpinestiffError
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.radiograph import read_radiographs, write_radiographs
from spinestiff.imaging.synthetic.acquisition import Acquisition
from spinestiff.study.runner import run_steps
from spinestiff.study.synthetic.recipe import Recipe
from spinestiff.study.synthetic.spines import real_spine
from spinestiff.study.synthetic.subject import synthesise
from spinestiff.study.truth import read_truth
from spinestiff.study.visit import open_visit
from spinestiff.subject.annotated_points import image_corners, image_pedicles
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_subject
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcomes import FrameProposals, Tracked
from spinestiff.subject.run_record import read_outcome

MOST_SECONDS = 20.0
LONGEST_LINE = 300
OUTCOMES = ("right", "refused", "unclear", "traceback", "hang", "overwritten", "wrong")
RESULTS = Path(__file__).parent / "results"
FOREIGN_WORDS = re.compile(
    r"\b\w+(Error|Exception)\b|\bNoneType\b|\bobject has no\b|<class|\bTraceback\b|\bfound None\b"
)
SHAPE = (512, 512)
ODD_NUMBERS = (0, -1, 1e9, -1e9, 1e308, 0.001, 1e-300, 7, 13.5, 400, 2**63, -0.0, 33)
ODD_TEXTS = (
    "",
    " ",
    "x",
    "../x",
    "/etc/hosts",
    "a\0b",
    "left ",
    "T13",
    "ä" * 80,
    "NaN",
    "\n",
    "None",
    "C:\\x",
    "a" * 5000,
)
ODD_VALUES = (None, True, False, [], {}, [[]], "x", 3, 1.5, [1, 2], {"a": 1})


JSON_WAYS = ("cut", "bytes", "root", "twice", "encoding", "value", "number", "text", "delete", "unknown", "shorter",
             "longer", "swapped", "literal", "key")  # fmt: skip


class Case(NamedTuple):
    """One bad input.

    Attributes
    ----------
    way : what was done to it.
    read : reads it; raises SpinestiffError, or returns what it read.
    names : one of them has to stand in a refusal.
    wrong : what speaks against what was read, or "".
    """

    way: str
    read: Callable[[], Any]
    names: tuple[str, ...]
    wrong: Callable[[Any], str]


@dataclass(frozen=True)
class Material:
    """Sound inputs that the bad ones are made from; ``folder`` holds the files."""

    folder: Path
    subject: dict[str, Any]
    annotation: dict[str, Any]
    views: dict[str, XRayView]
    dicom: list[Seed]
    read: dict[str, dict[str, Any]]
    corners: list[ImageCorners]
    meshes: dict[str, bytes]


Make = Callable[[np.random.Generator, Path, Material], Case]


# Sound material


def sound(folder: Path) -> Material:
    """Make the material in an empty folder."""
    torso = template_torso(157.0)
    views = {"frontal": frontal_view(shape=SHAPE, pixel=1.0), "lateral": lateral_view(shape=SHAPE, pixel=1.0)}
    images = {
        "rest/frontal": {"vertebrae": _spine(0.0), "pedicles": _pedicles()},
        "rest/lateral": {"vertebrae": _spine(10.0)},
        "push/main": {"vertebrae": _spine(4.0), "supports": {"pelvis": [[200, 480], [300, 480]]}},
        "push/main/2": {"vertebrae": {"T8": _spine(6.0)["T8"]}},
    }
    subject = {
        "schema_version": 1,
        "id": "girl-1",
        "age": 13.0,
        "sex": "female",
        "height_cm": 157.0,
        "mass_kg": 45.0,
        "xray": {"source_detector_mm": 1800.0, "source_patient_mm": 1500.0, "imager_pixel_mm": 0.4},
        "trunk": {"T8": {"breadth_mm": 260.0, "depth_mm": 180.0}},
        "pushes": [
            {
                "id": "main",
                "side": "left",
                "level": 8.0,
                "d21_mm": 402.4,
                "d31_mm": 150.9,
                "frames": "pushes/main.dcm",
                "forces_n": [0.0, 15.0, 22.5, 30.0],
                "roles": ["unused", "training", "training", "validation"],
            },
        ],
    }
    found = seeds()
    read = {}
    for seed in found:
        (folder / "damaged.dcm").write_bytes(seed.content)
        read[seed.name] = quantities(read_radiographs(folder / "damaged.dcm"))
    corners = [
        ImageCorners(name, tuple(_spine(0)), np.array(list(_spine(shift).values()))[:, [1, 0, 3, 2]], first_on="right")
        for name, shift in (("one", 0.0), ("two", 8.0))
    ]
    write_torso(folder / "torso.npz", torso)
    quick = Acquisition(samples=1)
    recipe = Recipe(seed=3, force_n=30.0, ratios=(0.2, 0.05), shape=SHAPE, mesh="coarse", acquisition=quick)
    synthesise(folder / "done", recipe)
    run_steps(open_visit(folder / "done"), ("track", "frames", "personalise", "estimate", "assess"))
    pixels = np.full((1, 48, 40), 900, dtype=np.uint16)
    write_radiographs(folder / "picture.dcm", pixels, frontal_view(shape=(48, 40), pixel=0.4))
    for image in corners:
        write_corners(folder / f"{image.image}.csv", [image])
    return Material(
        folder, subject, {"schema_version": 1, "images": images}, views, found, read, corners, _meshes(torso)
    )


def _spine(bend: float) -> dict[str, list[list[float]]]:
    """Corners of all vertebrae, column and row, first corner at the larger column; ``bend`` pixels of a curve."""
    quads = {}
    for i, name in enumerate(VERTEBRAE):
        x, y, w = 256.0 + bend * math.sin(0.4 * i), 25.0 + 27.0 * i, 18.0 + 0.8 * i
        quads[name] = [[x + w, y], [x - w, y], [x - w, y + 19.0], [x + w, y + 19.0]]
    return quads


def _pedicles() -> dict[str, list[list[float]]]:
    return {name: [[266.0, quad[0][1] + 6.0], [246.0, quad[0][1] + 6.0]] for name, quad in _spine(0.0).items()}


def _meshes(torso: Any) -> dict[str, bytes]:
    import trimesh

    surface = torso.bone_surfaces[torso.bone("T8")]
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    found = {
        "bone.stl": mesh.export(file_type="stl"),
        "text.stl": mesh.export(file_type="stl_ascii"),
        "bone.obj": mesh.export(file_type="obj"),
        "bone.ply": mesh.export(file_type="ply"),
        "text.ply": mesh.export(file_type="ply", encoding="ascii"),
    }
    return {name: one.encode() if isinstance(one, str) else one for name, one in found.items()}


# Damage


def spoiled_json(random: np.random.Generator, content: Any) -> tuple[str, bytes]:
    """A JSON text that is damaged in one way, or says something else than the sound one."""
    way = str(_pick(random, JSON_WAYS))
    text = json.dumps(content)
    copy = json.loads(text)
    holder, key = _spot(random, copy)
    if way == "cut":
        return way, text[: random.integers(len(text))].encode()
    if way == "bytes":
        raw = bytearray(text.encode())
        for _ in range(random.integers(1, 5)):
            raw[random.integers(len(raw))] = random.integers(256)
        return way, bytes(raw)
    if way == "root":
        return way, _pick(
            random, (b"", b"{}", b"[]", b"null", b"0", b'""', b"true", b"[" * 50_000, b"{" * 9, b"\0" * 99)
        )
    if way == "twice":
        name = _pick(random, list(content))
        return way, (text[:-1] + f", {json.dumps(name)}: {json.dumps(content[name])}}}").encode()
    if way == "encoding":
        return way, text.replace("main", "mäin").encode(_pick(random, ("utf-16", "latin-1", "utf-32", "utf-8-sig")))
    if way == "literal":
        marked = json.dumps(_set(copy, holder, key, "@"))
        odd = _pick(
            random, ("NaN", "Infinity", "-Infinity", "1e999", "9" * 5000, "01", "+1", "1.", "'x'", "nul", "1 2")
        )
        return way, marked.replace('"@"', odd).encode()
    if way == "value":
        _set(copy, holder, key, _pick(random, ODD_VALUES))
    elif way == "number":
        holder, key = _spot(random, copy, (int, float))
        _set(copy, holder, key, _pick(random, ODD_NUMBERS))
    elif way == "text":
        holder, key = _spot(random, copy, (str,))
        _set(copy, holder, key, _pick(random, ODD_TEXTS))
    elif way == "delete":
        del holder[key]
    elif way in ("unknown", "key"):
        holder, key = _spot(random, copy, in_=dict)
        if isinstance(holder, list):
            return spoiled_json(random, content)
        if way == "key":
            holder[_pick(random, (*ODD_TEXTS, key + "s", key.upper()))] = holder.pop(key)
        else:
            holder[_pick(random, ("colour", "__proto__", "Age", key + "_", *ODD_TEXTS))] = _pick(random, ODD_VALUES)
    elif way in ("shorter", "longer", "swapped"):
        holder, key = _spot(random, copy, in_=list)
        if isinstance(holder, dict):
            return spoiled_json(random, content)
        if way == "shorter":
            del holder[key]
        elif way == "longer":
            holder.insert(key, holder[key])
        else:
            other = int(random.integers(len(holder)))
            holder[key], holder[other] = holder[other], holder[key]
    return way, json.dumps(copy).encode()


def _spot(random: np.random.Generator, content: Any, kinds: tuple[type, ...] = (), in_: type | None = None) -> Any:
    """A place in a JSON value: what holds it, and its key there; a shallow one as often as a deep one."""
    spots: dict[int, list[Any]] = {}

    def walk(value: Any, depth: int) -> None:
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            if (not kinds or type(inner) in kinds) and (in_ is None or isinstance(value, in_)):
                spots.setdefault(depth, []).append((value, key))
            if isinstance(inner, dict | list):
                walk(inner, depth + 1)

    walk(content, 0)
    if not spots:
        return _spot(random, content)
    return _pick(random, spots[_pick(random, sorted(spots))])


def _set(root: Any, holder: Any, key: Any, value: Any) -> Any:
    holder[key] = value
    return root


def _pick(random: np.random.Generator, options: Any) -> Any:
    return options[int(random.integers(len(options)))]


def spoiled_bytes(random: np.random.Generator, content: bytes) -> tuple[str, bytes]:
    """Bytes cut, changed, moved or doubled."""
    way = str(random.choice(["cut", "bits", "bytes", "empty", "doubled", "gap", "lines"]))
    raw = bytearray(content)
    if way == "cut":
        return way, content[: random.integers(1, len(raw))]
    if way == "empty":
        return way, _pick(random, (b"", b"\n", b"\0" * 200, b"PK\x03\x04", b"solid", b"\xff" * 50))
    if way == "doubled":
        return way, content + content
    if way == "gap":
        start, length = random.integers(len(raw)), random.integers(1, 200)
        del raw[start : start + length]
        return way, bytes(raw)
    if way == "lines":
        lines = content.split(b"\n")
        random.shuffle(lines)
        return way, b"\n".join(lines)
    for _ in range(random.integers(1, 9)):
        at = random.integers(len(raw))
        raw[at] = raw[at] ^ 1 << int(random.integers(8)) if way == "bits" else int(random.integers(256))
    return way, bytes(raw)


# The classes. The docstring of each is its rule for what counts as accepted though wrong.


def subject(random: np.random.Generator, place: Path, material: Material) -> Case:
    """``subject.json``. Wrong if accepted with: a key that the page on subject folders does not name, given twice,
    or missing; a value of another type or outside the page's range; unequal numbers of forces and roles; a path out
    of the folder; or if a value differs from that of the file.
    """
    way, raw = spoiled_json(random, material.subject)
    folder = _laid_out(place, material, subject=raw)
    return Case(
        way,
        lambda: read_subject(folder),
        ("subject.json", "annotation.json", "pushes/", "radiograph of push/"),
        lambda found: _subject_faults(raw, found),
    )


def annotation(random: np.random.Generator, place: Path, material: Material) -> Case:
    """``annotation.json``, up to corners in mm. Wrong if accepted with: unknown, doubled or missing keys; fewer
    than 8 vertebrae in an image that needs them; an unknown image; a corner, support or pedicle that is no pair of
    finite numbers; a corner outside the image; a vertebra whose corners make no convex quadrilateral, are mirrored
    or upside down; vertebrae out of order from head to foot; or if a corner differs from the file's. A
    sound-looking vertebra in the wrong place can't be told here (docs/cobb.md).
    """
    way, raw = spoiled_json(random, material.annotation)
    folder = _laid_out(place, material, annotation=raw)

    def read() -> Any:
        found = read_subject(folder)
        for name in found.annotation.images:
            view = material.views["lateral" if name == "rest/lateral" else "frontal"]
            image_corners(found, name, view)
            image_pedicles(found, name, view)
        return found

    return Case(way, read, ("annotation.json",), lambda found: _annotation_faults(raw, found))


def dicom(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Damaged radiographs (``damaged_dicom.py``). Wrong if accepted with other sizes than those of the pixels, or
    with millimetres that no radiograph has (spacing 0.02 to 2 mm, distances 300 to 10,000 mm).
    """
    seed, way = _pick(random, material.dicom), _pick(random, DICOM_WAYS)
    path = place / "damaged.dcm"
    path.write_bytes(damaged(seed, way, random))

    def read() -> Any:
        verdict = judged(path, material.read[seed.name])
        if verdict.outcome == "refused":
            raise RadiographError(verdict.detail)
        return verdict

    return Case(
        way, read, ("damaged.dcm",), lambda v: v.outcome + " " + v.detail if v.outcome.startswith("FAULT") else ""
    )


def corner_csv(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Corners in a CSV, up to Cobb angles. Wrong if an image is accepted whose vertebrae or corners are not those
    that the file's rows give (each of four corners of a vertebra once, finite, at most 100,000 from the first
    pixel), or has an angle that is not finite or not below 180 degrees.
    """
    path = place / "corners.csv"
    write_corners(path, material.corners)
    way, raw = spoiled_bytes(random, path.read_bytes())
    if random.random() < 0.6:
        way, raw = _spoiled_cells(random, path.read_text())
    path.write_bytes(raw)
    return Case(way, lambda: _cobb_of(path), ("corners.csv", "one", "two"), lambda found: _csv_faults(raw, found))


def corner_json(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Corners in Slicer markups or an annotation, up to Cobb angles. Wrong if an image is accepted with a level
    that is unknown or doubled, a corner that is not finite, more vertebrae than a fourth of the file's points, or
    an angle that is not finite or not below 180 degrees.
    """
    path = place / "corners.mrk.json"
    write_corners(path, material.corners[:1])
    content = json.loads(path.read_text())
    if random.random() < 0.3:
        path.unlink()
        path, content = place / "annotation.json", material.annotation
    way, raw = spoiled_json(random, content)
    path.write_bytes(raw)
    return Case(
        way, lambda: _cobb_of(path), (path.name, "one", "rest/", "push/"), lambda found: _markup_faults(raw, found)
    )


def mesh(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Bone meshes. Wrong if accepted with: a coordinate that is not finite; a triangle of vertices that are not
    there; no triangle; or, from a file that was cut short, fewer triangles than the sound one. (An OBJ says nowhere
    how many there are: one cut between two lines is sound, and what is open is found when bones are closed.)
    """
    name = _pick(random, list(material.meshes))
    way, raw = spoiled_bytes(random, material.meshes[name])
    path = place / name
    path.write_bytes(material.meshes[name])
    whole = len(read_surface(path)[1])
    path.write_bytes(raw)

    def wrong(found: Any) -> str:
        vertices, faces = found
        if not np.isfinite(vertices[np.unique(faces)]).all():
            return "a coordinate that is not finite"
        if not len(faces) or faces.min() < 0 or faces.max() >= len(vertices):
            return "triangles without vertices"
        cut_short = way == "cut" and name != "bone.obj" and raw.rstrip() != material.meshes[name].rstrip()
        return f"{len(faces)} of {whole} triangles" if cut_short and len(faces) < whole else ""

    return Case(f"{name} {way}", lambda: tuple(read_surface(path)), (name,), wrong)


def bones(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Sets of bone files and their mapping. Wrong if accepted without a file for each of the 49 bones, with a file
    for two bones, or with a mesh in the folder that is neither a bone's, the skin nor ignored on request.
    """
    folder = place / "bones"
    folder.mkdir()
    names = [f"{bone}.stl" for bone in BONES]
    way = str(random.choice(["missing", "twice", "unknown", "renamed", "none", "mapping", "mapping names"]))
    if way == "missing":
        names.remove(_pick(random, names))
    elif way == "twice":
        names.append(_pick(random, names).replace(".stl", ".obj"))
    elif way == "unknown":
        names.append(_pick(random, ("femur_L.stl", "T13.stl", "rib_13_L.stl", "x.ply", "T 1 2.stl", "-.stl", "ä.obj")))
    elif way == "renamed":
        names[random.integers(len(names))] = _pick(random, ("bone.stl", "t99.stl", "L6.stl", "rib0_R.stl"))
    elif way == "none":
        names = list(_pick(random, ([], ["a.txt"], ["T1.stl"])))
    for name in names:
        (folder / name).write_bytes(b"solid")
    given = None
    if way.startswith("mapping"):
        content = {"bones": {bone: f"{bone}.stl" for bone in BONES}, "unit": "mm", "axes": "LPS", "ignore": []}
        given = place / "mapping.json"
        if way == "mapping":
            _, raw = spoiled_json(random, content)
        else:
            content["bones"][_pick(random, BONES)] = _pick(
                random, ("none.stl", "../T1.stl", "T1.stl", 3, None, "", ["T2.stl"])
            )
            raw = json.dumps(content).encode()
        given.write_bytes(raw)

    def wrong(found: Any) -> str:
        used = [file for files in found.bones.values() for file in files]
        if set(found.bones) != set(BONES) or not all(found.bones.values()):
            return "a bone without a file"
        if len(set(used)) < len(used):
            return "a file for two bones"
        kept = {*(file.name for file in used), *found.ignored, *([found.skin.name] if found.skin else [])}
        left = sorted(
            file.name for file in folder.iterdir() if file.suffix in (".stl", ".obj", ".ply") and file.name not in kept
        )
        return f"left over: {left}" if left and not given else ""

    return Case(way, lambda: find_files(folder, given), ("mapping.json", "bones", *BONES, *names, "mesh"), wrong)


def torso_file(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Torso files. Wrong if accepted with: a number that is not finite, a coordinate beyond 10 m, or, after damage
    to the file's bytes, any array that differs from the sound one.
    """
    path, good = place / "torso.npz", material.folder / "torso.npz"
    way = str(random.choice(["bytes", "value", "missing", "shape", "kind", "header"]))
    if way == "bytes":
        inner, raw = spoiled_bytes(random, good.read_bytes())
        way = f"bytes: {inner}"
        path.write_bytes(raw)
    else:
        with np.load(good) as stored:
            arrays = {key: stored[key] for key in stored.files}
        key = _pick(random, [k for k in arrays if k != "header"])
        if way == "missing":
            del arrays[key]
        elif way == "shape":
            arrays[key] = arrays[key][:-1] if arrays[key].ndim else np.zeros(3)
        elif way == "kind":
            arrays[key] = _pick(
                random, (arrays[key].astype("U8"), arrays[key].astype(complex), np.array(True), np.zeros((0, 3)))
            )
        elif way == "header":
            header = json.loads(str(arrays["header"]))
            arrays["header"] = np.array(spoiled_json(random, header)[1].decode("utf-8", "replace"))
        else:
            key = _pick(random, [k for k in arrays if arrays[k].dtype.kind == "f" and arrays[k].size])
            changed = arrays[key].copy()
            changed.flat[random.integers(changed.size)] = _pick(random, (np.nan, np.inf, -np.inf, 1e9, -1e30))
            arrays[key] = changed
        np.savez(path, **arrays)

    def wrong(found: Any) -> str:
        rest = (found.rest_pose.bone_positions, found.rest_pose.tissue_positions, found.tissue.rest_positions)
        where = np.concatenate([part.ravel() for part in (*rest, *(s.vertices for s in found.bone_surfaces))])
        if not np.isfinite(where).all() or np.abs(where).max() > 1e4 or not np.isfinite(found.joints.stiffness).all():
            return "numbers that no body has"
        if way.startswith("bytes"):
            write_torso(place / "again.npz", found)
            return "" if (place / "again.npz").read_bytes() == good.read_bytes() else "another torso"
        return ""

    return Case(way, lambda: read_torso(path), ("torso.npz",), wrong)


def result(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Results. Wrong if one is accepted that has other bytes than its step wrote; or one whose hash in run.json was
    corrected as well, with a key that no result has, without one that all have, of another schema version, or with
    a value that differs from the file's. A damaged run.json is wrong if another result than the step's is accepted.
    """
    folder = Path(shutil.copytree(material.folder / "done", place / "done"))
    kind = _pick(random, (Tracked, FrameProposals, GeometryRecord, Estimate, Assessment))
    path, run = folder / "results" / kind.FILE, folder / "results" / "run.json"
    target = path if random.random() < 0.7 else run
    before = path.read_bytes()
    way, raw = spoiled_json(random, json.loads(target.read_bytes()))
    if random.random() < 0.2:
        way, raw = spoiled_bytes(random, target.read_bytes())
    target.write_bytes(raw)
    vouched = target is path and random.random() < 0.5
    if vouched:
        record = json.loads(run.read_bytes())
        record["steps"][kind.STEP]["outputs"][f"results/{kind.FILE}"] = hashlib.sha256(raw).hexdigest()
        run.write_text(json.dumps(record))

    def wrong(found: Any) -> str:
        if not vouched:
            return "" if path.read_bytes() == before else "another result than the step wrote"
        try:
            said = _strict(raw)
        except _Twice:
            return "a key twice"
        whole = json.loads(before)
        if set(said) != set(whole) or said["schema_version"] != whole["schema_version"]:
            return f"keys or version: {sorted(said)}"
        return _differs(said, found.model_dump(mode="json")) or ""

    name = f"{target.name} {'vouched ' * vouched}{way}"
    return Case(name, lambda: read_outcome(read_subject(folder), kind), (kind.FILE, "run.json"), wrong)


def table(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Truth files and tables of spines. Wrong if a truth is accepted with a ratio that is not finite or not above
    0, or that differs from the file's; or a spine with a coordinate that is not finite.
    """
    if random.random() < 0.5:
        path = place / "truth.json"
        way, raw = spoiled_json(random, {"schema_version": 1, "ratios": {"lateral_bending": 0.2, "tissue": 0.05}})
        path.write_bytes(raw)

        def wrong(found: Any) -> str:
            said = json.loads(raw.decode("utf-8-sig"))["ratios"]
            return "" if found == said and all(math.isfinite(v) and v > 0.0 for v in found.values()) else f"{found}"

        return Case(f"truth {way}", lambda: read_truth(path), ("truth.json",), wrong)
    rows = ["id,level,keypoint,x_mm,y_mm,z_mm"]
    for name in VERTEBRAE:
        i = VERTEBRAE.index(name)
        rows += [f"a,{name},{point},{dx},{dy},{400 - 25 * i + dz}" for point, dx, dy, dz in KEYPOINTS]
    way, raw = spoiled_bytes(random, "\n".join(rows).encode())
    path = place / "spines.csv"
    path.write_bytes(raw)
    return Case(
        f"spines {way}", lambda: real_spine(template_torso(157.0), path, "a"), ("spines.csv",),
        lambda found: "" if all(np.isfinite(part).all() for part in found) else "not finite",
    )  # fmt: skip


KEYPOINTS = (("body", 0, 0, 0), ("left", 12, 15, 4), ("right", -12, 15, 4))


def places(random: np.random.Generator, place: Path, material: Material) -> Case:
    """What is no file, in place of every file that is read. Wrong if accepted: a named pipe, a device, a socket, a
    folder for a file, a link to itself, to nothing, to a pipe or (in a subject folder) out of it, a file of a
    terabyte.
    """
    folder = _laid_out(place, material)
    picture = str(material.folder / "picture.dcm")
    targets: dict[str, tuple[Path, Callable[[Path], Any]]] = {
        "subject.json": (folder / "subject.json", lambda p: read_subject(folder)),
        "annotation.json": (folder / "annotation.json", lambda p: read_subject(folder)),
        "frontal.dcm": (folder / "rest" / "frontal.dcm", lambda p: read_subject(folder)),
        "main.dcm": (folder / "pushes" / "main.dcm", lambda p: read_subject(folder)),
        "alone.dcm": (place / "alone.dcm", read_radiographs),
        "corners.csv": (place / "corners.csv", read_corner_file),
        "corners.json": (place / "corners.json", read_corner_file),
        "torso.npz": (place / "torso.npz", read_torso),
        "bone.stl": (place / "bone.stl", read_surface),
        "truth.json": (place / "truth.json", read_truth),
        "spines.csv": (place / "spines.csv", lambda p: real_spine(template_torso(157.0), p, "a")),
        "mapping.json": (place / "mapping.json", lambda p: find_files(_bone_folder(place), p)),
        "cobb": (place / "cobb.csv", lambda p: _status("cobb", str(p))),
        "view": (place / "view.npz", lambda p: _status("view", "--no-open", "--torso", str(p))),
        "show": (place / "show.npz", lambda p: _status("torso", "show", str(p))),
        "inspect": (place / "seen.dcm", lambda p: _status("inspect", str(p))),
        "key": (place / "key", lambda p: _status("deidentify", picture, str(place / "out"), "--key", str(p))),
    }  # fmt: skip
    target = _pick(random, sorted(targets))
    path, reader = targets[target]
    path.unlink(missing_ok=True)
    inside = path.is_relative_to(folder)
    ways = ["pipe", "device", "folder", "itself", "nothing", "to a pipe", "huge"] + (["out"] if inside else [])
    if target in ("main.dcm", "alone.dcm", "inspect"):
        ways.remove("folder")
    if target == "cobb":
        ways.remove("folder")
    way = str(random.choice(ways))
    if way == "pipe":
        os.mkfifo(path)
    elif way == "device":
        path.symlink_to(_pick(random, ("/dev/zero", "/dev/null", "/dev/urandom")))
    elif way == "folder":
        path.mkdir()
    elif way == "itself":
        path.symlink_to(path)
    elif way == "nothing" and target != "key":
        path.symlink_to(place / "gone")
    elif way in ("to a pipe", "nothing"):
        os.mkfifo(place / "pipe")
        path.symlink_to(place / "pipe")
    elif way == "huge":
        with path.open("wb") as file:
            file.truncate(2**40)
    else:
        path.symlink_to(shutil.copy(material.folder / "picture.dcm", place / "elsewhere"))
    names = (path.name, "key file", "rest/frontal", "push/main", "corners")
    return Case(f"{target} {way}", lambda: reader(path), names, lambda found: f"accepted {way}")


def options(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Options of the command line with values that the help or the docs exclude. Wrong if a command ends with 0."""
    good = str(material.folder / "torso.npz")
    csv_file = str(material.folder / "one.csv")
    number = ("nan", "inf", "-inf", "1e999", "x", "", "0", "-5", "1e9", "1,5", "٣x", "0x10")
    imported = ("torso", "import", str(place / "bones"), "--out", str(place / "new"))
    choices: list[tuple[tuple[str, ...], str, tuple[str, ...]]] = [
        *((("torso", "show"), f"--{name}", number) for name in ("height", "age", "mass", "kyphosis", "lordosis")),
        (("torso", "show"), "--sex", ("", "m", "Female", "x", "0")),
        (("torso", "show"), "--mesh", ("", "finest", "../x", "Coarse")),
        (("torso", "show", good), "--height", ("157", "nan")),
        (("torso", "export", "--out", str(place / "t")), "--format", ("", "stl", "VTU", "../vtu", "__init__")),
        (("synth", str(place / "s")), "--height", tuple(n for n in number)),
        (("synth", str(place / "s")), "--seed", ("-1", "x", "", "1.5", "nan")),
        (("synth", str(place / "s")), "--cobb", ("nan", "inf", "x", "", "180", "-180")),
        (("synth", str(place / "s")), "--curve", ("", "zigzag", "Thoracic")),
        (("synth", str(place / "s")), "--force", ("nan", "inf", "-1", "0", "x", "", "1e9")),
        (("synth", str(place / "s")), "--ratios", ("", "1", ",", "0,0", "nan,1", "1,inf", "-1,1", "1,1,1", "a,b")),
        (("synth", str(place / "s")), "--spine-id", ("a", "")),
        (("synth", str(place / "s")), "--spine", ("none.csv", "", ".")),
        (("demo", "--out", str(place / "d")), "--ratios", ("", "0,0", "soft", "nan,nan")),
        (("demo", "--out", str(place / "d")), "--height", ("nan", "inf", "0", "x")),
        (("cobb", csv_file), "--definition", ("", "x", "Endplate", "end plate")),
        (("cobb", csv_file), "--noise-px", ("nan", "inf", "0", "-1", "1e9", "x", "")),
        (("cobb", csv_file), "--patient-left", ("", "up", "Left", "both")),
        (("cobb", csv_file), "--picture", (str(place / "p.svg"), str(place / "p"), "")),
        (("annotate", str(place)), "--port", ("-1", "65536", "x", "", "nan")),
        (("run", str(place)), "--mesh", ("", "huge", "fine ")),
        (("run", str(place)), "--method", ("", "guess", "LM")),
        (("run", str(place)), "--orientation", ("", "up")),
        (("run", str(place)), "--truth", ("none.json", "", ".")),
        (("frames", str(place)), "--roles", ("x",)),
        (("view",), "--torso", ("none.npz", "", ".", csv_file)),
        (imported, "--unit", ("", "inch", "MM")),
        (imported, "--axes", ("", "LPX", "LLL", "xyz")),
        (imported, "--spacing", ("nan", "inf", "0", "-1", "1e9", "x")),
        (imported, "--height", ("nan", "inf", "0", "-1", "1e9", "x")),
        (imported, "--mesher", ("", "none", "../x")),
        *(((step, "none"), "", ("",)) for step in ("track", "personalise", "estimate", "assess", "report", "inspect")),
    ]  # fmt: skip
    start, option, values = _pick(random, choices)
    value = _pick(random, values)
    arguments = [*start, *([f"{option}={value}"] if option else [])]
    names = (
        option.lstrip("-").replace("-", " ") or "none",
        option or "none",
        value or "none",
        *start[1:2],
        "subject.json",
        "pixels",
        "ratio",
        ".png",
        "bones",
        ".: ",
    )
    return Case(
        " ".join([*start[:2][: 2 if start[0] == "torso" else 1], option]),
        lambda: _status(*arguments),
        names,
        lambda found: f"accepted {arguments}",
    )


def outputs(random: np.random.Generator, place: Path, material: Material) -> Case:
    """Places for outputs where something would be lost, with and without ``--force``. Wrong if a command ends with
    0 though the place is a folder, a named pipe, a device, a link to one or to itself, an input of the command, or,
    without ``--force``, any file that is there.
    """
    torso = Path(shutil.copy(material.folder / "torso.npz", place / "torso.npz"))
    corners = Path(shutil.copy(material.folder / "one.csv", place / "one.csv"))
    (place / "there.png").write_bytes(b"mine")
    os.mkfifo(place / "pipe.png")
    os.link(torso, place / "hard.png")
    (place / "folder.png").mkdir()
    for name, to in (("link.png", "torso.npz"), ("corner-link.png", "one.csv"), ("to-pipe.png", "pipe.png"),
                     ("itself.png", "itself.png"), ("null.png", "/dev/null"), ("full.png", "/dev/full")):  # fmt: skip
        (place / name).symlink_to(to)
    force = random.random() < 0.6
    empty = place / "bones"
    empty.mkdir()
    commands = {
        "view": ("view", "--no-open", "--torso", str(torso), "--out"),
        "export": ("torso", "export", str(torso), "--format", "mrk", "--out"),
        "template": ("torso", "export", "--format", "mrk", "--out"),
        "cobb": ("cobb", str(corners), "--picture"),
        "import": ("torso", "import", str(empty), "--out"),
    }
    command = str(random.choice(sorted(commands)))
    always = ["pipe.png", "folder.png", "to-pipe.png", "itself.png", "null.png", "full.png", "", "a\udcff\0b"]
    own = {"view": ["torso.npz", "link.png", "hard.png"], "cobb": ["corner-link.png"]}
    own["export"] = own["import"] = own["view"]
    name = str(
        _pick(random, [*always[:-1], *own.get(command, []), *([] if force and command != "import" else ["there.png"])])
    )
    target = "" if not name else str(place / name)
    asked = [*commands[command], target, *(["--force"] if force and command != "import" else [])]
    return Case(
        f"{command} {name}",
        lambda: _status(*asked),
        (name or "folder", "--out", "--picture", "bones"),
        lambda found: f"accepted {asked}",
    )


CLASSES: dict[str, tuple[Make, int]] = {
    "subject.json": (subject, 22),
    "annotation.json": (annotation, 22),
    "DICOM": (dicom, 20),
    "corners, CSV": (corner_csv, 12),
    "corners, JSON": (corner_json, 8),
    "meshes": (mesh, 8),
    "sets of bones": (bones, 6),
    "torso files": (torso_file, 5),
    "results": (result, 4),
    "truths and spine tables": (table, 4),
    "no files": (places, 5),
    "options": (options, 5),
    "outputs": (outputs, 3),
}
"""By name: what makes an input of the class, and its share."""


# Help for the rules


def _laid_out(place: Path, material: Material, **files: bytes) -> Path:
    folder = place / "girl"
    (folder / "rest").mkdir(parents=True)
    (folder / "pushes").mkdir()
    for name in ("subject", "annotation"):
        raw = files.get(name, json.dumps(getattr(material, name)).encode())
        (folder / f"{name}.json").write_bytes(raw)
    for name in ("rest/frontal.dcm", "rest/lateral.dcm", "pushes/main.dcm"):
        shutil.copy(material.folder / "picture.dcm", folder / name)
    return folder


def _bone_folder(place: Path) -> Path:
    folder = place / "bones"
    folder.mkdir()
    (folder / "T1.stl").write_bytes(b"solid")
    return folder


def _status(*arguments: str) -> int:
    """A command in this process; its refusal is raised as a SpinestiffError, whatever it printed before."""
    out, err = io.StringIO(), io.StringIO()
    was, sys.argv = sys.argv, ["spinestiff", *arguments]
    shown = warnings.showwarning
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main()
    except SystemExit as end:
        if end.code:
            lines = [line for line in (err.getvalue() + "\n" + out.getvalue()).splitlines() if line.strip()]
            told = [line for line in lines if line.startswith(("spinestiff: ", "Error: ")) and "warning: " not in line]
            told = told or [line for line in lines if "refused" in line]
            raise SpinestiffError(" | ".join(told) if told else "") from None
    finally:
        sys.argv, warnings.showwarning = was, shown
    return 0


class _Twice(Exception):
    """A key stands twice in an object."""


def _strict(raw: bytes) -> Any:
    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(pairs)) < len(pairs):
            raise _Twice
        return dict(pairs)

    return json.loads(raw.decode("utf-8-sig"), object_pairs_hook=once)


NEEDED = {"schema_version", "id", "age", "sex", "height_cm", "pushes"}
KNOWN = NEEDED | {"mass_kg", "xray", "torso", "trunk", "skin_scan"}
PUSH_NEEDED = {"id", "side", "level", "d21_mm", "d31_mm", "frames", "forces_n"}
RANGES = {"age": (0, 120), "height_cm": (120, 200), "mass_kg": (0, 300)}
PUSH_RANGES = {"level": (1, 12), "d21_mm": (30, 1000), "d31_mm": (30, 1000)}
XRAY_RANGES = {"source_detector_mm": (0, 10_000), "source_patient_mm": (0, 10_000), "imager_pixel_mm": (0, 5)}


def _subject_faults(raw: bytes, found: Any) -> str:
    try:
        said = _strict(raw)
    except _Twice:
        return "a key twice"
    if not isinstance(said, dict) or not NEEDED <= set(said) <= KNOWN:
        return f"keys {sorted(said)[:20]}"
    dumped = found.record.model_dump(mode="json")
    if (path := _differs(said, dumped)) is not None:
        return f"{path} differs from the file"
    checks = [(said, RANGES), *((push, PUSH_RANGES) for push in said["pushes"]), (said.get("xray") or {}, XRAY_RANGES)]
    for holder, ranges in checks:
        for key, (low, high) in ranges.items():
            value = holder.get(key)
            if value is not None and not (type(value) in (int, float) and low <= value <= high):
                return f"{key} is {value!r}"
    for push in said["pushes"]:
        if not set(push) >= PUSH_NEEDED or set(push) - PUSH_NEEDED - {"roles"}:
            return f"push keys {sorted(push)}"
        forces = push["forces_n"]
        if not forces or not all(type(f) in (int, float) and 0 <= f <= 500 for f in forces):
            return f"forces {forces}"
        if "roles" in push and len(push["roles"]) != len(forces):
            return "numbers of forces and roles"
        if ".." in push["frames"] or push["frames"].startswith("/") or push["d31_mm"] >= push["d21_mm"]:
            return "frames or distances"
    return "" if said["schema_version"] == 1 and said["sex"] in ("female", "male") else "version or sex"


def _differs(said: Any, read: Any, path: str = "") -> str | None:
    """Where a JSON value is not what was read of it; what was not said, or null, may be anything."""
    if isinstance(said, dict) and isinstance(read, dict):
        found = (_differs(value, read.get(key), f"{path}.{key}") for key, value in said.items())
        return next((where for where in found if where is not None), None)
    if isinstance(said, list) and isinstance(read, list) and len(said) == len(read):
        found = (_differs(a, b, f"{path}[{i}]") for i, (a, b) in enumerate(zip(said, read)))
        return next((where for where in found if where is not None), None)
    same = said == read and isinstance(said, bool) == isinstance(read, bool)
    return None if said is None or same else path


IMAGES = {"rest/frontal", "rest/lateral", "push/main"}


def _annotation_faults(raw: bytes, found: Any) -> str:
    try:
        said = _strict(raw)
    except _Twice:
        return "a key twice"
    if set(said) != {"schema_version", "images"} or said["schema_version"] != 1:
        return f"keys {sorted(said)}"
    images = said["images"]
    if not set(images) >= IMAGES or set(images) - IMAGES - {f"push/main/{i}" for i in (1, 2, 3)}:
        return f"images {sorted(images)}"
    for name, image in images.items():
        if set(image) - {"vertebrae", "supports", "pedicles"} or "vertebrae" not in image:
            return f"{name}: keys {sorted(image)}"
        if name in IMAGES and len(image["vertebrae"]) < 8:
            return f"{name}: {len(image['vertebrae'])} vertebrae"
        for points in [*image.get("supports", {}).values(), *image.get("pedicles", {}).values()]:
            if not np.isfinite(np.array(points, dtype=float)).all() or np.array(points).shape[1:] != (2,):
                return f"{name}: points"
        rows = []
        for level in VERTEBRAE:
            if level not in image["vertebrae"]:
                continue
            quad = np.array(image["vertebrae"][level], dtype=float)
            edges = np.roll(quad, -1, 0) - quad
            turns = edges[:, 0] * np.roll(edges, -1, 0)[:, 1] - edges[:, 1] * np.roll(edges, -1, 0)[:, 0]
            if quad.shape != (4, 2) or not np.isfinite(quad).all() or quad.min() < -0.5 or quad.max() > SHAPE[0] - 0.5:
                return f"{name}.{level}: a corner outside"
            if not ((turns > 0).all() or (turns < 0).all()):
                return f"{name}.{level}: no convex quadrilateral"
            if quad[[0, 3], 0].sum() <= quad[[1, 2], 0].sum() or quad[:2, 1].sum() >= quad[2:, 1].sum():
                return f"{name}.{level}: mirrored or upside down"
            rows.append(quad[:, 1].mean())
        # A row's mean is no order where the spine lies: only a clear step back counts.
        if rows and min(np.diff(rows), default=1.0) < -5.0:
            return f"{name}: out of order"
        dumped = found.annotation.images[name].model_dump(mode="json")
        if (path := _differs(image, dumped)) is not None:
            return f"{name}{path} differs from the file"
    return ""


def _cobb_of(path: Path) -> Any:
    found = read_corner_file(path)
    return found, [read_cobb(image) for image in found.images]


def _angles(readings: Any) -> str:
    angles = [reading.largest.angle.degrees for reading in readings if reading.largest is not None]
    return "" if all(math.isfinite(angle) and abs(angle) < 180.0 for angle in angles) else f"angles {angles}"


def _spoiled_cells(random: np.random.Generator, text: str) -> tuple[str, bytes]:
    rows = list(csv.reader(io.StringIO(text)))
    i, j = int(random.integers(0, len(rows))), int(random.integers(5))
    way = str(random.choice(["cell", "row less", "row twice", "field less", "field more", "separator"]))
    if way == "cell":
        rows[i][j] = _pick(
            random, ("", "nan", "inf", "1e9", "-5", "1,5", "T13", "top", "=1+1", "0", "\x07", "x" * 300, "12")
        )
    elif way == "row less":
        del rows[i]
    elif way == "row twice":
        rows.insert(i, rows[i])
    elif way == "field less":
        del rows[i][j]
    elif way == "field more":
        rows[i].insert(j, "7")
    stream = io.StringIO()
    csv.writer(stream, delimiter=_pick(random, ";\t|") if way == "separator" else ",").writerows(rows)
    return way, stream.getvalue().encode("utf-8", "replace")


def _csv_faults(raw: bytes, found: Any) -> str:
    corners, readings = found
    said: dict[str, dict[str, dict[str, tuple[float, float]]]] = {}
    for row in csv.DictReader(io.StringIO(raw.decode("utf-8-sig"), newline="")):
        cells = {str(key).strip(): (value or "").strip() for key, value in row.items()}
        image = said.setdefault(cells["image"].removeprefix("'"), {}).setdefault(cells["level"], {})
        try:
            place = (float(cells["x"]), float(cells["y"]))
        except ValueError:
            place = (math.nan, math.nan)
        image[cells["corner"] if cells["corner"] not in image else f"{cells['corner']} again"] = place
    for image in corners.images:
        if not isinstance(image, ImageCorners):
            continue
        rows = said.get(image.image)
        if rows is None or set(rows) != set(image.levels):
            return f"{image.image}: other vertebrae than in the file"
        for level, quad in zip(image.levels, image.corners):
            if len(rows[level]) != 4 or sorted(rows[level].values()) != sorted(map(tuple, quad.tolist())):
                return f"{image.image}.{level}: other corners than in the file"
    return _angles(readings)


def _markup_faults(raw: bytes, found: Any) -> str:
    corners, readings = found
    points = raw.count(b'"position"') or sum(len(v) for v in re.findall(rb"\[\[.*?\]\]", raw))
    for image in corners.images:
        if not isinstance(image, ImageCorners):
            continue
        if len(set(image.levels)) < len(image.levels) or not set(image.levels) <= set(VERTEBRAE):
            return f"{image.image}: levels {image.levels}"
        if not np.isfinite(image.corners).all() or 4 * len(image.levels) > points:
            return f"{image.image}: corners"
    return _angles(readings)


# The campaign


def prepared(name: str, number: int, seed: int, place: Path, material: Material) -> Case:
    """The case of a class and number."""
    make = CLASSES[name][0]
    return make(np.random.default_rng([seed, list(CLASSES).index(name), number]), place, material)


def tried(case: Case, place: Path) -> tuple[str, str]:
    """Outcome and detail of a case."""
    before = _digests(place)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            value = case.read()
    except SpinestiffError as refusal:
        outcome, detail = _judged_line(str(refusal).replace(str(place), ""), case.names)
    except BaseException as problem:
        outcome, detail = "traceback", f"{type(problem).__name__}: {problem}"
    else:
        try:
            detail = case.wrong(value)
        except Exception as problem:
            detail = f"the rule found nothing that it could judge: {type(problem).__name__}: {problem}"
        outcome = "wrong" if detail else "right"
    after = _digests(place)
    changed = sorted(name for name in before if after.get(name) != before[name])
    return ("overwritten", ", ".join(changed)) if changed else (outcome, detail)


def _judged_line(line: str, names: tuple[str, ...]) -> tuple[str, str]:
    clear = (
        line.strip() and line.isprintable() and len(line) <= LONGEST_LINE
        and len(line.split()) >= 3 and not FOREIGN_WORDS.search(line) and any(name in line for name in names if name)
    )  # fmt: skip
    return ("refused" if clear else "unclear"), line


def _digests(place: Path) -> dict[str, str]:
    found = {}
    for path in sorted(place.rglob("*")):
        if path.is_symlink():
            found[str(path)] = os.readlink(path)
        elif path.is_file():
            large = path.stat().st_size > 2**30
            found[str(path)] = str(path.stat().st_mtime_ns) if large else hashlib.sha256(path.read_bytes()).hexdigest()
        else:
            found[str(path)] = str(path.stat().st_mode)
    return found


def _serve(connection: multiprocessing.connection.Connection, material: Material, seed: int) -> None:
    while True:
        name, number = connection.recv()
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            os.chdir(place)
            case = prepared(name, number, seed, place, material)
            connection.send(("made", case.way))
            connection.send(tried(case, place))
            os.chdir("/")


class _Child:
    """The process that reads; a new one after its end or a hang."""

    def __init__(self, material: Material, seed: int) -> None:
        self.material, self.seed = material, seed
        self.start()

    def start(self) -> None:
        context = multiprocessing.get_context("fork")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, self.material, self.seed), daemon=True)
        self.process.start()
        other.close()

    def end(self) -> None:
        self.process.kill()
        self.process.join()

    def ask(self, name: str, number: int) -> tuple[str, str, str]:
        """Way, outcome and detail."""
        self.connection.send((name, number))
        way = ""
        try:
            _, way = self.connection.recv()
            if self.connection.poll(MOST_SECONDS):
                return (way, *self.connection.recv())
            outcome, detail = "hang", ""
        except EOFError:
            outcome, detail = "traceback", "the process ended"
        self.end()
        self.start()
        return way, outcome, detail


def campaign(inputs: int, seed: int, only: str | None) -> Iterator[tuple[str, int, str, str, str]]:
    """Class, number, way, outcome and detail of each input."""
    shares = sum(share for _, share in CLASSES.values())
    with tempfile.TemporaryDirectory() as folder:
        child = _Child(sound(Path(folder)), seed)
        for name, (_, share) in CLASSES.items():
            if only in (None, name):
                for number in range(max(1, round(inputs * share / shares))):
                    yield name, number, *child.ask(name, number)
        child.end()


def main() -> None:
    """Run the campaign and print what came out."""
    parser = argparse.ArgumentParser(description="bad inputs against every reader")
    parser.add_argument("--inputs", type=int, default=12_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(CLASSES))
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    parser.add_argument("--write", action="store_true", help="store the figures in results/bad_inputs.json")
    asked = parser.parse_args()
    counts: dict[str, Counter[str]] = {}
    faults = []
    for name, number, way, outcome, detail in campaign(asked.inputs, asked.seed, asked.only):
        counts.setdefault(name, Counter())[outcome] += 1
        if outcome not in ("right", "refused"):
            faults.append((name, number, way, outcome, detail[:400]))
    total = sum((one for one in counts.values()), Counter[str]())
    found = {
        "date": datetime.date.today().isoformat(),
        "seed": asked.seed,
        "inputs": total.total(),
        "all": {outcome: total[outcome] for outcome in OUTCOMES},
        "classes": {name: {outcome: one[outcome] for outcome in OUTCOMES} for name, one in counts.items()},
        "rules": {name: " ".join((CLASSES[name][0].__doc__ or "").split()) for name in counts},
    }
    if asked.json:
        print(json.dumps({**found, "faults": faults}, indent=1))
    else:
        for name, one in (*counts.items(), ("all", total)):
            print(f"{name:<24}" + "".join(f"{outcome} {one[outcome]:<6}" for outcome in OUTCOMES))
        for fault in faults:
            print(*fault)
    if asked.write:
        (RESULTS / "bad_inputs.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
