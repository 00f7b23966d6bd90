"""The spine of a torso beside the one in a picture, vertebra by vertebra, and what would explain the difference.

Both are the placed boxes of ``imaging.features``, (V, 4, 2) mm at the patient plane, in a view that was moved to where
the patient stood.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.estimation.objective import FEWEST_VERTEBRAE, Trial
from spinestiff.imaging.features import (
    VertebraCorners,
    picture_axes,
    place_boxes,
    reference_boxes,
    state_features,
    used_corners,
    vertebra_rows,
)
from spinestiff.imaging.projection import XRayView

# A vertebra is compared with the median of so many of its nearest neighbours.
NEIGHBOURS = 4
# Corners of the mirrored vertebra in the order of the vertebra's own.
_MIRRORED = np.array([1, 0, 3, 2])


@dataclass(frozen=True)
class Spines:
    """A torso's spine at rest and the one in a picture.

    Attributes
    ----------
    vertebrae : (n,) names of those in the picture.
    rows : (n,) their rows among the torso's.
    seen : (n, 4, 2) mm, measured boxes.
    model : (V, 4, 2) mm, boxes of all the torso's vertebrae at rest.
    left : (2,) the patient's left in the picture.
    """

    vertebrae: tuple[str, ...]
    rows: Ints
    seen: Floats
    model: Floats
    left: Floats

    @property
    def difference(self) -> Floats:
        """(n, 4, 2) mm, measured minus model, the model moved to fit best."""
        model = self.model[self.rows]
        return self.seen - moved(model, self.seen)


def spines(torso: TorsoModel, trial: Trial) -> Spines:
    """The torso at rest beside what a trial's radiograph shows."""
    rows = vertebra_rows(torso, trial.corners)
    used = used_corners(torso, trial.corners)
    model = state_features(torso, trial.view, torso.rest_pose, used=used).z
    left, _ = picture_axes(trial.view)
    return Spines(trial.corners.vertebrae, rows, placed(torso, trial.view, trial.corners), model, left)


def motion(torso: TorsoModel, trial: Trial, reference: Trial) -> tuple[Ints, Floats, Floats]:
    """Of the vertebrae that both radiographs show: rows (n,), boxes in the reference and in the trial (n, 4, 2) mm."""
    both = tuple(name for name in trial.corners.vertebrae if name in reference.corners.vertebrae)
    start, end = (placed(torso, t.view, t.corners.selected(both)) for t in (reference, trial))
    return vertebra_rows(torso, trial.corners.selected(both)), start, end


def shared(trial: Trial, reference: Trial) -> int:
    """How many vertebrae both radiographs show. How a spine bent is told by ``FEWEST_VERTEBRAE`` of them or more."""
    return len(set(trial.corners.vertebrae) & set(reference.corners.vertebrae))


def placed(torso: TorsoModel, view: XRayView, corners: VertebraCorners) -> Floats:
    """Measured boxes (n, 4, 2) mm, whatever the corners look like: what is wrong with them is to be found here."""
    boxes = reference_boxes(torso, view)[vertebra_rows(torso, corners)]
    seen = view.to_patient_plane(corners.corners.reshape(-1, 2)).reshape(-1, 4, 2)
    return place_boxes(seen, boxes, "procrustes", corners.usable, corners.vertebrae).z


def moved(points: Floats, goal: Floats, scaled: bool = False) -> Floats:
    """Points (n, 4, 2) turned and shifted (and scaled) to meet the goal best."""
    a, b = points.reshape(-1, 2), goal.reshape(-1, 2)
    factor = _similarity(points, goal)
    if not scaled:
        factor /= abs(factor)
    turned = factor * (_complex(a) - _complex(a).mean()) + _complex(b).mean()
    return np.stack([turned.real, turned.imag], -1).reshape(points.shape)


def strays(difference: Floats, rows: Ints) -> Floats:
    """(n,) mm: how far each vertebra's corners differ otherwise than those of its neighbours, as root mean square.

    The median of the nearest vertebrae stands for the neighbours, so that a stray one does not speak against the
    others, and what varies slowly along the spine (stance, another posture) is not one vertebra's.
    """
    result = np.zeros(len(rows))
    for i, row in enumerate(rows):
        distance = np.abs(rows - row).astype(float)
        distance[i] = np.inf
        near = np.argsort(distance, kind="stable")[: min(NEIGHBOURS, len(rows) - 1)]
        result[i] = rms(difference[i] - np.median(difference[near], axis=0))
    return result


def rms(difference: Floats) -> float:
    """Root of the mean squared length of vectors (..., 2)."""
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))


@dataclass(frozen=True)
class Explanation:
    """A mistake that would explain a difference.

    Attributes
    ----------
    kind : "vertebra", "mirror", "scale", "levels" or "load".
    text : what it is.
    left_mm : what would remain of the difference without it (RMS).
    """

    kind: str
    text: str
    left_mm: float


def explanations(found: Spines, loaded: Iterable[tuple[str, Spines]]) -> list[Explanation]:
    """What may be behind a torso that is not the one in an unloaded frame, the best explanation first.

    Parameters
    ----------
    found : the torso and the unloaded frame.
    loaded : the torso and other frames of the push, by their label.
    """
    tried = [_one_vertebra(found), _mirrored(found), _scaled(found), _renamed(found, -1), _renamed(found, 1)]
    tried += [
        Explanation("load", f"a rest picture under load, as in {label}", rms(other.difference))
        for label, other in loaded
    ]
    return sorted((one for one in tried if one is not None), key=lambda one: one.left_mm)


def _one_vertebra(found: Spines) -> Explanation | None:
    if len(found.rows) <= FEWEST_VERTEBRAE:
        return None
    worst = int(np.argmax(strays(found.difference, found.rows)))
    others = np.delete(np.arange(len(found.rows)), worst)
    model = found.model[found.rows[others]]
    left = rms(found.seen[others] - moved(model, found.seen[others]))
    return Explanation("vertebra", f"wrong corners of {found.vertebrae[worst]}", left)


def _mirrored(found: Spines) -> Explanation:
    seen = found.seen - 2.0 * (found.seen @ found.left)[..., None] * found.left
    seen = seen[:, _MIRRORED]
    left = rms(seen - moved(found.model[found.rows], seen))
    return Explanation("mirror", "a mirrored picture, at rest or of the push", left)


def _scaled(found: Spines) -> Explanation:
    """Boxes are placed at the model's own size: the size is in their places."""
    rigid = moved(found.model[found.rows], found.seen)
    middle, seen = rigid.mean(1), found.seen.mean(1)
    size = abs(_similarity(middle, seen))
    left = rms(found.seen - (rigid - middle[:, None] + moved(middle, seen, scaled=True)[:, None]))
    text = f"pixel spacing or distances, the push being {size:.2f} times as large as the rest pictures"
    return Explanation("scale", text, left)


def _renamed(found: Spines, step: int) -> Explanation | None:
    """The vertebrae of the picture under the names of those ``step`` below."""
    rows = found.rows + step
    inside = (rows >= 0) & (rows < len(found.model))
    if inside.sum() < FEWEST_VERTEBRAE:
        return None
    left = rms(found.seen[inside] - moved(found.model[rows[inside]], found.seen[inside]))
    where, other, example = ("down", "up", "T8 as T9") if step < 0 else ("up", "down", "T9 as T8")
    text = f"levels of the push named one too far {where} ({example}), or one too far {other} at rest"
    return Explanation("levels", text, left)


def _similarity(points: Floats, goal: Floats) -> complex:
    """The best turn and scale about the means, as a complex factor."""
    a, b = (_complex(p.reshape(-1, 2) - p.reshape(-1, 2).mean(0)) for p in (points, goal))
    return complex(np.vdot(a, b) / np.vdot(a, a).real)


def _complex(points: Floats) -> np.ndarray:
    return np.asarray(points[..., 0] + 1j * points[..., 1])
