"""Folders of bone meshes written from the template, whole or spoilt in one way."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from conftest import made_once
from spinestiff.anatomy.importing.placing import place_joints
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.template import template_torso


def stl_bytes(vertices, faces) -> bytes:
    record = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("_", "<u2")])
    record["corners"] = np.asarray(vertices)[faces]
    return b" " * 80 + struct.pack("<I", len(faces)) + record.tobytes()


def obj_bytes(vertices, faces) -> bytes:
    lines = ["mtllib /no/such/file.mtl", "o bone"]
    lines += ["v " + " ".join(f"{x:.9g}" for x in v) for v in np.asarray(vertices)]
    lines += ["f " + " ".join(str(i + 1) for i in f) for f in np.asarray(faces)]
    return "\n".join(lines).encode()


def ply_bytes(vertices, faces) -> bytes:
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    lines = [" ".join(f"{x:.9g}" for x in v) for v in np.asarray(vertices)]
    lines += ["3 " + " ".join(map(str, f)) for f in np.asarray(faces)]
    return (head + "\n".join(lines) + "\n").encode()


def vtp_bytes(vertices, faces, form="ascii", packed=False, order="<", header="u4", block=4096) -> bytes:
    """A .vtp file: ``form`` ascii, binary (base64), appended-raw or appended-base64."""
    arrays = [np.asarray(vertices, dtype="f4"), np.asarray(faces, dtype="i8"), 3 * np.arange(1, len(faces) + 1)]
    appended, tags = b"", []
    for array, kind, name in zip(arrays, ("Float32", "Int64", "Int64"), ("Points", "connectivity", "offsets")):
        array = array.astype(array.dtype.newbyteorder(order))
        attributes = f'type="{kind}" Name="{name}" NumberOfComponents="{3 if name == "Points" else 1}"'
        if form == "ascii":
            tags.append(
                f'<DataArray {attributes} format="ascii">{" ".join(map(str, array.ravel().tolist()))}</DataArray>'
            )
            continue
        data = array.tobytes()
        if packed:
            parts = [data[i : i + block] for i in range(0, len(data), block)]
            shut = [zlib.compress(part) for part in parts]
            last = len(parts[-1]) if len(parts[-1]) < block else 0
            head = np.array([len(parts), block, last, *map(len, shut)], dtype=order + header).tobytes()
            body = b"".join(shut)
            text = base64.b64encode(head) + base64.b64encode(body)
        else:
            head, body = np.array([len(data)], dtype=order + header).tobytes(), data
            text = base64.b64encode(head + body)
        if form == "binary":
            tags.append(f'<DataArray {attributes} format="binary">\n {text.decode()}\n</DataArray>')
        else:
            tags.append(f'<DataArray {attributes} format="appended" offset="{len(appended)}"/>')
            appended += head + body if form == "appended-raw" else text
    tail = ""
    if form.startswith("appended"):
        tail = f'<AppendedData encoding="{form.removeprefix("appended-")}">\n _'
    compressor = ' compressor="vtkZLibDataCompressor"' if packed else ""
    byte_order = "LittleEndian" if order == "<" else "BigEndian"
    start = (
        f'<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" byte_order="{byte_order}" '
        f'header_type="UInt{8 * int(header[1])}"{compressor}>\n<PolyData><Piece NumberOfPoints="{len(vertices)}" '
        f'NumberOfPolys="{len(faces)}"><Points>{tags[0]}</Points><Polys>{tags[1]}{tags[2]}</Polys></Piece></PolyData>\n'
    )
    end = b"</VTKFile>\n"
    if tail:
        return start.encode() + tail.encode() + appended + b"\n</AppendedData>\n" + end
    return start.encode() + end


WRITERS = {".stl": stl_bytes, ".obj": obj_bytes, ".ply": ply_bytes, ".vtp": vtp_bytes}


@pytest.fixture(scope="session")
def template():
    return template_torso(157.0)


@pytest.fixture(scope="session")
def template_bones(template):
    """{bone: (vertices mm, faces)} in world axes."""
    return {
        name: (template.surface_positions(template.rest_pose, i), np.array(template.bone_surfaces[i].faces))
        for i, name in enumerate(BONES)
    }


@pytest.fixture(scope="session")
def shift():
    """How far ``placed``'s bones lie from the template's, as a user's do."""
    return np.array([12.0, -300.0, 44.0])


@pytest.fixture(scope="session")
def placed(template_bones, shift, tmp_path_factory):
    """What ``place_joints`` finds on the template's bones, moved: the skeleton and where its origin was."""
    moved = {name: (vertices + shift, faces) for name, (vertices, faces) in template_bones.items()}
    return made_once(tmp_path_factory, "placed", lambda folder: place_joints(moved))


def write_bones(folder: Path, bones, endings=(".stl",), matrix=None) -> Path:
    """A file a bone, endings in turn; ``matrix`` (3, 3) takes world mm to the files' unit and axes."""
    folder.mkdir(exist_ok=True)
    turn = np.eye(3) if matrix is None else np.asarray(matrix)
    for i, (name, (vertices, faces)) in enumerate(bones.items()):
        ending = endings[i % len(endings)]
        (folder / f"{name}{ending}").write_bytes(WRITERS[ending](vertices @ turn.T, faces))
    return folder


@pytest.fixture(scope="session")
def meshes():
    """The writers above, for tests: ``meshes.stl(vertices, faces)`` and so on, ``meshes.write(folder, bones)``."""
    return SimpleNamespace(stl=stl_bytes, obj=obj_bytes, ply=ply_bytes, vtp=vtp_bytes, write=write_bones)


@pytest.fixture
def bone_folder(template_bones, tmp_path):
    """All 49 bones as STL, mm, world axes."""
    return write_bones(tmp_path / "bones", template_bones)


@pytest.fixture(scope="session")
def shared_bones():
    """The real bone set, where there is one beside the checkout."""
    folder = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "bones"
    if not folder.is_dir():
        pytest.skip("needs the bone set of ../shared/data/bones")
    return folder
