"""How long a person is at work from a hospital's files to the report on the workbench: clicks, keys, drags, seconds.

A subject (two radiographs at rest, one push or two, each of ``FRAMES`` frames, as a folder that is dropped) goes
through the page in a headless Chromium: the mouse is moved and pressed, keys are typed, and each is counted. Seconds
are those of the keystroke-level model (Card, Moran and Newell 1980), with the constants of ``annotation.py``; the time
to read a row or to find a value on paper is ours. What the annotation of a radiograph takes is not counted here: it is
the median of what ``annotation.py`` has counted last on synthetic radiographs of known corners, within
``TOLERANCE_MM``. What the machine does meanwhile (reading the files, some minutes of estimation) is nobody's time.

Lists and dialogs of the system can't be driven from a page: a choice from a list counts as two clicks and is made by
script, a dropped folder as a drag and the time to find it.

    python benchmarks/workbench_way.py [--write]
"""

from __future__ import annotations

import argparse
import datetime
import json
import shutil
import statistics
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from annotation import BUTTON_S, DRAG_S, KEY_S, LOOK_S, POINT_S

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from bench_client import Client
from bench_page import chosen, files, load, press
from chromium import Tab
from phantoms import phantom, sixteen_bit
from spinestiff.annotate.draft import DraftImage
from spinestiff.files import read_json, write_json
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.radiograph import write_radiographs
from spinestiff.loopback.serving import listening, server_of
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import write_annotation
from spinestiff.workbench.bench import open_bench
from spinestiff.workbench.door import access_of
from spinestiff.workbench.server import guarded_application

FRAMES = 5
PUSHES = (1, 2)
TOLERANCE_MM = 2.0
HOMING_S = 0.4
"""A hand from the mouse to the keys or back (Card, Moran and Newell 1980)."""
FIND_S = 10.0
"""To find a folder in a file manager, or a table in another program."""
SHAPE, PIXEL = (640, 448), 0.72 * 1500.0 / 1340.0
RESULTS = Path(__file__).parent / "results"


@dataclass
class Work:
    """What a part of the way takes.

    Attributes
    ----------
    clicks : those of lists included. ready : how many clicks and choices one gets ready for.
    homings : of a hand between mouse and keys. found : folders and tables. looked : values and rows that are read.
    """

    part: str
    clicks: int = 0
    keys: int = 0
    drags: int = 0
    homings: int = 0
    found: int = 0
    looked: int = 0
    ready: int = 0

    @property
    def seconds(self) -> float:
        told = self.ready * (BUTTON_S - POINT_S) + self.clicks * POINT_S + self.keys * KEY_S + self.drags * DRAG_S
        return told + self.homings * HOMING_S + self.found * FIND_S + self.looked * LOOK_S


class Hands:
    """Somebody's mouse and keys on the page, counted by part of the way."""

    def __init__(self, tab: Tab) -> None:
        self.tab, self.parts = tab, list[Work]()

    def part(self, name: str) -> Work:
        self.parts.append(Work(name))
        return self.parts[-1]

    def click(self, selector: str) -> None:
        """Move the mouse there and press it."""
        press(self.tab, selector)
        self.parts[-1].clicks += 1
        self.parts[-1].ready += 1

    def type(self, selector: str, text: str) -> None:
        """Look a value up, click into its field, type it, and take the mouse again."""
        self.click(selector)
        for letter in text:
            self.tab.press(letter)
        work = self.parts[-1]
        work.keys, work.homings, work.looked = work.keys + len(text), work.homings + 2, work.looked + 1

    def choose(self, selector: str, value: str) -> None:
        """Look a value up, open a list and click its entry."""
        chosen(self.tab, selector, value)
        work = self.parts[-1]
        work.clicks, work.ready, work.looked = work.clicks + 2, work.ready + 1, work.looked + 1

    def drop(self, paths: list[Path]) -> None:
        """Find a folder and drop it on the page."""
        self.tab.until("!!document.querySelector('#files')")
        files(self.tab, "#files", paths)
        work = self.parts[-1]
        work.drags, work.found = work.drags + 1, work.found + 1

    def paste(self, selector: str, column: list[str]) -> None:
        """Find a table, mark a column of it, copy it, click into a field and paste it."""
        work = self.parts[-1]
        work.found, work.drags, work.keys = work.found + 1, work.drags + 1, work.keys + 4
        self.click(selector)
        text = json.dumps("\n".join(column))
        self.tab.run(
            "(() => { const clipboardData = new DataTransfer();"
            f"clipboardData.setData('text', {text});"
            f"document.querySelector({json.dumps(selector)}).dispatchEvent("
            "new ClipboardEvent('paste', { clipboardData, bubbles: true, cancelable: true })); })()"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="store it in benchmarks/results/")
    given = parser.parse_args()
    marking = annotation_seconds(RESULTS / "annotation.json")
    rows = [whole_way(count, marking) for count in PUSHES]
    for row in rows:
        print(f"{row['pushes']} pushes: {row['page_s']:.0f} s on the page, {row['annotation_s']:.0f} s of annotation")
    settings = {
        "seconds": {"ready": BUTTON_S - POINT_S, "click": POINT_S, "key": KEY_S, "drag": DRAG_S, "homing": HOMING_S,
                    "find": FIND_S, "look": LOOK_S},
        "frames": FRAMES, "annotation_tolerance_mm": TOLERANCE_MM, "annotation_s_by_radiograph": marking,
    }  # fmt: skip
    if given.write:
        found = {"date": datetime.date.today().isoformat(), "settings": settings, "ways": rows}
        write_json(RESULTS / "workbench_way.json", found)


def annotation_seconds(path: Path) -> dict[str, float]:
    """Median seconds of the last run of ``annotation.py`` on synthetic radiographs, by the kind of radiograph."""
    last = max(read_json(path)["runs"].items(), key=lambda one: (one[0][:4].isdigit(), one[0]))[1]
    found: dict[str, list[float]] = {}
    for row in last["radiographs"]:
        if row["kind"] == "synthetic":
            (work,) = (one for one in row["work"] if one["tolerance_mm"] == TOLERANCE_MM)
            kind = row["name"].partition(", ")[2]
            found.setdefault("push" if kind.startswith("push/") else kind, []).append(work["seconds"])
    return {kind: round(statistics.median(seconds), 1) for kind, seconds in found.items()}


def whole_way(pushes: int, marking: dict[str, float]) -> dict[str, object]:
    """From the dropped files to the report, on the page of a server of its own."""
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        disc = write_disc(place / "disc", pushes)
        with served(place / "root") as client, Tab(place / "profile") as tab:
            tab.call("DOM.enable")
            load(tab, client.address)
            parts = way(Hands(tab), disc, pushes, place / "root" / "girl")
    page_s = sum(part.seconds for part in parts)
    annotation_s = marking["rest/frontal"] + marking["rest/lateral"] + pushes * marking["push"]
    return {
        "pushes": pushes,
        "parts": [{**asdict(part), "seconds": round(part.seconds, 1)} for part in parts],
        "page_s": round(page_s, 1),
        "annotation_s": round(annotation_s, 1),
        "person_s": round(page_s + annotation_s, 1),
    }


def way(hands: Hands, disc: list[Path], pushes: int, folder: Path) -> list[Work]:
    """What a person does; annotation is put into the folder instead of being made."""
    tab = hands.tab
    hands.part("files to subject")
    hands.click("a[href='#/new']")
    hands.drop(disc)
    tab.until("!!document.querySelector('#make')")
    hands.parts[-1].looked += len(disc)
    hands.type("#name", "girl")
    hands.click("#make")
    tab.until("!!document.querySelector('#f-age')")
    hands.part("values")
    hands.type("#f-age", "13")
    hands.choose("#f-sex", "female")
    hands.type("#f-height-cm", "157")
    for number in range(pushes):
        push = f"#f-pushes-{number}-"
        hands.choose(f"{push}-side", "right")
        for name, value in (("level", "8"), ("d21-mm", "400"), ("d31-mm", "200")):
            hands.type(f"{push}-{name}", value)
        hands.paste(f"{push}-forces-n-0-", [str(15 * frame) for frame in range(FRAMES)])
        for frame in range(1, FRAMES):
            hands.choose(f"{push}-roles-{frame}-", "validation" if frame == FRAMES - 1 else "training")
    tab.until("document.querySelector('.saved').innerText == 'Saved. Everything is filled in.'")
    hands.parts[-1].looked += 1
    hands.part("to the annotation and back")
    hands.click(".way a[href^='/annotate/']")
    tab.until("!!window.annotation && document.body.dataset.state == 'open'")
    for number in range(1, 2 + pushes):
        hands.click(f"#images li:nth-child({number + 1}) button")
    annotate(folder)
    hands.click("#back")
    tab.until("!!document.querySelector('#room')?.innerText.includes('Ready to run')")
    hands.part("run and results")
    hands.click(".card a.main")
    hands.click("#start-run")
    tab.until("!!document.querySelector('.live')")
    hands.parts[-1].looked += 1
    hands.click(".way a[href$='/results']")
    tab.until("document.querySelector('.way a[href$=\"/results\"]').getAttribute('aria-current') == 'page'")
    assert tab.complaints == [], tab.complaints
    return hands.parts


def pictures(pushes: int) -> dict[str, list[object]]:
    """Drawn radiographs by the name of their image, a frame each."""
    rest = {"rest/frontal": [phantom(bend=16.0)], "rest/lateral": [phantom(kind="lateral", bend=-20.0)]}
    bends = np.linspace(16.0, 10.0, FRAMES)
    return rest | {f"push/{number}": [phantom(bend=bend, seed=number) for bend in bends] for number in range(pushes)}


def write_disc(folder: Path, pushes: int) -> list[Path]:
    """The radiographs as files without names that tell anything."""
    folder.mkdir()
    paths = []
    for number, (image, frames) in enumerate(pictures(pushes).items()):
        view = (lateral_view if image == "rest/lateral" else frontal_view)(shape=SHAPE, pixel=PIXEL)
        pixels = np.stack([sixteen_bit(one.pixels) for one in frames])
        paths.append(folder / f"IM{number:04d}")
        write_radiographs(paths[-1], pixels if len(frames) > 1 else pixels[0], view)
    return paths


def annotate(folder: Path) -> None:
    """The marks that an annotator would make."""
    names = [push["id"] for push in read_json(folder / "subject.json")["pushes"]]
    shown = pictures(len(names))
    drawn = {"rest/frontal": shown["rest/frontal"][0], "rest/lateral": shown["rest/lateral"][0]}
    drawn |= {f"push/{name}": shown[f"push/{number}"][0] for number, name in enumerate(names)}
    whole = {name: DraftImage.model_validate({"vertebrae": one.named()}).whole() for name, one in drawn.items()}
    write_annotation(folder, Annotation(schema_version=1, images=whole))


@contextmanager
def served(root: Path) -> Iterator[Client]:
    """A workbench that starts no jobs."""
    bench = open_bench(root)
    with listening(0) as sock:
        port = sock.getsockname()[1]
        access = access_of(port, None, None, False)
        server = server_of(guarded_application(bench, access))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [sock]}, daemon=True)
        thread.start()
        yield Client(port, access.token, bench)
        server.should_exit = True
        thread.join(timeout=20)
    shutil.rmtree(root)


if __name__ == "__main__":
    main()
