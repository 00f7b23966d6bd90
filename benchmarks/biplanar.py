"""What other views, pedicles and skin markers tell of axial rotation: synthetic subjects estimated from less and more.

    python benchmarks/biplanar.py --log FILE [--seeds N ...] [--seen NAME ...]  make and estimate, a line each
    python benchmarks/biplanar.py --store FILE                  keep the log's figures, and those of the rigs made anew,
                                                                in benchmarks/results/biplanar.json
    python benchmarks/biplanar.py [--json]                      print that file

A subject is a body of ``coverage_subjects.py``, of its own mesh, proportions and curve, with drawn ratios of lateral
bending, tissue and axial rotation, one push at rib 8 with an unloaded and two loaded frames, supports that give, and a
force, place, stance and marks that are off by as much as ``estimation.priors.Priors`` say. The radiographs are frontal
and lateral, as of a biplanar system; pedicles are marked in the frontal ones, corners in both; cameras see 16 markers
on front and flanks. All three ratios are estimated on the coarse mesh from frontal corners, from these with pedicles,
with lateral corners, with both, with markers, and with all of it; ``--seen`` asks for some of these. Lines of a log
about one subject are joined.

The rigs: to first order at given ratios, what standard deviation the log of axial rotation has on the reference body
with a thoracic curve of 30 degrees under 40 and 60 N at rib 8, with the wall behind the back and without, the shape at
rest being known. All of it is synthetic.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from coverage_subjects import _pushed, _true_torso
from judgement_subjects import (
    FRAME_ROLL_SD,
    FRAME_SHIFT_SD_MM,
    TRACK_MM,
    TRACK_SPREAD,
    nominal_view,
    projected,
    standing,
)
from kept_rows import prepare, rows_of
from rich.console import Console
from rich.table import Table

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.tissue_points import PointsOnTissue
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.known import Known
from spinestiff.estimation.load_acts import changed_load, load_changes
from spinestiff.estimation.objective import Picture, SkinMarkers, Trial
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.unknowns import ACTS
from spinestiff.estimation.weighed import WeighedProblem, reduced
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.pedicles import PediclePoints, pedicle_centres
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.tracking.quality import quality_of
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, rib_push
from spinestiff.mechanics.push import raised_level
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.pose import align_view, posed
from spinestiff.personalise.shape import personalise
from spinestiff.study.fits import fit_pushes
from spinestiff.study.synthetic.elastic_supports import drawn_supports, elastic_supports, support_stiffness
from spinestiff.study.synthetic.markers import spread_markers
from spinestiff.study.synthetic.spines import curved_spine
from spinestiff.study.trials import PushSet, PushTrial, push_set
from spinestiff.subject.outcomes import MarkerTracks, TrackedPush
from spinestiff.subject.records import PushRecord

RESULTS = Path(__file__).parent / "results" / "biplanar.json"
NAMES = ("lateral_bending", "tissue", "axial_rotation")
START = {"lateral_bending": 0.07, "tissue": 0.04, "axial_rotation": 0.3}
LIMITS = {"lateral_bending": (0.03, 0.3), "tissue": (0.03, 0.2), "axial_rotation": (0.05, 1.0)}
SHARES = (0.0, 0.6, 1.0)
FORCE_N = 60.0
SEEN: Mapping[str, tuple[bool, bool, bool]] = {
    "frontal corners": (False, False, False),
    "and pedicles": (True, False, False),
    "and lateral corners": (False, True, False),
    "and both": (True, True, False),
    "and skin markers": (False, False, True),
    "and all": (True, True, True),
}
"""By name, whether pedicles in the frontal and corners in a lateral radiograph, and skin markers are used, too."""
MARKERS = 16
SWAY_STREAM = 31


@dataclass(frozen=True)
class Subject:
    """A subject as the steps get it, with its true ratios; ``pedicles`` and ``lateral`` of each frame."""

    height_cm: float
    cobb_deg: float
    ratios: Mapping[str, float]
    rest: Mapping[str, tuple[VertebraCorners, XRayView]]
    record: PushRecord
    tracked: TrackedPush
    pedicles: Sequence[PediclePoints]
    lateral: Sequence[VertebraCorners]
    largest_turn_deg: float
    markers: MarkerTracks


def make_subject(seed: int) -> Subject:
    """The subject of a seed. Raises SpinestiffError where it can't be made."""
    random, p = np.random.default_rng([29, seed]), Priors()
    height = float(random.uniform(145.0, 165.0))
    torso = _true_torso(random, height, 13.0, "female", 3000, seed)
    values = {name: float(np.exp(random.uniform(*np.log(limits)))) for name, limits in LIMITS.items()}
    nominal = {
        name: nominal_view(make, height) for name, make in (("frontal", frontal_view), ("lateral", lateral_view))
    }
    flat = projected(torso, nominal["frontal"], torso.rest_pose)
    cobb = float(cobb_angle(tilts(VERTEBRAE, flat, nominal["frontal"])).degrees)
    side: Literal["left", "right"] = "left" if cobb > 0.0 else "right"
    rest = {}
    for name, view in nominal.items():
        corners = projected(torso, standing(view, random, lateral=name == "lateral"), torso.rest_pose)
        wrong = random.normal(0.0, p.annotation_mm * view.magnification, corners.shape)
        rest[name] = (VertebraCorners(VERTEBRAE, corners + wrong), view)
    level = 8.0
    angle = np.deg2rad(p.direction_deg)
    sizes = (p.force_scale, p.force_offset_n, angle, angle, p.push_height_mm, p.push_depth_mm)
    acts = np.zeros(len(ACTS))
    acts[: len(sizes)] = random.normal(0.0, sizes)
    height = ACTS.index("height")
    site = rib_push(torso, side, raised_level(torso, side, level, acts[height])[0], FORCE_N)
    acts[height] = 0.0
    loads = []
    for share in SHARES:
        told = site.scaled(share)
        loads.append(changed_load(told, load_changes(told, torso), acts) if share else told)
    ratios = stiffness_ratios(values, torso.joints.kinds)
    springs = support_stiffness(torso, side, [loads[-1]], ratios, drawn_supports(random))
    problem = EquilibriumProblem(torso, elastic_supports(torso, side, springs))
    states = _pushed([problem] * len(loads), loads, ratios)
    told_n = [round(share * FORCE_N, 1) for share in SHARES]
    frontal, pedicles = _frontal(torso, nominal["frontal"], states, random, p)
    record = PushRecord(
        id="main",
        side=side,
        level=level,
        d21_mm=400.0,
        d31_mm=200.0,
        frames="main",
        forces_n=tuple(told_n),
        roles=("unused", "training", "training"),
    )
    return Subject(
        round(height, 0),
        cobb,
        values,
        rest,
        record,
        TrackedPush.of(nominal["frontal"], frontal),
        pedicles,
        _lateral(torso, nominal["lateral"], states, random, p),
        _turn_deg(torso, states[-1]),
        _markers(torso, nominal["frontal"], states, site, np.random.default_rng([SWAY_STREAM, seed]), p),
    )


def _moving(placed: XRayView, number: int, random: np.random.Generator, p: Priors) -> XRayView:
    """The view of a frame: after the first, the patient has swayed and turned a little."""
    if not number:
        return placed
    yaw = float(np.deg2rad(p.place_yaw_deg) * random.normal())
    return posed(placed, random.normal(0.0, FRAME_SHIFT_SD_MM, 2), float(random.normal(0.0, FRAME_ROLL_SD)), yaw)


def _frontal(
    torso: TorsoModel, nominal: XRayView, states: Sequence[TorsoState], random: np.random.Generator, p: Priors
) -> tuple[list[VertebraCorners], list[PediclePoints]]:
    placed = standing(nominal, random, lateral=False)
    wrong = random.normal(0.0, p.annotation_mm, (17, 4, 2))
    outwards = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
    there = pedicle_centres(torso) + outwards * random.normal(0.0, p.pedicles_mm, 3)
    there = there + random.normal(0.0, p.own_pedicle_mm, there.shape)
    points = PointsOnBones(np.repeat(torso.vertebra_bones, 2), there.reshape(-1, 3))
    found, marks = [], []
    for number, state in enumerate(states):
        view = _moving(placed, number, random, p)
        size = TRACK_MM * np.exp(TRACK_SPREAD * random.normal(size=(17, 1))) * (number > 0)
        error = size[..., None] * random.normal(size=(17, 4, 2))
        corners = projected(torso, view, state) + (wrong + error) * view.magnification
        quality = quality_of(np.sqrt(2.0) * np.broadcast_to(size, (17, 4)))
        found.append(VertebraCorners(VERTEBRAE, corners, quality))
        seen = view.project(points.positions(state)).reshape(17, 2, 2)
        seen = seen + random.normal(0.0, p.pedicle_mm * view.magnification, seen.shape)
        marks.append(PediclePoints(VERTEBRAE, seen))
    return found, marks


def _lateral(
    torso: TorsoModel, nominal: XRayView, states: Sequence[TorsoState], random: np.random.Generator, p: Priors
) -> list[VertebraCorners]:
    placed = standing(nominal, random, lateral=True)
    wrong = random.normal(0.0, p.annotation_mm, (17, 4, 2))
    found = []
    for number, state in enumerate(states):
        view = _moving(placed, number, random, p)
        own = random.normal(0.0, p.marking_mm, (17, 4, 2))
        found.append(VertebraCorners(VERTEBRAE, projected(torso, view, state) + (wrong + own) * view.magnification))
    return found


def _markers(
    torso: TorsoModel,
    nominal: XRayView,
    states: Sequence[TorsoState],
    site: LoadCase,
    random: np.random.Generator,
    p: Priors,
) -> MarkerTracks:
    """Markers as cameras see them: turned axes, an origin of their own, a patient who sways and breathes."""
    points, outward = spread_markers(torso, MARKERS, site.points.positions(torso.rest_pose))
    there = np.array([points.positions(torso, state) for state in states])
    shown = nominal.pixels(nominal.project(there[0]) + random.normal(0.0, 1.0, (MARKERS, 2)))
    there += p.marker_breath_mm * random.normal(size=(len(states), 1, 1)) * outward
    there += random.normal(0.0, p.marker_mm, there.shape)
    middle = there[0].mean(0)
    sway = np.deg2rad([p.place_deg, p.place_yaw_deg, p.place_deg])
    for number in range(1, len(states)):
        turned = (there[number] - middle) @ exp_so3(sway * random.normal(size=3)).T
        there[number] = middle + turned + random.normal(0.0, p.place_mm, 3)
    turn = exp_so3(np.deg2rad(p.marker_turn_deg) * random.normal(size=3))
    cameras = (there - middle) @ turn.T + random.normal(0.0, 400.0, 3)
    names = tuple(f"m{number + 1}" for number in range(MARKERS))
    return MarkerTracks(
        names=names,
        reference=0,
        side="front",
        shown_px={name: tuple(pixel) for name, pixel in zip(names, shown.tolist())},
        frames=tuple(tuple(tuple(place) for place in frame) for frame in cameras.tolist()),
    )


def with_more(pushes: PushSet, subject: Subject, pedicles: bool, lateral: bool, markers: bool) -> PushSet:
    """The trials with pedicles in their radiographs, with lateral ones, and with markers or without."""
    nominal = subject.rest["lateral"][1]
    view, _ = align_view(pushes.torso, pushes.torso.rest_pose, nominal, subject.lateral[0])
    found: list[PushTrial] = []
    for item in pushes.trials:
        picture = Picture(subject.lateral[item.frame], view, f"{item.trial.label} lateral", "main lateral")
        trial = replace(
            item.trial,
            pedicles=subject.pedicles[item.frame] if pedicles else None,
            further=(picture,) if lateral else (),
            markers=item.trial.markers if markers else None,
        )
        found.append(replace(item, trial=trial))
    return replace(pushes, trials=tuple(found))


def told(fit: StiffnessFit, truth: Mapping[str, float]) -> dict[str, Any]:
    """Estimate, interval and word of each ratio, and how far the truth lies from the estimate in sds."""
    likely = fit.likely
    assert likely is not None
    found: dict[str, Any] = {"status": fit.status.name, "p_value": None, "evaluations": len(fit.history)}
    if fit.weighed is not None:
        found["p_value"] = fit.weighed.p_value
    for i, name in enumerate(fit.names):
        profile = likely.profiles[i]
        at = np.log(truth[name])
        inside = profile.log_ratios[0] <= at <= profile.log_ratios[-1]
        rise = float(np.interp(at, profile.log_ratios, profile.rise)) if inside else float("nan")
        found[name] = {
            "estimate": fit.ratios.as_dict()[name],
            "interval": list(fit.intervals95[name]),
            "open": list(fit.open_ends[name]),
            "word": likely.kinds[i],
            "z": float(np.sign(np.log(fit.ratios.values[i]) - at) * np.sqrt(2.0 * max(rise, 0.0))),
        }
    return found


def run_one(seed: int, seen: Sequence[str]) -> dict[str, Any]:
    """A subject made and estimated from less and from more, as a line of the log."""
    began = time.process_time()
    try:
        subject = make_subject(seed)
        template = template_torso(subject.height_cm, age_years=13.0, sex="female")
        shaped = personalise(template, subject.rest)
        known = Known(Priors(), shaped.covariance)
        tracked = subject.tracked.model_copy(update={"markers": subject.markers})
        pushes = push_set(shaped.torso, [subject.record], {"main": tracked}, known=known)
    except SpinestiffError as error:
        return {"seed": seed, "not made": str(error)}
    row: dict[str, Any] = {
        "seed": seed,
        "cobb_deg": round(subject.cobb_deg, 1),
        "largest_turn_deg": round(subject.largest_turn_deg, 2),
        "ratios": dict(subject.ratios),
    }

    for name in seen:
        try:
            own = time.process_time()
            fit = fit_pushes(with_more(pushes, subject, *SEEN[name]), NAMES, START, extent="intervals")
            row[name] = {**told(fit, subject.ratios), "cpu_s": round(time.process_time() - own)}
            print(f"{seed} {name}: {row[name]}", flush=True)
        except SpinestiffError as error:
            row[name] = {"failed": str(error)}
    return {**row, "cpu_s": round(time.process_time() - began)}


def rigs() -> list[dict[str, Any]]:
    """Standard deviations of the log of axial rotation by rig, ratio and what is seen."""
    template = template_torso(157.0, "coarse")
    torso = place_vertebrae(template, *curved_spine(template, 30.0, "thoracic"))
    views = {"frontal": frontal_view(), "lateral": lateral_view()}
    found = []
    for wall in (True, False):
        problem = EquilibriumProblem(torso, three_point_supports(torso, "right", wall=wall))
        for axial in (1.0, 0.2):
            values = {"lateral_bending": 0.1, "tissue": 0.05, "axial_rotation": axial}
            ratios = stiffness_ratios(values, torso.joints.kinds)
            loads = [rib_push(torso, "right", 8.0, force) for force in (0.0, 40.0, 60.0)]
            states = _pushed([problem] * len(loads), loads, ratios)
            row: dict[str, Any] = {"wall": wall, "axial_rotation": axial, "turn_deg": _turn_deg(torso, states[-1])}
            markers = spread_markers(torso, MARKERS, loads[-1].points.positions(torso.rest_pose))
            for name, (pedicles, lateral, marked) in SEEN.items():
                trials = [_exact(torso, load, state, views, pedicles, lateral) for load, state in zip(loads, states)]
                if marked:
                    trials = [
                        replace(trial, markers=_exact_markers(torso, state, *markers))
                        for trial, state in zip(trials, states)
                    ]
                trial_set = TrialSet([problem] * 2, trials[1:], ratios.groups, "procrustes", None)
                asked = WeighedProblem(trial_set, [(problem, trials[0])], "procrustes", Known())
                nothing = np.zeros(len(asked.unknowns))
                point = asked.solve(np.log(ratios.values), nothing, starts=states[1:])
                slope = asked.slope(point)
                model = reduced(point, slope, asked.weights(point, slope, None))
                row[name] = float(np.sqrt(np.linalg.inv(model.ratios.T @ model.ratios)[2, 2]))
            found.append(row)
    return found


def _turn_deg(torso: TorsoModel, state: TorsoState) -> float:
    """The largest axial turn of a vertebra."""
    turned = state.bone_rotations @ np.swapaxes(torso.rest_pose.bone_rotations, 1, 2)
    turns = np.arctan2(turned[torso.vertebra_bones, 0, 2], turned[torso.vertebra_bones, 2, 2])
    return float(np.degrees(np.abs(turns).max()))


def _exact(
    torso: TorsoModel,
    load: LoadCase,
    state: TorsoState,
    views: Mapping[str, XRayView],
    pedicles: bool,
    lateral: bool,
) -> Trial:
    """What a state shows, without errors."""
    corners = {name: projected(torso, view, state) for name, view in views.items()}
    points = PointsOnBones(np.repeat(torso.vertebra_bones, 2), pedicle_centres(torso).reshape(-1, 3))
    marks = views["frontal"].project(points.positions(state)).reshape(17, 2, 2)
    quality = quality_of(np.full((17, 4), TRACK_MM))
    side = Picture(VertebraCorners(VERTEBRAE, corners["lateral"]), views["lateral"], f"{load.size:g} N side", "side")
    return Trial(
        load,
        VertebraCorners(VERTEBRAE, corners["frontal"], quality),
        views["frontal"],
        f"{load.size:g} N",
        "main",
        load.size == 0.0,
        pedicles=PediclePoints(VERTEBRAE, marks) if pedicles else None,
        further=(side,) if lateral else (),
    )


def _exact_markers(torso: TorsoModel, state: TorsoState, points: PointsOnTissue, outward: Floats) -> SkinMarkers:
    """Markers of a state, without errors."""
    names = tuple(f"m{number + 1}" for number in range(len(points)))
    return SkinMarkers(names, points.positions(torso, state), points, outward, "main markers")


def rig_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """What ``rigs`` found."""
    table = Table("wall", "axial rotation", "turn", *SEEN, title="sd of the log of axial rotation, to first order")
    for row in rows:
        told = "yes" if row["wall"] else "no"
        sds = (f"{row[name]:.2f}" for name in SEEN)
        table.add_row(told, f"{row['axial_rotation']:g}", f"{row['turn_deg']:.1f}°", *sds)
    return table


def summary(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Estimates of axial rotation and their intervals, by subject and by what was seen."""
    table = Table("subject", "turn", "seen", *NAMES, title="estimate (95 % interval; z of the truth)")
    for row in rows:
        if "not made" in row:
            table.add_row(str(row["seed"]), row["not made"])
            continue
        table.add_row(
            f"{row['seed']}: {row['cobb_deg']:.0f}°",
            f"{row['largest_turn_deg']:.1f}°",
            "truth",
            *(f"{row['ratios'][name]:.3g}" for name in NAMES),
        )
        for seen in (name for name in SEEN if name in row):
            one = row[seen]
            if "failed" in one:
                table.add_row("", "", seen, one["failed"])
                continue
            table.add_row("", "", seen, *(_shown(one[name]) for name in NAMES))
    return table


def _shown(one: Mapping[str, Any]) -> str:
    low, high = one["interval"]
    less, more = ("≤ " if one["open"][0] else ""), ("≥ " if one["open"][1] else "")
    return f"{one['estimate']:.3g} ({less}{low:.3g} to {more}{high:.3g}; {one['z']:+.1f})"


def main() -> None:
    """Make, store or print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--log", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--seen", nargs="+", choices=tuple(SEEN), default=list(SEEN))
    parser.add_argument("--store", type=Path)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    if asked.log:
        prepare(asked.log)
        with asked.log.open("a", encoding="utf-8") as log:
            for seed in asked.seeds:
                print(json.dumps(run_one(seed, asked.seen)), file=log, flush=True)
        return
    if asked.store:
        joined: dict[int, dict[str, Any]] = {}
        for row in rows_of([asked.store]):
            joined[row["seed"]] = {**joined.get(row["seed"], {}), **row}
        rows = [joined[seed] for seed in sorted(joined)]
        RESULTS.write_text(json.dumps({"subjects": rows, "rigs": rigs()}, indent=1) + "\n", encoding="utf-8")
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    if asked.json:
        print(json.dumps(stored))
        return
    Console().print(summary(stored["subjects"]), rig_table(stored["rigs"]))


if __name__ == "__main__":
    main()
