"""What the viewer is given: the equilibria, their loads and reactions, and corners where they were measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spinestiff.anatomy.template import template_torso
from spinestiff.estimation.evaluation import acted
from spinestiff.study.predictions import predicted_acts
from spinestiff.study.report.viewer.packing import packed, scene_record, skin_faces, unpacked
from spinestiff.study.report.viewer.scene import Scene, visit_scene
from spinestiff.study.steps import estimated_model


@pytest.fixture(scope="module")
def record(viewed):
    return scene_record(viewed.scene)


def push_of(record, name):
    return next(push for push in record["pushes"] if push["id"] == name)


def bone_poses(record, state):
    """(B, 3) mm and (B, 3, 3) of a packed state."""
    poses = unpacked(record["states"]["bones"])[state]
    return poses[:, :3], Rotation.from_quat(poses[:, 3:]).as_matrix()


def on_bones(record, state, bones, offsets):
    places, turns = bone_poses(record, state)
    return places[bones] + np.einsum("pij,pj->pi", turns[bones], np.reshape(offsets, (-1, 3)))


def close_to(record, state, number):
    """A packed state is this one, to the precision of what is packed."""
    torso = state[0]
    places, turns = bone_poses(record, number)
    np.testing.assert_allclose(places, state[1].bone_positions, atol=1e-4)
    np.testing.assert_allclose(turns, state[1].bone_rotations, atol=1e-6)
    used, _ = skin_faces(torso)
    skin = record["states"]["skin"]
    np.testing.assert_allclose(
        unpacked(skin)[number], torso.node_positions(state[1])[used], atol=0.5001 * skin["scale"]
    )


def test_steps_are_the_equilibria(viewed, record):
    torso = viewed.predictions.pushes.torso
    close_to(record, (torso, torso.rest_pose), 0)
    found = 0
    for prediction in viewed.predictions.frames:
        for model in ("fit", "default"):
            steps = push_of(record, prediction.item.push)["models"][model]
            (step,) = [s for s in steps if s["frame"] == prediction.item.frame]
            assert step["force"] == prediction.item.force_n > 0.0
            close_to(record, (torso, prediction.states[model]), step["state"])
            found += 1
    assert found == 2 * (3 + 1)
    assert record["states"]["bones"]["shape"] == [found + 1, 49, 7]
    for push in record["pushes"]:
        for steps in push["models"].values():
            assert steps[0]["state"] == 0 and steps[0]["force"] == 0.0
            assert [s["force"] for s in steps] == sorted(s["force"] for s in steps)


def test_a_step_is_what_a_solve_gives(viewed, record):
    """The way from the force to the picture, once more and on its own."""
    pushes = viewed.predictions.pushes
    model = estimated_model(viewed.estimate, pushes)
    (item,) = [t for t in pushes.of_role("validation") if t.push == "main"]
    (acts,) = predicted_acts(pushes, [item], model)
    push = push_of(record, "main")
    step = push["models"]["fit"][-1]
    assert step["force"] == 30.0
    asked, load, ratios = acted(pushes.problems["main"], item.trial.load, model.ratios, acts)
    solved = asked.solve(load, ratios).require()
    close_to(record, (pushes.torso, solved.state), step["state"])
    # The wall's points of a scapula share its name.
    assert len(solved.reactions) == len(push["supports"]) == 20
    for support, force, reaction in zip(push["supports"], step["reactions"], solved.reactions):
        assert (support["name"], support["kind"]) == (reaction.name, reaction.kind)
        np.testing.assert_allclose(force, reaction.force, atol=0.02)
        point = on_bones(record, step["state"], [support["bone"]], support["offset"])[0]
        np.testing.assert_allclose(point, reaction.point, atol=2e-3)


def test_bones_and_skin_are_the_torsos(viewed, record):
    torso = viewed.predictions.pushes.torso
    vertices, faces = unpacked(record["vertices"]), unpacked(record["faces"])
    vertex = face = 0
    for bone, surface, name in zip(record["bones"], torso.bone_surfaces, torso.bone_names):
        assert bone["name"] == name
        own = vertices[vertex : vertex + bone["vertices"]]
        np.testing.assert_allclose(own, surface.vertices, atol=0.5001 * record["vertices"]["scale"])
        np.testing.assert_array_equal(faces[face : face + bone["faces"]], surface.faces)
        vertex, face = vertex + bone["vertices"], face + bone["faces"]
    assert vertex == len(vertices) and face == len(faces)
    # A hundredth of a millimetre.
    assert record["vertices"]["scale"] < 0.02 and record["states"]["skin"]["scale"] < 0.03
    used, skin = skin_faces(torso)
    np.testing.assert_array_equal(unpacked(record["skin"]), skin)
    np.testing.assert_array_equal(used[skin], torso.tissue.boundary_faces())
    kinds = [bone["kind"] for bone in record["bones"]]
    assert (kinds.count("vertebra"), kinds.count("rib"), kinds.count("other")) == (17, 24, 8)


def test_joints_lie_between_their_bones(viewed, record):
    joints = viewed.predictions.pushes.torso.joints
    centres = on_bones(record, 0, record["joints"]["bone"], unpacked(record["joints"]["offset"]))
    rest = viewed.predictions.pushes.torso.rest_pose
    on_child = rest.bone_positions[joints.child] + np.einsum(
        "jik,jk->ji", rest.bone_rotations[joints.child], joints.child_position
    )
    np.testing.assert_allclose(centres, on_child, atol=0.02)
    assert record["joints"]["names"] == list(joints.names) and len(centres) == 67


def test_arrows_stand_at_the_pushed_points(viewed, record):
    for prediction in viewed.predictions.frames:
        item = prediction.item
        load, push = item.trial.load, push_of(record, item.push)
        (step,) = [s for s in push["models"]["fit"] if s["frame"] == item.frame]
        places = on_bones(record, step["state"], push["load"]["bone"], push["load"]["offset"])
        np.testing.assert_allclose(places, load.points.positions(prediction.states["fit"]), atol=2e-3)
        np.testing.assert_allclose(np.array(push["load"]["force"]) * item.force_n, load.forces, atol=1e-4)


def test_what_is_shown_balances(viewed, record):
    """Reactions and the push as the model has it add up to nothing; moments are left to the solver's own tests.

    The push that is shown is the gauge's; by default stiffness it is the model's, by the estimate within its errors.
    """
    pushes, balanced = viewed.predictions.pushes, 0
    loads = [t for t in pushes.trials if t.force_n > 0.0]
    acts = predicted_acts(pushes, loads, estimated_model(viewed.estimate, pushes))
    for item, known in zip(loads, acts):
        push = push_of(record, item.push)
        for name, steps in push["models"].items():
            (step,) = [step for step in steps if step["frame"] == item.frame]
            shown = step["force"] * np.sum(push["load"]["force"], axis=0)
            load = acted(pushes.problems[item.push], item.trial.load, None, known if name == "fit" else 0.0 * known)[1]
            np.testing.assert_allclose(np.sum(step["reactions"], axis=0) + load.total, 0.0, atol=0.02)
            np.testing.assert_allclose(load.total, shown, atol=1e-4 if name == "default" else 4.0)
            assert np.abs(step["reactions"]).max() > 1.0
            balanced += 1
    assert balanced == 8


def test_corners_lie_in_the_patient_plane_and_on_their_rays(viewed, record):
    for item in viewed.predictions.pushes.trials:
        push = push_of(record, item.push)
        (frame,) = [f for f in push["frames"] if f["frame"] == item.frame]
        view, q = item.trial.view, np.array(frame["measured"])
        shown = push["view"]
        points = np.array(shown["origin"]) + q @ np.array([shown["columns"], shown["rows"]])
        np.testing.assert_allclose((points - view.source) @ view.normal, view.source_to_patient, atol=1e-2)
        np.testing.assert_allclose(view.project(points), view.from_patient_plane(q), atol=1e-2)
        np.testing.assert_allclose(shown["source"], view.source, atol=1e-3)
        # Placed boxes have the corners' centre.
        corners = view.to_patient_plane(item.trial.corners.corners)
        good = item.trial.corners.usable.all(1)
        assert good.sum() > 5 and frame["vertebrae"] == list(item.trial.corners.vertebrae)
        np.testing.assert_allclose(q.mean(1)[good], corners.mean(1)[good], atol=2e-3)


def test_errors_are_those_of_the_outlines_shown(viewed, record):
    checked = 0
    for push in record["pushes"]:
        for frame in push["frames"]:
            for model, error in frame["rmse"].items():
                (step,) = [s for s in push["models"][model] if s["frame"] == frame["frame"]]
                assert step["vertebrae"] == frame["vertebrae"]
                apart = np.array(step["boxes"]) - np.array(frame["measured"])
                assert error == pytest.approx(np.sqrt(np.mean(np.sum(apart**2, axis=-1))), abs=1e-3)
                checked += 1
    assert checked == 2 * 6
    full = push_of(record, "main")["frames"][-1]
    assert full["role"] == "validation" and full["rmse"]["fit"] < full["rmse"]["default"]


def test_further_views_and_markers_are_where_they_were_seen(beside):
    """The whole torso moves by 6 mm to the left, half as far with default stiffness."""
    (push,) = scene_record(visit_scene("x", beside, {"main": ("left", 8.0)}))["pushes"]
    rest, full = push["frames"]
    picture = beside.frames[0].item.trial.further[0]
    shown, q = push["further"]["aside"], np.array(full["outlines"]["aside"]["boxes"])
    assert full["outlines"]["aside"]["vertebrae"] == list(picture.corners.vertebrae)
    points = np.array(shown["origin"]) + q @ np.array([shown["columns"], shown["rows"]])
    np.testing.assert_allclose(picture.view.project(points), picture.view.from_patient_plane(q), atol=1e-2)
    seen = picture.view.to_patient_plane(picture.corners.corners)
    np.testing.assert_allclose(q.mean(1), seen.mean(1), atol=2e-3)
    before = np.array(list(rest["markers"].values()))
    assert list(rest["markers"]) == list(full["markers"]) == [f"m{number}" for number in range(1, 8)]
    np.testing.assert_allclose(np.array(list(full["markers"].values())) - before, [[6.0, 0.0, 0.0]] * 7, atol=2e-3)
    for model, share in (("fit", 1.0), ("default", 0.5)):
        first, last = push["models"][model]
        assert first["markers"] == rest["markers"]
        moved = np.array(list(last["markers"].values())) - before
        np.testing.assert_allclose(moved, [[6.0 * share, 0.0, 0.0]] * 7, atol=2e-3)
        apart = np.abs(np.array(last["outlines"]["aside"]["boxes"]) - q).max()
        assert (apart < 0.05) == (model == "fit")


def test_pedicles_are_where_they_were_marked_and_where_a_model_has_them(beside):
    """The whole torso moves by 6 mm to the left, half as far with default stiffness."""
    (push,) = scene_record(visit_scene("x", beside, {"main": ("left", 8.0)}))["pushes"]
    trial = beside.frames[0].item.trial
    (picture,) = trial.further
    frontal = push["view"], trial.view, trial.pedicles, lambda part: part["pedicles"]
    aside = (
        push["further"]["aside"], picture.view, picture.pedicles, lambda part: part["outlines"]["aside"]["pedicles"]
    )  # fmt: skip
    for shown, view, marked, of in (frontal, aside):
        rest, full = (of(frame) for frame in push["frames"])
        names = [f"{vertebra} {side}" for vertebra in marked.vertebrae for side in ("left", "right")]
        assert list(full) == names == list(rest)
        q = np.array(list(full.values()))
        points = np.array(shown["origin"]) + q @ np.array([shown["columns"], shown["rows"]])
        np.testing.assert_allclose(view.project(points), marked.points.reshape(-1, 2), atol=1e-2)
        for model, share in (("fit", 1.0), ("default", 0.5)):
            first, last = (np.array([of(step)[name] for name in names]) for step in push["models"][model])
            np.testing.assert_allclose(first, list(rest.values()), atol=2e-3)
            np.testing.assert_allclose(last - first, share * (q - first), atol=0.05)
    # Seen from the front, the way is as long as it is, but for what lies nearer to the source.
    moved = np.array([np.subtract(push["frames"][1]["pedicles"][n], push["frames"][0]["pedicles"][n]) for n in names])
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 6.0, atol=0.4)


def test_a_push_seen_from_the_front_alone_has_nothing_beside(record):
    for push in record["pushes"]:
        parts = [*push["frames"], *(step for steps in push["models"].values() for step in steps)]
        assert "further" not in push and not any({"pedicles", "outlines", "markers"} & part.keys() for part in parts)


def test_a_push_without_a_frame_at_rest_starts_there_all_the_same(viewed):
    loaded = tuple(t for t in viewed.predictions.pushes.trials if t.force_n > 0.0)
    pushes = replace(viewed.predictions.pushes, trials=loaded)
    levels = {"main": ("right", 8.0), "second": ("right", 6.0)}
    scene = visit_scene("x", replace(viewed.predictions, pushes=pushes), levels)
    for push in scene.pushes:
        assert push.frames[0].force_n > 0.0
        first = push.models["fit"][0]
        assert (first.force_n, first.frame) == (0.0, None)
        assert first.state is pushes.torso.rest_pose and not first.reactions.any()


def test_a_model_without_an_equilibrium_is_left_out(viewed):
    def without(prediction, name):
        return replace(prediction, solved={key: found for key, found in prediction.solved.items() if key != name})

    def scene_with(frames):
        return visit_scene("x", replace(viewed.predictions, frames=tuple(frames)), levels)

    levels = {"main": ("right", 8.0), "second": ("right", 6.0)}
    partly = [without(p, "default") for p in viewed.predictions.frames]
    scene = scene_with(partly)
    assert [list(push.models) for push in scene.pushes] == [["fit"], ["fit"]]
    assert all(set(f.rmse_mm) == {"fit"} for push in scene.pushes for f in push.frames if f.force_n)
    one = [without(p, "fit") if p.item.frame == 2 else p for p in viewed.predictions.frames]
    main = scene_with(one).pushes[0]
    assert [s.frame for s in main.models["fit"]] == [0, 1, 3] and [s.frame for s in main.models["default"]] == [
        0,
        1,
        2,
        3,
    ]
    none = [without(without(p, "fit"), "default") for p in viewed.predictions.frames]
    assert scene_with(none).pushes == ()


@pytest.mark.parametrize("torso", [template_torso(157.0), replace(template_torso(157.0), bone_surfaces=())])
def test_a_torso_alone(torso):
    record = scene_record(Scene("template", torso))
    assert record["pushes"] == []
    assert record["states"]["bones"]["shape"] == [1, 49, 7]
    assert sum(bone["faces"] for bone in record["bones"]) == record["faces"]["shape"][0]


@pytest.mark.parametrize("kind", ["float32", "int16", "uint16", "uint32"])
def test_packing(kind):
    values = np.array([[0, 3, 65535], [2, 1, 7]]) if kind.startswith("u") else np.array([[-2.5, 0.001], [1e3, 400.0]])
    record = packed(values, kind)
    assert record["shape"] == list(values.shape)
    np.testing.assert_allclose(
        unpacked(record), values, atol=0.5001 * record["scale"] if kind == "int16" else 0.0, rtol=1e-7
    )
    empty = packed(np.empty((0, 3)), kind)
    assert unpacked(empty).shape == (0, 3)
