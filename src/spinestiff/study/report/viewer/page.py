"""The 3D viewer as a component of a page, and as a page of its own: one file that asks nothing of any other.

The component is what ``web/viewer`` builds, with the scene beside it as a block of data. A page's policy allows this
one script, by its hash, and no request at all.
"""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from spinestiff import __version__
from spinestiff.mechanics.supports import SupportKind
from spinestiff.study.report.viewer.packing import scene_record
from spinestiff.study.report.viewer.scene import MODELS, PushScene, Scene

MODEL_TITLES = {"fit": "Estimated stiffness", "default": "Default stiffness"}
ROLE_TITLES = {"training": "training", "validation": "held out", "unused": "not used"}


@dataclass(frozen=True)
class Component:
    """What a template needs to show a scene.

    Attributes
    ----------
    title, note : in words.
    data : the scene, safe inside a script element of type application/json; not to be escaped again.
    script, style : the component's own, the same for every scene; neither to be escaped.
    pushes : (id, words) of each. models : (name, words) of those that any push has.
    most_n : the largest force, N.
    rows : the table of frames, cells as people read them.
    further, pedicles, markers : some frame shows vertebrae from another side, pedicles, markers on the skin.
    """

    title: str
    note: str
    data: str
    script: str
    style: str
    pushes: tuple[tuple[str, str], ...]
    models: tuple[tuple[str, str], ...]
    most_n: float
    rows: tuple[tuple[str, ...], ...]
    further: bool
    pedicles: bool
    markers: bool


def component(scene: Scene) -> Component:
    """A scene ready for ``viewer/component.html.j2``."""
    known = [name for name in MODELS if any(name in push.models for push in scene.pushes)]
    beside = [frame.beside for push in scene.pushes for frame in push.frames]
    return Component(
        scene.title,
        scene.note,
        _data(scene_record(scene)),
        _shipped("viewer.js"),
        _shipped("viewer.css"),
        tuple((push.push, _push_words(push)) for push in scene.pushes),
        tuple((name, MODEL_TITLES[name]) for name in known),
        max((frame.force_n for push in scene.pushes for frame in push.frames), default=0.0),
        tuple(row for push in scene.pushes for row in _rows(push)),
        any(push.further for push in scene.pushes),
        any(one.pedicles or any(view.pedicles for view in one.outlines.values()) for one in beside),
        any(one.markers for one in beside),
    )


def view_page(scene: Scene) -> str:
    """A page with the scene alone."""
    shown = component(scene)
    policy = (
        f"default-src 'none'; script-src {source_hash(shown.script)}; style-src {source_hash(shown.style)}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    environment = page_environment()
    return environment.get_template("viewer/view.html.j2").render(scene=shown, policy=policy, version=__version__)


def page_environment(*folders: Path) -> Environment:
    """The templates of pages, and of further folders, everything escaped that is not marked as safe."""
    return Environment(
        loader=FileSystemLoader([Path(__file__).parent.parent, *folders]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def source_hash(text: str) -> str:
    """What a content security policy calls an inline script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def script_hash() -> str:
    """``source_hash`` of the component's script."""
    return source_hash(_shipped("viewer.js"))


@lru_cache
def _shipped(name: str) -> str:
    # Newlines as a browser sees them: the hash is of that text.
    return (files("spinestiff.study.report.viewer") / name).read_text(encoding="utf-8").replace("\r\n", "\n")


def _data(record: dict[str, Any]) -> str:
    """JSON that no text in it can end the element around."""
    text = json.dumps(record, allow_nan=False, ensure_ascii=True, separators=(",", ":"), sort_keys=True)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _push_words(push: PushScene) -> str:
    most = max(frame.force_n for frame in push.frames)
    return f"{push.push}: {most:g} N from the {push.side} at rib {push.level:g}"


def _rows(push: PushScene) -> list[tuple[str, ...]]:
    """Push, frame, force, use, RMSE of each model, reactions of the first one at shoulder and pelvis, Cobb angle."""
    best = next(name for name in MODELS if name in push.models)
    steps = {step.frame: step for step in push.models[best] if step.frame is not None}
    rows = []
    for frame in push.frames:
        errors = [f"{frame.rmse_mm[name]:.1f}" if name in frame.rmse_mm else "–" for name in MODELS]
        held = {}
        for i, support in enumerate(push.supports):
            step = steps.get(frame.frame)
            if step is not None and support.kind in (SupportKind.HELD, SupportKind.SHOULDER):
                held[support.kind] = _sideways(float(step.reactions[i, 0]))
        rows.append(
            (
                push.push,
                str(frame.frame),
                f"{frame.force_n:g}",
                ROLE_TITLES.get(frame.role, frame.role),
                *errors,
                held.get(SupportKind.SHOULDER, "–"),
                held.get(SupportKind.HELD, "–"),
                frame.cobb or "–",
            )
        )
    return rows


def _sideways(force_n: float) -> str:
    size = f"{abs(force_n):.1f}"
    return "0" if size == "0.0" else f"{size} to the {'left' if force_n > 0.0 else 'right'}"
