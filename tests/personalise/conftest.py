"""What a radiograph shows of a torso at rest."""

from __future__ import annotations

import pytest

from spinestiff.anatomy.template import template_torso
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features


def annotated(torso, view, names=None):
    """Corners as seen, without error."""
    shares = silhouette_shares(torso, view, torso.rest_pose)
    corners = state_features(torso, view, torso.rest_pose, shares).corners
    found = VertebraCorners(torso.vertebrae, corners)
    return found if names is None else found.selected(tuple(names))


@pytest.fixture(scope="session")
def template():
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="session")
def see():
    return annotated
