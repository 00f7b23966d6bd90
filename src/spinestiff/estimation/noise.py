"""What makes a radiograph differ from the right model, as a covariance: what is seen wrongly, and what the model lacks.

A vertebra's picture has three numbers, its *channels*: shifts along columns and rows and the turn, as orthonormal
combinations of its eight corner coordinates, in mm. Most of their errors are shared. An annotation's error is in all
frames of its sequence, one of geometry in all frames of all sequences, where the patient stood in a whole radiograph.
Only what tracking adds is a frame's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize_scalar

from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.estimation.objective import Residuals, Target
from spinestiff.estimation.priors import Priors
from spinestiff.imaging.features import picture_axes
from spinestiff.imaging.tracking.quality import error_of

CHANNELS = 3
# A vertebra whose own error is more than this many times what was expected counts by as much less.
USUAL = 2.5
# Of what is expected, in log: the range in which the size of tracking errors is looked for.
WIDEST_FACTOR = 3.0


@dataclass(frozen=True, repr=False)
class Channels(ShortRepr):
    """From the corners of a radiograph's vertebrae to their channels.

    Attributes
    ----------
    basis : (Nv, 3, 4, 2), orthonormal rows.
    rows : (Nv,) the vertebrae among the torso's.
    arms : (Nv,) mm, what a turn of 1 rad gives the third channel.
    """

    basis: Floats
    rows: Ints
    arms: Floats

    @classmethod
    def of(cls, target: Target) -> Channels:
        """Of a target's vertebrae."""
        arms = target.z - target.z.mean(axis=1, keepdims=True)
        turn = np.stack([-arms[..., 1], arms[..., 0]], -1)
        sizes = np.linalg.norm(turn, axis=(1, 2))
        turn = turn / sizes[:, None, None]
        shift = np.zeros((2, len(arms), 4, 2))
        shift[0, :, :, 0] = shift[1, :, :, 1] = 0.5
        return cls(np.stack([*shift, turn], axis=1), target.rows, sizes)

    def apply(self, features: Floats) -> Floats:
        """(3 Nv, ...) channels of features (Nv, 4, 2, ...), vertebra by vertebra."""
        found = np.einsum("vcki,vki...->vc...", self.basis, features)
        return found.reshape(CHANNELS * len(self.rows), *features.shape[3:])

    def turning(self, upper: int, lower: int) -> Floats:
        """(3 Nv,) weights of the channels that give the turn of vertebra ``upper`` against ``lower``, rad."""
        weights = np.zeros(CHANNELS * len(self.rows))
        for row, sign in ((upper, 1.0), (lower, -1.0)):
            weights[CHANNELS * row + 2] = sign / self.arms[row]
        return weights


@dataclass(frozen=True)
class Seen:
    """A radiograph among those of a fit.

    Attributes
    ----------
    target : what it shows.
    sequence : frames of one carry the same name here.
    annotated : its corners were set by hand, so that tracking adds no error.
    """

    target: Target
    sequence: str
    annotated: bool


class Noise:
    """The covariance of all channels of several radiographs, in parts that do not depend on the ratios.

    Parameters
    ----------
    seen : radiographs.
    still : (n_i, 4, 2, 6) of each, derivative of its features in the rest poses of its vertebrae.
    geometry : (6V, 6V) covariance of the rest poses (dt mm, dw rad), or None: known.
    priors : of everything else.
    """

    def __init__(
        self, seen: Sequence[Seen], still: Sequence[Residuals], geometry: Floats | None, priors: Priors
    ) -> None:
        self.seen = tuple(seen)
        self.channels = tuple(Channels.of(one.target) for one in seen)
        counts = [CHANNELS * len(one.rows) for one in self.channels]
        self.ends = np.concatenate([[0], np.cumsum(counts)])
        self.size = int(self.ends[-1])
        self._priors = priors
        self._sequences = [one.sequence for one in seen]
        self._rows = np.concatenate([np.repeat(one.rows, CHANNELS) for one in self.channels])
        self._channel = np.tile(np.arange(CHANNELS), self.size // CHANNELS)
        self._trial = np.repeat(np.arange(len(seen)), counts)
        sequence = np.array([list(dict.fromkeys(self._sequences)).index(name) for name in self._sequences])[self._trial]
        alike = (self._rows[:, None] == self._rows) & (self._channel[:, None] == self._channel)
        self.parts: dict[str, Floats] = {
            "annotation": priors.annotation_mm**2 * (alike & (sequence[:, None] == sequence))
        }
        stance_roll = float(np.deg2rad(priors.stance_deg))
        roll = float(np.deg2rad(priors.place_deg))
        self.parts["place in the picture"] = _outer(self._places(seen, self._trial, priors.place_mm, roll, 0.0))
        self.parts["posture"] = _outer(self._waves(seen, sequence, float(np.deg2rad(priors.posture_deg))))
        self.parts["stance"] = _outer(self._places(seen, sequence, priors.stance_mm, stance_roll, priors.stance_scale))
        if geometry is not None:
            self.parts["rest geometry"] = self._of_geometry(still, geometry)
        own = np.zeros(self.size)
        tracked = np.zeros(self.size, dtype=bool)
        for i, one in enumerate(seen):
            if not one.annotated:
                corners = one.target.trial.corners
                error = np.where(corners.usable, error_of(np.maximum(corners.quality, 1e-6)), 0.0)
                squares = np.sum(error**2, axis=1) / np.maximum(corners.usable.sum(1), 1)
                own[self.of(i)] = np.repeat(priors.tracking_mm**2 + 0.5 * squares, CHANNELS)
                tracked[self.of(i)] = True
        self._own = own
        apart = np.abs(np.subtract.outer(self._rows, self._rows)) / priors.tracking_length
        together = (self._trial[:, None] == self._trial) & (self._channel[:, None] == self._channel)
        both = tracked[:, None] & tracked
        self._shared = priors.tracking_shared_mm**2 * np.exp(-apart) * (together & both)

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

    def inflation(self, own: Floats, factor: float) -> Floats:
        """(n,) by how much a vertebra's own variance is too small for the own errors (n,) found."""
        size = factor * np.sqrt(self._own)
        with np.errstate(divide="ignore", invalid="ignore"):
            squares = np.where(size > 0.0, (own / size) ** 2, 0.0).reshape(-1, CHANNELS)
        of_vertebra = np.sqrt(squares.mean(axis=1))
        return np.repeat(np.maximum(of_vertebra / USUAL, 1.0) ** 2, CHANNELS)

    def own_errors(self, solved: Floats, factor: float, inflation: Floats) -> Floats:
        """(n,) mm, the most probable own errors for ``solved`` = Sigma^-1 r."""
        return np.asarray(factor**2 * self._own * inflation * solved)

    def _places(self, seen: Sequence[Seen], of: Ints, shift_mm: float, turn: float, scale: float) -> Floats:
        """(n, k) columns of each group of radiographs: shifts along both axes, a turn, another size of the picture."""
        columns = []
        for group in dict.fromkeys(of.tolist()):
            for kind, size in enumerate((shift_mm, shift_mm, turn, scale)):
                if size == 0.0:
                    continue
                column = np.zeros(self.size)
                for i, one in enumerate(seen):
                    if of[self.ends[i]] == group:
                        column[self.of(i)] = size * self.channels[i].apply(_place_change(one.target.z, kind))
                columns.append(column)
        return np.stack(columns, axis=1) if columns else np.zeros((self.size, 0))

    def _waves(self, seen: Sequence[Seen], of: Ints, bend: float) -> Floats:
        """(n, 3 k) columns: the spine of each group of radiographs bent sideways by smooth waves.

        A wave's steepest tilts differ by ``bend`` rad, and its vertebrae turn with it.
        """
        columns = []
        for group in dict.fromkeys(of.tolist()) if bend else ():
            for half_waves in (1, 2, 3):
                column = np.zeros(self.size)
                for i, one in enumerate(seen):
                    if of[self.ends[i]] == group:
                        column[self.of(i)] = self.channels[i].apply(_wave(one.target, half_waves, bend))
                columns.append(column)
        return np.stack(columns, axis=1) if columns else np.zeros((self.size, 0))

    def _of_geometry(self, still: Sequence[Residuals], covariance: Floats) -> Floats:
        vertebrae = len(covariance) // 6
        jacobian = np.zeros((self.size, vertebrae, 6))
        for i, part in enumerate(still):
            found = self.channels[i].apply(part.jacobian).reshape(-1, CHANNELS, 6)
            rows = np.arange(self.ends[i], self.ends[i + 1]).reshape(-1, CHANNELS)
            for own, where, vertebra in zip(found, rows, self.channels[i].rows):
                jacobian[where, vertebra] = own
        flat = jacobian.reshape(self.size, -1)
        return np.asarray(flat @ covariance @ flat.T)


def _place_change(z: Floats, kind: int) -> Floats:
    """(Nv, 4, 2) change of boxes z per mm along columns (0) or rows (1), per rad (2), per relative size (3).

    Boxes are placed at their own size, so that only their places tell how large the picture is.
    """
    if kind < 2:
        return np.broadcast_to(np.eye(2)[kind], z.shape)
    if kind == 2:
        return np.stack([-z[..., 1], z[..., 0]], -1)
    return np.broadcast_to(z.mean(axis=1, keepdims=True), z.shape)


def _wave(target: Target, half_waves: int, bend: float) -> Floats:
    """(Nv, 4, 2) mm, how a sideways wave moves a target's boxes."""
    left, up = picture_axes(target.trial.view)
    middle = target.z.mean(axis=1)
    height = middle @ up
    length = max(float(np.ptp(height)), 1e-9)
    phase = np.pi * half_waves * (height.max() - height) / length
    tilt = 0.5 * bend * np.cos(phase)
    aside = -0.5 * bend * length / (np.pi * half_waves) * np.sin(phase)
    arms = target.z - middle[:, None]
    turned = (arms @ up)[..., None] * left - (arms @ left)[..., None] * up
    return np.asarray(aside[:, None, None] * left + tilt[:, None, None] * turned)


def _outer(columns: Floats) -> Floats:
    return np.asarray(columns @ columns.T)


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
        root = cholesky(rest + noise.tracking(float(np.exp(log_factor)), inflation), lower=True)
        whitened = np.vstack([solve_triangular(root, np.column_stack([fixed, values]), lower=True), known_before])
        q, triangle = np.linalg.qr(whitened[:, :-1])
        left = whitened[:, -1] - q @ (q.T @ whitened[:, -1])
        known = np.abs(np.diag(triangle))
        determinant = 2.0 * np.log(np.diag(root)).sum() + 2.0 * np.log(np.maximum(known, 1e-12)).sum()
        return 0.5 * float(left @ left + determinant + (log_factor / spread) ** 2)

    limit = WIDEST_FACTOR * min(spread, 1.0)
    return float(np.exp(minimize_scalar(cost, bounds=(-limit, limit), method="bounded", options={"xatol": 0.02}).x))
