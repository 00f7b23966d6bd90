import numpy as np
import pytest

from spinestiff.anatomy.importing.repairing import MOST_FACES, edges_of, repaired, thinned
from spinestiff.anatomy.solids import enclosed, exits
from spinestiff.anatomy.template.surfaces import ball, inside, joined, signed_volume
from spinestiff.errors import TorsoError

BALL = ball(np.array([3.0, -4.0, 50.0]), 20.0, 12, 20)
VOLUME = signed_volume(BALL)


def assert_closed(surface):
    edges = edges_of(surface[1])
    net = {}
    for a, b in edges.tolist():
        key = (min(a, b), max(a, b))
        net[key] = net.get(key, 0) + (1 if a < b else -1)
    assert not any(net.values())


def fixed(surface):
    found, notes = repaired("bone.stl", surface)
    assert_closed(found)
    return found, notes


def test_a_sound_surface_stays_and_says_nothing():
    found, notes = fixed(BALL)
    assert notes == []
    assert signed_volume(found) == pytest.approx(VOLUME, rel=1e-9)


def test_a_soup_of_triangles_is_sewn_together():
    vertices, faces = BALL
    soup = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    found, notes = fixed(soup)
    assert notes == [] and len(found[0]) == len(vertices)


def test_a_small_hole_is_closed_and_a_large_one_refused():
    vertices, faces = BALL
    found, notes = fixed((vertices, np.delete(faces, 40, axis=0)))
    assert len(notes) == 1 and "bone.stl: 1 hole closed" in notes[0]
    assert signed_volume(found) == pytest.approx(VOLUME, rel=0.01)
    half = faces[vertices[faces].mean(1)[:, 0] > 3.0]
    with pytest.raises(TorsoError, match=r"bone.stl has a hole of .* cm2 at"):
        repaired("bone.stl", (vertices, half))


def test_turned_triangles_are_turned_back():
    vertices, faces = BALL
    some = faces.copy()
    some[[3, 50, 51, 120]] = some[[3, 50, 51, 120]][:, ::-1]
    found, notes = fixed((vertices, some))
    assert notes == ["bone.stl: 4 triangles turned round to match the others"]
    assert signed_volume(found) == pytest.approx(VOLUME, rel=1e-9)


def test_a_surface_inside_out_is_turned():
    found, notes = fixed((BALL[0], BALL[1][:, ::-1]))
    assert notes == ["bone.stl: it faced inwards and was turned"]
    assert signed_volume(found) == pytest.approx(VOLUME, rel=1e-9)


def test_a_cavity_stays_a_cavity_whichever_way_the_whole_is_turned():
    vertices, faces = ball(np.array([3.0, -4.0, 50.0]), 8.0)
    hollow = joined(BALL, (vertices, faces[:, ::-1]))
    wanted = signed_volume(hollow)
    assert wanted < VOLUME
    assert signed_volume(fixed(hollow)[0]) == pytest.approx(wanted, rel=1e-9)
    found, notes = fixed((hollow[0], hollow[1][:, ::-1]))
    assert signed_volume(found) == pytest.approx(wanted, rel=1e-9)
    assert len(notes) == 1


@pytest.mark.parametrize("turned", [0, 1], ids=["the large one", "the small one"])
def test_of_two_overlapping_pieces_one_that_faces_inwards_is_turned_alone(turned):
    """As the parts of a pelvis in one file; the small one's first triangle lies in the large one."""
    pieces = [ball(np.zeros(3), 20.0), ball(np.array([0.0, 24.0, 0.0]), 8.0)]
    wrong = [(v, f[:, ::-1] if i == turned else f) for i, (v, f) in enumerate(pieces)]
    surface, notes = repaired("pelvis", joined(*wrong))
    assert notes == ["pelvis: 1 of its 2 pieces faced inwards and was turned"]
    assert signed_volume(surface) == pytest.approx(sum(map(signed_volume, pieces)))
    assert enclosed(surface, np.array([[0.0, 0.0, 0.0], [0.0, 18.0, 0.0], [0.0, 30.0, 0.0]])).all()


def test_repeats_flat_triangles_and_specks_go():
    vertices, faces = BALL
    speck = ball(np.array([60.0, 0.0, 0.0]), 0.2)
    mess = joined((vertices, np.vstack([faces, faces[:3], [[5, 5, 9]]])), speck)
    found, notes = fixed(mess)
    assert len(found[1]) == len(faces)
    assert any("4 triangles without area or there twice" in note for note in notes)
    assert any("1 loose speck left out" in note for note in notes)


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        (np.zeros((3, 3)), [[0, 1, 2]]),
        (np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 0]]), [[0, 1, 2], [1, 3, 2], [0, 2, 1], [1, 2, 3]]),
    ],
)
def test_what_encloses_nothing_is_refused(vertices, faces):
    with pytest.raises(TorsoError, match=r"bone.stl (encloses no volume|has no triangle|has a hole)"):
        repaired("bone.stl", (vertices, np.array(faces)))


def test_fine_surfaces_are_thinned_and_stay_closed():
    fine = ball(np.zeros(3), 20.0, 100, 120)
    assert len(fine[1]) > MOST_FACES
    found, notes = fixed(fine)
    assert len(found[1]) <= MOST_FACES and "thinned" in notes[0]
    assert signed_volume(found) == pytest.approx(signed_volume(fine), rel=0.01)
    coarse = thinned(fine, 500)
    assert_closed(coarse)
    assert len(coarse[1]) <= 500


def test_inside_by_rays_is_inside_by_solid_angle(template_bones):
    rng = np.random.default_rng(1)
    for name in ("T6", "pelvis", "scapula_L", "R5_R"):
        surface = template_bones[name]
        points = rng.uniform(surface[0].min(0) - 2.0, surface[0].max(0) + 2.0, (2000, 3))
        wanted = inside(surface, points)
        assert wanted.sum() > 2
        np.testing.assert_array_equal(enclosed(surface, points), wanted)


def test_rays_leave_a_ball_at_its_surface_and_overlapping_balls_at_the_last():
    fine = ball(np.zeros(3), 20.0, 60, 80)
    two = joined(fine, ball(np.array([0.0, 0.0, 15.0]), 20.0, 60, 80))
    z = np.array([0.0, 0.0, 1.0])
    assert exits(fine, np.zeros((1, 3)), z) == pytest.approx(20.0, abs=0.1)
    assert exits(two, np.zeros((1, 3)), z) == pytest.approx(35.0, abs=0.1)
    assert exits(two, np.zeros((1, 3)), [1.0, 1.0, 0.0]) == pytest.approx(20.0, abs=0.1)
    assert np.isnan(exits(fine, np.array([[30.0, 0.0, 0.0]]), z)).all()
