"""Push a torso from the right and see how far its vertebrae tilt, with default and with softer parameters.

Run: python examples/01_push_a_torso.py
"""

import numpy as np

import spinestiff as ss

torso = ss.template_torso(height_cm=157, mesh="coarse")
problem = ss.EquilibriumProblem(torso, ss.three_point_supports(torso, side="right"))
load = ss.rib_push(torso, side="right", level=8, force_n=40)


def tilts_deg(state: ss.TorsoState) -> np.ndarray:
    """Turn about the front-to-back axis since rest, a vertebra each, anticlockwise seen from the front."""
    bones = torso.vertebra_bones
    turned = state.bone_rotations[bones] @ np.swapaxes(torso.rest_pose.bone_rotations[bones], 1, 2)
    return np.degrees(np.arctan2(turned[:, 1, 0], turned[:, 0, 0]))


default = problem.solve(load).require()
soft = problem.solve(load, ss.stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.01})).require()

print("tilt since rest (deg)   default   soft")
for name, stiff_tilt, soft_tilt in zip(torso.vertebrae, tilts_deg(default.state), tilts_deg(soft.state)):
    print(f"{name:>20}   {stiff_tilt:7.2f} {soft_tilt:6.2f}")

# Upper minus lower: positive = convex to the patient's left.
tilts = tilts_deg(soft.state)
tilt_change_deg = float(max(upper - lower for i, upper in enumerate(tilts) for lower in tilts[i + 1 :]))
print(f"largest change of tilt between two vertebrae, soft: {tilt_change_deg:.1f} deg")
shoulder, pelvis = (-soft.reaction(name)[0] for name in ("shoulder", "pelvis"))
print(f"of {load.size:.0f} N the shoulder holds {shoulder:.1f} N, the pelvis {pelvis:.1f} N")
