import numpy as np
import pytest

from spinestiff.anatomy.importing.orienting import axes_matrix, find_placement
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.errors import TorsoError


def placed(bones, matrix):
    """The bones in the coordinates of files: ``matrix`` takes world mm there."""
    return {
        name: (vertices @ np.asarray(matrix).T + [5.0, -7.0, 3.0], faces) for name, (vertices, faces) in bones.items()
    }


@pytest.mark.parametrize("axes", ["LSA", "LPS", "RAS", "ASR", "ALS", "SAL"])
@pytest.mark.parametrize(("unit", "mm"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0)])
def test_unit_and_axes_are_found(template_bones, axes, unit, mm):
    file_from_world = axes_matrix(axes).T / mm
    found = find_placement(placed(template_bones, file_from_world))
    assert (found.unit, found.axes, found.told) == (unit, axes, ())
    np.testing.assert_allclose(found.world_from_file @ file_from_world, np.eye(3), atol=1e-12)
    assert f"unit {unit} (found), axes {axes}" in str(found)


def test_what_is_told_is_kept_and_said(template_bones):
    found = find_placement(placed(template_bones, axes_matrix("LPS").T), unit="mm", axes="lps")
    assert found.told == ("unit", "axes") and "as told" in str(found) and found.axes == "LPS"


def test_what_is_told_wrongly_is_refused(template_bones):
    with pytest.raises(TorsoError, match=r"in m a vertebra would measure .* the files look like mm"):
        find_placement(template_bones, unit="m")
    with pytest.raises(TorsoError, match=r"axes LPS contradict .* look like LSA"):
        find_placement(template_bones, axes="LPS")
    with pytest.raises(TorsoError, match=r"unit 'inch'"):
        find_placement(template_bones, unit="inch")


@pytest.mark.parametrize(
    ("axes", "message"),
    [("XYZ", "three letters"), ("LS", "three letters"), ("LRS", "along one line"), ("RPS", "left-handed")],
)
def test_axes_that_are_none(axes, message):
    with pytest.raises(TorsoError, match=message):
        axes_matrix(axes)


def test_a_mirrored_body_or_swapped_sides_are_refused(template_bones):
    with pytest.raises(TorsoError, match=r"left-handed: left and right are swapped"):
        find_placement(placed(template_bones, np.diag([-1.0, 1.0, 1.0])))


def test_a_unit_that_is_none_is_refused(template_bones):
    with pytest.raises(TorsoError, match=r"none in mm, cm, m"):
        find_placement(placed(template_bones, 25.0 * np.eye(3)))


@pytest.mark.parametrize(
    ("factor", "why"),
    [(1e-3, r"mm against m\?"), (1000.0, r"mm against m\?"), (0.1, r"mm against cm\?"), (4.0, "whose")],
)
def test_one_bone_of_another_size_is_named(template_bones, factor, why):
    bones = dict(template_bones)
    bones["R6_L"] = (bones["R6_L"][0] * factor, bones["R6_L"][1])
    with pytest.raises(TorsoError, match=f"^R6_L is .* times too .*{why}"):
        find_placement(bones)


@pytest.mark.parametrize(
    ("one", "other", "message"), [("T4", "T5", "T4 lies below T5"), ("R9_L", "R9_R", "R9_L lies to the right of R9_R")]
)
def test_swapped_names_are_refused(template_bones, one, other, message):
    bones = template_bones | {one: template_bones[other], other: template_bones[one]}
    with pytest.raises(TorsoError, match=message):
        find_placement(bones)


@pytest.mark.parametrize(
    ("part", "side"),
    [(lambda x: x > -45.0, "right"), (lambda x: x < 45.0, "left"), (lambda x: np.abs(x) < 45.0, "left")],
    ids=["no right hip", "no left hip", "sacrum alone"],
)
def test_a_pelvis_without_a_hip_bone_is_refused(template_bones, part, side):
    vertices, faces = template_bones["pelvis"]
    faces = faces[part(vertices[faces, 0].mean(1))]
    used, number = np.unique(faces, return_inverse=True)
    bones = template_bones | {"pelvis": (vertices[used], number.reshape(faces.shape))}
    with pytest.raises(TorsoError, match=rf"^pelvis reaches \d\d mm to the {side} of L5, wanted some 1[23]\d mm"):
        find_placement(placed(bones, axes_matrix("LPS").T / 10.0))


def test_a_body_that_lies_askew_needs_to_be_turned_or_told(template_bones):
    askew = exp_so3(np.array([0.0, 0.75, 0.0]))
    with pytest.raises(TorsoError, match=r"degrees off the files' axes"):
        find_placement(placed(template_bones, askew))
    assert find_placement(placed(template_bones, askew), axes="LSA").axes == "LSA"


def test_bones_each_in_its_own_place_are_refused(template_bones):
    alone = {name: (vertices - vertices.mean(0), faces) for name, (vertices, faces) in template_bones.items()}
    with pytest.raises(TorsoError, match=r"own frame|lies below|left-handed|off the files' axes|on top of each other"):
        find_placement(alone)
