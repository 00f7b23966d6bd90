import json
import zipfile
from io import BytesIO

import numpy as np
import pytest

from spinestiff.anatomy.files import SCHEMA_VERSION, read_torso, write_torso
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TorsoError


@pytest.fixture(scope="module")
def torso():
    return template_torso(150.0)


@pytest.fixture
def path(torso, tmp_path):
    write_torso(tmp_path / "torso.npz", torso)
    return tmp_path / "torso.npz"


def rewritten(path, **changes):
    with np.load(path) as stored:
        arrays = {key: stored[key] for key in stored.files}
    arrays |= changes
    with open(path, "wb") as stream:
        np.savez(stream, **{key: value for key, value in arrays.items() if value is not None})


def test_a_torso_comes_back_bit_by_bit(torso, path):
    again = read_torso(path)
    assert again.bone_names == torso.bone_names
    assert again.joints.names == torso.joints.names
    assert again.joints.kinds == torso.joints.kinds
    assert again.vertebrae == torso.vertebrae
    assert again.height_cm == torso.height_cm
    for key in ("rest_positions", "elements", "bone_of_node", "lame_mu", "lame_lambda"):
        np.testing.assert_array_equal(getattr(again.tissue, key), getattr(torso.tissue, key))
    for key in ("parent", "child", "parent_position", "parent_axes", "child_position", "child_axes", "stiffness"):
        np.testing.assert_array_equal(getattr(again.joints, key), getattr(torso.joints, key))
    for key in ("bone_positions", "bone_rotations", "tissue_positions"):
        np.testing.assert_array_equal(getattr(again.rest_pose, key), getattr(torso.rest_pose, key))
    assert set(again.landmarks) == set(torso.landmarks)
    for key, points in torso.landmarks.items():
        np.testing.assert_array_equal(again.landmarks[key].offset, points.offset)
        np.testing.assert_array_equal(again.landmarks[key].bone, points.bone)
    for a, b in zip(again.bone_surfaces, torso.bone_surfaces, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.faces, b.faces)


def test_the_same_torso_gives_the_same_bytes(torso, path, tmp_path):
    write_torso(tmp_path / "again.npz", torso)
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TorsoError, match=r"none\.npz: no such file$"):
        read_torso(tmp_path / "none.npz")


@pytest.mark.parametrize("content", [b"", b"not a torso", b"PK\x03\x04 half a zip", b"\x93NUMPY\x01\x00"])
def test_foreign_files_are_refused(tmp_path, content):
    (tmp_path / "x.npz").write_bytes(content)
    with pytest.raises(TorsoError, match="torso"):
        read_torso(tmp_path / "x.npz")


def test_an_npz_of_something_else_is_refused(tmp_path):
    np.savez(tmp_path / "x.npz", a=np.zeros(3))
    with pytest.raises(TorsoError, match="no torso file"):
        read_torso(tmp_path / "x.npz")


def test_a_pickle_is_never_opened(tmp_path):
    np.save(tmp_path / "x.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(TorsoError):
        read_torso(tmp_path / "x.npy")


def test_another_schema_version_is_refused(path):
    with np.load(path) as stored:
        header = json.loads(str(stored["header"]))
    header["schema_version"] = SCHEMA_VERSION + 1
    rewritten(path, header=np.array(json.dumps(header)))
    with pytest.raises(TorsoError, match=f"version {SCHEMA_VERSION + 1}"):
        read_torso(path)


@pytest.mark.parametrize(
    "change",
    [
        {"tissue_elements": None},
        {"tissue_elements": np.zeros((3, 7), dtype=int)},
        {"tissue_rest_positions": np.full((5, 3), np.nan)},
        {"surface_sizes": np.array([[4, 4]])},
        {"joints_parent": np.array([[1]])},
        {"header": np.array('{"schema": "spinestiff-torso"}')},
        {"height_cm": np.array("tall")},
        {"height_cm": np.array(np.nan)},
        {"surface_sizes": np.array([[-5, 4]] + [[0, 0]] * 48)},
        {"rest_bone_positions": np.zeros((49, 3), dtype=complex)},
        {"header": np.array("[" * 100_000)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_damaged_content_is_refused_in_one_line(path, change):
    rewritten(path, **change)
    with pytest.raises(TorsoError, match=r"torso\.npz") as caught:
        read_torso(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("place", [(0, 0), (0, 1), (48, 0)])
def test_sizes_of_surfaces_that_do_not_add_up_are_refused(torso, path, place):
    sizes = np.array([(len(s.vertices), len(s.faces)) for s in torso.bone_surfaces])
    sizes[place] += 3
    rewritten(path, surface_sizes=sizes)
    with pytest.raises(TorsoError, match=r"torso\.npz is damaged: the sizes of the bones' surfaces don't add up"):
        read_torso(path)


@pytest.mark.parametrize("words", [[1, 2], "T1", {"T1": 0}])
def test_names_that_are_no_list_of_words_are_refused(path, words):
    with np.load(path) as stored:
        header = json.loads(str(stored["header"]))
    for key in ("bone_names", "vertebrae", "joint_names", "joint_kinds", "landmarks"):
        rewritten(path, header=np.array(json.dumps({**header, key: words})))
        with pytest.raises(TorsoError, match=rf"torso\.npz is damaged: {key} is no list of words$"):
            read_torso(path)


def _with_array_of(shape, path):
    """The file with a header of ``joints_parent`` that promises an array of ``shape``."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    stream = BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    parts["joints_parent.npy"] = stream.getvalue() + bytes(64)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)


def _with_bytes(path, central, local, value):
    """The file with a byte of the first part's entries in the archive changed."""
    content = bytearray(path.read_bytes())
    content[content.find(b"PK\x01\x02") + central] = content[content.find(b"PK\x03\x04") + local] = value
    path.write_bytes(bytes(content))


def test_another_file_is_no_torso_and_nobody_is_told_to_run_code_in_it(path):
    path.write_text("no torso", encoding="utf-8")
    with pytest.raises(
        TorsoError,
        match=r"or it is damaged; name a torso\.npz, as spinestiff personalise and torso import write it$",
    ):
        read_torso(path)


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: _with_array_of((10**15, 3), path),
        lambda path: _with_array_of((2**62, 4), path),
        lambda path: _with_bytes(path, 8, 6, 1),
        lambda path: _with_bytes(path, 10, 8, 99),
    ],
    ids=["more than any memory", "more than can be counted", "encrypted", "unknown compression"],
)
def test_archives_that_cannot_be_unpacked_are_refused_in_one_line(path, damage):
    damage(path)
    with pytest.raises(TorsoError, match=r"^[^\n]*torso\.npz is no torso file, or it is damaged \([^\n]*\)$"):
        read_torso(path)


def test_a_truncated_file_is_refused(path):
    content = path.read_bytes()
    for share in (0.3, 0.7, 0.99):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(TorsoError):
            read_torso(path)


def test_flipped_bytes_are_noticed(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))
    with pytest.raises(TorsoError):
        read_torso(path)


def test_a_file_in_the_way_is_reported(torso, tmp_path):
    (tmp_path / "none").write_bytes(b"")
    with pytest.raises(TorsoError, match=r"none/torso\.npz: can't be written \("):
        write_torso(tmp_path / "none" / "torso.npz", torso)


def test_a_coordinate_that_no_body_has_is_refused(torso, tmp_path):
    path = tmp_path / "far.npz"
    write_torso(path, torso)
    with np.load(path) as stored:
        arrays = dict(stored)
    for key in ("rest_bone_positions", "tissue_rest_positions"):
        moved = arrays[key].copy()
        moved[1, 1] = -1e30
        np.savez(path, **{**arrays, key: moved})
        with pytest.raises(
            TorsoError, match=r"far\.npz is damaged: found a coordinate of 1e\+30 mm, wanted at most 10000"
        ):
            read_torso(path)
