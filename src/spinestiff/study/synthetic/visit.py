"""A synthetic subject's visit while it is made: radiographs and records in its folder, and what they truly show."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from spinestiff.anatomy.axes import Axis, body_axes
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import cobb_angle, cobb_change, tilts
from spinestiff.errors import SubjectError
from spinestiff.estimation.priors import Priors
from spinestiff.imaging.features import silhouette_shares, state_features, view_kind
from spinestiff.imaging.pedicles import pedicle_centres
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.radiograph import write_radiographs
from spinestiff.imaging.synthetic.acquisition import Acquisition, Gauge, acquire
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.places import place_of_pelvis
from spinestiff.mechanics.push import push_heights
from spinestiff.mechanics.supports import Supports, held_shoulder
from spinestiff.parallel import in_parallel
from spinestiff.personalise.prior import OWN_PEDICLE_SD, PERSON_PEDICLE_SD
from spinestiff.study.synthetic.elastic_supports import shoulder_shift
from spinestiff.study.synthetic.markers import spread_markers, view_of_markers
from spinestiff.study.synthetic.recipe import Recipe, SyntheticPush
from spinestiff.subject.annotation_record import FEWEST_OF_VIEW, FEWEST_VERTEBRAE, Annotation, ImageAnnotation
from spinestiff.subject.folder import write_annotation, write_subject
from spinestiff.subject.image_names import frame_image, rest_image
from spinestiff.subject.marker_table import write_markers
from spinestiff.subject.record_reading import parse_record
from spinestiff.subject.records import LEVELS, PushRecord, SubjectRecord
from spinestiff.words import counted

ANNOTATION_SD_MM = 0.3  # of a hand-set corner, at the patient plane
PEDICLE_SD_MM = 0.7  # of a pedicle's mark, the same
SIDE = "lateral"  # id of the further view
CAMERAS_SD_MM = 400.0  # of the cameras' origin
CAMERA_AXES: dict[str, Axis] = {"left": "+x", "up": "+z", "front": "-y"}
MARKER_STREAM, GAUGE_STREAM = 29, 31
LEVEL_MM = 25.0  # from rib to rib along the spine
Side = Literal["left", "right"]
OPPOSITE: Mapping[Side, Side] = {"left": "right", "right": "left"}
STANDING_SD_MM, STANDING_SD_RAD = 4.0, 0.012  # how differently a patient stands from one exposure to the next
DETECTOR_WIDTH_MM = 427.0


class VisitInMaking:
    """One synthetic visit: images, annotation and truth collect here while they are made.

    Raises SubjectError for a recipe that no subject may have, and for radiographs that show too little.
    """

    def __init__(self, folder: Path, torso: TorsoModel, recipe: Recipe, random: np.random.Generator) -> None:
        self.folder, self.torso, self.recipe, self.random = folder, torso, recipe, random
        self.images: dict[str, ImageAnnotation] = {}
        self._shown_truly: dict[str, object] = {}
        spine = torso.rest_pose.bone_positions[torso.vertebra_bones]
        self.centre = np.array([0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0])
        self._rest_tilts = self._tilts(torso.rest_pose)
        self._rest_cobb = cobb_angle(self._rest_tilts)
        convex: Side = "left" if self._rest_cobb.degrees > 0.0 else "right"
        self.main_side: Side = recipe.side or convex
        # Streams of their own: what else is random is the same with and without markers, and errors of the gauge.
        self._marker_random = np.random.default_rng([recipe.seed, MARKER_STREAM])
        self._gauge_random = np.random.default_rng([recipe.seed, GAUGE_STREAM])
        self.pushes = tuple(self._push_record(push) for push in recipe.pushes)
        self._record()

    def side_of(self, push: SyntheticPush) -> Side:
        """The side of a push."""
        return OPPOSITE[self.main_side] if push.other_side else self.main_side

    def rest_images(self) -> None:
        """Take the rest radiographs and mark them."""
        lateral = replace(self.recipe.acquisition, exposure=self.recipe.lateral_exposure)
        taken = []
        # Both are marked before the first file: what shows too little of the spine leaves nothing behind.
        for name, nominal, orientation, how in (
            ("frontal", self._nominal(frontal_view), ("L", "F"), self.recipe.acquisition),
            ("lateral", self._nominal(lateral_view), ("A", "F"), lateral),
        ):
            view, seed = self._standing(nominal), self._drawn_seed()
            self.images[rest_image(name)] = self._annotation(view)
            taken.append((name, view, orientation, how, seed))

        def radiograph(
            name: str, view: XRayView, orientation: tuple[str, str], how: Acquisition, seed: int
        ) -> np.ndarray:
            return self._radiographs([self.torso.rest_pose], view, how, seed)

        pictures = in_parallel(lambda one: radiograph(*one), taken)
        for (name, view, orientation, *_), pixels in zip(taken, pictures, strict=True):
            self._write(self.folder / "rest" / f"{name}.dcm", pixels, view, orientation, f"rest {name}")

    def push(self, push: SyntheticPush, states: list[TorsoState], supports: Supports) -> None:
        """Take the radiographs of a push, of a state each, and mark what a person would mark in them."""
        view = self._standing(self._nominal(frontal_view))
        load = rib_push(self.torso, self.side_of(push), push.level, 1.0)
        gauge = Gauge(load.points, load.forces)
        pixels = self._radiographs(states, view, self.recipe.acquisition, self._drawn_seed(), gauge)
        path = self.folder / "pushes" / f"{push.id}.dcm"
        self._write(path, pixels, view, ("L", "F"), f"push {push.id}")
        self.images[frame_image(push.id)] = self._annotation(view, held_against=self.side_of(push))
        if self.recipe.biplanar:
            self._seen_aside(push, states, view)
        if self.recipe.markers:
            self._seen_by_cameras(push, states, view)
        shares = silhouette_shares(self.torso, view, self.torso.rest_pose)
        self._shown_truly[push.id] = [
            {
                "corners_px": view.pixels(state_features(self.torso, view, state, shares).corners).round(4).tolist(),
                "cobb_change_deg": _as_dict(cobb_change(self._rest_tilts, self._tilts(state))),
                "obliquity_deg": round(float(np.degrees(place_of_pelvis(self.torso, state))), 4),
                "shoulder_mm": round(shoulder_shift(supports, state), 4),
            }
            for state in states
        ]

    def _seen_aside(self, push: SyntheticPush, states: list[TorsoState], frontal: XRayView) -> None:
        """Lateral radiographs of a push's frames with their corners, and pedicles in the frontal ones."""
        side = self._standing(self._nominal(lateral_view))
        how = replace(self.recipe.acquisition, exposure=self.recipe.lateral_exposure)
        path = self.folder / "pushes" / f"{push.id}-{SIDE}.dcm"
        pixels = self._radiographs(states, side, how, self._drawn_seed())
        self._write(path, pixels, side, ("A", "F"), f"push {push.id} lateral")
        record = next(record for record in self.pushes if record.id == push.id)
        for number, state in enumerate(states):
            self.images[record.view_image(number, SIDE)] = self._annotation(side, state=state, fewest=FEWEST_OF_VIEW)
            name = record.frame_image(number)
            there = self.images[name].model_dump() if name in self.images else {"vertebrae": {}}
            marked = {**there, "pedicles": self._marked_pedicles(frontal, state)}
            self.images[name] = ImageAnnotation.model_validate(marked)

    def _seen_by_cameras(self, push: SyntheticPush, states: list[TorsoState], frontal: XRayView) -> None:
        """The table of a push's skin markers, and where its first radiograph shows those that lie in the picture."""
        random, priors = self._marker_random, Priors()
        load = rib_push(self.torso, self.side_of(push), push.level, 1.0)
        spots = load.points.positions(self.torso.rest_pose)
        points, outward = spread_markers(self.torso, self.recipe.markers, spots)
        there = np.array([points.positions(self.torso, state) for state in states])
        seen = view_of_markers(frontal, there[0], random)
        inside = self._shown(seen, frontal)
        if not inside.any():
            raise SubjectError("no marker lies in the frontal radiograph; ask for more of them")
        breath = priors.marker_breath_mm * random.normal(size=(len(states), 1, 1)) * outward
        there = there + breath + random.normal(0.0, priors.marker_mm, there.shape)
        turn = exp_so3(np.deg2rad(priors.marker_turn_deg) * random.normal(size=3))
        cameras = (there - self.centre) @ turn.T + random.normal(0.0, CAMERAS_SD_MM, 3)
        names = tuple(f"m{number + 1:02d}" for number in range(len(points)))
        file = f"pushes/{push.id}-markers.csv"
        axes = body_axes(*CAMERA_AXES.values())
        write_markers(self.folder / file, names, cameras @ axes)
        shown = {names[i]: seen[i].round(2).tolist() for i in np.flatnonzero(inside)}
        record = {"file": file, "unit": "mm", "axes": CAMERA_AXES, "side": "front", "shown": shown}
        number = next(i for i, own in enumerate(self.pushes) if own.id == push.id)
        marked = {**self.pushes[number].model_dump(mode="json"), "markers": record}
        whole = parse_record(json.dumps(marked), f"push '{push.id}' of the recipe", PushRecord)
        self.pushes = (*self.pushes[:number], whole, *self.pushes[number + 1 :])

    def _marked_pedicles(self, view: XRayView, state: TorsoState) -> dict[str, list[list[float]]]:
        points = PointsOnBones(np.repeat(self.torso.vertebra_bones, 2), self._own_pedicles.reshape(-1, 3))
        seen = view.project(points.positions(state))
        seen = seen + self.random.normal(0.0, PEDICLE_SD_MM, seen.shape) * view.magnification
        pixels = view.pixels(seen).round(2).reshape(-1, 2, 2)
        inside = self._shown(pixels, view).all(1)
        return {VERTEBRAE[i]: pixels[i].tolist() for i in np.flatnonzero(inside)}

    @cached_property
    def _own_pedicles(self) -> Floats:
        """(V, 2, 3) mm in the vertebra's frame: those of this person."""
        outwards = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
        there = pedicle_centres(self.torso) + outwards * self.random.normal(0.0, PERSON_PEDICLE_SD, 3)
        return np.asarray(there + self.random.normal(0.0, OWN_PEDICLE_SD, there.shape))

    def write_records(self) -> None:
        """Write ``subject.json`` and ``annotation.json``."""
        write_subject(self.folder, self._record())
        write_annotation(self.folder, Annotation(schema_version=1, images=self.images))

    def truth(self) -> dict[str, object]:
        """What the radiographs truly show, as the subject's truth holds it."""
        return {"rest_cobb_deg": self._rest_cobb.degrees, "vertebrae": list(VERTEBRAE), "pushes": self._shown_truly}

    def _record(self) -> SubjectRecord:
        """Raises SubjectError for a recipe that no subject may have."""
        recipe = self.recipe
        record = {
            "schema_version": 1,
            "id": f"synthetic-{recipe.seed}",
            "age": recipe.age,
            "sex": recipe.sex,
            "height_cm": recipe.height_cm,
            "pushes": [push.model_dump(mode="json") for push in self.pushes],
        }
        return parse_record(json.dumps(record), "the recipe", SubjectRecord)

    def _nominal(self, make: Callable[..., XRayView]) -> XRayView:
        shape = self.recipe.shape
        return make(shape=shape, pixel=round(DETECTOR_WIDTH_MM / shape[1], 4), centre=self.centre)

    def _standing(self, nominal: XRayView) -> XRayView:
        shift = self.random.normal(0.0, STANDING_SD_MM, 2)
        return nominal.moved(shift, float(self.random.normal(0.0, STANDING_SD_RAD)))

    def _drawn_seed(self) -> int:
        return int(self.random.integers(2**31))

    def _radiographs(
        self, states: list[TorsoState], view: XRayView, how: Acquisition, seed: int, gauge: Gauge | None = None
    ) -> np.ndarray:
        return np.stack(acquire(self.torso, states, view, how, person=self.recipe.seed, seed=seed, gauge=gauge))

    def _write(
        self, path: Path, pixels: np.ndarray, view: XRayView, orientation: tuple[str, str], description: str
    ) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_radiographs(
            path,
            pixels,
            view,
            frame_time_ms=1000.0 * self.recipe.acquisition.frame_time,
            orientation=orientation,
            patient_id=f"synthetic-{self.recipe.seed}",
            description=description,
        )

    def _annotation(
        self,
        view: XRayView,
        held_against: Side | None = None,
        state: TorsoState | None = None,
        fewest: int = FEWEST_VERTEBRAE,
    ) -> ImageAnnotation:
        """What a person would click in a state's image, by default the unloaded torso's: the visible vertebrae, a
        little off, and with a pushed side pelvis and held shoulder. Raises SubjectError for fewer than ``fewest``."""
        corners = state_features(self.torso, view, self.torso.rest_pose if state is None else state).corners
        noise = self.random.normal(0.0, ANNOTATION_SD_MM, corners.shape) * view.magnification
        pixels = view.pixels(corners + noise).round(2)
        inside = self._shown(pixels, view).all(1)
        vertebrae = {VERTEBRAE[i]: pixels[i].tolist() for i in np.flatnonzero(inside)}
        if len(vertebrae) < fewest:
            raise SubjectError(
                f"a {view_kind(view)} radiograph shows {counted(len(vertebrae), 'vertebra', 'vertebrae')} as a whole, "
                f"wanted at least {fewest}; collimate less"
            )
        points: dict[str, list[list[float]]] = {}
        if held_against is not None:
            held = {"pelvis": self.torso.landmark("pelvis_belt"), "shoulder": held_shoulder(self.torso, held_against)}
            for name, marked in held.items():
                seen = view.pixels(view.project(marked.positions(self.torso.rest_pose))).round(2)
                if self._shown(seen, view).all():
                    points[name] = seen.tolist()
        return ImageAnnotation.model_validate({"vertebrae": vertebrae, "supports": points})

    def _shown(self, pixels: Floats, view: XRayView) -> np.ndarray:
        """Which points (..., 2) pixels lie inside the collimated field, 4 pixels from its edge or more."""
        first, last = self.recipe.acquisition.collimation.field(view)
        return np.asarray(((pixels > first + 4.5) & (pixels < last - 4.5)).all(-1))

    def _push_record(self, push: SyntheticPush) -> PushRecord:
        side, forces, level = self.side_of(push), [share * self.recipe.force_n for share in push.shares], push.level
        shoulder, pelvis, rib = push_heights(self.torso, side, level)
        if self.recipe.misread:
            forces, level = misread(forces, level, self._gauge_random)
        record = {
            "id": push.id,
            "side": side,
            "level": level,
            "d21_mm": round(shoulder - pelvis, 1),
            "d31_mm": round(shoulder - rib, 1),
            "frames": f"pushes/{push.id}.dcm",
            "forces_n": [round(force, 3) for force in forces],
            "roles": push.roles,
        }
        if self.recipe.biplanar:
            every = list(range(len(push.shares)))
            files = f"pushes/{push.id}-{SIDE}.dcm"
            record["views"] = [{"id": SIDE, "kind": "lateral", "files": files, "frames": every}]
        return parse_record(json.dumps(record), f"push '{push.id}' of the recipe", PushRecord)

    def _tilts(self, state: TorsoState):  # type: ignore[no-untyped-def]
        view = self._nominal(frontal_view)
        return tilts(VERTEBRAE, state_features(self.torso, view, state).corners, view)


def misread(forces: Sequence[float], level: float, random: np.random.Generator) -> tuple[list[float], float]:
    """Forces of a push, N, as a gauge with the errors of ``estimation.priors.Priors`` tells them, and its rib level as
    somebody feels it; no force is told as none."""
    p = Priors()
    scale, offset = p.force_scale * random.normal(), p.force_offset_n * random.normal()
    felt = level + p.push_height_mm / LEVEL_MM * random.normal()
    told = [max(round((force - offset) * float(np.exp(-scale)), 1), 0.1) if force > 0.0 else 0.0 for force in forces]
    return told, round(float(np.clip(felt, *LEVELS)), 1)


def _as_dict(change) -> dict[str, float]:  # type: ignore[no-untyped-def]
    return {key: round(float(getattr(change, key)), 4) for key in ("signed", "fixed_levels", "tilt")}
