"""Path lengths against exact clipping of rays, watertightness, and what exposure does to grey values."""

from __future__ import annotations

import math

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.errors import RadiographError, TorsoError
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.synthetic.detector import AIR_GREY, GREY_PER_OPTICAL_DEPTH, Exposure, expose
from spinestiff.imaging.synthetic.materials import Material, attenuations, monoenergetic
from spinestiff.imaging.synthetic.path_length import _side, _turn, path_length
from spinestiff.imaging.synthetic.rendering import Absorber, thicknesses
from spinestiff.imaging.synthetic.texture import Texture

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
OCTAHEDRON = np.vstack([np.eye(3), -np.eye(3)])
OCTAHEDRON_FACES = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
MU = attenuations(np.array([60.0]))[0]


def tissue(bodies: list[Absorber], view: XRayView, samples: int = 1) -> np.ndarray:
    """mm of soft tissue."""
    maps = thicknesses(bodies, view, samples)
    assert not maps[1:].any()
    return np.asarray(maps[Material.SOFT_TISSUE])


def box(size: tuple[float, float, float], turn: tuple[float, float, float] = (0, 0, 0), centre: object = (0, 0, 0)):
    return 0.5 * CUBE * size @ exp_so3(np.array(turn, dtype=float)).T + centre, CUBE_FACES


def sphere(radius: float, subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = OCTAHEDRON.copy(), OCTAHEDRON_FACES
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        a, b, c = (len(vertices) + inverse.reshape(-1, 3)).T
        middles = vertices[unique].sum(axis=1)
        vertices = np.vstack([vertices, middles / np.linalg.norm(middles, axis=1, keepdims=True)])
        i, j, k = faces.T
        faces = np.vstack([np.column_stack(t) for t in ((i, a, c), (a, j, b), (c, b, k), (a, b, c))])
    return radius * vertices, faces


def clipped_rays(vertices: np.ndarray, faces: np.ndarray, view: XRayView) -> np.ndarray:
    """Path lengths through a convex body, each ray clipped by the planes of all its faces."""
    column, row = np.meshgrid(np.arange(view.shape[1]), np.arange(view.shape[0]))
    ends = view.detector_point(view.from_pixels(np.stack([column, row], -1)))
    rays = ends - view.source
    near, far = np.zeros(view.shape), np.ones(view.shape)
    for a, b, c in vertices[faces]:
        normal = np.cross(b - a, c - a)
        speed, room = rays @ normal, (a - view.source) @ normal
        with np.errstate(divide="ignore"):
            at = room / speed
        near = np.where(speed < 0, np.maximum(near, at), near)
        far = np.where(speed > 0, np.minimum(far, at), far)
    return np.maximum(far - near, 0.0) * np.linalg.norm(rays, axis=-1)


def small_view(**change: object) -> XRayView:
    return frontal_view(**{"shape": (90, 110), "pixel": 0.8, "centre": (0.0, 0.0, 0.0), **change})  # type: ignore[arg-type]


BODIES = {
    "box": box((40.0, 30.0, 20.0)),
    "turned box": box((40.0, 30.0, 20.0), (0.4, -0.7, 1.1), (3.0, -4.0, 20.0)),
    "thin sheet": box((40.0, 30.0, 0.01), (0.1, 0.2, 0.3)),
    "needle": box((60.0, 0.4, 0.4), (0.0, 0.1, 0.5)),
    "ball": sphere(25.0, 3),
}


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("view", [small_view(), lateral_view(shape=(90, 110), pixel=(0.8, 0.7), centre=(0, 0, 0))])
def test_lengths_are_those_of_rays_clipped_by_the_faces(name: str, view: XRayView) -> None:
    vertices, faces = BODIES[name]
    lengths = path_length(vertices, faces, view)
    wanted = clipped_rays(vertices, faces, view)
    assert wanted.max() > 0.0
    np.testing.assert_allclose(lengths, wanted, atol=1e-9)


def test_a_view_with_mirrored_columns_gives_the_mirrored_map() -> None:
    view = small_view()
    vertices, faces = BODIES["turned box"]
    last = view.detector_origin + (view.shape[1] - 1) * view.pixel_spacing[0] * view.detector_axes[0]
    mirrored = XRayView(view.source, last, view.detector_axes * [[-1.0], [1.0]], view.pixel_spacing, view.shape, 1340.0)
    np.testing.assert_allclose(
        path_length(vertices, faces, mirrored), path_length(vertices, faces, view)[:, ::-1], atol=1e-9
    )


def test_a_tessellated_ball_converges_to_the_sphere() -> None:
    view = small_view()
    column, row = np.meshgrid(np.arange(view.shape[1]), np.arange(view.shape[0]))
    rays = view.detector_point(view.from_pixels(np.stack([column, row], -1))) - view.source
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    passing2 = np.sum(np.cross(rays, -view.source) ** 2, axis=-1)
    chord = 2.0 * np.sqrt(np.maximum(25.0**2 - passing2, 0.0))
    errors = [np.abs(path_length(*sphere(25.0, n), view) - chord)[chord > 20.0].mean() for n in (3, 4, 5, 6)]
    assert errors[-1] < 0.01
    # Second order in the edge: four times smaller at each halving.
    assert all(3.7 < coarse / fine < 4.3 for coarse, fine in zip(errors, errors[1:]))


def exact_view() -> XRayView:
    """Whole numbers project to whole pixels without rounding: far plane at half the source's distance."""
    return XRayView(np.array([0, 0, 64.0]), np.array([-32.0, 32.0, -64.0]), np.array([[1.0, 0, 0], [0, -1.0, 0]]),
                    np.ones(2), (65, 65), 64.0)  # fmt: skip


def test_a_pixel_on_an_edge_is_counted_once() -> None:
    # Edges and diagonals of the near face (magnified twice) and of the far face run through pixel centres.
    view = exact_view()
    vertices, faces = box((8.0, 8.0, 64.0), centre=(0.0, 0.0, -32.0))
    lengths = path_length(vertices, faces, view)
    np.testing.assert_allclose(lengths, clipped_rays(vertices, faces, view), atol=1e-9)
    assert lengths[32, 32] == 64.0


def test_a_pixel_on_a_vertex_is_counted_once() -> None:
    view = exact_view()
    lengths = path_length(8.0 * OCTAHEDRON, OCTAHEDRON_FACES, view)
    assert lengths[32, 32] == pytest.approx(16.0, abs=1e-12)
    np.testing.assert_allclose(lengths, clipped_rays(8.0 * OCTAHEDRON, OCTAHEDRON_FACES, view), atol=1e-9)


def test_no_cracks_on_random_closed_surfaces() -> None:
    # A crack or a double count is worth the distance to the source, 1300 mm.
    random = np.random.default_rng(0)
    vertices, faces = sphere(1.0, 3)
    for _ in range(20):
        lumpy = np.rint(16.0 * vertices * random.uniform(0.4, 1.6, (len(vertices), 1)))
        lengths = path_length(lumpy, faces, exact_view())
        assert np.abs(lengths).max() < 120.0


def test_vertices_that_miss_pixel_centres_by_rounding_leave_no_cracks() -> None:
    # A closed blanket with a vertex on the ray of every pixel, so that rounding decides on which side it falls.
    view = frontal_view(shape=(40, 40), pixel=0.417, centre=(1.0, 203.0, -2.0)).moved((0.3, 0.1), 0.05)
    column, row = np.meshgrid(np.arange(5, 35), np.arange(5, 35))
    rim = (column == 5) | (column == 34) | (row == 5) | (row == 34)
    ends = view.detector_point(view.from_pixels(np.stack([column, row], -1)))
    random = np.random.default_rng(2)
    near = np.where(rim, 0.85, 0.85 - random.uniform(0.001, 0.01, rim.shape))
    far = np.where(rim, 0.85, 0.85 + random.uniform(0.001, 0.01, rim.shape))
    vertices = np.vstack([(view.source + s[..., None] * (ends - view.source)).reshape(-1, 3) for s in (near, far)])
    i = (np.arange(29)[:, None] * 30 + np.arange(29)).ravel()
    sheet = np.vstack([np.column_stack([i, i + 30, i + 1]), np.column_stack([i + 1, i + 30, i + 31])])
    lengths = path_length(vertices, np.vstack([sheet, sheet[:, ::-1] + 900]), view)
    wanted = np.zeros(view.shape)
    wanted[5:35, 5:35] = (far - near) * np.linalg.norm(ends - view.source, axis=-1)
    np.testing.assert_allclose(lengths, wanted, atol=1e-6)


def test_the_side_of_an_edge_is_exact() -> None:
    # Points one step of the lattice beside the line (cross product 1) or on it; the products have 100 bits.
    random = np.random.default_rng(8)
    for _ in range(200):
        dx, dy = (2 * int(n) + 1 for n in random.integers(2**47, 2**49, 2))
        if math.gcd(dx, dy) != 1:
            continue
        ey = pow(dx, -1, dy)
        ex = (dx * ey - 1) // dy
        for turn, p in ((1, (ex, ey)), (-1, (-ex, -ey)), (0, (0, 0))):
            a, b, c = ((x * 2.0**-36, y * 2.0**-36) for x, y in ((0, 0), (dx, dy), p))
            assert _turn(*a, *b, *c) == turn == -_turn(*b, *a, *c)
            assert _side(*a, *b, *c) == -_side(*b, *a, *c) != 0


def test_pieces_add_up_and_turned_faces_count_negative() -> None:
    view = small_view()
    (a, faces), (b, _) = box((20.0, 30.0, 20.0), centre=(-10.0, 0, 0)), box((20.0, 30.0, 20.0), centre=(10.0, 0, 0))
    both = path_length(np.vstack([a, b]), np.vstack([faces, faces + 8]), view)
    np.testing.assert_allclose(both, path_length(*box((40.0, 30.0, 20.0)), view), atol=1e-9)
    total = path_length(a, faces, view)
    assert path_length(b, faces, view, out=total) is total
    np.testing.assert_allclose(total, both, atol=1e-9)
    np.testing.assert_allclose(path_length(a, faces[:, ::-1], view), -path_length(a, faces, view), atol=1e-9)


def test_a_surface_beyond_the_detector_leaves_no_shadow_and_half_a_one_is_clipped() -> None:
    view = small_view()
    assert not path_length(*box((10.0, 10.0, 10.0), centre=(500.0, 0, 0)), view).any()
    vertices, faces = box((40.0, 30.0, 20.0), (0.4, -0.7, 1.1), (40.0, 30.0, 0.0))
    np.testing.assert_allclose(path_length(vertices, faces, view), clipped_rays(vertices, faces, view), atol=1e-9)


def test_an_open_surface_is_refused_and_a_seam_is_not() -> None:
    vertices, faces = BODIES["box"]
    with pytest.raises(TorsoError, match="not closed: 3 edges"):
        path_length(vertices, faces[1:], small_view())
    seam = vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)
    np.testing.assert_array_equal(path_length(*seam, small_view()), path_length(vertices, faces, small_view()))


def test_a_surface_around_the_source_is_refused() -> None:
    with pytest.raises(RadiographError, match="source"):
        path_length(*box((40.0, 30.0, 3000.0)), small_view())


def test_grey_values_follow_beer_and_lambert() -> None:
    view = small_view()
    vertices, faces = BODIES["box"]
    quiet = Exposure(beam=monoenergetic(60.0), scatter_fraction=0.0, haze=0.0, focal_spot=0.0, detector_blur=0.0,
                     electronic_noise=0.0, photons=1e12)  # fmt: skip
    for material in Material:
        image = expose(thicknesses([Absorber(vertices, faces, material, 0.7)], view), view, quiet)
        wanted = AIR_GREY + GREY_PER_OPTICAL_DEPTH * MU[material] * 0.7 * path_length(vertices, faces, view)
        assert image.dtype == np.uint16
        np.testing.assert_allclose(image, wanted, atol=2.0)


def test_a_shell_absorbs_along_the_wall() -> None:
    view = small_view()
    vertices, faces = sphere(25.0, 4)
    depth = tissue([Absorber(vertices, faces, density=0.2, shell=2.0, shell_density=1.0)], view)
    wanted = 1.2 * path_length(vertices, faces, view) - path_length(vertices * 23.0 / 25.0, faces, view)
    np.testing.assert_allclose(depth, wanted, atol=0.1)  # normals of a tessellation
    thick = np.where(vertices[:, 1] > 0.0, 2.0, 0.0)
    upper = tissue([Absorber(vertices, faces, density=0.2, shell=thick, shell_density=1.0)], view)
    np.testing.assert_allclose(upper[:35], depth[:35], atol=1e-9)
    np.testing.assert_allclose(upper[55:], 0.2 * path_length(vertices, faces, view)[55:], atol=1e-9)


def test_texture_rides_on_its_body() -> None:
    # Turning body and view together leaves the picture; the pattern is not stuck to the world.
    vertices, faces = BODIES["ball"]
    view = small_view()
    shift, turn = np.array([0.0, 0.0, 40.0]), exp_so3(np.array([0.0, 0.0, 0.3]))
    still = tissue([Absorber(vertices, faces, density=0.02, texture=Texture(0.2, 6.0, 1))], view)
    moved = tissue(
        [Absorber(vertices @ turn.T + shift, faces, density=0.02, texture=Texture(0.2, 6.0, 1, shift, turn))],
        XRayView(view.source @ turn.T + shift, view.detector_origin @ turn.T + shift, view.detector_axes @ turn.T,
                 view.pixel_spacing, view.shape, view.source_to_patient),
    )  # fmt: skip
    np.testing.assert_allclose(moved, still, atol=1e-9)
    plain = tissue([Absorber(vertices, faces, density=0.02)], view)
    inside = plain > 0.5
    ratio = still[inside] / plain[inside]
    assert 0.01 < ratio.std() < 0.2
    assert np.abs(ratio - 1.0).max() < 0.25
    other = tissue([Absorber(vertices, faces, density=0.02, texture=Texture(0.2, 6.0, 2))], view)
    assert np.abs(other - still).max() > 0.02


def test_several_rays_a_pixel_are_their_mean() -> None:
    # A path length that is linear across the image keeps its values: the finer rays lie evenly about the pixel.
    wedge = np.array([[-30.0, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0], [30, -30, 40], [30, 30, 40]])
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [2, 3, 5], [1, 2, 5], [1, 5, 4], [0, 4, 5], [0, 5, 3]])
    view = frontal_view(sid=1e7, source_to_patient=1e7 - 100.0, shape=(50, 50), pixel=1.9, centre=(0.0, 0.0, 0.0))
    one, three = (tissue([Absorber(wedge, faces, density=0.1)], view, samples) for samples in (1, 3))
    inside = slice(14, 36)
    np.testing.assert_allclose(three[inside, inside], one[inside, inside], rtol=1e-4)
    assert np.ptp(one[25, inside]) > 1.0
    assert np.abs(three - one).max() > 0.1
    with pytest.raises(RadiographError, match="0 samples"):
        tissue([], view, 0)


def test_smoothing_keeps_what_is_absorbed() -> None:
    view = small_view()
    vertices, faces = BODIES["box"]
    sharp = tissue([Absorber(vertices, faces, density=0.02)], view)
    soft = tissue([Absorber(vertices, faces, density=0.02, smoothing=2.0)], view)
    assert soft.sum() == pytest.approx(sharp.sum(), rel=0.02)
    assert np.abs(np.diff(soft[45])).max() < 0.5 * np.abs(np.diff(sharp[45])).max()
