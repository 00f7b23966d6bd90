"""Checks of the derivatives of an equilibrium (Eqs. 6-7) and of the image features (Eqs. 9-12)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios, parameter_group, stiffness_ratios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.objective import Trial, make_target, residuals
from spinestiff.imaging.features import VertebraCorners, reference_boxes, silhouette_shares, state_features
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load
from spinestiff.mechanics.sensitivity import Linearisation
from spinestiff.personalise.image_terms import image_points, shape_of
from spinestiff.verification.energies import GRADIENT_TOLERANCE, STATES, dense
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import points_on, shaken, toy_torso
from spinestiff.verification.oracle import STEP, Complexes, Dual, EnergyOracle, curvature_along, rotation
from spinestiff.verification.outcome import Check, compared, counted, judged, vanishing

NAMES = {"lateral_bending": 0.3, "tissue": 0.2, "axial_rotation": 0.5, "tissue_mu": 0.8}


class _Goal:
    """A smooth function of a state: half the weighted squared distance of points from places, and its derivative."""

    def __init__(self, torso: TorsoModel, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.points: PointsOnBones = points_on(torso, 6, seed)
        self.targets = self.points.positions(torso.rest_pose) + random.uniform(-3.0, 3.0, (6, 3))
        self.weights = random.uniform(0.5, 2.0, torso.rest_pose.tissue_positions.shape)

    def value(self, state: TorsoState) -> float:
        gap = self.points.positions(state) - self.targets
        return float(0.5 * np.sum(gap**2) + np.sum(self.weights * state.tissue_positions))

    def gradient(self, state: TorsoState) -> Floats:
        gradient = np.zeros(state.dofs)
        rows = gradient[: 6 * len(state.bone_positions)].reshape(-1, 6)
        gap = self.points.positions(state) - self.targets
        np.add.at(rows, self.points.bone, np.einsum("pij,pi->pj", self.points.jacobian(state), gap))
        gradient[6 * len(state.bone_positions) :] = self.weights.ravel()
        return gradient


class _Case:
    """A soft toy torso in equilibrium and its tangent."""

    def __init__(self, nodes: int) -> None:
        self.torso = toy_torso(1, nodes)
        self.problem = EquilibriumProblem(self.torso, toy_supports(self.torso))
        self.load: LoadCase = toy_load(40.0)
        self.ratios: StiffnessRatios = stiffness_ratios(NAMES, self.torso.joints.kinds)
        # Tighter than the default 1e-10 of the load: differences of solves are taken.
        self.fine = 1e-12 * self.load.size
        self.found = self.problem.solve(self.load, self.ratios, tolerance=self.fine).require()
        self.tangent: Linearisation = self.problem.linearise(self.found, self.load, self.ratios)
        self.goal = _Goal(self.torso, 3)

    def at(self, log_change: Floats) -> TorsoState:
        ratios = self.ratios.with_values(self.ratios.values * np.exp(log_change))
        return self.problem.solve(self.load, ratios, start=self.found.state, tolerance=self.fine).require().state

    def along(self, direction: Floats) -> Callable[[float], float]:
        """The goal as a function of the step in log ratios along ``direction``."""
        return lambda step: self.goal.value(self.at(step * direction))


def sensitivities() -> Iterator[Check]:
    """Forward, adjoint and dense inverse agree; both agree with differences of whole solves."""
    for nodes in (4, 10):
        case = _Case(nodes)
        potential, groups = case.problem.potential, case.ratios.groups
        forward = case.tangent.forward(groups)
        gradient = case.goal.gradient(case.found.state)
        adjoint = case.tangent.adjoint(gradient, groups)
        yield compared(f"D1 Eqs. 6-7: adjoint against forward, {nodes} nodes", adjoint, gradient @ forward, 1e-10)
        stiffness, terms = potential.stiffness(case.ratios), case.problem.all_terms(case.load)
        free = np.setdiff1d(np.arange(potential.dofs), case.problem.held)
        hessian = dense(potential, potential.hessian(case.found.state, stiffness, terms))[np.ix_(free, free)]
        shares = potential.ratio_gradients(case.found.state, stiffness, groups)[free]
        wanted = np.zeros_like(forward)
        wanted[free] = -np.linalg.inv(hessian) @ shares
        yield compared(f"D1 Eq. 6: forward against a dense inverse, {nodes} nodes", forward, wanted, 1e-10)
        yield vanishing(
            f"D1 Eq. 6: held bones stay, {nodes} nodes", forward[case.problem.held], float(np.abs(forward).max()), 0.0
        )
        step = 1e-3
        for i, name in enumerate(case.ratios.names):
            unit = step * np.eye(len(NAMES))[i]
            weights = ((1, 8 / 12), (2, -1 / 12))
            difference = sum(
                w * (case.goal.value(case.at(k * unit)) - case.goal.value(case.at(-k * unit))) for k, w in weights
            )
            yield compared(
                f"D3 Eq. 7: d goal / d log {name} against differences, {nodes} nodes",
                adjoint[i],
                difference / step,
                1e-6,
            )


def taylor_slopes(value: Callable[[float], float], slope: float, first: float, halvings: int) -> tuple[Floats, Floats]:
    """Orders at which |v(h) - v(0)| and |v(h) - v(0) - h slope| shrink as h is halved, (halvings,) each."""
    steps = first * 0.5 ** np.arange(halvings + 1)
    change = np.array([value(float(h)) for h in steps]) - value(0.0)
    return np.log2(np.abs(change[:-1] / change[1:])), np.log2(
        np.abs((change - steps * slope)[:-1] / (change - steps * slope)[1:])
    )


def taylor() -> Iterator[Check]:
    """The remainder after the gradient falls with the square of the step, without the gradient in proportion to it."""
    for nodes in (4, 10):
        case = _Case(nodes)
        direction = np.array([0.6, -0.7, 0.4, 0.5])
        slope = float(case.tangent.adjoint(case.goal.gradient(case.found.state), case.ratios.groups) @ direction)
        without, remainder = taylor_slopes(case.along(direction), slope, 0.04, 8)
        yield judged(f"D2 Taylor: slope of the remainder less 2, {nodes} nodes", np.abs(remainder - 2.0).max(), 0.05)
        yield judged(f"D2 Taylor: slope without the gradient less 1, {nodes} nodes", np.abs(without - 1.0).max(), 0.05)


def load_derivative() -> Iterator[Check]:
    """The equilibrium's derivative in the load against differences of solves."""
    case = _Case(10)
    found = case.tangent.load_derivative(case.load)[18:]
    step, total = 1e-3, np.zeros_like(found)
    for k, weight in ((1, 8 / 12), (2, -1 / 12)):
        loads = [case.load.scaled(1 + s * k * step) for s in (1, -1)]
        ends = [case.problem.solve(load, case.ratios, tolerance=case.fine).require() for load in loads]
        total = total + weight * (ends[0].state.tissue_positions - ends[1].state.tissue_positions).ravel()
    yield compared("D3 load derivative against differences of solves", found, total / step, 1e-6)


def superposition() -> Iterator[Check]:
    """Shares of the force add up: of the parts to the whole, of the parts of a group to the group."""
    torso = toy_torso(4, 10)
    problem = EquilibriumProblem(torso, toy_supports(torso))
    state, kinds = shaken(torso, 9), torso.joints.kinds
    ratios = stiffness_ratios(NAMES, kinds)
    stiffness = problem.potential.stiffness(ratios)
    directions = [parameter_group(name, kinds) for name in ("lateral_shear", "separation", "sagittal_shear")]
    directions += [parameter_group(name, kinds) for name in ("flexion_extension", "axial_rotation", "lateral_bending")]
    tissue = [parameter_group(name, kinds) for name in ("tissue_mu", "tissue_lambda")]

    def shares(groups: list[ParameterGroup]) -> Floats:
        return problem.potential.ratio_gradients(state, stiffness, groups).sum(1)

    whole = problem.potential.gradient(state, stiffness, ())
    yield compared("D5 superposition: shares of all parts are the force", shares(directions + tissue), whole, 1e-14)
    yield compared(
        "D5 superposition: one group for everything", shares([parameter_group("everything", kinds)]), whole, 1e-14
    )
    yield compared(
        "D5 superposition: tissue is mu and lambda", shares([parameter_group("tissue", kinds)]), shares(tissue), 1e-14
    )
    # The energy is linear in a ratio: a complex step in the ratio leaves the share's own energy, whose slope is asked.
    random = np.random.default_rng(15)
    for name in ("lateral_bending", "axial_rotation", "tissue_mu", "tissue_lambda", "tissue", "everything"):
        group = parameter_group(name, kinds)
        share = shares([group])
        oracle = _GroupOracle(torso, state, ratios, group)
        directions_tried = random.normal(size=(20, len(share)))
        directions_tried[:, : 6 * problem.potential.bones].reshape(20, -1, 6)[:, :, 3:] *= 0.03
        found = directions_tried @ share
        wanted = [curvature_along(oracle, np.array([1.0]), d) for d in directions_tried]
        yield compared(f"D5 superposition: d force / d log {name}, complex step in the ratio", found, wanted, 1e-12)


class _GroupOracle:
    """The second energy as a function of one log ratio and the state: a complex step in one, a slope in the other."""

    def __init__(self, torso: TorsoModel, state: TorsoState, ratios: StiffnessRatios, group: ParameterGroup) -> None:
        self._group, self._ratios = group, ratios
        self._whole = EnergyOracle(torso, state, ratios)
        mesh = torso.tissue
        inside = group.elements_of(len(mesh.elements))
        mu, lambda_ = group.mu * inside * mesh.lame_mu, group.lambda_ * inside * mesh.lame_lambda
        kept = replace(
            torso,
            joints=replace(torso.joints, stiffness=np.where(group.joints, torso.joints.stiffness, 0.0)),
            tissue=replace(mesh, lame_mu=mu, lame_lambda=lambda_),
        )
        self._own = EnergyOracle(kept, state, ratios)

    def __call__(self, step: Dual) -> Dual:
        change, direction = step.value[0], step.slope
        at = Dual(np.zeros(len(direction), dtype=complex), direction)
        # E(ratio (1 + change)) = E + change E_own, to first order exactly.
        return self._whole(at) + self._own(at) * change


def _by_dense_algebra(case: _Case, state: TorsoState, ratios: StiffnessRatios) -> Floats:
    """The goal's derivative in the log ratios at any state (Eq. 7), by a dense solution."""
    potential = case.problem.potential
    stiffness, terms = potential.stiffness(ratios), case.problem.all_terms(case.load)
    free = np.setdiff1d(np.arange(potential.dofs), case.problem.held)
    hessian = dense(potential, potential.hessian(state, stiffness, terms))[np.ix_(free, free)]
    shares = potential.ratio_gradients(state, stiffness, ratios.groups)[free]
    return np.asarray(-shares.T @ np.linalg.solve(hessian, case.goal.gradient(state)[free]))


def loose_derivatives() -> Iterator[Check]:
    """What a gradient is worth at a state out of balance: its error goes with the residual, so the limit of 1e-8."""
    case = _Case(10)
    exact = _by_dense_algebra(case, case.found.state, case.ratios)
    away = np.random.default_rng(3).normal(size=case.problem.potential.dofs)
    away[: 6 * case.problem.potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
    away[case.problem.held] = 0.0
    for residual in (1e-2, 1e-4, 1e-6, 1e-8):
        found = _by_dense_algebra(case, _off_balance(case, away, residual), case.ratios)
        yield compared(f"D4 gradient at a residual of {residual:.0e} of the load", found, exact, 3.0 * residual)


def earlier_factors() -> Iterator[Check]:
    """An earlier factor serves for steps, never for a derivative: the state it leads to has a tangent of its own."""
    case = _Case(10)
    changed = case.ratios.with_values(1.2 * case.ratios.values)
    found = case.problem.solve(case.load, changed, start=case.tangent, tolerance=case.fine).require()
    tangent = case.problem.linearise(found, case.load, changed)
    slopes = tangent.adjoint(case.goal.gradient(found.state), changed.groups)
    wanted = _by_dense_algebra(case, found.state, changed)
    yield compared("D4 gradient after steps with an earlier factor, against dense algebra", slopes, wanted, 1e-10)
    theirs = [case.tangent.belongs_to(state) for state in (found.state, case.found.state)]
    yield counted("D4 tangent told from that of another state", int(theirs != [False, True]), 1)


def _off_balance(case: _Case, direction: Floats, share: float) -> TorsoState:
    """The equilibrium moved along ``direction`` (dofs,) until the residual is ``share`` of the load."""
    potential = case.problem.potential
    stiffness, terms = potential.stiffness(case.ratios), case.problem.all_terms(case.load)
    size, state = 1e-3 * share, case.found.state
    for _ in range(8):
        state = retract(case.found.state, size * direction)
        gradient = potential.gradient(state, stiffness, terms)
        gradient[case.problem.held] = 0.0
        gradient[: 6 * potential.bones].reshape(-1, 6)[:, 3:] /= 30.0
        size *= share * case.load.size / float(np.abs(gradient).max())
    return state


def refused_derivatives() -> Iterator[Check]:
    """No derivative where there is no equilibrium: not converged, other load, other ratios."""
    case = _Case(10)
    short = case.problem.solve(case.load, case.ratios, max_iterations=1)
    loose = case.problem.solve(case.load, case.ratios, tolerance=1e-3 * case.load.size)
    away = np.zeros(case.found.state.dofs)
    away[-1] = 1.0
    nudged = replace(case.found, state=_off_balance(case, away, 1.5e-8))
    tries = [
        (short, case.load, case.ratios),
        (loose, case.load, case.ratios),
        (nudged, case.load, case.ratios),
        (case.found, case.load.scaled(1.001), case.ratios),
        (case.found, case.load, None),
    ]
    given = 0
    for state, load, ratios in tries:
        try:
            case.problem.linearise(state, load, ratios)
        except EquilibriumError:
            continue
        given += 1
    yield counted("D4 refusal: derivatives away from equilibrium", given, len(tries))
    yield judged("D4 refusal: the loose state passed as converged", float(not loose.converged), 0.0)
    near = replace(case.found, state=_off_balance(case, away, 5e-9))
    try:
        tangent = case.problem.linearise(near, case.load, case.ratios)
        slopes = tangent.adjoint(case.goal.gradient(near.state), case.ratios.groups)
    except EquilibriumError:
        slopes = np.full(len(NAMES), np.nan)
    wanted = case.tangent.adjoint(case.goal.gradient(case.found.state), case.ratios.groups)
    yield compared("D4 gradient given at a residual of 5e-9 of the load", slopes, wanted, 1e-7)


def boxed_torso() -> TorsoModel:
    """The toy torso with its three bones as vertebrae, their boxes wider than high and slightly skewed."""
    torso = toy_torso(5, 4, turned=0.0)
    signs = np.array([[x, y, z] for y in (1, -1) for x in (1, -1) for z in (1, -1)], dtype=float)
    boxes = np.stack([0.5 * signs * size for size in ([42.0, 24.0, 34.0], [45.0, 26.0, 36.0], [48.0, 27.0, 38.0])])
    boxes = boxes + np.random.default_rng(6).uniform(-1.5, 1.5, boxes.shape)
    names = ("T10", "T11", "T12")
    return replace(torso, bone_names=names, vertebrae=names, vertebra_boxes=boxes)


def _corners_oracle(
    torso: TorsoModel, view: XRayView, state: TorsoState, shares: Floats | None, dx: Complexes
) -> Complexes:
    """The silhouette's corners (V, 4, 2), mm at the patient plane from the source's foot, by another way.

    Without ``shares`` they are those of the state.
    """
    v = len(torso.vertebrae)
    t = state.bone_positions + dx[:, :3]
    r = rotation(dx[:, 3:]) @ state.bone_rotations
    frontal = abs(view.detector_axes[0, 0]) > 0.5
    boxes = torso.vertebra_boxes.reshape(v, 2, 2, 2, 3)
    level, side = (0, 0, 1, 1), (0, 1, 1, 0)
    normal = np.cross(*view.detector_axes)
    height = normal @ (view.detector_origin - view.source)
    seen = np.empty((v, 4, 2), dtype=complex)
    for i in range(v):
        for k in range(4):
            first, second = (boxes[(i, level[k], *((side[k], m) if frontal else (m, side[k])))] for m in (0, 1))
            middle, half = 0.5 * (first + second), 0.5 * (first - second)
            share = _share_oracle(t[i] - view.source, r[i], middle, half, frontal) if shares is None else shares[i, k]
            point = t[i] + r[i] @ (middle + share * half)
            ray = point - view.source
            spot = ray * (height / (ray @ normal))
            # From the source's foot, in units of the patient plane.
            seen[i, k] = (view.detector_axes @ spot) * view.source_to_patient / abs(height)
    return seen


def _share_oracle(place: Complexes, r: Complexes, middle: Floats, half: Floats, frontal: bool) -> complex:
    """Where the rim is seen farthest out, by Cramer's rule: half = a across + b up + c ray in the world, t of a + b."""
    up, across = r @ (middle * [0.0, 1.0, 0.0]), r @ (middle * ([1.0, 0.0, 0.0] if frontal else [0.0, 0.0, 1.0]))
    ray, h = place + r @ middle, r @ half

    def volume(*edges: Complexes) -> complex:
        return complex(edges[0] @ np.cross(edges[1], edges[2]))

    reach = (volume(h, up, ray) + volume(across, h, ray)) / volume(across, up, ray)
    return complex(reach / np.sqrt(1.0 + reach * reach))


def _features_oracle(
    torso: TorsoModel, view: XRayView, state: TorsoState, shares: Floats, orientation: str, dx: Complexes
) -> Complexes:
    """z (V, 4, 2) by another way: homogeneous projection, complex arithmetic, half-angle formulas."""
    seen = _corners_oracle(torso, view, state, shares, dx)
    centre = seen.mean(1, keepdims=True)
    c, ref = seen - centre, reference_boxes(torso, view)
    if orientation == "procrustes":
        along = np.sum(ref * c, axis=(1, 2))
        across = np.sum(ref[..., 0] * c[..., 1] - ref[..., 1] * c[..., 0], axis=1)
        cosine, sine = along / np.sqrt(along**2 + across**2), across / np.sqrt(along**2 + across**2)
    else:
        xx, yy, xy = (np.mean(c[..., i] * c[..., j], axis=1) for i, j in ((0, 0), (1, 1), (0, 1)))
        size = np.sqrt((xx - yy) ** 2 + 4.0 * xy**2)
        cosine = np.sqrt(0.5 * (1.0 + (xx - yy) / size))
        sine = xy / size / cosine
    turn = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    return centre + np.einsum("vij,vkj->vki", turn, ref)


def features() -> Iterator[Check]:
    """Image features and their derivative in the vertebrae's poses, both orientations, both views."""
    torso = boxed_torso()
    state = shaken(torso, 7, turn=0.1, move=5.0)
    for view_name, view in (("frontal", frontal_view()), ("lateral", lateral_view())):
        shares = silhouette_shares(torso, view, torso.rest_pose)
        for orientation in ("procrustes", "covariance"):
            found = state_features(torso, view, state, shares, orientation)  # type: ignore[arg-type]

            def oracle(
                dx: Complexes, view: XRayView = view, shares: Floats = shares, kind: str = orientation
            ) -> Complexes:
                return _features_oracle(torso, view, state, shares, kind, dx)

            name = f"{view_name} view, {orientation}"
            yield compared(
                f"D6 features: Eqs. 9-11, {name}", found.z, oracle(np.zeros((3, 6), dtype=complex)).real, 1e-12
            )
            wanted = np.empty((3, 4, 2, 6))
            for dof in range(6):
                dx = np.zeros((3, 6), dtype=complex)
                dx[:, dof] = 1j * STEP
                wanted[..., dof] = oracle(dx).imag / STEP
            for part, columns in (("shifts", slice(0, 3)), ("turns", slice(3, 6))):
                yield compared(
                    f"D6 features: derivative in {part} (Eq. 12), {name}",
                    found.jacobian[..., columns],
                    wanted[..., columns],
                    1e-11,
                )


def _corners(torso: TorsoModel, view: XRayView, state: TorsoState, shares: Floats) -> VertebraCorners:
    """The picture of ``state``: corners on the detector whose features are the state's own."""
    z = state_features(torso, view, state, shares).z
    return VertebraCorners(torso.vertebrae, view.from_patient_plane(z), np.ones(z.shape[:2]))


def image_loss() -> Iterator[Check]:
    """The image loss's slope in the pose (Eqs. 9-12) over 100 random states, as a fit and as a geometry feel it."""
    torso = boxed_torso()
    view = frontal_view()
    shares = silhouette_shares(torso, view, torso.rest_pose)
    seen = _corners(torso, view, shaken(torso, STATES, turn=0.1, move=4.0), shares)
    target = make_target(torso, Trial(no_load(), seen, view, "picture"))
    points = image_points(torso, view, seen)
    places = view.to_patient_plane(seen.corners)
    random = np.random.default_rng(16)
    errors = []
    for seed in range(STATES):
        state = shaken(torso, seed, turn=0.1, move=4.0)
        part = residuals(torso, target, state)
        direction = random.normal(size=(3, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]
        z = _features_oracle(torso, view, state, shares, "procrustes", 1j * STEP * direction)
        wanted = float((0.5 * np.sum((z - target.z) ** 2)).imag / STEP)
        # A geometry sees the silhouette of each state.
        shown = _corners_oracle(torso, view, state, None, 1j * STEP * direction)
        pulled = float((0.5 * np.sum((shown - places) ** 2)).imag / STEP)
        found = part.gradient(state.dofs)[:18].reshape(3, 6) * direction
        gap, slope, _ = points.linearised(shape_of(torso, state), np.zeros(4))
        felt = np.zeros((3, 6))
        np.add.at(felt, points.vertebra, np.einsum("pic,pi->pc", slope[:, :, :6], gap))
        felt = felt * direction
        errors.append([abs(v.sum() - w) / np.linalg.norm(v) for v, w in ((found, wanted), (felt, pulled))])
    for name, worst in zip(("of a fit", "of a geometry"), np.max(errors, axis=0)):
        yield judged(f"A1 gradient: image loss {name}, worst of {STATES} random states", worst, GRADIENT_TOLERANCE)


def gauss_newton() -> Iterator[Check]:
    """J^T J of a fit against differences of the loss's gradient by whole solves, where the radiograph fits exactly."""
    torso = boxed_torso()
    problem = EquilibriumProblem(torso, toy_supports(torso))
    view, load = frontal_view(), toy_load(40.0)
    shares = silhouette_shares(torso, view, torso.rest_pose)
    names = {"lateral_bending": 0.3, "tissue": 0.2}
    truth = stiffness_ratios(names, torso.joints.kinds)
    pictured = problem.solve(load, truth, tolerance=1e-12 * load.size).require().state
    trials = [Trial(load, _corners(torso, view, pictured, shares), view, "push")]
    fit = TrialSet([problem], trials, truth.groups, "procrustes", None)
    at = np.log(truth.values)
    point = fit.solve(at)
    jacobian = fit.jacobian(point, fit.slope(point))
    step, hessian = 1e-3, np.zeros((2, 2))
    for i in range(2):
        for k, weight in ((1, 8 / 12), (2, -1 / 12)):
            for sign in (1, -1):
                there = fit.solve(at + sign * k * step * np.eye(2)[i], near=point)
                hessian[:, i] += sign * weight * fit.gradient(there) / step
    yield compared(
        "D7 fit: J^T J against the loss's second differences at no residual", jacobian.T @ jacobian, hessian, 1e-5
    )
    yield vanishing("D7 fit: residual where the radiograph is the model's own, mm", point.values, 1.0, 1e-8)


GROUPS = (
    sensitivities,
    taylor,
    load_derivative,
    superposition,
    loose_derivatives,
    earlier_factors,
    refused_derivatives,
    features,
    image_loss,
    gauss_newton,
)
