"""What the values of ``subject.json`` are called, their units, and which picture shows what they mean."""

from __future__ import annotations

from typing import Final


def _coordinates(of: str) -> dict[str, dict[str, str]]:
    """Of a file with points in space."""
    return {
        f"{of}.unit": {"title": "Unit of the file's coordinates"},
        f"{of}.axes.left": {"title": "Axis that runs to the patient's left"},
        f"{of}.axes.up": {"title": "Axis that runs up"},
        f"{of}.axes.front": {"title": "Axis that runs to the front"},
    }


WORDS: Final[dict[str, dict[str, str]]] = {
    "id": {"title": "Subject", "help": "A name that is no person's: letters, digits, '.', '_' or '-'."},
    "age": {"title": "Age", "unit": "years", "help": "When the radiographs were taken."},
    "sex": {"title": "Sex"},
    "height_cm": {"title": "Standing height", "unit": "cm"},
    "mass_kg": {
        "title": "Body mass",
        "unit": "kg",
        "help": "If known: the torso takes the sizes of such a body.",
    },
    "pushes": {"title": "Pushes"},
    "pushes.side": {"title": "Side that is pushed", "help": "The patient's.", "picture": "side"},
    "pushes.level": {
        "title": "Rib that is pushed",
        "unit": "rib",
        "help": "8.5 lies between ribs 8 and 9.",
        "picture": "level",
    },
    "pushes.d21_mm": {
        "title": "Shoulder support to pelvis support (d21)",
        "unit": "mm",
        "help": "Vertical distance. May stay empty unless the pelvis is held by dead loads.",
        "picture": "d21",
    },
    "pushes.d31_mm": {
        "title": "Shoulder support to push (d31)",
        "unit": "mm",
        "help": "Vertical distance, from the shoulder; shorter than d21. May stay empty as d21 may.",
        "picture": "d31",
    },
    "pushes.forces_n": {"title": "Force", "unit": "N", "help": "Of each frame, without sign.", "picture": "force"},
    "pushes.roles": {
        "title": "Use",
        "help": "Estimate from it (training), predict it and compare (validation), or leave it out (unused). "
        "An estimate needs a frame under force for training.",
    },
    "pushes.views": {
        "title": "From another side",
        "help": "Lateral or oblique radiographs of the pushed patient. Each was taken under the force of one of the "
        "push's frames.",
    },
    "pushes.views.kind": {"title": "What they are, or are turned from"},
    "pushes.views.frames": {
        "title": "Frames of the push that they belong to",
        "help": "Numbers from 0, one a radiograph, in their order: 0, 3.",
    },
    "pushes.views.turned_deg": {
        "title": "Turn of the patient",
        "unit": "degrees",
        "help": "To the left, about the vertical, against the frontal or lateral view.",
    },
    "pushes.markers": {
        "title": "Markers on the skin",
        "help": "Seen by cameras or a surface scanner in each frame.",
    },
    **_coordinates("pushes.markers"),
    "pushes.markers.side": {"title": "Side of the trunk that they lie on"},
    "pushes.markers.shown": {
        "title": "Where the radiograph without force shows them",
        "unit": "pixels",
        "help": "Marker, column, row, a line each: sternum, 531.5, 402. The first pixel is 0, 0. One is needed; three "
        "far apart tell how the axes are turned, too.",
    },
    "xray": {"title": "X-ray geometry", "help": "Only where the DICOM files lack it."},
    "xray.source_detector_mm": {"title": "X-ray source to detector", "unit": "mm", "picture": "source_detector"},
    "xray.source_patient_mm": {"title": "X-ray source to patient", "unit": "mm", "picture": "source_patient"},
    "xray.imager_pixel_mm": {"title": "Pixel at the detector", "unit": "mm", "picture": "pixel"},
    "xray.orientation": {"title": "Orientation of radiographs that don't tell theirs"},
    "xray.beam": {"title": "Beam of frontal radiographs that don't tell theirs"},
    "xray.images": {
        "title": "A picture that was taken otherwise",
        "help": "Where the files lack the geometry and not all pictures have the same: rest radiographs and pushes "
        "from two systems, a scanned film. What is empty here is as given above.",
    },
    "xray.scale": {
        "title": "A known length in a picture",
        "help": "Where a file has no pixel size of its own and none is given above, its millimetres come from a length "
        "that is known in that very picture. Where it has one, the length is held against it: more than 5 % off, of a "
        "vertebra 10 %, is refused.",
    },
    "xray.scale.object_mm": {"title": "Length of the object", "unit": "mm", "picture": "object"},
    "xray.scale.object_px": {
        "title": "Its two ends, in pixels",
        "help": "Column, row, a line each: 612, 240. The first pixel is 0, 0; 20 pixels apart or more.",
        "picture": "object",
    },
    "xray.scale.plane": {
        "title": "Where the object lay",
        "help": "patient: as far from the source as the spine, as usual; detector: on the detector.",
        "picture": "object",
    },
    "xray.scale.vertebra": {"title": "Vertebra", "help": "One that is annotated in this picture."},
    "xray.scale.width_mm": {
        "title": "Width of its body",
        "unit": "mm",
        "help": "Halfway between its endplates: the breadth in a frontal picture, the depth in a lateral one.",
    },
    "pelvis": {"title": "How the model holds the pelvis"},
    "wall": {"title": "What the back wall can do"},
    "priors": {"title": "What is not quite known", "help": "Standard deviations that differ from the usual ones."},
    "trunk": {
        "title": "Sizes of the trunk",
        "help": "Straight across, by caliper or between two rulers, without the arms, at the height of a vertebra: T9 "
        "lies at the lower end of the breastbone, L4 at the top of the pelvis. They shape the skin, not the ribs.",
    },
    "trunk.breadth_mm": {"title": "Side to side", "unit": "mm"},
    "trunk.depth_mm": {"title": "Front to back", "unit": "mm"},
    "skin_scan": {
        "title": "Scan of the skin",
        "help": "Of the standing patient's trunk, by a surface scanner; open, in parts or with holes, as it comes. It "
        "shapes the skin of the model.",
    },
    **_coordinates("skin_scan"),
    "population": {
        "title": "Whose ratios are held as a prior",
        "help": "koutras2025: bending of seven adolescents with scoliosis, for estimates of the whole spine's bending.",
    },
    "parameters": {
        "title": "Ratios to estimate",
        "help": "Stiffness of this patient over the usual one. Up to four have intervals from profiles; with more, "
        "intervals are to first order. Two that scale the same joints can't be told apart.",
    },
    "priors.force_scale": {"title": "Forces: calibration of the gauge", "unit": "relative"},
    "priors.force_offset_n": {"title": "Forces: zero of the gauge, lag of its log", "unit": "N"},
    "priors.direction_deg": {"title": "Direction of the push, upward and forward", "unit": "degrees"},
    "priors.push_height_mm": {"title": "Height of the pushed point", "unit": "mm"},
    "priors.push_depth_mm": {"title": "Pushed point, front to back", "unit": "mm"},
    "priors.breathing_mm": {"title": "Height of the pushed point from frame to frame", "unit": "mm"},
    "priors.obliquity_deg": {"title": "Turn of the pelvis in all, at the force below", "unit": "degrees"},
    "priors.shoulder_mm": {"title": "Motion of the opposite shoulder in all, at the force below", "unit": "mm"},
    "priors.frame_obliquity_deg": {"title": "Turn of the pelvis, each frame's own part", "unit": "degrees"},
    "priors.frame_shoulder_mm": {"title": "Motion of the shoulder, each frame's own part", "unit": "mm"},
    "priors.support_force_n": {"title": "Force for which these four are given", "unit": "N"},
    "priors.place_mm": {"title": "Place of the patient in each radiograph", "unit": "mm"},
    "priors.place_deg": {"title": "Roll of the patient in each radiograph", "unit": "degrees"},
    "priors.posture_deg": {"title": "Bend of the spine between rest and a sequence", "unit": "degrees"},
    "priors.stance_mm": {"title": "Where the patient stood for a sequence", "unit": "mm"},
    "priors.stance_deg": {"title": "Roll of the patient for a sequence", "unit": "degrees"},
    "priors.stance_scale": {"title": "Size of a sequence's pictures", "unit": "relative"},
    "priors.trunk": {"title": "Breadth and depth of the trunk, without a tape", "unit": "relative"},
    "priors.trunk_taped": {"title": "The same where they were measured", "unit": "relative"},
    "priors.rib_joints": {"title": "Stiffness with which ribs turn on their vertebrae", "unit": "log"},
    "priors.tissue_volume": {"title": "How far tissue resists a change of volume", "unit": "log"},
    "priors.mesh": {"title": "How stiff the mesh makes the tissue", "unit": "log"},
    "priors.source_distance": {"title": "Distance of the X-ray source", "unit": "relative"},
    "priors.annotation_mm": {"title": "A corner set by hand, alike in all frames", "unit": "mm"},
    "priors.marking_mm": {"title": "A corner set by hand, each frame's own part", "unit": "mm"},
    "priors.pedicle_mm": {"title": "A pedicle's mark", "unit": "mm"},
    "priors.pedicles_mm": {"title": "Where all pedicles of a person lie", "unit": "mm"},
    "priors.own_pedicle_mm": {"title": "Where each pedicle lies by itself", "unit": "mm"},
    "priors.stance_yaw_deg": {"title": "Turn about the vertical between rest and a sequence", "unit": "degrees"},
    "priors.place_yaw_deg": {"title": "Turn about the vertical from radiograph to radiograph", "unit": "degrees"},
    "priors.marker_mm": {"title": "A skin marker as cameras see it", "unit": "mm"},
    "priors.marker_place_mm": {"title": "Where a skin marker sits against the model's skin", "unit": "mm"},
    "priors.marker_turn_deg": {"title": "Axes of the cameras against the torso's", "unit": "degrees"},
    "priors.marker_breath_mm": {"title": "How far a breath moves the skin out", "unit": "mm"},
    "priors.marker_slide": {"title": "How far the skin slides", "unit": "relative"},
    "priors.tracking_mm": {"title": "A followed corner", "unit": "mm"},
    "priors.tracking_shared_mm": {"title": "Followed corners, shared with neighbours", "unit": "mm"},
    "priors.tracking_length": {"title": "Over how many neighbours", "unit": "vertebrae"},
    "priors.tracking_factor": {"title": "Size of all errors of following", "unit": "log"},
    "priors.tracking_drag": {"title": "How far followed vertebrae are taken along", "unit": "relative"},
    "priors.level_smoothness": {"title": "Difference of neighbouring levels' ratios", "unit": "log"},
}
"""By the place in the schema, without numbers of list entries."""
JOINTS, TISSUE = "joints", "tissue"
RATIO_GROUPS: Final[dict[str, tuple[str, str]]] = {
    "lateral_bending": ("Lateral bending, with the ribs' joints at the breastbone", JOINTS),
    "intervertebral_bending": ("Lateral bending of the spine alone", JOINTS),
    "flexion_extension": ("Flexion and extension", JOINTS),
    "axial_rotation": ("Axial rotation", JOINTS),
    "lateral_shear": ("Shear to the side", JOINTS),
    "sagittal_shear": ("Shear front to back", JOINTS),
    "separation": ("Compression and separation", JOINTS),
    "rib_rotation": ("Turning of the ribs on their vertebrae", JOINTS),
    "tissue": ("Soft tissue", TISSUE),
    "tissue_mu": ("Soft tissue, shear modulus alone", TISSUE),
    "tissue_lambda": ("Soft tissue, resistance to a change of volume alone", TISSUE),
}
"""Groups of stiffnesses (``anatomy.stiffness``) in words, and whether they are taken at joints or in tissue."""
RATIO_PARTS: Final[dict[str, dict[str, str]]] = {
    JOINTS: {
        "": "the whole spine",
        "thoracic": "thoracic (T1 to T12)",
        "lumbar": "lumbar (T12 to S1)",
        "levels": "each level by itself",
    },
    TISSUE: {"": "all of it", "thorax": "thorax", "abdomen": "abdomen"},
}
"""Where a group may be taken (``anatomy.regions``), in words; joints also between two vertebrae."""
