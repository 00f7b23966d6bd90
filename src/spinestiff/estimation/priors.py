"""What is known about an estimate's inputs before any fit: one table of standard deviations, each with its source.

All are settable in ``subject.json`` (``priors``), where somebody measured better or knows of worse.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from spinestiff.errors import FitError

ABOVE_0 = (
    "annotation_mm",
    "marking_mm",
    "pedicle_mm",
    "marker_mm",
    "tracking_mm",
    "tracking_length",
    "support_force_n",
)
"""Priors that can't be 0: without these errors two sights of one thing contradict each other."""


@dataclass(frozen=True)
class Priors:
    """Standard deviations of what is not quite known; 0 = known.

    Attributes
    ----------
    force_scale : of a push's forces, relative, common to its frames: a hand-held gauge's calibration (2 %).
    force_offset_n : N, of a push, common to its loaded frames: zero, and lag between log and exposure at 4 frames a
        second (paper 2.1).
    direction_deg : of a push against the lateral axis, upward and forward, each.
    push_height_mm : of the pushed point's height; a rib level is told by palpation, to about a fifth of a level.
    push_depth_mm : of the pushed point, front to back.
    breathing_mm : of the pushed point's height from frame to frame: ribs rise by some mm with a quiet breath while
        the gauge stays.
    obliquity_deg, shoulder_mm : of how far pelvis and opposite shoulder give in all, at ``support_force_n``.
    frame_obliquity_deg, frame_shoulder_mm : the part of that which is each frame's own; the rest goes with the force.
    support_force_n : N, see above.
    place_mm, place_deg : of the patient's place and roll in each radiograph, along columns and rows, at the patient
        plane; a breath and a sway between exposures.
    posture_deg : of the spine's coronal bend between the rest radiographs and a sequence, as the largest change of
        tilt, in each of three smooth waves: who is placed anew stands a little differently.
    stance_mm, stance_deg, stance_scale : of where the patient stood for a sequence, along columns and rows, its roll,
        and the relative size of the picture, which goes with the distance from the detector; wide, as its first frame
        shows them.
    trunk : of the trunk's breadth and of its depth, relative, without a tape (6 %; children of one age and height).
    trunk_taped : the same where ``subject.json`` has the trunk's size.
    trunk_power : of tissue's resistance in (breadth, depth): 0.9 and 0.6 where the skin alone moves, a third more where
        ribs do, too, as in a body of another mass (``benchmarks/trunk_size.py``).
    rib_joints : of the log of the stiffness with which ribs turn on their vertebrae, over Table 1's: bench values are
        an eleventh of it (J Biomech 2024 163:111923).
    tissue_volume : of the log of the tissue's lambda at a given mu: Poisson's ratio of 0.3 or 0.49 for 0.45 is a factor
        of 6 less or 5 more.
    mesh : of the log of the tissue's stiffness on the mesh over that on ever finer ones: bodies on 65,000 and 26,000
        nodes move as if their tissue were 3 and 4.5 % softer than the fine mesh's, give or take 3 %
        (``benchmarks/mesh_limit.py``).
    source_distance : of the source's distance, relative; it scales motions.
    annotation_mm : of a corner set by hand, along one axis, common to all frames of a sequence.
    marking_mm : of a corner set by hand in a loaded frame or in a radiograph from another side, along one axis, beside
        ``annotation_mm``: each such radiograph is marked anew.
    pedicle_mm : of a pedicle's mark, along one axis; each radiograph is marked anew. A judgement: a pedicle is a ring,
        and its middle is told less well than a corner.
    pedicles_mm, own_pedicle_mm : of where a person's pedicles lie, outwards, up and front, from where the template has
        them: all alike, and each by itself; as ``personalise.prior`` has them.
    stance_yaw_deg : of the patient's turn about the vertical between the rest radiographs and a sequence.
    place_yaw_deg : the same from radiograph to radiograph of a sequence: nothing in the rig holds it but belt and wall.
        A judgement. Both yaws count only where more is seen than corners of frontal radiographs.
    marker_mm : of a marker on the skin as cameras see it, along one axis, in each frame by itself: optical systems
        scatter by some tenths of a mm, points of a surface scan by about this much.
    marker_place_mm : of where a marker sits against the point of the model's skin that carries it, along one axis,
        alike in all frames of a push: a torso's skin lies up to centimetres from a person's, and so may the cameras'
        origin; wide, as the unloaded frame shows it.
    marker_turn_deg : of the cameras' axes against the torso's, about each axis: axes are stated by eye, and nobody
        stands quite straight. It turns the markers' motion.
    marker_breath_mm : of how far out the skin under all markers has moved in a frame, by a breath: the chest's wall
        moves by 3 to 5 mm between the ends of a quiet one. A judgement.
    marker_slide : of the skin's motion along each axis, relative to the size of the frontal motion of the spine, beside
        what variants of the model show (``discrepancy.SKIN_SD``): the model's skin is one with the tissue under it, a
        person's slides on it. A judgement.
    tracking_mm : of a tracked vertebra's shifts and turn (channels of ``noise``), where tracking predicts less.
    tracking_shared_mm, tracking_length : of the same, shared with neighbours over so many vertebrae.
    tracking_factor : of the size of these tracking errors, in log; restricted likelihood tells the factor.
    tracking_drag : of how far tracked vertebrae are taken along by what lies before and behind them, relative to the
        spine's motion sideways; alike in all frames of a visit, see ``noise`` (docs/tracking.md).
    level_smoothness : of the difference of the logs of neighbouring levels' ratios, where each level has one
        (``ratio_priors``); 0: nothing is held. A judgement: the representative motions of neighbouring levels in
        lateral bending (White and Panjabi 1990, as recalled) differ by 0.25 (root mean square).
    """

    force_scale: float = 0.02
    force_offset_n: float = 1.5
    direction_deg: float = 3.0
    push_height_mm: float = 5.0
    push_depth_mm: float = 10.0
    breathing_mm: float = 2.0
    obliquity_deg: float = 3.0
    shoulder_mm: float = 3.0
    frame_obliquity_deg: float = 1.0
    frame_shoulder_mm: float = 1.0
    support_force_n: float = 60.0
    place_mm: float = 0.5
    place_deg: float = 0.1
    posture_deg: float = 1.5
    stance_mm: float = 20.0
    stance_deg: float = 3.0
    stance_scale: float = 0.02
    trunk: float = 0.06
    trunk_taped: float = 0.01
    trunk_power: tuple[float, float] = (1.2, 0.8)
    rib_joints: float = 1.5
    tissue_volume: float = 1.0
    mesh: float = 0.04
    source_distance: float = 0.01
    annotation_mm: float = 0.3
    marking_mm: float = 0.3
    pedicle_mm: float = 0.7
    pedicles_mm: float = 2.0
    own_pedicle_mm: float = 1.0
    stance_yaw_deg: float = 3.0
    place_yaw_deg: float = 0.5
    marker_mm: float = 0.5
    marker_place_mm: float = 20.0
    marker_turn_deg: float = 3.0
    marker_breath_mm: float = 1.5
    marker_slide: float = 0.1
    tracking_mm: float = 0.1
    tracking_shared_mm: float = 0.05
    tracking_length: float = 2.0
    tracking_factor: float = 0.7
    tracking_drag: float = 0.008
    level_smoothness: float = 0.3

    def __post_init__(self) -> None:
        for field in fields(self):
            two = field.name == "trunk_power"
            try:
                found = np.asarray(getattr(self, field.name), dtype=float)
                sound = found.shape == ((2,) if two else ()) and np.isfinite(found).all() and (found >= 0.0).all()
            except (TypeError, ValueError):
                sound = False
            if not sound:
                wanted = "two finite numbers" if two else "a finite number"
                raise FitError(f"prior {field.name} {getattr(self, field.name)}; wanted {wanted} from 0")
        for name in ABOVE_0:
            if not getattr(self, name) > 0.0:
                raise FitError(f"prior {name} {getattr(self, name):g}; wanted above 0")
        for whole, part in (("obliquity_deg", "frame_obliquity_deg"), ("shoulder_mm", "frame_shoulder_mm")):
            if getattr(self, part) > getattr(self, whole):
                raise FitError(
                    f"prior {part} {getattr(self, part):g} is a part of {whole} {getattr(self, whole):g}; wanted less"
                )

    def scaled(self, name: str, factor: float) -> Priors:
        """The same with one standard deviation times ``factor``."""
        return replace(self, **{name: getattr(self, name) * factor})
