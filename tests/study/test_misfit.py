"""Spines beside each other: what is taken out, what stands out, and what explains a difference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.study.misfit import Spines, explanations, moved, rms, strays

ROWS = np.arange(17)
BOX = np.array([[15.0, -10.0], [-15.0, -10.0], [-15.0, 10.0], [15.0, 10.0]])


@pytest.fixture
def pair():
    """A curved spine seen as it is: vertebrae 20 to 36 mm apart, tilted along the curve."""
    down = np.concatenate([[0.0], np.cumsum(np.linspace(20.0, 36.0, 16))])
    aside = 25.0 * np.sin(np.pi * down / down[-1]) ** 2
    slope = np.gradient(aside, down)
    tall = np.linspace(0.8, 1.4, 17)[:, None, None] * BOX
    turned = tall + slope[:, None, None] * np.stack([tall[..., 1], -tall[..., 0]], -1)
    model = turned + np.stack([aside, down], -1)[:, None]
    return Spines(VERTEBRAE, ROWS, model, model, np.array([1.0, 0.0]))


def turned(points, angle, shift):
    cosine, sine = np.cos(angle), np.sin(angle)
    return points @ np.array([[cosine, sine], [-sine, cosine]]) + shift


def test_where_the_patient_stood_is_no_difference(pair):
    seen = replace(pair, seen=turned(pair.model, 0.3, [40.0, -7.0]))
    assert rms(seen.difference) < 1e-9
    assert rms(moved(pair.model, 1.2 * pair.model) - 1.2 * pair.model) > 5.0
    assert rms(moved(pair.model, 1.2 * pair.model, scaled=True) - 1.2 * pair.model) < 1e-9


def test_one_vertebra_stands_out_of_a_smooth_difference(pair):
    smooth = np.sin(np.pi * ROWS / 16.0)[:, None, None] * np.array([6.0, 0.0]) * np.ones((17, 4, 2))
    found = strays(smooth, ROWS)
    assert found[2:-2].max() < 0.5
    # At the ends all neighbours lie on one side.
    assert found.max() < 3.0
    for row in (0, 8, 16):
        odd = np.array(smooth)
        odd[row] += [0.0, 7.0]
        found = strays(odd, ROWS)
        assert np.argmax(found) == row
        assert found[row] == pytest.approx(7.0, abs=0.6)
        # Its neighbours are not blamed for it.
        assert np.delete(found, row).max() < 3.0
        assert np.delete(found, row)[3:-3].max() < 0.8


def test_neighbours_are_the_nearest_that_are_seen():
    rows = np.array([0, 1, 2, 9, 10, 11])
    difference = np.where(rows < 5, 0.0, 8.0)[:, None, None] * np.ones((6, 4, 2))
    # Of four neighbours two are of the other group at most.
    assert strays(difference, rows).max() <= 0.5 * np.sqrt(2.0) * 8.0 + 1e-9


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("vertebra", "wrong corners of T8"),
        ("mirror", "a mirrored picture, at rest or of the push"),
        ("scale", "pixel spacing or distances, the push being 0.80 times as large as the rest pictures"),
        ("levels", "levels of the push named one too far down (T8 as T9), or one too far up at rest"),
        ("up", "levels of the push named one too far up (T9 as T8), or one too far down at rest"),
        ("load", "a rest picture under load, as in frame 2 (40 N)"),
    ],
)
def test_the_mistake_itself_explains_best(pair, kind, words):
    seen = np.array(pair.model)
    bent = seen + np.sin(np.pi * ROWS / 16.0)[:, None, None] * np.array([9.0, 0.0])
    found = pair
    if kind == "vertebra":
        seen[7] += 30.0
        found = replace(pair, seen=seen)
    elif kind == "mirror":
        found = replace(pair, seen=(seen * [-1.0, 1.0])[:, [1, 0, 3, 2]])
    elif kind == "scale":
        middle = seen.mean(1, keepdims=True)
        found = replace(pair, seen=seen - middle + 0.8 * middle)  # boxes are placed at the model's size
    elif kind == "levels":
        found = Spines(VERTEBRAE[1:], ROWS[1:], seen[:-1], seen, pair.left)
    elif kind == "up":
        found = Spines(VERTEBRAE[:-1], ROWS[:-1], seen[1:], seen, pair.left)
    else:
        found = replace(pair, model=bent)
    loaded = [
        ("frame 1 (20 N)", replace(found, seen=0.5 * (seen + bent))),
        ("frame 2 (40 N)", replace(found, seen=bent)),
    ]
    best, *others = explanations(found, loaded if kind == "load" else [])
    assert best.text == words
    assert best.left_mm < 0.05
    assert all(other.left_mm > 10.0 * best.left_mm for other in others)
    assert [other.left_mm for other in others] == sorted(other.left_mm for other in others)
