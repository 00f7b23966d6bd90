"""A skin of few triangles becomes smooth without losing volume; a fine one stays as it is."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.rounding import rounded
from spinestiff.anatomy.template.surfaces import ball, signed_volume

SPACING = 36.0


@pytest.fixture(scope="module")
def facets():
    """A ball of some 140 triangles."""
    return ball(np.zeros(3), 150.0, 7, 12)


def edge_angles(surface) -> np.ndarray:
    """Degrees between neighbouring triangles, large ones first."""
    vertices, faces = surface
    normal = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, inverse = np.unique(edges, axis=0, return_inverse=True)
    pair = np.argsort(inverse.ravel(), kind="stable").reshape(-1, 2) // 3
    cosine = np.einsum("ni,ni->n", normal[pair[:, 0]], normal[pair[:, 1]])
    return np.sort(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))[::-1]


def test_large_triangles_are_rounded_at_the_same_volume(facets):
    smooth = rounded(facets, SPACING)
    assert signed_volume(smooth) == pytest.approx(signed_volume(facets), rel=1e-3)
    assert edge_angles(facets)[0] > 20.0
    assert edge_angles(smooth)[0] < 15.0
    # Nearer to a ball than its triangles are.
    radius = [np.linalg.norm(s[0][s[1]].mean(1), axis=1) for s in (facets, smooth)]
    assert np.ptp(radius[1]) < np.ptp(np.linalg.norm(facets[0], axis=1).tolist() + radius[0].tolist())


def test_a_fine_or_an_odd_skin_stays_as_it_is(facets):
    fine = ball(np.zeros(3), 150.0, 40, 60)
    assert rounded(fine, SPACING) is fine
    # A triangle given twice: some edges have four faces.
    odd = (facets[0], np.vstack([facets[1], facets[1][:1]]))
    assert rounded(odd, SPACING) is odd
