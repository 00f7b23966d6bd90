"""Do the tests notice faults? Puts one fault at a time into a copy of the package and runs the tests that should fail.

    python tools/seeded_faults.py [part of a name ...]

Prints caught or MISSED for each; exits with 1 if any was missed. Needs pytest; about ten minutes in all.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Fault(NamedTuple):
    """Replace ``before``, which occurs once in ``file``, by ``after``; ``tests`` (below tests/) should then fail."""

    name: str
    file: str
    before: str
    after: str
    tests: str


MECHANICS, CHECKS = "mechanics", "verification/test_checks.py"
FAULTS = (
    Fault(
        "joint: moment on the parent has the wrong sign",
        "mechanics/joints.py",
        "-cross(pose.gap, force) - moment",
        "-cross(pose.gap, force) + moment",
        CHECKS,
    ),
    Fault(
        "joint: parent's lever is its own arm, not the gap",
        "mechanics/joints.py",
        "-cross(pose.gap, force) - moment",
        "-cross(pose.parent_arm, force) - moment",
        CHECKS,
    ),
    Fault(
        "joint: axes not turned with the parent",
        "mechanics/joints.py",
        "axes = parent @ joints.parent_axes",
        "axes = joints.parent_axes + 0.0 * parent",
        CHECKS,
    ),
    Fault(
        "joint: Jacobian transposed",
        "mechanics/joints.py",
        "np.eye(3) - 0.5 * k + c",
        "np.eye(3) + 0.5 * k + c",
        CHECKS,
    ),
    Fault(
        "joint: half of the product of two exponentials missing",
        "mechanics/joints.py",
        "0.5 * cross_matrix(moment) - world",
        "-world",
        CHECKS,
    ),
    Fault(
        "joint: mixed translation block missing",
        "mechanics/joints.py",
        "        (PARENT_W, CHILD_T, cross_force),\n",
        "",
        CHECKS,
    ),
    Fault("joint: wrong coefficient of a small angle", "mechanics/joints.py", "1 / 720,", "1 / 360,", CHECKS),
    Fault(
        "joint: derivative of the Jacobian's coefficient off",
        "mechanics/joints.py",
        "- 2.0 * c / p2",
        "- 1.0 * c / p2",
        CHECKS,
    ),
    Fault(
        "tissue: sign of lambda log J in the tangent",
        "mechanics/tissue.py",
        "w_mix = w_mu - w_lam * log_j",
        "w_mix = w_mu + w_lam * log_j",
        CHECKS,
    ),
    Fault(
        "tissue: an entry of the tangent transposed",
        "mechanics/tissue.py",
        "block[0, 1] += m0 * h1 + l1 * h0",
        "block[0, 1] += m1 * h0 + l0 * h1",
        CHECKS,
    ),
    Fault(
        "tissue: F^-T becomes F^-1",
        "mechanics/tissue.py",
        "volume[a, i] += g[i, 0] * x0 + g[i, 1] * x1 + g[i, 2] * x2",
        "volume[a, i] += g[0, i] * x0 + g[1, i] * x1 + g[2, i] * x2",
        CHECKS,
    ),
    Fault(
        "tissue: quadrature weight one per cent off",
        "mechanics/tissue.py",
        "determinant * weights / 6.0",
        "determinant * weights / 6.06",
        CHECKS,
    ),
    Fault(
        "tissue: two middle nodes swapped in the element's order",
        "anatomy/torso.py",
        "((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))",
        "((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))",
        CHECKS,
    ),
    Fault(
        "tissue: inverted points have finite energy",
        "mechanics/tissue.py",
        "energy[t] = np.inf",
        "energy[t] = 1e6",
        MECHANICS + "/test_tissue.py",
    ),
    Fault(
        "tissue: projection turns negative curvature around",
        "mechanics/tissue.py",
        "_add_mode(blocks[t], -value * weights[t, q]",
        "_add_mode(blocks[t], -2.0 * value * weights[t, q]",
        MECHANICS + "/test_tissue.py",
    ),
    Fault(
        "assembly: rotation term of tied nodes missing",
        "mechanics/tissue.py",
        "np.add.at(tangent.bones[:, 3:, 3:], of.tied_points.bone, turning)",
        "pass",
        CHECKS,
    ),
    Fault(
        "assembly: two nodes of one bone couple once",
        "mechanics/tissue.py",
        "block[r, k] if a == b else block[r, k] + block[k, r]",
        "block[r, k]",
        CHECKS,
    ),
    Fault(
        "assembly: swapped pair not transposed",
        "mechanics/tissue.py",
        "hessians[t, pair, j, i] if swap else hessians[t, pair, i, j]",
        "hessians[t, pair, i, j]",
        CHECKS,
    ),
    Fault(
        "assembly: moment of tied nodes has the wrong sign",
        "mechanics/assembly.py",
        "cross(self.tied_arms, on_bones)",
        "cross(on_bones, self.tied_arms)",
        CHECKS,
    ),
    Fault(
        "assembly: arms of tied nodes stay those of rest",
        "mechanics/tissue.py",
        "arms[of.tied] = at.tied_arms",
        "arms[of.tied] = of.tied_points.arms(of.torso.rest_pose)",
        CHECKS,
    ),
    Fault(
        "assembly: lambda scaled by mu's ratio",
        "anatomy/stiffness.py",
        "zip(scaled, (group.mu, group.lambda_))",
        "zip(scaled, (group.mu, group.mu))",
        MECHANICS + "/test_potential.py",
    ),
    Fault(
        "assembly: joint's parent and child blocks exchanged",
        "mechanics/joints.py",
        "blocks[:, :6, 6:], blocks[:, 6:, :6])",
        "blocks[:, 6:, :6], blocks[:, :6, 6:])",
        CHECKS,
    ),
    Fault(
        "points: second derivative loses its trace", "anatomy/points.py", "- dot[:, None, None] * np.eye(3)", "", CHECKS
    ),
    Fault(
        "load: force on a free node points the other way",
        "mechanics/loads.py",
        "node_gradient=-self.node_forces",
        "node_gradient=self.node_forces",
        CHECKS,
    ),
    Fault(
        "load: energy has the wrong sign",
        "mechanics/loads.py",
        "return -float(np.sum(self.forces",
        "return float(np.sum(self.forces",
        CHECKS,
    ),
    Fault(
        "load: pushes towards the pushed side",
        "mechanics/loads.py",
        '{"right": 1.0, "left": -1.0}',
        '{"right": -1.0, "left": 1.0}',
        MECHANICS + "/test_loads.py",
    ),
    Fault(
        "load: lever rule reversed",
        "mechanics/loads.py",
        "np.array([1.0 - share, share])",
        "np.array([share, 1.0 - share])",
        MECHANICS + "/test_loads.py",
    ),
    Fault(
        "Eqs. 1-2: F1 and F2 exchanged",
        "mechanics/loads.py",
        "return force_n - f2, f2",
        "return f2, force_n - f2",
        MECHANICS + "/test_loads.py",
    ),
    Fault(
        "supports: shoulder of the pushed side held",
        "mechanics/supports.py",
        '("right", "left").index(side)',
        '("left", "right").index(side)',
        MECHANICS + "/test_supports.py",
    ),
    Fault(
        "supports: hinge about the wrong axis",
        "mechanics/supports.py",
        '(True, True, True, True, True, pelvis != "hinge")',
        '(True, True, True, pelvis != "hinge", True, True)',
        MECHANICS + "/test_supports.py",
    ),
    Fault(
        "springs: force has the wrong sign",
        "mechanics/terms.py",
        "return -(self.stiffness * self.extension(state))",
        "return (self.stiffness * self.extension(state))",
        CHECKS,
    ),
    Fault(
        "solver: a saddle passes as an equilibrium",
        "mechanics/newton.py",
        "return SolveStatus.CONVERGED if self.tangent.factor.positive_definite else SolveStatus.SADDLE",
        "return SolveStatus.CONVERGED",
        CHECKS,
    ),
    Fault(
        "solver: any state that a stale tangent led to counts as a minimum",
        "mechanics/newton.py",
        "if spare is not None and self._least_ritz(at, spare) > LEAST_RITZ:",
        "if factor is not None:",
        CHECKS,
    ),
    Fault(
        "solver: an indefinite tangent counts as near a stale one",
        "mechanics/newton.py",
        "self._least_ritz(at, spare) > LEAST_RITZ",
        "self._least_ritz(at, spare) > -1e9",
        CHECKS,
    ),
    Fault(
        "Newton: steps may rise again after an indefinite tangent",
        "mechanics/newton.py",
        "                    if factor.projected:\n",
        "                    if False:\n",
        MECHANICS + "/test_equilibrium.py",
    ),
    Fault(
        "descent: what is concave is taken for convex",
        "mechanics/truncated.py",
        "if not curvature > 0.0:",
        "if curvature == 0.0:",
        MECHANICS + "/test_truncated.py",
    ),
    Fault(
        "descent: steps leave the ball",
        "mechanics/truncated.py",
        ">= radius**2:",
        ">= np.inf:",
        MECHANICS + "/test_truncated.py",
    ),
    Fault(
        "descent: a factor serves for one step",
        "mechanics/newton.py",
        "if way.products == MOST_PRODUCTS or factor.factor.iterative or (step < 1.0 and not fresh):",
        "if factor is not None:",
        MECHANICS + "/test_equilibrium.py",
    ),
    Fault(
        "descent: a factor made far back serves on",
        "mechanics/newton.py",
        " or (step < 1.0 and not fresh):",
        ":",
        MECHANICS + "/test_equilibrium.py",
    ),
    Fault(
        "descent: the way down from a saddle is not taken",
        "mechanics/newton.py",
        "if way.concave is not None:",
        "if False:",
        MECHANICS + "/test_equilibrium.py",
    ),
    Fault(
        "descent: products with the tangent cost nothing",
        "mechanics/newton.py",
        "self._products += way.products",
        "pass",
        MECHANICS + "/test_equilibrium.py",
    ),
    Fault(
        "solver: step taken without a line search",
        "mechanics/newton.py",
        "if energy <= at.energy + 1e-4 * step * slope:",
        "if True:",
        CHECKS,
    ),
    Fault(
        "solver: held rows keep their coupling",
        "mechanics/system.py",
        "values[self._held_entries] = 0.0",
        "pass",
        CHECKS,
    ),
    Fault(
        "solver: moments left out of the residual",
        "mechanics/system.py",
        "np.max([np.abs(bones[:, :3]).max(initial=0.0), turning, rest])",
        "np.max([np.abs(bones[:, :3]).max(initial=0.0), rest])",
        CHECKS,
    ),
    Fault(
        "solver: reactions have the wrong sign",
        "mechanics/system.py",
        "held[bone, :3], held[bone, 3:]",
        "-held[bone, :3], -held[bone, 3:]",
        CHECKS,
    ),
    Fault(
        "solver: iteration limit passes as converged",
        "mechanics/newton.py",
        "        return at.ended(SolveStatus.ITERATION_LIMIT, self.max_iterations)\n\n    def in_steps",
        "        return at.ended(SolveStatus.CONVERGED, self.max_iterations)\n\n    def in_steps",
        CHECKS,
    ),
    Fault(
        "solver: J at a step's end not looked at",
        "mechanics/newton.py",
        "if smallest_j > LEAST_J_SHARE * min(1.0, at.smallest_j) and np.isfinite(energy):",
        "if True:",
        CHECKS,
    ),
    Fault(
        "step: parent's lever lost when forces are handed down",
        "mechanics/kinematics.py",
        "rows[p, 3 + i] += gap[b, j] * rows[b, k] - gap[b, k] * rows[b, j]",
        "rows[p, 3 + i] += rows[b, 3 + i]",
        CHECKS,
    ),
    Fault(
        "step: strain in the transposed frame of the joint",
        "mechanics/kinematics.py",
        'np.einsum("bji,bj->bi", self._axes, own - carried)',
        'np.einsum("bij,bj->bi", self._axes, own - carried)',
        CHECKS,
    ),
    Fault(
        "step: nodes do not turn with the bones that carry them",
        "mechanics/kinematics.py",
        "rows[:, 3:] -= cross(self.state.bone_positions, rows[:, :3])",
        "pass",
        CHECKS,
    ),
    Fault(
        "state: turned from the wrong side",
        "anatomy/state.py",
        "exp_so3(bones[:, 3:]) @ state.bone_rotations",
        "state.bone_rotations @ exp_so3(bones[:, 3:])",
        CHECKS,
    ),
    Fault(
        "points: arms turned by the transposed rotation",
        "anatomy/points.py",
        'np.einsum("pij,pj->pi", state.bone_rotations[self.bone], self.offset)',
        'np.einsum("pji,pj->pi", state.bone_rotations[self.bone], self.offset)',
        CHECKS,
    ),
    Fault(
        "contact: springs that pull are kept, those that press let go",
        "mechanics/contact.py",
        "np.where(touching, gap, -gap)",
        "np.where(touching, -gap, gap)",
        MECHANICS + "/test_contact.py",
    ),
    Fault(
        "factor: definite matrices not told from indefinite",
        "mechanics/factor.py",
        "negative == 0 and zero == 0",
        "zero == 0",
        MECHANICS + "/test_factor.py",
    ),
    Fault(
        "factor: singular matrices pass",
        "mechanics/factor.py",
        "if not solved.all():",
        "if False:",
        MECHANICS + "/test_factor.py",
    ),
    Fault(
        "factor: columns are refined by the largest alone",
        "mechanics/factor.py",
        "size = np.abs(b).max(axis=0, initial=0.0)",
        "size = np.full(b.shape[1:], np.abs(b).max(initial=0.0))",
        MECHANICS + "/test_factor.py",
    ),
    Fault(
        "sensitivity: forward has the wrong sign",
        "mechanics/sensitivity.py",
        "columns = -self.solve(np.hstack(gradients))",
        "columns = self.solve(np.hstack(gradients))",
        CHECKS,
    ),
    Fault(
        "sensitivity: the held pelvis does not turn",
        "mechanics/sensitivity.py",
        "self._system.supports), -2] = 1.0",
        "self._system.supports), -2] = 0.0",
        CHECKS,
    ),
    Fault(
        "sensitivity: stale Hessian, that of the rest pose",
        "mechanics/sensitivity.py",
        "system.tangent(self._state, self._stiffness, terms)",
        "system.tangent(system.torso.rest_pose, self._stiffness, terms)",
        CHECKS,
    ),
    Fault(
        "sensitivity: F^-T with the wrong sign in the adjoint's one pass",
        "mechanics/tissue.py",
        "np.sum((f - g) * u)",
        "np.sum((f + g) * u)",
        CHECKS,
    ),
    Fault(
        "sensitivity: a joint's share has the wrong sign on the parent",
        "mechanics/joints.py",
        "strains[:, 3:, PARENT_W], strains[:, 3:, CHILD_W] = -turn, turn",
        "strains[:, 3:, PARENT_W], strains[:, 3:, CHILD_W] = turn, turn",
        CHECKS,
    ),
    Fault(
        "sensitivity: derivative in the load has the wrong sign",
        "mechanics/sensitivity.py",
        "return -self.solve(self._system.potential.term_gradient(change, self._state))",
        "return self.solve(self._system.potential.term_gradient(change, self._state))",
        CHECKS,
    ),
    Fault(
        "sensitivity: a turned pelvis does not count in the adjoint",
        "mechanics/sensitivity.py",
        "np.array([own - turned @ u",
        "np.array([0.0 * own - turned @ u",
        CHECKS,
    ),
    Fault(
        "place: the pad's force without its share along the motion",
        "mechanics/places.py",
        "forces = (springs.stiffness * share)[:, None]",
        "forces = (springs.stiffness + 0.0 * share)[:, None]",
        CHECKS,
    ),
    Fault(
        "place: shoulders' places add up",
        "mechanics/system.py",
        "before = self.place.shoulder_mm if self.place else 0.0",
        "before = 0.0",
        MECHANICS + "/test_places.py",
    ),
    Fault(
        "ratios: replace a stiffness instead of scaling it",
        "anatomy/stiffness.py",
        "scaled[group.joints_of(len(scaled))] *= value",
        "scaled[group.joints_of(len(scaled))] = value",
        CHECKS,
    ),
    Fault(
        "autodiff: cotangent of a rotation transposed",
        "mechanics/differentiable.py",
        "m = rotations @ np.swapaxes(self.pose.rotations, 1, 2)",
        "m = self.pose.rotations @ np.swapaxes(rotations, 1, 2)",
        MECHANICS + "/test_differentiable.py",
    ),
    Fault(
        "fit: image loss pulls the wrong way (Eq. 11 as printed)",
        "estimation/objective.py",
        'blocks = np.einsum("vki,vkic->vc", self.difference, self.jacobian)',
        'blocks = -np.einsum("vki,vkic->vc", self.difference, self.jacobian)',
        CHECKS,
    ),
    Fault(
        "sensitivity: adjoint leaves held rows in",
        "mechanics/sensitivity.py",
        "self._factor.solve(self._system.free(rhs), LINEAR_RESIDUAL)",
        "self._factor.solve(rhs, LINEAR_RESIDUAL)",
        MECHANICS + "/test_sensitivity.py",
    ),
    Fault(
        "sensitivity: given for a state out of balance",
        "mechanics/sensitivity.py",
        "if residual > limit:",
        "if residual > 1e9 + limit:",
        MECHANICS + "/test_sensitivity.py",
    ),
    Fault(
        "sensitivity: tangent at default ratios",
        "mechanics/sensitivity.py",
        "self._stiffness = system.potential.stiffness(ratios)",
        "self._stiffness = system.potential.stiffness(None)",
        MECHANICS + "/test_sensitivity.py",
    ),
    Fault(
        "features: derivative of the angle has the wrong sign",
        "imaging/features.py",
        "(along[:, None, None] * quarter - across",
        "(along[:, None, None] * quarter + across",
        CHECKS,
    ),
    Fault(
        "features: detector mm and patient-plane mm mixed (Eq. 9 as printed)",
        "imaging/features.py",
        "(jacobian / view.magnification)",
        "jacobian",
        CHECKS,
    ),
)


def misfits(faults: tuple[Fault, ...] = FAULTS) -> list[str]:
    """Faults whose text does not occur exactly once in their file: the program has changed under them."""
    found = []
    for fault in faults:
        times = (ROOT / "src" / "spinestiff" / fault.file).read_text(encoding="utf-8").count(fault.before)
        if times != 1:
            found.append(f"'{fault.name}': its text occurs {times} times in {fault.file}, wanted once")
    return found


class Copy:
    """A copy of the package in a folder of its own; faults go there, never into the package itself."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.package = folder / "src" / "spinestiff"
        shutil.copytree(ROOT / "src" / "spinestiff", self.package, ignore=shutil.ignore_patterns("__pycache__"))

    def caught(self, fault: Fault) -> bool:
        """Whether the tests fail with this fault in the copy."""
        target = self.package / fault.file
        text = target.read_text(encoding="utf-8")
        target.write_text(text.replace(fault.before, fault.after), encoding="utf-8")
        try:
            return not self.passes(fault.tests)
        finally:
            target.write_text(text, encoding="utf-8")

    def passes(self, tests: str) -> bool:
        """Whether the tests pass with the copy as it is."""
        # Compiled kernels are kept between faults (numba looks at a file's time); byte code, which goes by whole
        # seconds, is not.
        environment = {
            **os.environ,
            "PYTHONPATH": str(self.package.parent),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(self.folder / "numba"),
        }
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", f"tests/{tests}"]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900)
        if done.returncode not in (0, 1):
            raise SystemExit(f"pytest did not run\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
        return done.returncode == 0


def main(words: list[str]) -> int:
    """Try every fault whose name holds one of ``words``; the number of missed ones decides the exit status."""
    chosen = tuple(f for f in FAULTS if not words or any(word in f.name for word in words))
    if lost := misfits(chosen):
        raise SystemExit("\n".join(lost))
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        for tests in sorted({fault.tests for fault in chosen}):
            if not copy.passes(tests):
                raise SystemExit(f"tests/{tests} fails without any fault")
        for fault in chosen:
            start = time.perf_counter()
            found = copy.caught(fault)
            missed += not found
            print(f"{'caught' if found else 'MISSED'}  {time.perf_counter() - start:5.1f} s  {fault.name}", flush=True)
    print(f"{len(chosen) - missed} of {len(chosen)} faults caught")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
