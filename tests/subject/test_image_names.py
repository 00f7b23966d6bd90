"""Names of a subject's images: what is spelt is read again, and what is no name is none."""

from __future__ import annotations

import pytest

from spinestiff.subject.image_names import (
    FRONTAL,
    LATERAL,
    PushImage,
    described,
    frame_image,
    rest_image,
    rest_view,
    view_image,
)


@pytest.mark.parametrize(
    ("name", "image", "words"),
    [
        ("push/left-5", PushImage("left-5", 0, None), "push left-5"),
        ("push/push-1/12", PushImage("push-1", 12, None), "push-1, frame 12"),
        ("push/left-5/0/side", PushImage("left-5", 0, "side"), "push left-5, frame 0, view side"),
        ("push/left-5/3/side", PushImage("left-5", 3, "side"), "push left-5, frame 3, view side"),
    ],
)
def test_names_of_a_pushs_images_are_spelt_read_and_put_in_words(name, image, words):
    push, frame, view = image
    assert (frame_image(push, frame) if view is None else view_image(push, frame, view)) == name
    assert PushImage.named(name) == image
    assert image.later == (name == "push/push-1/12")
    assert described(name) == words


def test_rest_radiographs_are_named_by_their_views():
    assert [rest_image(view) for view in ("frontal", "lateral")] == [FRONTAL, LATERAL]
    assert [rest_view(image) for image in (FRONTAL, LATERAL)] == ["frontal", "lateral"]
    assert [described(image) for image in (FRONTAL, LATERAL)] == ["rest, frontal", "rest, lateral"]


@pytest.mark.parametrize(
    "name", ["rest/frontal", "push/", "push/a/0", "push/a/03", "push/a/b", "push/a/1/", "push/a/1/b/c", "push/a/99999"]
)
def test_other_names_are_of_no_pushs_image(name):
    assert PushImage.named(name) is None
