import json
from pathlib import Path

import pytest

from spinestiff.anatomy.importing.naming import bone_of_name, find_files
from spinestiff.anatomy.names import BONES
from spinestiff.errors import TorsoError


@pytest.fixture
def folder(tmp_path):
    """Empty files, a bone each: naming looks at names alone."""
    (tmp_path / "bones").mkdir()
    for name in BONES:
        (tmp_path / "bones" / f"{name}.stl").touch()
    return tmp_path / "bones"


def mapping(folder, **record):
    path = folder.parent / "map.json"
    path.write_text(json.dumps(record))
    return path


@pytest.mark.parametrize(
    ("name", "bone"),
    [
        ("T1", "T1"), ("thoracic12", "T12"), ("vertebrae_L5", "L5"), ("Th3", "T3"), ("lumbar1", "L1"),
        ("R10_L", "R10_L"), ("rib_left_7", "R7_L"), ("rib3_R", "R3_R"), ("Right Rib 12", "R12_R"),
        ("clavicula_left", "clavicle_L"), ("scapula_R", "scapula_R"), ("humerus_l", "humerus_L"),
        ("hip_right", "pelvis"), ("l_pelvis", "pelvis"), ("sacrum", "pelvis"), ("sternum", "sternum"),
        ("skin", "skin"), ("T13", None), ("L6", None), ("rib13_L", None), ("rib3", None), ("rib_left_3_R", None),
        ("skull", None), ("femur_left", None), ("C7", None), ("", None), ("l", None),
    ],
)  # fmt: skip
def test_names_people_use(name, bone):
    assert bone_of_name(name) == bone


def test_own_names_need_no_mapping(folder):
    found = find_files(folder)
    assert tuple(found.bones) == BONES
    assert all(paths[0].stem == bone for bone, paths in found.bones.items())
    assert found.skin is None


def test_a_pelvis_in_parts_is_one_bone(folder):
    (folder / "pelvis.stl").unlink()
    for name in ("sacrum.stl", "hip_left.ply", "r_pelvis.obj"):
        (folder / name).touch()
    assert {path.name for path in find_files(folder).bones["pelvis"]} == {"sacrum.stl", "hip_left.ply", "r_pelvis.obj"}


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ("skull.stl", "skull.stl: no bone of the torso by this name"),
        ("vertebra_t5.ply", "T5.stl, vertebra_t5.ply would all be T5"),
        ("T5.obj", "would all be T5"),
        ("sacrum.stl", "would all be pelvis"),
        ("T13.stl", "T13.stl: no bone"),
    ],
)
def test_unknown_and_duplicate_names_are_refused(folder, extra, message):
    (folder / extra).touch()
    with pytest.raises(TorsoError, match=message):
        find_files(folder)


@pytest.mark.parametrize("mapped", [False, True], ids=["by name", "beside a mapping"])
@pytest.mark.parametrize(
    ("whole", "files", "message"),
    [
        ("pelvis", ("sacrum.stl", "hip_left.stl", "l_pelvis.ply"), "hip_left.stl, l_pelvis.ply, sacrum.stl"),
        ("pelvis", ("pelvis.stl", "sacrum.stl"), "pelvis.stl, sacrum.stl"),
        ("sternum", ("sternum.stl", "sternum.obj"), "sternum.obj, sternum.stl"),
        ("sternum", ("Manubrium.ply", "manubrium.stl", "sternum.stl"), "Manubrium.ply, manubrium.stl, sternum.stl"),
    ],
)
def test_a_part_given_twice_or_beside_the_whole_is_refused(folder, whole, files, message, mapped):
    (folder / f"{whole}.stl").unlink()
    for name in files:
        (folder / name).touch()
    with pytest.raises(TorsoError, match=f"^{message} would all be {whole}; "):
        find_files(folder, mapping(folder, unit="mm") if mapped else None)


@pytest.mark.parametrize("mapped", [False, True], ids=["by name", "beside a mapping"])
def test_a_skin_that_is_stated_is_the_skin_whatever_its_name(folder, mapped):
    (folder / "body.ply").touch()
    found = find_files(folder, mapping(folder, unit="mm") if mapped else None, folder / "." / "body.ply")
    assert found.skin == folder / "body.ply" and tuple(found.bones) == BONES


def test_a_mapping_as_windows_editors_save_it_is_read(folder):
    path = mapping(folder, unit="cm")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert find_files(folder, path).unit == "cm"


def test_a_bone_is_no_skin(folder):
    """Unless a mapping says which file is which."""
    bone = folder / "R7_L.stl"
    with pytest.raises(TorsoError, match="has the name of a bone, R7_L; wanted the file of the skin, or another name"):
        find_files(folder, skin=bone)
    elsewhere = folder.parent / "R7_L.stl"
    elsewhere.write_bytes(b"x")
    assert find_files(folder, skin=elsewhere).skin == elsewhere


def test_a_skin_by_its_name_is_the_skin_unless_a_mapping_names_another(folder):
    for name in ("skin.stl", "body.ply"):
        (folder / name).touch()
    path = mapping(folder, ignore=["body.ply"])
    assert find_files(folder, path).skin == folder / "skin.stl"
    assert find_files(folder, mapping(folder, skin="body.ply")).skin == folder / "body.ply"


def test_a_mapping_is_read_as_every_json_file_is(folder):
    path = folder.parent / "map.json"
    for text, message in (
        ('{"unit": "mm",}', r"^map.json: not JSON at line 1, column \d+: .*comma"),
        ('{"unit": "m", "unit": "mm"}', "^map.json: key 'unit' is given twice in one object; keep one$"),
        ('{"height_cm": NaN}', "^map.json: found NaN, wanted a finite number$"),
        ("PK\x03\x04", "map.json: a spreadsheet program's own format"),
    ):
        path.write_text(text)
        with pytest.raises(TorsoError, match=message):
            find_files(folder, path)


def test_hidden_files_are_passed_by(folder):
    """What macOS leaves beside each file on other disks."""
    (folder / "._T5.stl").touch()
    (folder / ".skull.ply").touch()
    assert find_files(folder).bones["T5"] == (folder / "T5.stl",)


def test_a_folder_s_name_with_a_zero_byte_is_none():
    with pytest.raises(TorsoError, match=r"^'bones\\x00': no name of a folder$"):
        find_files(Path("bones\0"))


def test_a_missing_bone_is_named(folder):
    (folder / "R7_L.stl").unlink()
    (folder / "T4.stl").unlink()
    with pytest.raises(TorsoError, match="no mesh for T4, R7_L; all 49"):
        find_files(folder)


def test_no_folder_and_no_mesh(tmp_path):
    with pytest.raises(TorsoError, match="no such file"):
        find_files(tmp_path / "none")
    with pytest.raises(TorsoError, match="holds no mesh"):
        find_files(tmp_path)


def test_a_mapping_names_ignores_and_leaves_the_rest_to_names(folder):
    (folder / "T5.stl").rename(folder / "object_17.stl")
    (folder / "skull.stl").touch()
    (folder / "body.ply").touch()
    path = mapping(
        folder,
        bones={"T5": "object_17.stl"},
        ignore=["skull.stl"],
        skin="body.ply",
        unit="m",
        axes="LPS",
        height_cm=161,
    )
    found = find_files(folder, path)
    assert found.bones["T5"][0].name == "object_17.stl"
    assert found.skin.name == "body.ply" and found.ignored == ("skull.stl",)
    assert (found.unit, found.axes, found.height_cm) == ("m", "LPS", 161.0)


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ({"bones": {"T5": "none.stl"}}, "no mesh 'none.stl'"),
        ({"bones": {"T5": "../../secret.stl"}}, "no mesh"),
        ({"bones": {"T99": "T5.stl"}}, "no bone 'T99'"),
        ({"bones": {"T5": "T4.stl"}}, "no mesh for T4|would both be T5"),
        ({"bones": {"T5": "T4.stl", "T4": "T4.stl"}}, "T4.stl stands for both"),
        ({"bones": {"T5": []}}, "T5: no file named"),
        ({"bones": ["T5"]}, "no object"),
        ({"ignore": "T5.stl"}, "no list"),
        ({"ignore": ["T5.stl"]}, "no mesh for T5"),
        ({"unit": 3}, '"unit" is no text'),
        ({"height_cm": "tall"}, '^map.json: "height_cm" is no number from 90 to 230$'),
        ({"height_cm": 10**400}, '^map.json: "height_cm" is no number from 90 to 230$'),
        ({"height_cm": 1600}, '^map.json: "height_cm" is no number from 90 to 230$'),
        ({"colour": "red"}, "unknown key 'colour'"),
        ([1], "no object"),
    ],
)
def test_mappings_that_say_what_is_not_so(folder, record, message):
    path = folder.parent / "map.json"
    path.write_text(json.dumps(record))
    with pytest.raises(TorsoError, match=message):
        find_files(folder, path)


@pytest.mark.parametrize("text", ["", "{", '{"unit": "m", "unit": "mm"}', "[" * 100_000, '{"a": 1e999}', "\xff"])
def test_mappings_that_are_no_json(folder, text):
    path = folder.parent / "map.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(TorsoError) as caught:
        find_files(folder, path)
    assert "\n" not in str(caught.value) and "map.json" in str(caught.value)
