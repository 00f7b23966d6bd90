"""What anatomy expects of a row of vertebrae in a view: the template along and beside the spine's middle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template.sizes import VERTEBRA_SIZES
from spinestiff.anatomy.template.vertebrae import build_spine, vertebra_boxes
from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import picture_axes, view_kind
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.silhouette import halves, rim_share
from spinestiff.imaging.straightening import SpineCurve

# Where a picture of the template's bones changes from bone to what lies beside it: so far inside the line between two
# corners, mm, near the corners and midway (walls are waisted), on the "first" side and on the other. Measured on
# synthetic radiographs; the rear wall is hollow from side to side, so that its rims show little.
DEPTHS = {"frontal": ((0.2, 0.9), (0.2, 0.9)), "lateral": ((0.7, 1.5), (1.8, 2.9))}


@dataclass(frozen=True)
class ExpectedSpine:
    """Of n vertebrae, in mm of the template along the spine, 0 = middle of the first.

    Outlines of bodies that kyphosis and lordosis tilt in the beam are taller than the bodies, and discs lower.

    Attributes
    ----------
    places : (2n,) where the endplates cross the spine's middle, upper and lower of each vertebra in turn.
    tilts : (2n,) rad, of the endplates against a line across the spine; above 0 where the "first" side lies lower.
    halves : (2n,) half the endplates' width, as seen in the view.
    depths : where a body's side ends inside the line between two corners, see ``DEPTHS``.
    """

    places: Floats
    tilts: Floats
    halves: Floats
    depths: tuple[tuple[float, float], tuple[float, float]]

    @property
    def length(self) -> float:
        """From the middle of the first to the middle of the last."""
        return float(0.5 * (self.places[-2:].sum() - self.places[:2].sum()))

    @staticmethod
    def of(
        vertebrae: Sequence[str], view: XRayView, middle: Floats, leans: Mapping[str, float] | None = None
    ) -> ExpectedSpine:
        """The template as it is seen in ``view`` with the middle of these vertebrae about the pixel ``middle`` (2,).

        The view's pixels are square. ``leans``: how far vertebrae lean to the side, rad, as a frontal radiograph tells;
        others lean as their neighbours do, or not. From the side one that leans looks taller, and its disc lower.

        Raises
        ------
        TrackingError : fewer than two vertebrae, or no neighbours of each other.
        """
        rows = [VERTEBRAE.index(name) for name in vertebrae if name in VERTEBRAE]
        if len(rows) != len(vertebrae) or len(rows) < 2 or (np.diff(rows) != 1).any():
            raise TrackingError(f"can't propose {', '.join(vertebrae) or 'nothing'}; wanted two or more neighbours")
        kind = view_kind(view)
        corners = _template_outline(view, kind, rows, middle, _leans(vertebrae, leans or {}))
        middles = corners.mean(axis=1)
        # A curve needs three points.
        line = middles if len(middles) > 2 else np.stack([middles[0], middles.mean(axis=0), middles[1]])
        curve = SpineCurve.through(line, picture_axes(view)[0])
        scale = float(view.magnification / view.pixel_spacing[0])
        seen = curve.coordinates(corners.reshape(-1, 2)).reshape(corners.shape) / scale
        upper, lower = seen[:, 0] - seen[:, 1], seen[:, 3] - seen[:, 2]
        plates = np.stack([seen[:, :2].mean(axis=1), seen[:, 2:].mean(axis=1)], axis=1).reshape(-1, 2)
        slope = np.stack([upper[:, 0] / upper[:, 1], lower[:, 0] / lower[:, 1]], axis=1).ravel()
        widths = VERTEBRA_SIZES[rows][:, [0, 2] if kind == "frontal" else [1, 3]].ravel()
        return ExpectedSpine(plates[:, 0] - slope * plates[:, 1], np.arctan(slope), 0.5 * widths, DEPTHS[kind])


def _leans(vertebrae: Sequence[str], known: Mapping[str, float]) -> Floats:
    """(n,) rad; between known ones in proportion, beyond them as the last."""
    found = [i for i, name in enumerate(vertebrae) if name in known]
    if not found:
        return np.zeros(len(vertebrae))
    return np.interp(np.arange(len(vertebrae)), found, [known[vertebrae[i]] for i in found])


def _template_outline(view: XRayView, kind: str, rows: Sequence[int], middle: Floats, leans: Floats) -> Floats:
    """(n, 4, 2) pixels of the template's vertebrae in the order of ``VertebraCorners``, their middle at a pixel."""
    spine = build_spine()
    turns = exp_so3(np.multiply.outer(leans, [0.0, 0.0, 1.0])) @ spine.rotations[rows]
    # Vertebrae follow each other along the spine, of which a view from the side sees less where it leans.
    steps = np.diff(spine.centres[rows], axis=0) * np.cos(0.5 * (leans[1:] + leans[:-1]))[:, None] ** np.array(
        [0, 1, 0]
    )
    centres = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    plane = view.to_patient_plane(view.from_pixels(middle))
    place = view.source + view.source_to_patient * view.normal + plane @ view.detector_axes
    centres = centres + place - 0.5 * (centres[0] + centres[-1])
    box = vertebra_boxes()[rows].reshape(-1, 2, 2, 2, 3)
    pairs = (box.swapaxes(2, 3) if kind == "lateral" else box)[:, [0, 0, 1, 1], [0, 1, 1, 0]]
    rim, half = halves(pairs)
    beam = np.einsum("vji,vj->vi", turns, centres - view.source)
    share = rim_share(rim, half, rim + beam[:, None], 2 if kind == "frontal" else 0)
    world = centres[:, None] + np.einsum("vij,vcj->vci", turns, rim + share[..., None] * half)
    return view.pixels(view.project(world))
