"""Names of a subject's images, as its annotation has them: spelt, read and put in words.

    rest/frontal, rest/lateral   the rest radiographs
    push/<id>                    a push, and its first frame
    push/<id>/<frame>            a later frame of a push
    push/<id>/<frame>/<view>     a frame's radiograph from another side

Frames are counted from 0.
"""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

from spinestiff.words import push_named

REST, PUSH = "rest/", "push/"
"""What names begin with, of rest radiographs and of a push's images."""
FRONTAL, LATERAL = f"{REST}frontal", f"{REST}lateral"
_FRAME = r"[1-9][0-9]{0,3}"
_OF_PUSH = re.compile(rf"{PUSH}([^/]+)(?:/({_FRAME})|/(0|{_FRAME})/([^/]+))?")


class PushImage(NamedTuple):
    """What the name of a push's image says.

    Attributes
    ----------
    push, view : ids; the view is None in the push's own radiographs.
    frame : counted from 0.
    """

    push: str
    frame: int
    view: str | None

    @classmethod
    def named(cls, name: str) -> PushImage | None:
        """The image of that name; None where it is no name of a push's image."""
        found = _OF_PUSH.fullmatch(name)
        if found is None:
            return None
        push, later, frame, view = found.groups()
        return cls(push, int(later or frame or 0), view)

    @property
    def later(self) -> bool:
        """Whether it is one of the push's own radiographs, after the first."""
        return self.view is None and self.frame > 0


def rest_image(view: str) -> str:
    """Name of the "frontal" or "lateral" rest radiograph."""
    return f"{REST}{view}"


def frame_image(push: str, frame: int = 0) -> str:
    """Name of a push's frame; the first one's is that of the push."""
    return f"{PUSH}{push}" if frame == 0 else f"{PUSH}{push}/{frame}"


def view_image(push: str, frame: int, view: str) -> str:
    """Name of a frame's radiograph from another side."""
    return f"{PUSH}{push}/{frame}/{view}"


def rest_view(image: str) -> Literal["frontal", "lateral"]:
    """The view of a rest radiograph."""
    return "lateral" if image == LATERAL else "frontal"


def described(image: str) -> str:
    """An image in words: "rest, frontal", "push left-5", "push left-5, frame 2, view side"."""
    found = PushImage.named(image)
    if found is None:
        return f"rest, {image.removeprefix(REST)}"
    view = "" if found.view is None else f", view {found.view}"
    return push_named(found.push) + (f", frame {found.frame}" if view or found.later else "") + view
