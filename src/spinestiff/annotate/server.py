"""The page's server: FastAPI on 127.0.0.1, for as long as somebody annotates."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from typing import Any

import numpy as np
from fastapi import FastAPI, Response

from spinestiff import __version__
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.annotate.exchange import Form, exported, imported
from spinestiff.annotate.following import Follower, following_record
from spinestiff.annotate.pictures import MOST_SIDE, frame_of, picture
from spinestiff.annotate.requests import Import, Judge, Propose, Save, Track, judged_record
from spinestiff.annotate.session import AnnotationSession
from spinestiff.arrays import Floats
from spinestiff.imaging.proposal import propose_boxes
from spinestiff.imaging.tracking.quality import DOUBTED_QUALITY
from spinestiff.loopback.asking import Body, bare_application, sent
from spinestiff.loopback.guard import Access, Guard, own_origins
from spinestiff.loopback.serving import LOOPBACK, listening, run_server, shipped
from spinestiff.subject.gaps import open_frames
from spinestiff.subject.image_names import PushImage, described, rest_view
from spinestiff.words import sentence

PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/annotate.js": ("annotate.js", "text/javascript; charset=utf-8"),
    "/annotate.css": ("annotate.css", "text/css; charset=utf-8"),
}


def application(session: AnnotationSession) -> FastAPI:
    """The page and its data, still unguarded: what ``serve`` puts behind ``Guard``."""
    app = bare_application()
    for path in PAGE:
        app.add_api_route(path, page_of(path), methods=["GET"])
    follower = Follower(session)

    @app.get("/api/session")
    def everything() -> dict[str, Any]:
        # Marks and their revision: a save of another window in between would be overwritten by this one's next.
        with session.lock:
            session.reload()
            return session_record(session)

    @app.get("/api/radiograph")
    def radiograph(
        image: str, frame: int = 0, wide: int = MOST_SIDE, tall: int = MOST_SIDE, part: str = ""
    ) -> Response:
        content, about = picture(frame_of(session, image, frame), wide, tall, part)
        return Response(content, media_type="application/octet-stream", headers={"x-radiograph": json.dumps(about)})

    @app.put("/api/annotation")
    def save(body: Body) -> dict[str, Any]:
        asked = sent(body, Save)
        revision = session.save(asked.draft, asked.revision)
        return {"revision": revision, "missing": session.judge.missing(session.marks)}

    @app.post("/api/judge")
    def judge(body: Body) -> dict[str, Any]:
        asked = sent(body, Judge)
        return judged_record(session.judge.told(asked.image, {**session.marks, asked.image: asked.marks}))

    @app.post("/api/propose")
    def propose(body: Body) -> dict[str, Any]:
        asked = sent(body, Propose)
        shown = frame_of(session, asked.image, asked.frame)
        names = VERTEBRAE[VERTEBRAE.index(asked.upper) : VERTEBRAE.index(asked.lower) + 1]
        kept: dict[str, Floats] = {name: np.array(quad) for name, quad in asked.kept.items()}
        points = np.array(asked.points, dtype=float).reshape(-1, 2)
        boxes = propose_boxes(shown, points, names, kept, session.leans(asked.image))
        return {"vertebrae": {name: quad.round(2).tolist() for name, quad in zip(names, boxes)}}

    @app.post("/api/import")
    def read_file(body: Body) -> dict[str, Any]:
        asked = sent(body, Import)
        marks, said = imported(session, asked.name, asked.text, asked.image)
        return {"marks": {name: image.model_dump(mode="json") for name, image in marks.items()}, "warnings": said}

    @app.get("/api/export")
    def write_file(form: Form) -> Response:
        return Response(exported(session, form), media_type="application/octet-stream")

    @app.get("/api/track")
    def tracking(image: str) -> dict[str, Any]:
        return following_record(session, image, follower.state(image))

    @app.post("/api/track")
    def track(body: Body) -> dict[str, Any]:
        asked = sent(body, Track)
        return following_record(session, asked.image, follower.start(asked.image))

    return app


def session_record(session: AnnotationSession) -> dict[str, Any]:
    """What the page starts from, as JSON; nothing of a DICOM file is in it."""
    record = session.subject.record
    images: list[dict[str, Any]] = []
    for name in session.images:
        of_push, one = PushImage.named(name), dict[str, Any]()
        if of_push is None:
            one = {"kind": rest_view(name), "forces": [None], "roles": [None]}
        else:
            push = session.subject.push(of_push.push)
            unknown = open_frames(session.subject.gaps, record.pushes.index(push))
            forces = [None if i in unknown else force for i, force in enumerate(push.forces_n)]
            if name in session.views:
                frame, view = session.subject.view(name)
                one = {"kind": view.kind, "forces": forces[frame : frame + 1], "roles": push.roles[frame : frame + 1]}
            else:
                one = {"kind": "frontal", "forces": forces, "roles": push.roles}
        images.append({"name": name, "title": sentence(described(name)), **one})
    marks = {name: image.model_dump(mode="json") for name, image in session.marks.items()}
    return {
        "version": __version__,
        "subject": record.id,
        "vertebrae": VERTEBRAE,
        "lowest_quality": DOUBTED_QUALITY,
        "images": images,
        "marks": marks,
        "revision": session.revision,
        "missing": session.judge.missing(session.marks),
    }


def serve(session: AnnotationSession, port: int, ready: Callable[[str], None]) -> None:
    """Serve until interrupted.

    Parameters
    ----------
    port : 0 = any that is free.
    ready : called with the page's address, token included, once requests are taken.

    Raises
    ------
    SubjectError : the port is taken.
    """
    with listening(port) as sock:
        guarded, address = guarded_application(session, sock.getsockname()[1])
        ready(address)
        run_server(guarded, sock)


def guarded_application(session: AnnotationSession, port: int) -> tuple[Guard, str]:
    """The application behind its guard with a fresh token, and the address that opens it.

    The token stands in the fragment, which a browser sends to nobody.
    """
    token = secrets.token_urlsafe(32)
    return Guard(application(session), Access(token, own_origins(port))), f"http://{LOOPBACK}:{port}/#{token}"


def page_of(path: str) -> Callable[[], Response]:
    """What answers a request for a part of the page."""
    name, kind = PAGE[path]
    content = shipped("spinestiff.annotate", name)

    def page() -> Response:
        return Response(content(), media_type=kind)

    return page
