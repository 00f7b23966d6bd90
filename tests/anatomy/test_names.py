from collections import Counter

from spinestiff.anatomy.names import BONE_INDEX, BONES, JOINTS, RIBS, VERTEBRAE


def test_forty_nine_bones_with_unique_names():
    assert len(BONES) == len(set(BONES)) == 49
    assert len(VERTEBRAE) == 17 and len(RIBS) == 24
    assert all(BONES[i] == name for name, i in BONE_INDEX.items())


def test_sixty_seven_joints_of_the_papers_kinds():
    assert len(JOINTS) == len(set(JOINTS)) == 67
    assert Counter(joint.kind for joint in JOINTS) == {
        "thoracic": 11,
        "lumbar": 6,
        "rib_vertebra": 24,
        "rib_sternum": 20,
        "sternum_clavicle": 2,
        "clavicle_scapula": 2,
        "scapula_humerus": 2,
    }


def test_every_joint_names_known_bones_and_every_bone_has_a_joint():
    joined = {bone for joint in JOINTS for bone in (joint.parent, joint.child)}
    assert joined == set(BONES)


def test_bones_hang_together_with_nineteen_loops():
    # 48 joints would make a tree of 49 bones; each rib pair that reaches the sternum but one rib closes a loop.
    group = {bone: bone for bone in BONES}

    def root(bone):
        while group[bone] != bone:
            bone = group[bone]
        return bone

    loops = 0
    for joint in JOINTS:
        a, b = root(joint.parent), root(joint.child)
        loops += a == b
        group[a] = b
    assert loops == 19
    assert len({root(bone) for bone in BONES}) == 1


def test_the_lower_bone_carries_an_intervertebral_frame():
    assert JOINTS[0] == ("T2", "T1", "thoracic")
    assert JOINTS[11] == ("L1", "T12", "lumbar")
    assert JOINTS[16] == ("pelvis", "L5", "lumbar")


def test_floating_ribs_do_not_reach_the_sternum():
    to_sternum = {joint.child for joint in JOINTS if joint.kind == "rib_sternum"}
    assert to_sternum == {f"R{i}_{side}" for i in range(1, 11) for side in "LR"}
