"""How the template takes a body's size: its length from pictures of a curved spine, its skin from a scan.

Height: how much nearer the ends of the 157 cm template's spine are in a curve of so many degrees. Neighbours: standard
deviations of two neighbouring vertebrae's difference by the prior, along the body's axes (least, median, largest).

Length: the template of eight heights with a curve of 13 to 65 degrees each, of four kinds, is seen from the front and
the side with 0.5 mm of noise, and the template of that height is shaped to it, the views estimated. The spine's length
over the template's should be 1.

Skin: scans of template bodies of 38, 46 and 60 kg (157 cm, fine mesh), without floor and lid, with 1 mm of noise,
turned by 20 degrees, leaning by 3 and 390 mm away (``tests/scans.py``); the skin of the 46 kg template on the coarse
mesh is moved to each by ``personalise.scanned_skin``. Told is the distance of the skin from the true one, mm, before
and after.
``docs/personalisation.md`` quotes it.

    python benchmarks/carried_bodies.py [--write]
    python benchmarks/carried_bodies.py --json
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import measure_once

from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.prior import elastic_prior, pelvis_on_springs
from spinestiff.personalise.scan import read_scan
from spinestiff.personalise.scanned_skin import with_scan
from spinestiff.personalise.shape import personalise
from spinestiff.study.synthetic.spines import CURVES, curved_spine, rest_vertebrae

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from scans import AXES, HEIGHT, body, errors, surface, written

RESULTS = Path(__file__).parent / "results" / "carried_bodies.json"
BODIES = 8
BENT_DEG = (60.0, 65.0, 80.0)
COBB_DEG, HEIGHTS_CM = (13.0, 65.0), (139.0, 180.0)
NOISE_MM, DETECTOR_PX = 0.5, (1536, 1024)
OWN_KG, LEAN_DEG = 46.0, 3.0
# What is scanned: the body's mass, kg, and whether its arms hang in the scan.
SCANS = {
    "whole, 38 kg": (38.0, False),
    "whole, 60 kg": (60.0, False),
    "with arms, 60 kg": (60.0, True),
    "whole, 46 kg (its own)": (46.0, False),
}


def seen(torso: TorsoModel, view: XRayView, rng: np.random.Generator) -> VertebraCorners:
    """Corners of a torso at rest in a view, with noise at the patient plane."""
    shares = silhouette_shares(torso, view, torso.rest_pose)
    corners = state_features(torso, view, torso.rest_pose, shares).corners
    return VertebraCorners(torso.vertebrae, corners + rng.normal(0.0, NOISE_MM * view.magnification, corners.shape))


def of_length(number: int) -> dict[str, Any]:
    """One body's length over the template's, as it is found where it is 1."""
    share = number / (BODIES - 1)
    height = float(np.interp((3 * number) % BODIES, [0, BODIES - 1], HEIGHTS_CM))
    kinds: Sequence[str] = tuple(CURVES)
    cobb, curve = float(np.interp(share, [0.0, 1.0], COBB_DEG)), kinds[number % len(kinds)]
    template = template_torso(height, "coarse")
    person = place_vertebrae(template, *curved_spine(template, cobb, curve))
    rng = np.random.default_rng(number)
    spine = template.rest_pose.bone_positions[template.vertebra_bones]
    centre = np.array([0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0])
    shape = (1536, 1024)
    views = {
        name: of(shape=shape, centre=centre) for name, of in (("frontal", frontal_view), ("lateral", lateral_view))
    }
    pictures = {name: (seen(person, view, rng), view) for name, view in views.items()}

    return {
        "cobb_deg": round(cobb, 1),
        "curve": curve,
        "height_cm": round(height, 1),
        "length_scale": round(personalise(template, pictures, geometry="estimated").length_scale, 4),
    }


def height_lost(cobb_deg: float) -> float:
    """Share of the distance between T1 and L5 that a thoracic curve takes away."""
    torso = template_torso(HEIGHT, "coarse")
    ends = [
        float(np.linalg.norm(places[0] - places[-1]))
        for places in (rest_vertebrae(torso)[0], curved_spine(torso, cobb_deg, "thoracic")[0])
    ]
    return round(1.0 - ends[1] / ends[0], 3)


def neighbours() -> dict[str, list[float]]:
    """Least, median and largest of all pairs: degrees about each axis, mm to the left, up and to the front."""
    torso = template_torso(HEIGHT, "coarse")
    prior = elastic_prior(EquilibriumProblem(torso, pelvis_on_springs(torso)), torso.rest_pose)
    covariance = np.linalg.inv(prior.hessian).reshape(17, 6, 17, 6)
    upper, lower = np.arange(16), np.arange(1, 17)
    parts = ((upper, upper, 1.0), (lower, lower, 1.0), (upper, lower, -1.0), (lower, upper, -1.0))
    # (16, 6) variances of the differences, shifts before turns.
    variance = sum(sign * np.einsum("nii->ni", covariance[one, :, other, :]) for one, other, sign in parts)
    sd = np.sqrt(np.asarray(variance))
    named = {"left_mm": sd[:, 0], "up_mm": sd[:, 1], "front_mm": sd[:, 2], "turn_deg": np.degrees(sd[:, 3:])}
    return {name: [round(float(pick(of)), 2) for pick in (np.min, np.median, np.max)] for name, of in named.items()}


def told(distances: Floats) -> list[float]:
    """Median and 95th percentile."""
    return [round(float(np.percentile(distances, q)), 2) for q in (50, 95)]


def of_scan(mass_kg: float, arms: bool, folder: Path) -> dict[str, list[float]]:
    """How far the skin lies from the scanned body's, mm."""
    truth, own = body(mass_kg, "fine"), body(OWN_KG)
    path = written(surface(truth, arms=arms), folder / "scan.ply", tilt=LEAN_DEG)
    after, _ = with_scan(own, read_scan(path, "mm", AXES, HEIGHT))
    return {"before_mm": told(errors(own, truth)), "after_mm": told(errors(after, truth))}


def measured() -> dict[str, Any]:
    """All of it."""
    lengths = [of_length(number) for number in range(BODIES)]
    with tempfile.TemporaryDirectory() as folder:
        scans = {name: of_scan(*what, Path(folder)) for name, what in SCANS.items()}
    ends = [pick(row["length_scale"] for row in lengths) for pick in (min, max)]
    return {
        "height_lost": {f"{cobb:g}": height_lost(cobb) for cobb in BENT_DEG},
        "neighbours": neighbours(),
        "length": {"ends": ends, "bodies": lengths},
        "skin": scans,
    }


if __name__ == "__main__":
    measure_once(__doc__, RESULTS, measured)
