import struct

import numpy as np
import pytest

from spinestiff.anatomy.importing import reading
from spinestiff.anatomy.importing.reading import read_surface
from spinestiff.anatomy.template.surfaces import ball, signed_volume
from spinestiff.errors import TorsoError

VERTICES, FACES = ball(np.array([3.0, -4.0, 50.0]), 20.0)
VOLUME = signed_volume((VERTICES, FACES))
VTP_FORMS = [
    {"form": form, "packed": packed, "order": order, "header": header}
    for form in ("ascii", "binary", "appended-raw", "appended-base64")
    for packed in (False, True)
    for order, header in (("<", "u4"), (">", "u8"))
    if not (form == "ascii" and packed)
]


def read(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    return read_surface(tmp_path / name)


def refusal(tmp_path, name, content) -> str:
    with pytest.raises(TorsoError) as caught:
        read(tmp_path, name, content)
    message = str(caught.value)
    assert name in message and "\n" not in message
    return message


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "vtp"])
def test_every_kind_of_file_gives_the_same_surface(tmp_path, meshes, kind):
    surface = read(tmp_path, f"bone.{kind}", getattr(meshes, kind)(VERTICES, FACES))
    assert len(surface[1]) == len(FACES)
    assert signed_volume(surface) == pytest.approx(VOLUME, rel=1e-5)
    assert np.ptp(surface[0], axis=0) == pytest.approx(np.ptp(VERTICES, axis=0), rel=1e-5)


@pytest.mark.parametrize("options", VTP_FORMS, ids=lambda o: "-".join(map(str, o.values())))
def test_vtp_in_all_its_encodings(tmp_path, meshes, options):
    vertices, faces = read(tmp_path, "bone.vtp", meshes.vtp(VERTICES, FACES, **options, block=600))
    np.testing.assert_allclose(vertices, VERTICES, rtol=1e-6)
    np.testing.assert_array_equal(faces, FACES)


def test_vtp_polygons_become_fans_and_strips_triangles(tmp_path):
    points = "0 0 0 1 0 0 1 1 0 0 1 0"
    text = (
        '<VTKFile type="PolyData"><PolyData><Piece><Points><DataArray type="Float64" NumberOfComponents="3">'
        f'{points}</DataArray></Points><Polys><DataArray type="Int32" Name="connectivity">0 1 2 3</DataArray>'
        '<DataArray type="Int32" Name="offsets">4</DataArray></Polys><Strips><DataArray type="Int32" '
        'Name="connectivity">0 1 3 2</DataArray><DataArray type="Int32" Name="offsets">4</DataArray></Strips>'
        "</Piece></PolyData></VTKFile>"
    )
    _, faces = read(tmp_path, "bone.vtp", text.encode())
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 3], [3, 1, 2]]


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "vtp"])
@pytest.mark.parametrize("content", [b"", b"   \n", b"nothing of the kind", b"\x00" * 100, b"<", b"ply\n", b"solid\n"])
def test_what_is_no_mesh_is_refused_in_a_line(tmp_path, kind, content):
    refusal(tmp_path, f"bone.{kind}", content)


NAME = "Wirbelkörper".encode("latin-1")


@pytest.mark.parametrize("kind", ["stl", "ascii.stl", "obj", "ply"])
def test_text_of_any_encoding_in_a_file_is_passed_by(tmp_path, meshes, kind):
    if kind == "ascii.stl":
        lines = [b"solid " + NAME]
        for corners in VERTICES[FACES]:
            lines += [b"facet normal 0 0 0", b"outer loop"]
            lines += ["vertex {} {} {}".format(*map(float, corner)).encode() for corner in corners]
            lines += [b"endloop", b"endfacet"]
        content = b"\n".join([*lines, b"endsolid " + NAME, b""])
    else:
        content = getattr(meshes, kind)(VERTICES, FACES)
        if kind == "stl":
            content = NAME.ljust(80) + content[80:]
        elif kind == "obj":
            content = b"# " + NAME + b"\no " + NAME + b"\n" + content
        else:
            content = content.replace(b"\nelement vertex", b"\ncomment " + NAME + b"\nelement vertex", 1)
    assert NAME in content
    vertices, faces = read(tmp_path, f"bone.{kind}", content)
    assert signed_volume((vertices, faces)) == pytest.approx(VOLUME, rel=1e-5)


@pytest.mark.parametrize("kind", ["stl", "obj", "ply"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e9])
def test_numbers_that_are_none_are_refused(tmp_path, meshes, kind, bad):
    vertices = VERTICES.copy()
    vertices[FACES[5, 1], 2] = bad
    refusal(tmp_path, f"bone.{kind}", getattr(meshes, kind)(vertices, FACES))


@pytest.mark.parametrize("kind", ["obj", "ply", "vtp"])
def test_vertices_of_no_triangle_are_passed_by(tmp_path, meshes, kind):
    """Some programs write those of a whole scene into the file of each of its objects."""
    vertices = np.vstack([[[9e3, 9e3, 9e3]], VERTICES[:5], [[-9e3, 9e3, 9e3]], VERTICES[5:]])
    faces = np.where(FACES < 5, FACES + 1, FACES + 2)
    surface = read(tmp_path, f"bone.{kind}", getattr(meshes, kind)(vertices, faces))
    np.testing.assert_allclose(surface[0][surface[1]], VERTICES[FACES], rtol=1e-6)
    assert len(surface[0]) == len(VERTICES)


def test_a_face_beyond_the_vertices_is_refused(tmp_path, meshes):
    faces = FACES.copy()
    faces[3, 0] = 999
    for kind in ("obj", "ply", "vtp"):
        refusal(tmp_path, f"bone.{kind}", getattr(meshes, kind)(VERTICES, faces))


@pytest.mark.parametrize("wrong", [-5, 999])
def test_the_vertex_that_is_not_there_is_named(tmp_path, meshes, wrong):
    faces = FACES.copy()
    faces[3, 0] = wrong
    told = refusal(tmp_path, "bone.ply", meshes.ply(VERTICES, faces))
    assert told == f"bone.ply: a triangle names vertex {wrong}, but there are {len(VERTICES)}, from 0 on"


@pytest.mark.parametrize("change", [-1, -60, 7])
@pytest.mark.parametrize("title", [b"bone", b"solid bone"])
def test_a_binary_stl_of_another_length_than_it_says_is_told(tmp_path, meshes, change, title):
    content = title.ljust(80) + meshes.stl(VERTICES, FACES)[80:]
    cut = content[:change] if change < 0 else content + bytes(change)
    assert refusal(tmp_path, "bone.stl", cut) == (
        f"bone.stl has {len(cut):,} bytes, but by its number of triangles {len(content):,}; copy or export it again"
    )


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("faces", [[(0, 1, 2), (0, 1, 2, 3)], [(0, 1, 2, 3, 4), (0, 1, 2), (2, 3, 4)]])
def test_a_binary_ply_of_faces_of_several_kinds_says_what_to_do(tmp_path, order, faces):
    content = binary_ply(faces, order)
    few, many = min(map(len, faces)), max(map(len, faces))
    told = refusal(tmp_path, "skin.ply", content)
    assert told == (
        f"skin.ply has faces of {few} to {many} corners, wanted triangles alone, as it is a binary PLY; make triangles "
        "of them in the program that it comes from, or export it as STL or OBJ"
    )
    # Cut short it is that, and no more is said of its faces.
    assert "can't be read as PLY" in refusal(tmp_path, "skin.ply", content[:-3])
    # Faces of one kind are fanned, as everywhere.
    assert len(read(tmp_path, "skin.ply", binary_ply(faces[:1], order))[1]) == len(faces[0]) - 2


def binary_ply(faces, order):
    """Five vertices with a colour each, and faces with one, too."""
    title = "little" if order == "<" else "big"
    head = (
        f"ply\nformat binary_{title}_endian 1.0\ncomment by hand\nelement vertex 5\nproperty float x\n"
        f"property float y\nproperty double z\nproperty uchar red\nelement face {len(faces)}\n"
        "property list uchar int vertex_indices\nproperty uchar red\nend_header\n"
    )
    vertices = (struct.pack(f"{order}ffdB", np.cos(k), np.sin(k), 0.1 * k, 7) for k in range(5))
    corners = (struct.pack(f"{order}B{len(face)}iB", len(face), *face, 7) for face in faces)
    return head.encode() + b"".join((*vertices, *corners))


def test_too_large_files_are_refused_before_they_are_read(tmp_path, meshes, monkeypatch):
    monkeypatch.setattr(reading, "MOST_BYTES", 1000)
    assert "at most" in refusal(tmp_path, "bone.stl", meshes.stl(VERTICES, FACES))
    monkeypatch.undo()
    monkeypatch.setattr(reading, "MOST_FACES", 10)
    assert "at most 10" in refusal(tmp_path, "bone.stl", meshes.stl(VERTICES, FACES))


@pytest.mark.parametrize("cut", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("kind", ["stl", "vtp"])
def test_files_cut_short_are_refused(tmp_path, meshes, kind, cut):
    content = meshes.stl(VERTICES, FACES) if kind == "stl" else meshes.vtp(VERTICES, FACES, form="appended-raw")
    refusal(tmp_path, f"bone.{kind}", content[: int(cut * len(content))])


def test_vtp_entities_are_never_expanded(tmp_path):
    bomb = b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><VTKFile>&b;</VTKFile>'
    assert "document type" in refusal(tmp_path, "bone.vtp", bomb)


def test_a_packed_vtp_block_that_unpacks_to_more_than_it_says_is_refused(tmp_path, meshes, monkeypatch):
    content = meshes.vtp(np.zeros((60_000, 3)), FACES, form="binary", packed=True, block=800_000)
    monkeypatch.setattr(reading, "MOST_VTP_BYTES", 500_000)
    assert "larger than allowed" in refusal(tmp_path, "bone.vtp", content)


@pytest.mark.parametrize("options", VTP_FORMS, ids=lambda o: "-".join(map(str, o.values())))
def test_the_arrays_of_a_vtp_file_share_one_limit(tmp_path, meshes, monkeypatch, options):
    numbers = VERTICES.size + FACES.size + len(FACES)
    content = meshes.vtp(VERTICES, FACES, **options)
    monkeypatch.setattr(reading, "MOST_VTP_BYTES", 8 * numbers)
    assert len(read(tmp_path, "bone.vtp", content)[1]) == len(FACES)
    monkeypatch.setattr(reading, "MOST_VTP_BYTES", 8 * numbers - 1)
    assert "larger than allowed" in refusal(tmp_path, "bone.vtp", content)


def test_of_a_vtp_file_only_corners_and_points_are_read(tmp_path, meshes):
    """Other arrays of its cells may hold anything."""
    content = meshes.vtp(VERTICES, FACES)
    more = b'<DataArray type="Int32" Name="more">no number</DataArray>'
    assert len(read(tmp_path, "bone.vtp", content.replace(b"<Polys>", b"<Polys>" + 3 * more))[1]) == len(FACES)


def test_other_packers_are_named(tmp_path, meshes):
    content = meshes.vtp(VERTICES, FACES, form="binary", packed=True).replace(b"vtkZLib", b"vtkLZ4")
    assert "vtkLZ4DataCompressor" in refusal(tmp_path, "bone.vtp", content)


def test_random_damage_never_ends_in_a_traceback(tmp_path, meshes):
    rng, said = np.random.default_rng(0), []
    for i in range(60):
        form = ("binary", "appended-raw")[i % 2]
        content = bytearray(meshes.vtp(VERTICES, FACES, form=form, packed=i % 3 == 0))
        for at in rng.integers(0, len(content), 12):
            content[at] = int(rng.integers(0, 256))
        (tmp_path / "bone.vtp").write_bytes(bytes(content))
        try:
            vertices, faces = read_surface(tmp_path / "bone.vtp")
        except TorsoError as error:
            said.append(str(error))
        else:
            assert faces.max() < len(vertices)
    assert said and not any("\n" in line for line in said)


def test_a_text_ply_cut_between_two_lines_is_refused(tmp_path, meshes):
    import trimesh

    path = tmp_path / "bone.ply"
    text = trimesh.creation.icosphere(1).export(file_type="ply", encoding="ascii")
    path.write_bytes(text)
    assert len(read_surface(path)[1]) == 80
    path.write_bytes(b"\n".join(text.split(b"\n")[:-10]))
    with pytest.raises(TorsoError, match=r"bone\.ply says 80 faces, but holds \d+; copy the file again"):
        read_surface(path)
