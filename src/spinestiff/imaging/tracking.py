"""Vertebra corners followed through a sequence of radiographs (paper 2.2).

As in the paper, frame by frame: the new frame's histogram is matched, dense optical flow (DIS) carries the corners
over. Two things are added, since flow of single points drifts and a corner alone has little texture:

- a vertebra moves as a body: a robust rigid motion in the picture is fitted to the flow over its area;
- that motion is then corrected against the annotated first frame (registration of the vertebra's patch), and kept
  only if it correlates better there, so that errors don't add up from frame to frame.

Quality says how well the patch still correlates with the first frame and how well forward and backward flow agree.
The second alone is blind: it stays small where both directions follow the same wrong thing.

Inside, everything is in pixels (column, row), the first pixel's centre at (0, 0).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import VertebraCorners

if TYPE_CHECKING:
    from spinestiff.imaging.radiograph import Radiograph

Image = NDArray[np.float32]
Observer = Callable[[int, int], None]

SUPPORT_LIMIT_MM = 3.0
"""A support that moved by more (patient plane) makes a frame unfit for use (paper 2.1)."""
DEPTH_OF_SLIDE = 0.4
"""Motion in depth of a shoulder for each mm that it slides along its wall: 0.3 to 0.4 in the template under a push."""
# Half width of the band along a vertebra's outline that is registered, in parts of the vertebra's size.
BAND = 0.2
# Pictures finer than this (mm at the patient plane) are binned first: noise shrinks and flow needs its time.
FINEST_MM = 0.3
PATCH_POINTS = 3000
# Correlation with the first frame up to which quality is 0 and from which on it is 1.
CORRELATION = (0.25, 0.75)
# Disagreement of forward and backward flow (mm, patient plane) that halves quality.
ROUND_TRIP_MM = 1.0
LOST = 0.1
# Part of a patch that must lie within the image.
FEWEST_SEEN = 0.5
SUPPORT_RADIUS_MM = 15.0
# Standard deviations in mm at the patient plane: what is registered, coarse then fine, and the shading taken off.
SMOOTHING_MM = (1.2, 0.45)
SHADING_MM = 3.0
ROBUST_ROUNDS = 5
REGISTRATION_ROUNDS = 15
# The largest correction of the flow's motion, in patch sizes: half a vertebra away its neighbour would match.
LARGEST_CORRECTION = 0.25
# Correlation that a pose one patch size away from its neighbour's motion must gain to be believed.
STRAY_COST = 0.4


@dataclass(frozen=True)
class SupportMotion:
    """How far a support moved in the picture since the first frame.

    Attributes
    ----------
    name : "pelvis" or "shoulder".
    displacement : (F, 2) mm at the patient plane along columns and rows, mean over the support's points: a pelvis that
        turns about its hinge does not count as moved.
    quality : (F,) in 0..1; 0 = not visible, the displacement means nothing.
    off_axis : how far the support's points lie from the principal ray, over the distance of the source.
    """

    name: str
    displacement: Floats
    quality: Floats
    off_axis: float = 0.0

    def __post_init__(self) -> None:
        displacement = read_only("displacement", self.displacement, (None, 2), TrackingError)
        object.__setattr__(self, "displacement", displacement)
        object.__setattr__(self, "quality", read_only("quality", self.quality, (len(displacement),), TrackingError))

    @property
    def distance(self) -> Floats:
        """(F,) mm that count: a shoulder may slide along its smooth wall, so only its motion across does."""
        counting = self.displacement[:, :1] if self.name == "shoulder" else self.displacement
        return np.asarray(np.linalg.norm(counting, axis=1))

    @property
    def limit(self) -> Floats:
        """(F,) mm: 3, and for a shoulder what its slide may add: with it goes a motion in depth, seen off the axis."""
        slide = np.abs(self.displacement[:, 1]) if self.name == "shoulder" else 0.0 * self.displacement[:, 1]
        return np.asarray(SUPPORT_LIMIT_MM + self.off_axis * DEPTH_OF_SLIDE * slide)

    @property
    def moved(self) -> NDArray[np.bool_]:
        """(F,) whether it is seen to have moved by more than its limit."""
        return np.asarray((self.distance > self.limit) & (self.quality > 0.0))

    def messages(self) -> dict[int, str]:
        """For each frame to be dropped, why."""
        return {
            int(frame): f"frame {frame}: the {self.name} moved by {self.distance[frame]:.1f} mm "
            f"(limit {self.limit[frame]:.1f} mm); the frame is dropped"
            for frame in np.flatnonzero(self.moved)
        }


def track(
    frames: Sequence[Radiograph], first: VertebraCorners, observer: Observer | None = None
) -> tuple[VertebraCorners, ...]:
    """Corners in every frame, followed from the annotated first one (paper 2.2).

    Parameters
    ----------
    frames : F radiographs of one view and size, in order of time.
    first : corners in frame 0, mm on the detector.
    observer : called with (frames done, frames in all).

    Returns
    -------
    F corners with their quality; the first is ``first``. A vertebra or corner that was lost or left the image has
    quality 0; its position is then only the last guess.

    Raises
    ------
    TrackingError : no frames, frames of different size or geometry, corners outside the first frame, or no vertebra
        found in any later frame.
    """
    pictures = _Pictures.of(frames)
    view, shape = frames[0].view, frames[0].pixels.shape
    _check_inside(view.pixels(first.corners), shape, first.vertebrae)
    corners = pictures.binned(view.pixels(first.corners))
    bodies = [_Body.of_vertebra(quad) for quad in corners]
    poses, quality = _follow(pictures, bodies, observer, chained=True)
    tracked = [first]
    for k in range(1, len(frames)):
        moved = np.stack([body.placed(pose, quad) for body, pose, quad in zip(bodies, poses[k], corners)])
        moved = pictures.unbinned(moved)
        seen = quality[k][:, None] * _inside(moved, shape) * np.asarray(first.quality)
        tracked.append(VertebraCorners(first.vertebrae, view.from_pixels(moved), seen))
    if len(tracked) > 1 and not any(corners.usable.any() for corners in tracked[1:]):
        raise TrackingError(
            "no vertebra of the first frame was found in any other; are these frames of one sequence, in order?"
        )
    return tuple(tracked)


def support_motion(
    frames: Sequence[Radiograph], points: Mapping[str, Floats], observer: Observer | None = None
) -> tuple[SupportMotion, ...]:
    """Motion of pelvis and shoulder through a sequence, where their points are visible (paper 2.1).

    Parameters
    ----------
    frames : F radiographs of one view and size.
    points : (n, 2) pixels (column, row) in frame 0, by support.
    observer : called with (frames done, frames in all).

    Raises
    ------
    TrackingError : as ``track``; a point outside the first frame.
    """
    if not points:
        return ()
    pictures = _Pictures.of(frames)
    groups = {name: np.asarray(where, dtype=float).reshape(-1, 2) for name, where in points.items()}
    for name, where in groups.items():
        _check_inside(where, frames[0].pixels.shape, (f"a {name} point",) * len(where))
    owners = np.array([name for name, where in groups.items() for _ in where])
    radius = SUPPORT_RADIUS_MM / pictures.mm
    bodies = [_Body.of_square(point, radius) for where in groups.values() for point in pictures.binned(where)]
    poses, quality = _follow(pictures, bodies, observer, chained=False)
    shifts = poses[:, :, 1:] * pictures.mm
    view = frames[0].view
    found = []
    for name in groups:
        mine = owners == name
        weight = quality[:, mine] + 1e-12
        mean = np.einsum("fp,fpi->fi", weight / weight.sum(1, keepdims=True), shifts[:, mine])
        away = np.abs(view.to_patient_plane(view.from_pixels(groups[name]))[:, 0]).max()
        found.append(SupportMotion(name, mean, quality[:, mine].max(1), float(away) / view.source_to_patient))
    return tuple(found)


@dataclass(frozen=True)
class _Body:
    """A patch of the first frame that moves rigidly in the picture. A pose is (angle, shift), (3,) rad and pixels.

    Attributes
    ----------
    centre, size : (2,) and pixels.
    points : (n, 2) of the patch.
    normals : (n, 2) unit, the only direction in which a point tells of motion; None = both.
    """

    centre: Floats
    size: float
    points: Floats
    normals: Floats | None = None

    @staticmethod
    def of_vertebra(quad: Floats) -> _Body:
        """A band along the outline (4, 2), in which each point tells of motion across the outline.

        Arch and processes lie behind the body, are brighter than its walls and move otherwise (with axial rotation,
        and by parallax): the middle is left out, and where they cross the endplates they must not count sideways.
        """
        size = np.sqrt(_area(quad))
        grid = _grid(_dilated(quad, BAND * size))
        points = grid[~_within(_dilated(quad, -BAND * size), grid)]
        along = np.roll(quad, -1, axis=0) - quad
        across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
        distance = np.abs(np.einsum("pki,ki->pk", points[:, None] - quad, across))
        return _Body(quad.mean(axis=0), float(size), points, across[np.argmin(distance, axis=1)])

    @staticmethod
    def of_square(centre: Floats, radius: float) -> _Body:
        """All around a point."""
        return _Body(centre, 2.0 * radius, _grid(centre + radius * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])))

    def placed(self, pose: Floats, points: Floats) -> Floats:
        """Points (n, 2) of the first frame carried along."""
        return self.centre + pose[1:] + (points - self.centre) @ _turn(pose[0]).T


@dataclass(frozen=True)
class _Pictures:
    """The frames' pixels, binned by a whole factor where they are finer than tracking needs.

    Attributes
    ----------
    images : (F) of (H, W), in standard deviations of the first.
    factor : pixels of a frame along the side of a bin.
    mm : a bin's side at the patient plane.
    """

    images: tuple[Image, ...]
    factor: int
    mm: float

    @staticmethod
    def of(frames: Sequence[Radiograph]) -> _Pictures:
        _check_frames(frames)
        mm = float((frames[0].view.pixel_spacing / frames[0].view.magnification).mean())
        factor = max(1, int(FINEST_MM / mm))
        images = [_binned(frame.pixels, factor) for frame in frames]
        middle, spread = images[0].mean(), images[0].std()
        if not spread > 0.0:
            raise TrackingError("the first frame is one grey value; wanted a radiograph")
        return _Pictures(tuple((image - middle) / spread for image in images), factor, mm * factor)

    def binned(self, pixels: Floats) -> Floats:
        """Positions in the frames to positions in ``images``."""
        return np.asarray((pixels - 0.5 * (self.factor - 1)) / self.factor)

    def unbinned(self, bins: Floats) -> Floats:
        """Inverse of ``binned``."""
        return np.asarray(bins * self.factor + 0.5 * (self.factor - 1))


def _binned(pixels: Image, factor: int) -> Image:
    if factor == 1:
        return np.asarray(pixels, dtype=np.float32)
    rows, columns = (n // factor for n in pixels.shape)
    blocks = pixels[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


def _follow(
    pictures: _Pictures, bodies: Sequence[_Body], observer: Observer | None, chained: bool
) -> tuple[Floats, Floats]:
    """Poses (F, n, 3) and quality (F, n) of bodies; ``chained`` ones lie along a spine, one beside the other."""
    images, mm = pictures.images, pictures.mm
    start = _bytes(images[0])
    first = _levels(images[0], mm)
    patches = [_Patch.of(body, first) for body in bodies]
    poses, quality = np.zeros((len(images), len(bodies), 3)), np.ones((len(images), len(bodies)))
    # Flow starts from the last frame in which bodies were found: a spoilt frame must not spoil those after it.
    base, found = start, 0
    for k in range(1, len(images)):
        image = _matched(_bytes(images[k]), start)
        levels = _levels(images[k], mm)
        forward, backward = _flow(base, image), _flow(image, base)
        carried = [_carried(body, pose, forward) for body, pose in zip(bodies, poses[found])]
        poses[k], likeness = _settled(bodies, patches, levels, carried, chained)
        for i, body in enumerate(bodies):
            trip = _round_trip(body, poses[found, i], poses[k, i], backward) * mm
            visible = _inside(body.placed(poses[k, i], body.centre[None]), image.shape)[0]
            quality[k, i] = visible * _quality(likeness[i], trip)
        if np.median(quality[k]) > LOST:
            base, found = image, k
        if observer is not None:
            observer(k + 1, len(images))
    return poses, quality


def _quality(correlation: float, round_trip: float) -> float:
    low, high = CORRELATION
    likeness = np.clip((correlation - low) / (high - low), 0.0, 1.0)
    return float(likeness / (1.0 + (round_trip / ROUND_TRIP_MM) ** 2))


def _bytes(image: Image) -> NDArray[np.uint8]:
    """The image's own middle range of grey values as 0..255, the form that flow takes."""
    low, high = np.percentile(image, [0.5, 99.5])
    return np.asarray(np.clip(np.rint((image - low) * (255.0 / max(high - low, 1e-9))), 0, 255), dtype=np.uint8)


def _matched(image: NDArray[np.uint8], reference: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The image with the reference's histogram (paper 2.2)."""
    from skimage.exposure import match_histograms

    matched = np.rint(match_histograms(image, reference))
    return np.asarray(np.clip(matched, 0, 255), dtype=np.uint8)


def _flow(image: NDArray[np.uint8], following: NDArray[np.uint8]) -> Image:
    """Dense optical flow (H, W, 2), pixels, from an image to the one that follows."""
    import cv2

    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    # The third argument is the flow to start from, not only where to write.
    return np.asarray(flow.calc(image, following, np.zeros((*image.shape, 2), np.float32)))


def _levels(image: Image, mm: float) -> list[Image]:
    """Structures between noise and soft-tissue shading, which does not move with the bones; coarse, then fine."""
    import cv2

    shading = cv2.GaussianBlur(image, (0, 0), SHADING_MM / mm)
    return [np.asarray(cv2.GaussianBlur(image, (0, 0), sigma / mm) - shading, np.float32) for sigma in SMOOTHING_MM]


def _sampled(image: Image, points: Floats) -> Floats:
    """Values (n,) or (n, c) at points (n, 2), linear between pixels, the border's beyond it."""
    column = np.clip(points[:, 0], 0.0, image.shape[1] - 1.001)
    row = np.clip(points[:, 1], 0.0, image.shape[0] - 1.001)
    j, i = column.astype(np.intp), row.astype(np.intp)
    extra = (slice(None),) + (None,) * (image.ndim - 2)
    a, b = (column - j)[extra], (row - i)[extra]
    upper = (1.0 - a) * image[i, j] + a * image[i, j + 1]
    lower = (1.0 - a) * image[i + 1, j] + a * image[i + 1, j + 1]
    return np.asarray((1.0 - b) * upper + b * lower)


def _carried(body: _Body, pose: Floats, flow: Image) -> Floats:
    """The pose after the body moved with the flow: the rigid motion that most of its points agree on."""
    here = body.placed(pose, body.points)
    there = here + _sampled(flow, here)
    weight: Floats = np.ones(len(here))
    for _ in range(ROBUST_ROUNDS):
        pose = _rigid_fit(body, there, weight)
        distance = np.linalg.norm(there - body.placed(pose, body.points), axis=1)
        scale = max(1.5 * float(np.median(distance)), 0.1)
        weight = 1.0 / (1.0 + (distance / scale) ** 2) ** 2
    return pose


def _rigid_fit(body: _Body, there: Floats, weight: Floats) -> Floats:
    """Pose that brings the body's points nearest to ``there`` (n, 2) by weighted least squares."""
    share = weight / weight.sum()
    relative = body.points - body.centre
    middle, target = share @ relative, share @ there
    a, b = relative - middle, there - target
    angle = np.arctan2(share @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), share @ np.sum(a * b, axis=1))
    return np.array([angle, *(target - _turn(angle) @ middle - body.centre)])


@dataclass(frozen=True)
class _Patch:
    """A body's picture in the first frame at each smoothing: values (n,) and gradients (n, 2)."""

    values: tuple[Floats, ...]
    gradients: tuple[Floats, ...]

    @staticmethod
    def of(body: _Body, levels: Sequence[Image]) -> _Patch:
        values, gradients = [], []
        for image in levels:
            values.append(_sampled(image, body.points))
            ahead = [_sampled(image, body.points + 0.5 * e) - _sampled(image, body.points - 0.5 * e) for e in np.eye(2)]
            gradient = np.stack(ahead, axis=1)
            if body.normals is not None:
                gradient = body.normals * np.sum(gradient * body.normals, axis=1, keepdims=True)
            gradients.append(gradient)
        return _Patch(tuple(values), tuple(gradients))


def _settled(
    bodies: Sequence[_Body],
    patches: Sequence[_Patch],
    levels: Sequence[Image],
    carried: Sequence[Floats],
    chained: bool,
) -> tuple[Floats, Floats]:
    """Poses (n, 3) and correlations (n,) after correction.

    Where flow lost a vertebra (it takes the neighbour for it, or what crosses it), the motion of the one beside it is
    a better start. Sweeps in both directions carry it on. Vertebrae look alike, so likeness alone does not decide: a
    pose far from where the one beside would carry it must be that much more like the first frame.
    """
    settled = [_corrected(body, patch, levels, pose) for body, patch, pose in zip(bodies, patches, carried)]
    order = range(len(bodies)) if chained else range(0)
    for sweep, beside in ((order[1:], -1), (order[-2::-1], 1)):
        for i in sweep:
            centre, pose = bodies[i].centre, settled[i + beside][0]
            guess = np.array([pose[0], *(bodies[i + beside].placed(pose, centre[None])[0] - centre)])
            here, trial = settled[i], _corrected(bodies[i], patches[i], levels, guess)
            if _credit(trial, guess, bodies[i]) > _credit(here, guess, bodies[i]):
                settled[i] = trial
    return np.stack([pose for pose, _ in settled]), np.array([likeness for _, likeness in settled])


def _credit(found: tuple[Floats, float], expected: Floats, body: _Body) -> float:
    """Likeness of a found pose, less what it costs to lie away from where it is expected."""
    pose, likeness = found
    return likeness - STRAY_COST * min(1.0, float(np.linalg.norm(pose[1:] - expected[1:])) / body.size)


def _corrected(body: _Body, patch: _Patch, levels: Sequence[Image], pose: Floats) -> tuple[Floats, float]:
    """The pose registered on the first frame's patch, if that correlates better, and its correlation (finest level)."""

    def likeness(at: Floats) -> float:
        there = body.placed(at, body.points)
        seen = _inside(there, levels[-1].shape)
        if np.mean(seen) < FEWEST_SEEN:
            return 0.0
        return _correlation(patch.values[-1][seen], _sampled(levels[-1], there[seen]))

    trial = pose
    for values, gradients, image in zip(patch.values, patch.gradients, levels):
        trial = _registered(body, values, gradients, image, trial)
    near = np.linalg.norm(trial[1:] - pose[1:]) < LARGEST_CORRECTION * body.size
    before, after = likeness(pose), likeness(trial)
    return (trial, after) if near and after > before else (pose, before)


def _registered(body: _Body, values: Floats, gradients: Floats, image: Image, pose: Floats) -> Floats:
    """Robust Gauss-Newton for the pose in which ``image`` shows the patch up to brightness and contrast.

    Inverse compositional (Baker & Matthews 2004): the patch's own gradient stands for the image's, the small motion
    found for the patch is undone on the pose.
    """
    arm = body.points - body.centre
    turned = gradients[:, 1] * arm[:, 0] - gradients[:, 0] * arm[:, 1]
    columns = np.column_stack([turned, gradients, values, np.ones(len(values))])
    for _ in range(REGISTRATION_ROUNDS):
        there = body.placed(pose, body.points)
        inside = _inside(there, image.shape)
        if np.mean(inside) < FEWEST_SEEN:
            break
        seen = _sampled(image, there[inside])
        # seen = contrast * patch(moved by d) + brightness, linear in (contrast * d, contrast, brightness).
        solution = _robust_fit(columns[inside], seen)
        contrast = solution[3]
        if not contrast > 0.0:
            break
        d = solution[:3] / contrast
        pose = _undone(pose, d)
        if np.abs(d[1:]).max() < 0.003 and abs(d[0]) < 1e-4:
            break
    return pose


def _robust_fit(columns: Floats, wanted: Floats) -> Floats:
    """Least squares that gives little weight to what moves otherwise (ribs, soft tissue seen through)."""
    weight: Floats = np.ones(len(wanted))
    solution = np.zeros(columns.shape[1])
    for _ in range(3):
        weighted = columns * weight[:, None]
        normal = weighted.T @ columns
        normal[np.diag_indices_from(normal)] *= 1.0 + 1e-9
        solution = np.asarray(np.linalg.lstsq(normal, weighted.T @ wanted, rcond=None)[0], dtype=np.float64)
        residual = np.abs(wanted - columns @ solution)
        scale = 1.5 * 1.4826 * float(np.median(residual)) + 1e-12
        weight = 1.0 / (1.0 + (residual / scale) ** 2)
    return solution


def _undone(pose: Floats, step: Floats) -> Floats:
    """The pose composed with the inverse of a small motion of the patch about its centre."""
    angle = pose[0] - step[0]
    return np.array([angle, *(pose[1:] - _turn(angle) @ step[1:])])


def _correlation(a: Floats, b: Floats) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / size) if size > 0.0 else 0.0


def _round_trip(body: _Body, before: Floats, after: Floats, backward: Image) -> float:
    """Median distance (pixels) by which backward flow from the new place misses the old one."""
    there = body.placed(after, body.points)
    back = there + _sampled(backward, there)
    return float(np.median(np.linalg.norm(back - body.placed(before, body.points), axis=1)))


def _turn(angle: float) -> Floats:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def _area(quad: Floats) -> float:
    following = np.roll(quad, -1, axis=0)
    return 0.5 * abs(float(np.sum(quad[:, 0] * following[:, 1] - quad[:, 1] * following[:, 0])))


def _dilated(quad: Floats, margin: float) -> Floats:
    """Corners moved away from the middle by about ``margin`` pixels along both sides."""
    centre = quad.mean(axis=0)
    across, down = 0.5 * (quad[1] + quad[2] - quad[0] - quad[3]), 0.5 * (quad[2] + quad[3] - quad[0] - quad[1])
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    unit = np.stack([across / np.linalg.norm(across), down / np.linalg.norm(down)])
    return np.asarray(quad + margin * sides @ unit) if np.isfinite(unit).all() else centre + (quad - centre)


def _within(outline: Floats, points: Floats) -> NDArray[np.bool_]:
    """Whether points (n, 2) lie in a convex outline (4, 2)."""
    edges = np.roll(outline, -1, axis=0) - outline
    relative = points[:, None] - outline
    side = edges[:, 0] * relative[..., 1] - edges[:, 1] * relative[..., 0]
    return np.asarray((side >= 0.0).all(axis=1) | (side <= 0.0).all(axis=1))


def _grid(outline: Floats) -> Floats:
    """Pixels (n, 2) within a convex outline, thinned to a bounded number."""
    low, high = np.floor(outline.min(0)), np.ceil(outline.max(0))
    step = max(1.0, np.sqrt(np.prod(high - low) / PATCH_POINTS))
    column, row = np.meshgrid(np.arange(low[0], high[0] + 1, step), np.arange(low[1], high[1] + 1, step))
    grid = np.stack([column.ravel(), row.ravel()], axis=1)
    return np.asarray(grid[_within(outline, grid)])


def _inside(points: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    rows, columns = shape
    return np.asarray((points >= -0.5).all(-1) & (points[..., 0] <= columns - 0.5) & (points[..., 1] <= rows - 0.5))


def _check_inside(points: Floats, shape: tuple[int, ...], names: Sequence[str]) -> None:
    for name, inside in zip(names, _inside(points, shape)):
        if not np.all(inside):
            raise TrackingError(f"{name} lies outside the first frame of {shape[1]} columns and {shape[0]} rows")


def _check_frames(frames: Sequence[Radiograph]) -> None:
    if not frames:
        raise TrackingError("no frames to track through; wanted at least the annotated one")
    first = frames[0]
    for k, frame in enumerate(frames):
        if frame.pixels.shape != first.pixels.shape:
            raise TrackingError(
                f"frame {k} has shape {frame.pixels.shape}, frame 0 {first.pixels.shape}; wanted one size"
            )
        if not np.allclose(frame.view.pixel_spacing, first.view.pixel_spacing) or not np.isclose(
            frame.view.magnification, first.view.magnification
        ):
            raise TrackingError(
                f"frame {k} has another pixel spacing or magnification than frame 0; wanted one geometry"
            )
        if not np.isfinite(frame.pixels).all():
            raise TrackingError(f"frame {k} holds pixels that are not finite")
