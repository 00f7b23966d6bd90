"""Do the tests notice faults? Puts one fault at a time into a copy of the package and runs the tests that should fail.

    python tools/seeded_faults.py [part of a name ...]

Prints caught or MISSED for each; exits with 1 if any was missed. Needs pytest; about five minutes in all.
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
        "-np.cross(pose.gap, force) - moment",
        "-np.cross(pose.gap, force) + moment",
        CHECKS,
    ),
    Fault(
        "joint: parent's lever is its own arm, not the gap",
        "mechanics/joints.py",
        "-np.cross(pose.gap, force) - moment",
        "-np.cross(pose.parent_arm, force) - moment",
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
        "tissue: tangent's two outer products swapped",
        "mechanics/tissue.py",
        "w_mix * h[b, i] * h[a, j] + w_lam * h[a, i] * h[b, j]",
        "w_mix * h[a, i] * h[b, j] + w_lam * h[b, i] * h[a, j]",
        CHECKS,
    ),
    Fault(
        "tissue: F^-T becomes F^-1",
        "mechanics/tissue.py",
        "volume += g[i, j] * gradients[t, q, a, j]",
        "volume += g[j, i] * gradients[t, q, a, j]",
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
        "tissue: projection keeps negative curvature",
        "mechanics/tissue.py",
        "np.maximum(values, 0.0) * data.weights",
        "np.abs(values) * data.weights",
        MECHANICS + "/test_tissue.py",
    ),
    Fault(
        "assembly: rotation term of tied nodes missing",
        "mechanics/potential.py",
        "np.add.at(blocks[:, 3:, 3:], self.tied_points.bone, turning)",
        "pass",
        CHECKS,
    ),
    Fault(
        "assembly: two nodes of one bone couple once",
        "mechanics/potential.py",
        "block[r, k] if a == b else block[r, k] + block[k, r]",
        "block[r, k]",
        CHECKS,
    ),
    Fault(
        "assembly: swapped pair not transposed",
        "mechanics/potential.py",
        "hessians[t, a, b, j, i] if swap else hessians[t, a, b, i, j]",
        "hessians[t, a, b, i, j]",
        CHECKS,
    ),
    Fault(
        "assembly: moment of tied nodes has the wrong sign",
        "mechanics/potential.py",
        "np.cross(self.tied_points.arms(state), on_bones)",
        "np.cross(on_bones, self.tied_points.arms(state))",
        CHECKS,
    ),
    Fault(
        "assembly: arms of tied nodes stay those of rest",
        "mechanics/potential.py",
        "arms[self.tied] = self.tied_points.arms(state)",
        "arms[self.tied] = self.tied_points.arms(self.torso.rest_pose)",
        CHECKS,
    ),
    Fault(
        "assembly: lambda scaled by mu's ratio",
        "mechanics/potential.py",
        "lambda_ * mesh.lame_lambda[number]",
        "mu * mesh.lame_lambda[number]",
        MECHANICS + "/test_potential.py",
    ),
    Fault(
        "assembly: joint's parent and child blocks exchanged",
        "mechanics/potential.py",
        "joints[:, :6, 6:], joints[:, 6:, :6])",
        "joints[:, 6:, :6], joints[:, :6, 6:])",
        CHECKS,
    ),
    Fault(
        "points: second derivative loses its trace", "anatomy/points.py", "- dot[:, None, None] * np.eye(3)", "", CHECKS
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
        'opposite = "right" if side == "left" else "left"',
        "opposite = side",
        MECHANICS + "/test_supports.py",
    ),
    Fault(
        "supports: hinge about the wrong axis",
        "mechanics/supports.py",
        '(True, True, True, True, True, pelvis == "clamp")',
        '(True, True, True, pelvis == "clamp", True, True)',
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
        "mechanics/equilibrium.py",
        "SolveStatus.CONVERGED if stable else SolveStatus.SADDLE",
        "SolveStatus.CONVERGED",
        CHECKS,
    ),
    Fault(
        "solver: step taken without a line search",
        "mechanics/equilibrium.py",
        "if trial_energy <= energy + 1e-4 * step * slope:",
        "if True:",
        MECHANICS + "/test_equilibrium.py",
    ),
    Fault(
        "solver: held rows keep their coupling",
        "mechanics/equilibrium.py",
        "values[self._held_entries] = 0.0",
        "pass",
        CHECKS,
    ),
    Fault(
        "solver: moments left out of the residual",
        "mechanics/equilibrium.py",
        "np.abs(bones[:, :3]).max(initial=0.0), turning, rest)",
        "np.abs(bones[:, :3]).max(initial=0.0), rest)",
        CHECKS,
    ),
    Fault(
        "solver: reactions have the wrong sign",
        "mechanics/equilibrium.py",
        "held[bone, :3], held[bone, 3:]",
        "-held[bone, :3], -held[bone, 3:]",
        CHECKS,
    ),
    Fault(
        "solver: iteration limit passes as converged",
        "mechanics/equilibrium.py",
        "factorisations, stable, status = 0, True, SolveStatus.ITERATION_LIMIT",
        "factorisations, stable, status = 0, True, SolveStatus.CONVERGED",
        CHECKS,
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
        "if not error <= RESIDUAL_LIMIT * scale and scale > 0.0:",
        "if False:",
        MECHANICS + "/test_factor.py",
    ),
    Fault(
        "sensitivity: forward has the wrong sign",
        "mechanics/sensitivity.py",
        "return -self.solve(self._ratio_gradients(groups))",
        "return self.solve(self._ratio_gradients(groups))",
        CHECKS,
    ),
    Fault(
        "sensitivity: adjoint leaves held rows in",
        "mechanics/sensitivity.py",
        "free[self._problem.held] = 0.0",
        "pass",
        MECHANICS + "/test_sensitivity.py",
    ),
    Fault(
        "sensitivity: given for a state out of balance",
        "mechanics/sensitivity.py",
        "if residual > max(",
        "if residual > 1e9 + max(",
        MECHANICS + "/test_sensitivity.py",
    ),
    Fault(
        "sensitivity: tangent at default ratios",
        "mechanics/sensitivity.py",
        "self._stiffness = problem.potential.stiffness(ratios)",
        "self._stiffness = problem.potential.stiffness(None)",
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


def caught(fault: Fault) -> bool:
    """Whether the tests fail with this fault in a copy of the package."""
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder) / "src" / "spinestiff"
        shutil.copytree(ROOT / "src" / "spinestiff", package, ignore=shutil.ignore_patterns("__pycache__"))
        target = package / fault.file
        text = target.read_text()
        if text.count(fault.before) != 1:
            raise SystemExit(
                f"'{fault.name}': its text occurs {text.count(fault.before)} times in {fault.file}, wanted once"
            )
        target.write_text(text.replace(fault.before, fault.after))
        environment = {**os.environ, "PYTHONPATH": str(package.parent), "NUMBA_CACHE_DIR": folder}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", f"tests/{fault.tests}"]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600)
        if done.returncode not in (0, 1):
            raise SystemExit(f"'{fault.name}': pytest did not run\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
        return done.returncode == 1


def main(words: list[str]) -> int:
    """Try every fault whose name holds one of ``words``; the number of missed ones decides the exit status."""
    chosen = [f for f in FAULTS if not words or any(word in f.name for word in words)]
    missed = 0
    for fault in chosen:
        start = time.perf_counter()
        found = caught(fault)
        missed += not found
        print(f"{'caught' if found else 'MISSED'}  {time.perf_counter() - start:5.1f} s  {fault.name}", flush=True)
    print(f"{len(chosen) - missed} of {len(chosen)} faults caught")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
