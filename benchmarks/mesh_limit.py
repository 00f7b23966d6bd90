"""How far the fine mesh's estimates lie from those of other meshes, of 15,000 to 65,000 nodes.

``python benchmarks/mesh_limit.py --scratch FOLDER [--subjects 10] [--json] [--write]``

Subjects are those of ``discrepancy_pairs``: bodies, curves and ratios at random. Each is pushed at ribs 5, 7.5 and 10
on the side of its curve, hard enough to turn its vertebrae by about 12 degrees against each other. The truth is on
meshes that do not ship, two of about 25,000 nodes from different seeds and one of 65,000, and on that which synthetic
subjects have (15,000). Model and truth have equal
ratios. What the difference of the 17 vertebrae's motions does to an estimate on the fine mesh is found as in
``discrepancy.py``: generalised least squares about the true ratios, with the covariance that an estimate takes and its
unknowns. Nothing else is wrong in the data.

Asked of the mean over the subjects: 0.1 of log bending and 0.03 of log tissue at most. It goes on from what is in the
folder (CPU minutes a subject: about one on 25,000 nodes, two on 65,000).
"""

from __future__ import annotations

import argparse
import datetime
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from discrepancy import Pair, pair_of, weighed
from discrepancy_pairs import LEVELS, ROOT, Bench, Frame, at_frames, rounded, subject_of
from kept_rows import begun, prepare

from spinestiff.anatomy.files import read_torso, write_torso
from spinestiff.anatomy.template import OWN_MESH, template_torso
from spinestiff.anatomy.template.assemble import assemble, build_skeleton
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import EquilibriumError, SpinestiffError
from spinestiff.estimation.discrepancy_data import shipped_modes

sys.path.insert(0, str(ROOT / "tools"))

import build_torso
from tissue_mesh import half_mesh, mirror, quadratic

RESULTS = Path(__file__).parent / "results" / "mesh_limit.json"
FINEST = 17.0  # mm between points inside
# Of the truths: mm between points inside, as in the family of ``mesh_convergence``, and seed.
MESHES = {
    "fine's family": f"{FINEST:g} {build_torso.SEED}",
    "another": f"{FINEST:g} 71",
    "finest": "12.6 71",
    "synthetic subjects'": OWN_MESH,
}
TILT_DEG = 12.0
ASKED = (0.1, 0.03)  # of log bending, log tissue


def run_subject(number: int, meshes: Sequence[str], cache: Path) -> list[dict[str, Any]]:
    """The pairs of a subject, one a mesh.

    Raises
    ------
    SpinestiffError : the model can't carry a push, or has no mesh.
    """
    subject = subject_of(number)
    side = "left" if subject.cobb_deg > 0.0 else "right"
    rough = Bench(subject.shaped(template_torso(subject.height_cm)))
    frames = tuple(Frame("grid", side, level, _force(rough, side, level, subject.ratios)) for level in LEVELS)
    bench = Bench(subject.shaped(template_torso(subject.height_cm, "fine")))
    model = at_frames(bench, subject, frames, (None,) * len(frames))
    rows = []
    for mesh in meshes:
        began = time.process_time()
        row: dict[str, Any] = {"kind": "fine to limit", "subject": number, "mesh": mesh, "cobb_deg": subject.cobb_deg}
        row |= {"bending": subject.bending, "tissue_mpa": subject.tissue_mpa, "frames": []}
        try:
            truth = Bench(subject.shaped(_on(MESHES[mesh], subject.height_cm, cache)))
            row["nodes"] = len(truth.torso.tissue.rest_positions)
            for frame, motion, slope in zip(model.frames, model.motions, model.slopes):
                load = truth.load(frame.side, frame.level, frame.force_n)
                true = truth.motion(truth.solve(frame.side, load, subject.ratios))
                told = {"model": rounded(motion), "truth": rounded(true), "slope": rounded(slope)}
                row["frames"].append({**frame.__dict__, **told})
        except SpinestiffError as error:
            row = {"subject": number, "mesh": mesh, "failed": str(error)}
        rows.append({**row, "cpu_s": round(time.process_time() - began, 1)})
    return rows


def _on(mesh: str, height_cm: float, cache: Path) -> TorsoModel:
    """The reference body at a height, on a mesh of ``MESHES``."""
    if mesh == OWN_MESH:
        return template_torso(height_cm, mesh)
    torso = _family(mesh, cache)
    return torso.scaled(height_cm / torso.height_cm)


@lru_cache(maxsize=8)
def _family(name: str, cache: Path) -> TorsoModel:
    """The template on a mesh that does not ship, kept in a folder."""
    path = cache / f"{name.replace(' ', '_')}.npz"
    if not path.exists():
        inside, seed = name.split()
        spacing, skeleton = build_torso.family_spacing(float(inside)), build_skeleton()
        half = half_mesh(skeleton, spacing, int(seed))
        nodes, elements, bones = quadratic(*mirror(half), skeleton, build_torso.NEAR * spacing.inside)
        write_torso(path, assemble(skeleton, nodes, elements, bones))
    stored = read_torso(path)
    like = template_torso(stored.height_cm)
    mu, lambda_ = (np.full(len(stored.tissue.elements), m[0]) for m in (like.tissue.lame_mu, like.tissue.lame_lambda))
    return replace(stored, joints=like.joints, tissue=replace(stored.tissue, lame_mu=mu, lame_lambda=lambda_))


def _force(bench: Bench, side: str, level: float, ratios: Any) -> float:
    """N that turn vertebrae by about ``TILT_DEG``."""
    force = 10.0
    for _ in range(6):
        try:
            turns = np.degrees(bench.motion(bench.solve(side, bench.load(side, level, force), ratios))[:, 2])
        except EquilibriumError:
            force *= 0.5
            continue
        change = float(np.clip(TILT_DEG / (turns.max() - turns.min()), 0.2, 5.0))
        if 0.8 < change < 1.25:
            break
        force *= change**0.8
    return force


def biases(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """By mesh: what the difference does to log bending and log tissue, over the subjects."""
    modes, found = shipped_modes("fine"), {}
    for mesh in MESHES:
        own = [row for row in rows if row["mesh"] == mesh and "failed" not in row]
        if not own:
            continue
        pairs: list[Pair] = [pair_of(row) for row in own]
        estimates = [weighed(pair, range(len(pair.frames)), modes) for pair in pairs]
        bias, sd = np.array([e.bias for e in estimates]), np.sqrt([np.diag(e.variance) for e in estimates])
        relative = [np.sqrt(np.mean(pair.relative(range(len(pair.frames))) ** 2) * 3.0) for pair in pairs]
        found[mesh] = {
            "subjects": len(own),
            "nodes": [min(row["nodes"] for row in own), max(row["nodes"] for row in own)],
            "relative": round(float(np.mean(relative)), 4),
            "mean_bias": bias.mean(axis=0).round(4).tolist(),
            "standard_error": (bias.std(axis=0, ddof=1) / np.sqrt(len(own))).round(4).tolist()
            if len(own) > 1
            else None,
            "largest": np.abs(bias).max(axis=0).round(4).tolist(),
            "rms_bias_over_sd": np.sqrt(np.mean((bias / sd) ** 2, axis=0)).round(3).tolist(),
            "met": bool((np.abs(bias.mean(axis=0)) <= ASKED).all()),
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scratch", type=Path, required=True, help="folder of pairs and meshes; a run goes on from it")
    parser.add_argument("--subjects", type=int, default=10)
    parser.add_argument("--meshes", nargs="+", choices=list(MESHES), default=list(MESHES))
    parser.add_argument("--json", action="store_true", help="print what was found as JSON")
    parser.add_argument("--write", action="store_true", help="store it in benchmarks/results/")
    asked = parser.parse_args()
    asked.scratch.mkdir(parents=True, exist_ok=True)
    log, cache = asked.scratch / "limit.jsonl", asked.scratch / "meshes"
    cache.mkdir(exist_ok=True)
    prepare(log)
    rows = begun(log)
    for number in range(asked.subjects):
        done = {row["mesh"] for row in rows if row["subject"] == number}
        todo = [mesh for mesh in asked.meshes if mesh not in done]
        if not todo:
            continue
        new = run_subject(number, todo, cache)
        rows += new
        with log.open("a") as stream:
            stream.writelines(json.dumps(row) + "\n" for row in new)
        if not asked.json:
            print(number, [(row["mesh"], row.get("failed", row["cpu_s"])) for row in new], flush=True)
    date = datetime.datetime.now(datetime.UTC).date().isoformat()
    result = {"date": date, "asked": ASKED, "meshes": biases(rows)}
    result["failed"] = [row for row in rows if "failed" in row]
    print(json.dumps(result, indent=1))
    if asked.write:
        RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
