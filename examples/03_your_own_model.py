"""The engine alone: bones, joints, mesh, load and loss of one's own, and a fit by the adjoint's gradient.

Three blocks on two joints in a soft beam. How stiff is each joint, if we see how far markers on the blocks move?

Run: python examples/03_your_own_model.py
"""

from itertools import permutations

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize

import spinestiff as ss

# Mesh: a beam of 30 x 120 x 30 mm in cubes of six tetrahedra, one for each order in which to walk along the axes.
cells, size = np.array([4, 12, 4]), np.array([30.0, 120.0, 30.0])
nodes = np.indices(cells + 1).reshape(3, -1).T * size / cells - size * [0.5, 0.0, 0.5]
corner = np.indices(cells).reshape(3, -1).T
walks = [np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(order)]], axis=0) for order in permutations(range(3))]
elements = np.vstack([np.ravel_multi_index((corner[:, None] + walk).T, cells + 1).T for walk in walks])
inside_out = np.linalg.det(nodes[elements[:, 1:]] - nodes[elements[:, :1]]) < 0
elements[inside_out] = elements[inside_out][:, [0, 1, 3, 2]]

# Bones: three blocks; nodes inside a block are tied to it.
origins, half = np.array([[0.0, 20.0, 0.0], [0.0, 60.0, 0.0], [0.0, 100.0, 0.0]]), np.array([8.0, 10.0, 8.0])
inside = (np.abs(nodes[:, None] - origins) <= half + 1e-9).all(2)
bone_of_node = np.where(inside.any(1), inside.argmax(1), -1)
rest = ss.TorsoState(origins, np.broadcast_to(np.eye(3), (3, 3, 3)), nodes[bone_of_node < 0])

# Joints: halfway between the blocks, N/mm along and N mm/rad about x, y, z.
parent, child = np.array([0, 1]), np.array([1, 2])
frames = ss.joint_frames(
    rest, parent, child, 0.5 * (origins[parent] + origins[child]), np.broadcast_to(np.eye(3), (2, 3, 3))
)
stiffness = np.tile([200.0, 200.0, 200.0, 8e3, 8e3, 8e3], (2, 1))
joints = ss.JointTable(("lower", "upper"), ("mine", "mine"), parent, child, stiffness=stiffness, **frames)
mu, lambda_ = (np.full(len(elements), value) for value in ss.lame_parameters(young=0.02, poisson=0.45))  # MPa
body = ss.TorsoModel(
    bone_names=("base", "middle", "top"),
    rest_pose=rest,
    joints=joints,
    tissue=ss.TissueMesh(nodes, elements, bone_of_node, mu, lambda_),
    vertebra_boxes=np.empty((0, 8, 3)),
    bone_surfaces=(),
    landmarks={},
    height_cm=12.0,
    vertebrae=(),
)

# Supports: the base is held, and a thread of 0.5 N/mm keeps the top block from swinging forward.
held = np.zeros((3, 6), dtype=bool)
held[0] = True
eye = ss.PointsOnBones(np.array([2]), np.array([[0.0, 10.0, 0.0]]))
thread = ss.PointSprings(eye, eye.positions(rest), np.array([[0.0, 0.0, 1.0]]), np.array([0.5]))
problem = ss.EquilibriumProblem(body, ss.Supports(held, thread, ("thread",)))
ss.require_no_mechanism(body, problem.supports)

# Load: 25 N to the side on the front of the top block, so that the beam bends and twists.
load = ss.LoadCase(ss.PointsOnBones(np.array([2]), np.array([[0.0, 10.0, 8.0]])), np.array([[25.0, 0.0, 0.0]]))

# Parameters: the logarithm of one ratio for each joint.
groups = [ss.ParameterGroup(name, np.arange(2)[:, None] == [row] * 6) for row, name in enumerate(joints.names)]
model = ss.DifferentiableEquilibrium(problem, load, groups)

# Loss: markers on the corners of the two upper blocks, against where a body with these ratios shows them.
truth = {"lower": 2.0, "upper": 0.4}
offsets = half * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0)
bone, offset = np.repeat([1, 2], 8), np.tile(offsets, (2, 1))


def markers(pose: ss.Pose) -> np.ndarray:
    return pose.positions[bone] + np.einsum("pij,pj->pi", pose.rotations[bone], offset)


measured = markers(model.solve(np.log(list(truth.values()))).pose)


def loss(log_ratios: np.ndarray) -> tuple[float, np.ndarray]:
    """Half the sum of squared marker errors, mm^2, and its gradient: one solve with the tangent's factor."""
    solution = model.solve(log_ratios)
    error = markers(solution.pose) - measured
    slope = ss.Pose(*(np.zeros_like(values) for values in solution.pose))
    np.add.at(slope.positions, bone, error)
    np.add.at(slope.rotations, bone, error[:, :, None] * offset[:, None, :])
    return 0.5 * float(np.sum(error**2)), solution.vjp(slope)


start, h = np.zeros(2), 1e-4
gradient = loss(start)[1]
differences = np.array([(loss(start + h * e)[0] - loss(start - h * e)[0]) / (2.0 * h) for e in np.eye(2)])
gradient_error = float(np.abs(gradient - differences).max() / np.abs(differences).max())
print(f"gradient by the adjoint {gradient}, by differences {differences}, relative error {gradient_error:.1e}")

fit = minimize(loss, start, jac=True, method="BFGS")
found = dict(zip(joints.names, np.exp(fit.x).tolist()))
for name, value in truth.items():
    print(f"{name} joint: true ratio {value:g}, found {found[name]:.5f}")
print(f"{fit.nfev} evaluations, loss {loss(start)[0]:.1f} -> {fit.fun:.1e} mm^2")

figure = Figure(figsize=(4.5, 7.0), layout="constrained")
axes = figure.add_subplot(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
faces = body.tissue.boundary_faces()
front = faces[(nodes[faces, 2] > 14.9).all(1)]
pushed = {name: model.solve(log_ratios).equilibrium.state for name, log_ratios in (("start", start), ("fitted", fit.x))}
for label, state, colour in (("rest", rest, "0.8"), *zip(pushed, pushed.values(), ("tab:orange", "tab:blue"))):
    x, y, _ = body.node_positions(state).T
    axes.triplot(x, y, front, color=colour, lw=0.8, label=label)
axes.plot(*measured[:, :2].T, "x", color="tab:red", label="measured markers")
figure.legend(loc="outside upper center", ncols=2)
figure.savefig("your_own_model.png", dpi=120)
