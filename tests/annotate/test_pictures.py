"""What the page is sent of a radiograph: the whole no finer than asked, a part as it is, in the same greys."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.annotate.pictures import frame_of, picture
from spinestiff.errors import SubjectError


def greys(content, about):
    columns, rows = about["shown"]
    return np.frombuffer(content, "<u2").reshape(rows, columns).astype(float)


def test_a_picture_is_no_finer_than_asked_and_keeps_its_shape(session):
    radiograph = frame_of(session, "rest/frontal", 0)
    whole = greys(*picture(radiograph))
    assert whole.shape == radiograph.pixels.shape == (640, 448)
    content, about = picture(radiograph, 224, 9000 - 1000)
    assert about["shown"] == [224, 320] and about["part"] == [0, 0, 448, 640]
    assert (about["rows"], about["columns"]) == (640, 448)
    # Means of two by two pixels.
    np.testing.assert_allclose(greys(content, about), whole.reshape(320, 2, 224, 2).mean(axis=(1, 3)), atol=2.0)
    assert picture(radiograph, 448, 64)[1]["shown"] == [45, 64] and about["shape"] == [1.0, 1.0]


def test_a_part_has_the_greys_of_the_whole(session):
    radiograph = frame_of(session, "push/a", 2)
    whole = greys(*picture(radiograph))
    content, about = picture(radiograph, part="100,200,140,260")
    np.testing.assert_array_equal(greys(content, about), whole[200:260, 100:140])
    assert about["part"] == [100, 200, 140, 260] and about["shown"] == [40, 60]


@pytest.mark.parametrize(
    "part", ["1,2,3", "a,b,c,d", "-1,0,5,5", "0,0,0,5", "0,0,449,5", "5,5,4,9", "0,0,1e3,5", "0;0;5;5"]
)
def test_a_part_that_there_is_not_is_refused(served, part):
    from urllib.parse import quote

    status, answer = served.json("GET", f"/api/radiograph?image=rest/frontal&part={quote(part)}")
    assert status == 422 and "part" in answer["error"]


@pytest.mark.parametrize("size", ["0", "-5", "9999999", "x"])
def test_a_size_that_is_none_is_refused(served, size):
    assert served.json("GET", f"/api/radiograph?image=rest/frontal&wide={size}")[0] == 422


def test_frames_are_counted_from_0(session):
    with pytest.raises(SubjectError, match="push/a has no frame 3; wanted 0 to 2"):
        frame_of(session, "push/a", 3)
