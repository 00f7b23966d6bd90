"""What makes a radiograph differ from the right model, as a covariance: what is seen wrongly, and what the model lacks.

A vertebra's picture has three numbers, its *channels*: shifts along columns and rows and the turn, as orthonormal
combinations of its eight corner coordinates, in mm. Most of their errors are shared. An annotation's error is in all
frames of its sequence, one of geometry in all frames of all sequences, where the patient stood in a whole radiograph.
Of what tracking adds a part is a frame's own. Another part, its *drag*, is not: a patch holds what lies before and
behind the vertebra, too, which moves less or more and takes the patch along, in all frames alike and in proportion to
how far the spine moved.

Where more is seen than corners of frontal radiographs (``sights``), a mark's two coordinates are channels, too. Marks
set by hand in a radiograph err for themselves, pedicles lie elsewhere than the template's, and how the patient was
turned about the vertical is not known. Corners of frontal radiographs alone hardly tell of that turn, and leave it
out. Of markers on the skin all three coordinates are channels (``marker_noise``).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.optimize import minimize_scalar

from spinestiff.arrays import Floats, Ints
from spinestiff.errors import FitError
from spinestiff.estimation.causes import Cause
from spinestiff.estimation.channels import CHANNELS, Channels, channels_of, marking_errors
from spinestiff.estimation.marker_noise import SeenMarkers, marker_parts
from spinestiff.estimation.objective import Target
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.sights import (
    OWN,
    MarkerResiduals,
    MarkerTarget,
    PedicleTarget,
    PictureSight,
    PointResiduals,
    Sight,
    SightResiduals,
)
from spinestiff.imaging.features import picture_axes
from spinestiff.imaging.tracking.quality import error_of

# Errors of a tracked vertebra's shifts along columns and rows and of its turn, over the predicted error of one of its
# corners along one axis: corners are followed as a body. Measured on synthetic sequences (benchmarks/tracking_drag.py).
TRACKED = np.array([1.3, 0.85, 1.6])
# A vertebra whose own error is more than this many times what was expected counts by as much less.
USUAL = 2.5
# Of what is expected, in log: the range in which the size of tracking errors is looked for.
WIDEST_FACTOR = 3.0
# Of the drag's variance, in shifts along columns and in turns: the share that is each vertebra's own; of the rest, the
# distance in vertebrae at which its correlation has fallen to 1/e; and the size of turns over that of shifts, as
# channels. Measured on synthetic sequences (benchmarks/tracking_drag.py).
DRAG_OWN, DRAG_LENGTH = (0.5, 0.6), (3.5, 2.0)
DRAG_TURN = 1.0
_VERTICAL = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Seen:
    """What a radiograph shows of one kind, or cameras of markers, among all of a fit.

    Attributes
    ----------
    target : corners, pedicles, or markers.
    sequence : frames of one carry the same name here.
    annotated : its marks were set by hand, so that tracking adds no error but to those that its trial says it followed.
    radiograph : number of the radiograph; None: this is the only thing that one shows.
    marked : set by hand once more, while frames of a tracked sequence share their annotation: corners with one number
        here were, in one radiograph; ``OWN``: each mark by itself; None: not (``sights.FurtherSight``).
    """

    target: Sight
    sequence: str
    annotated: bool
    radiograph: int | None = None
    marked: int | None = None


class Noise:
    """The covariance of all channels of several radiographs, in parts that do not depend on the ratios.

    Parameters
    ----------
    seen : radiographs.
    still : of each, at rest: residuals whose derivatives are those in the rest poses of its vertebrae.
    geometry : (6V, 6V) covariance of the rest poses (dt mm, dw rad), or None: known.
    priors : of everything else.
    positions : (V, 3) mm, the vertebrae at rest, where radiographs show more than frontal corners.

    Attributes
    ----------
    turns : (n, k) columns of the part "turn of the patient", which counts where more is seen than corners of frontal
        radiographs; k = 0 where there is no more.
    placed : (n, k) columns of a sequence's place in the picture, shifts of 1 mm and turns of 1 rad.
    """

    def __init__(
        self,
        seen: Sequence[Seen],
        still: Sequence[SightResiduals],
        geometry: Floats | None,
        priors: Priors,
        positions: Floats | None = None,
    ) -> None:
        self.seen = tuple(seen)
        self._pictures = tuple(
            (i, one.target) for i, one in enumerate(seen) if not isinstance(one.target, MarkerTarget)
        )
        self.channels = tuple(channels_of(one.target) for one in seen)
        counts = [one.each * len(one.rows) for one in self.channels]
        self.ends = np.concatenate([[0], np.cumsum(counts)])
        self.size = int(self.ends[-1])
        self._priors = priors
        self._sequences = [one.sequence for one in seen]
        self._rows = np.concatenate([np.repeat(one.rows, one.each) for one in self.channels])
        self._channel = np.concatenate([np.tile(np.arange(one.each), len(one.rows)) for one in self.channels])
        self._of_boxes = np.repeat([isinstance(one.target, Target) for one in seen], counts)
        numbers = [i if one.radiograph is None else one.radiograph for i, one in enumerate(seen)]
        self._trial = np.repeat(numbers, counts)
        sequence = np.array([list(dict.fromkeys(self._sequences)).index(name) for name in self._sequences])
        sequence = np.repeat(sequence, counts)
        self.parts: dict[Cause, Floats] = {
            "annotation": priors.annotation_mm**2 * _outer(self._marked(self._sequences))
        }
        stance_roll = float(np.deg2rad(priors.stance_deg))
        roll = float(np.deg2rad(priors.place_deg))
        self.parts["place in the picture"] = _outer(self._places(self._trial, priors.place_mm, roll, 0.0))
        self.parts["posture"] = _outer(self._waves(sequence, float(np.deg2rad(priors.posture_deg)), still))
        self.placed = self._places(sequence, 1.0, 1.0, 0.0)
        self.parts["stance"] = _outer(self._places(sequence, priors.stance_mm, stance_roll, priors.stance_scale))
        if geometry is not None:
            jacobian = self.pose_jacobian(still, len(geometry) // 6).reshape(self.size, -1)
            self.parts["rest geometry"] = np.asarray(jacobian @ geometry @ jacobian.T)
        anew = [one.marked is not None for one in seen]
        if any(anew):
            groups = [(i if one.marked == OWN else None, one.marked) for i, one in enumerate(seen)]
            boxes = self._marked([group if again else None for again, group in zip(anew, groups)])
            points = np.repeat(anew, counts) & ~self._of_boxes
            self.parts["marks set by hand"] = priors.marking_mm**2 * _outer(boxes) + np.diag(
                priors.pedicle_mm**2 * points
            )
        self.turns = np.zeros((self.size, 0))
        if positions is not None:
            self.parts["pedicles' places"] = _outer(self._pedicles(still))
            turned = self._turned(still, positions)
            own, shared = (float(np.deg2rad(sd)) for sd in (priors.place_yaw_deg, priors.stance_yaw_deg))
            self.turns = np.column_stack([own * _by_group(turned, self._trial), shared * _by_group(turned, sequence)])
            self.parts["turn of the patient"] = _outer(self.turns)
        markers = [
            SeenMarkers(one.target, one.sequence, self.of(i))
            for i, one in enumerate(seen)
            if isinstance(one.target, MarkerTarget)
        ]
        self.parts |= marker_parts(markers, self.size, priors)
        own_error = np.zeros(self.size)
        tracked = np.zeros(self.size, dtype=bool)
        for i, one in enumerate(seen):
            followed = _followed(one)
            if followed.any():
                corners = one.target.trial.corners
                error = np.where(corners.usable, error_of(np.maximum(corners.quality, 1e-6)), 0.0)
                squares = np.sum(error**2, axis=1) / np.maximum(corners.usable.sum(1), 1)
                variance = np.maximum(priors.tracking_mm**2, np.outer(0.5 * squares, TRACKED**2))
                own_error[self.of(i)] = (variance * followed[:, None]).ravel()
                tracked[self.of(i)] = np.repeat(followed, CHANNELS)
        self._own = own_error
        distance = np.abs(np.subtract.outer(self._rows, self._rows)) / priors.tracking_length
        together = (self._trial[:, None] == self._trial) & (self._channel[:, None] == self._channel)
        both = tracked[:, None] & tracked
        self._shared = priors.tracking_shared_mm**2 * np.exp(-distance) * (together & both)
        # What lies behind a spine from the side is other than from the front.
        aside = np.repeat([one.radiograph is not None for one in seen], counts)
        self._drag = priors.tracking_drag**2 * self._dragged() * (both & (aside[:, None] == aside))

    def boxes(self, number: int) -> Channels:
        """From corners to channels, of one that shows corners."""
        found = self.channels[number]
        assert isinstance(found, Channels)
        return found

    def of(self, trial: int) -> slice:
        """Where a radiograph's channels are."""
        return slice(int(self.ends[trial]), int(self.ends[trial + 1]))

    @property
    def constant(self) -> Floats:
        """(n, n) mm^2, all parts but tracking."""
        return np.asarray(sum(self.parts.values()))

    def tracking(self, factor: float = 1.0, inflation: Floats | None = None) -> Floats:
        """(n, n) mm^2, errors of tracking times ``factor``^2; ``inflation`` (n,) of a vertebra's own variance."""
        own = self._own if inflation is None else self._own * inflation
        return factor**2 * (self._shared + np.diag(own))

    def drag(self, motions: Floats) -> Floats:
        """(n, n) mm^2, what tracking is taken along, for how far the vertebrae of each radiograph have moved along
        columns: (number of ``seen``,) mm, root mean square of that channel, with its sign."""
        moved = np.repeat(motions, np.diff(self.ends))
        return np.asarray(moved[:, None] * moved * self._drag)

    def inflation(self, own: Floats, factor: float) -> Floats:
        """(n,) by how much a vertebra's own variance is too small for the own errors (n,) found."""
        size = factor * np.sqrt(self._own)
        with np.errstate(divide="ignore", invalid="ignore"):
            squares = np.where(size > 0.0, (own / size) ** 2, 0.0)[self._of_boxes].reshape(-1, CHANNELS)
        of_vertebra = np.sqrt(squares.mean(axis=1))
        found = np.ones(self.size)
        found[self._of_boxes] = np.repeat(np.maximum(of_vertebra / USUAL, 1.0) ** 2, CHANNELS)
        return found

    def own_errors(self, solved: Floats, factor: float, inflation: Floats) -> Floats:
        """(n,) mm, the most probable own errors for ``solved`` = Sigma^-1 r."""
        return np.asarray(factor**2 * self._own * inflation * solved)

    def _dragged(self) -> Floats:
        """(n, n) covariance of the drag per mm that vertebrae moved and in units of its size."""
        apart = np.abs(np.subtract.outer(self._rows, self._rows))
        whole = np.zeros((self.size, self.size))
        for channel, size, own, length in zip((0, 2), (1.0, DRAG_TURN), DRAG_OWN, DRAG_LENGTH):
            mine = self._of_boxes & (self._channel == channel)
            alike = own * (apart == 0) + (1.0 - own) * np.exp(-((apart / length) ** 2))
            whole += size**2 * alike * (mine[:, None] & mine)
        return whole

    def _marked(self, groups: Sequence[Hashable]) -> Floats:
        """(n, k) columns: errors of corners, in mm, that are the same in all radiographs of a group (one for each that
        is seen; None: no errors)."""
        columns: dict[tuple[Hashable, int], Floats] = {}
        for i, (one, group) in enumerate(zip(self.seen, groups, strict=True)):
            if group is None or not isinstance(one.target, Target):
                continue
            errors = marking_errors(one.target, self.boxes(i))
            for number, (row, error) in enumerate(zip(one.target.rows, errors)):
                mine = columns.setdefault((group, int(row)), np.zeros((self.size, error.shape[1])))
                begin = self.ends[i] + CHANNELS * number
                mine[begin : begin + CHANNELS] = error
        return np.hstack(list(columns.values())) if columns else np.zeros((self.size, 0))

    def _groups(self, of: Ints) -> tuple[int, ...]:
        """Groups of radiographs, each once, in their order; ``of`` (n,) of each channel."""
        return tuple(dict.fromkeys(int(of[self.ends[i]]) for i, _ in self._pictures))

    def _places(self, of: Ints, shift_mm: float, turn: float, scale: float) -> Floats:
        """(n, k) columns of each group of radiographs: shifts along both axes, a turn, another size of the picture."""
        columns = []
        for group in self._groups(of):
            for kind, size in enumerate((shift_mm, shift_mm, turn, scale)):
                if size == 0.0:
                    continue
                column = np.zeros(self.size)
                for i, target in self._pictures:
                    if of[self.ends[i]] == group:
                        column[self.of(i)] = size * self.channels[i].apply(_place_change(target.z, kind))
                columns.append(column)
        return np.stack(columns, axis=1) if columns else np.zeros((self.size, 0))

    def _waves(self, of: Ints, bend: float, still: Sequence[SightResiduals]) -> Floats:
        """(n, 3 k) columns: the spine of each group of radiographs bent sideways by smooth waves.

        A wave's steepest tilts differ by ``bend`` rad, and its vertebrae turn with it. It runs over all vertebrae that
        the group shows, where they are at rest, so that it is the same in each radiograph.
        """
        columns = []
        for group in self._groups(of) if bend else ():
            mine = [(i, target) for i, target in self._pictures if of[self.ends[i]] == group]
            heights: dict[int, float] = {}
            for i, target in mine:
                if isinstance(target, Target):
                    resting = (target.z + still[i].difference).mean(axis=1) @ picture_axes(target.trial.view)[1]
                    heights |= dict(zip(target.rows.tolist(), resting.tolist()))
            for half_waves in (1, 2, 3):
                column = np.zeros(self.size)
                for i, target in mine:
                    column[self.of(i)] = self.channels[i].apply(_wave(target, half_waves, bend, heights))
                columns.append(column)
        return np.stack(columns, axis=1) if columns else np.zeros((self.size, 0))

    def pose_jacobian(self, still: Sequence[SightResiduals], vertebrae: int) -> Floats:
        """(n, V, 6), derivative of all channels in the rest poses (dt mm, dw rad) of the vertebrae; of markers none."""
        jacobian = np.zeros((self.size, vertebrae, 6))
        for i, (channels, part) in enumerate(zip(self.channels, still)):
            if isinstance(part, MarkerResiduals):
                continue
            found = channels.apply(part.jacobian).reshape(-1, channels.each, 6)
            rows = np.arange(self.ends[i], self.ends[i + 1]).reshape(-1, channels.each)
            for own, where, vertebra in zip(found, rows, channels.rows):
                jacobian[where, vertebra] = own
        return jacobian

    def _turned(self, still: Sequence[SightResiduals], positions: Floats) -> Floats:
        """(n,) change of the channels per rad that the patient is turned about the vertical through the patient plane's
        middle."""
        jacobian = self.pose_jacobian(still, len(positions))
        found = np.zeros(self.size)
        for i, target in self._pictures:
            view = target.trial.view
            pivot = view.source + view.source_to_patient * view.normal
            moved = np.cross(_VERTICAL, positions - pivot)
            pose = np.column_stack([moved, np.broadcast_to(_VERTICAL, moved.shape)])
            found[self.of(i)] = np.einsum("nvc,vc->n", jacobian[self.of(i)], pose)
        return found

    def _pedicles(self, still: Sequence[SightResiduals]) -> Floats:
        """(n, k) columns: where all pedicles lie from the template's, outwards, up and front, and each by itself.

        Along the world's axes, from which vertebrae are turned by little.
        """
        p = self._priors
        columns: dict[tuple[int, int, int], Floats] = {}
        for i, target in self._pictures:
            part = still[i]
            if not (isinstance(target, PedicleTarget) and isinstance(part, PointResiduals)):
                continue
            slopes = part.jacobian[:, :, :3]
            for number, (row, side) in enumerate(zip(target.rows, target.outward)):
                where = self.ends[i] + 2 * number + np.arange(2)
                for axis in range(3):
                    way = float(side) if axis == 0 else 1.0
                    for key, sd in (((-1, 0, axis), p.pedicles_mm), ((int(row), int(side), axis), p.own_pedicle_mm)):
                        column = columns.setdefault(key, np.zeros(self.size))
                        column[where] = sd * way * slopes[number, :, axis]
        return np.stack(list(columns.values()), axis=1) if columns else np.zeros((self.size, 0))


def _followed(one: Seen) -> np.ndarray:
    """(n,) bool, which of the vertebrae, or marks, that are seen tracking has followed."""
    if not (one.annotated and isinstance(one.target, Target)):
        return np.full(len(one.target.rows), not one.annotated)
    trial = one.target.trial
    return np.isin(trial.corners.vertebrae, trial.tracked)


def _by_group(column: Floats, of: Ints) -> Floats:
    """(n, k) the column for each group of radiographs by itself."""
    return np.stack([np.where(of == group, column, 0.0) for group in dict.fromkeys(of.tolist())], axis=1)


def _place_change(z: Floats, kind: int) -> Floats:
    """(Nv, 4, 2) change of boxes, or (P, 2) of points z, per mm along columns (0) or rows (1), per rad (2), per
    relative size (3).

    Boxes are placed at their own size, so that only their places tell how large the picture is.
    """
    if kind < 2:
        return np.broadcast_to(np.eye(2)[kind], z.shape)
    if kind == 2:
        return np.stack([-z[..., 1], z[..., 0]], -1)
    return z if z.ndim == 2 else np.broadcast_to(z.mean(axis=1, keepdims=True), z.shape)


def _wave(target: PictureSight, half_waves: int, bend: float, heights: Mapping[int, float]) -> Floats:
    """(Nv, 4, 2) mm, how a wave along the picture moves a target's boxes; (P, 2) of pedicles, with their vertebrae.

    ``heights``: mm in the picture, of vertebrae at rest, from whose lowest to whose highest the wave runs.
    """
    left, up = picture_axes(target.trial.view)
    if isinstance(target, PedicleTarget):
        # Vertebrae whose corners are not marked turn about the pedicles themselves.
        at = {int(row): place for row, place in zip(target.boxes.rows, target.boxes.z.mean(axis=1))}
        middle = np.array([at.get(int(row), place) for row, place in zip(target.rows, target.z)])
    else:
        middle = target.z.mean(axis=1)
    height = np.array([heights.get(int(row), place @ up) for row, place in zip(target.rows, middle)])
    bottom, top = min(heights.values()), max(heights.values())
    length = max(top - bottom, 1e-9)
    phase = np.pi * half_waves * (top - height) / length
    tilt = 0.5 * bend * np.cos(phase)
    aside = -0.5 * bend * length / (np.pi * half_waves) * np.sin(phase)
    if isinstance(target, PedicleTarget):
        arms = target.z - middle
        turned = (arms @ up)[:, None] * left - (arms @ left)[:, None] * up
        return np.asarray(aside[:, None] * left + tilt[:, None] * turned)
    arms = target.z - middle[:, None]
    turned = (arms @ up)[..., None] * left - (arms @ left)[..., None] * up
    return np.asarray(aside[:, None, None] * left + tilt[:, None, None] * turned)


def _outer(columns: Floats) -> Floats:
    return np.asarray(columns @ columns.T)


def lower_root(covariance: Floats) -> Floats:
    """(n, n) lower Cholesky factor of a covariance of residuals.

    Raises
    ------
    FitError : by rounding it is none, since of two errors one is so much smaller than the other.
    """
    try:
        return np.asarray(cholesky(covariance, lower=True))
    except LinAlgError:
        raise FitError(
            "by these priors two sights of one thing contradict each other: beside the others' size the least of them "
            "is lost to rounding; look for a prior that is far too small, e.g. annotation_mm, or far too large"
        ) from None


def restricted_factor(
    noise: Noise,
    rest: Floats,
    values: Floats,
    fixed: Floats,
    spread: float,
    inflation: Floats,
    held: tuple[Floats, Floats] | None = None,
) -> float:
    """By how much tracking errors are larger than predicted, by restricted likelihood.

    Parameters
    ----------
    rest : (n, n) all other covariance, that of nuisances included.
    values : (n,) residuals. fixed : (n, P) columns of the ratios.
    spread : standard deviation of the log of the factor before the fit.
    held : (k, P) rows and (k,) values with variance 1, what is known of the ratios beside the residuals; None: nothing.
    """
    if spread == 0.0:
        return 1.0
    known_before = np.zeros((0, fixed.shape[1] + 1)) if held is None else np.column_stack(held)

    def cost(log_factor: float) -> float:
        root = lower_root(rest + noise.tracking(float(np.exp(log_factor)), inflation))
        whitened = np.vstack([solve_triangular(root, np.column_stack([fixed, values]), lower=True), known_before])
        q, triangle = np.linalg.qr(whitened[:, :-1])
        left = whitened[:, -1] - q @ (q.T @ whitened[:, -1])
        known = np.abs(np.diag(triangle))
        determinant = 2.0 * np.log(np.diag(root)).sum() + 2.0 * np.log(np.maximum(known, 1e-12)).sum()
        return 0.5 * float(left @ left + determinant + (log_factor / spread) ** 2)

    limit = WIDEST_FACTOR * min(spread, 1.0)
    return float(np.exp(minimize_scalar(cost, bounds=(-limit, limit), method="bounded", options={"xatol": 0.02}).x))
