"""What a job may do: commands of this program by name, and their options, each with all that it may be."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from spinestiff.errors import OptionError
from spinestiff.study.planning.wish import COMFORT_N, EXPOSURES, LEAST_LIMIT_N, MOST_EXPOSURES, RIBS
from spinestiff.subject.records import GAUGE_LIMIT_N


@dataclass(frozen=True)
class Choice:
    """An option that is one of some words, the first unless another is chosen; ``words`` what each means."""

    title: str
    words: Mapping[str, str]

    def argument(self, name: str, value: Any) -> str:
        """As the command line takes it. Raises OptionError."""
        if not isinstance(value, str) or value not in self.words:
            raise OptionError(f"{name}: wanted one of {', '.join(self.words)}")
        return f"--{name}={value}"


@dataclass(frozen=True)
class Number:
    """An option that is a number within limits."""

    title: str
    low: float
    high: float
    usual: float
    unit: str = ""
    whole: bool = False

    def argument(self, name: str, value: Any) -> str:
        """As the command line takes it. Raises OptionError."""
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not self.low <= value <= self.high:
            raise OptionError(f"{name}: wanted {self.low:g} to {self.high:g} {self.unit}".rstrip())
        if self.whole and value != int(value):
            raise OptionError(f"{name}: wanted a whole number")
        return f"--{name}={int(value) if self.whole else float(value)!r}"


@dataclass(frozen=True)
class Switch:
    """An option that is there or not."""

    title: str

    def argument(self, name: str, value: Any) -> str:
        """As the command line takes it, "" where it is off. Raises OptionError."""
        if not isinstance(value, bool):
            raise OptionError(f"{name}: wanted true or false")
        return f"--{name}" if value else ""


@dataclass(frozen=True)
class Text:
    """An option that is a text of some form, given as an ``example``; empty: left out.

    ``fields`` : the parts that commas join, by their words: a unit, or words to choose from with "|" between them.
    ``only`` : the value of another option with which it is asked, and needed; None: it may always be given.
    """

    title: str
    pattern: str
    example: str
    help: str = ""
    fields: Mapping[str, str] = field(default_factory=dict)
    only: tuple[str, str] | None = None

    def argument(self, name: str, value: Any) -> str:
        """As the command line takes it, "" where it is left out. Raises OptionError."""
        tidy = re.sub(r"\s*,\s*", ",", value.strip()) if isinstance(value, str) else None
        if tidy is None or (tidy and not re.fullmatch(self.pattern, tidy)):
            raise OptionError(f"{self.title}: found {str(value)[:40]!r}, wanted e.g. {self.example}")
        return f"--{name}={tidy}" if tidy else ""


Option = Choice | Number | Switch | Text


@dataclass(frozen=True)
class Verb:
    """A command that a job runs on a subject."""

    title: str
    about: str
    options: Mapping[str, Option] = field(default_factory=dict)
    minutes: str = ""

    def arguments(self, verb: str, given: Mapping[str, Any]) -> list[str]:
        """The command line in the subject's folder. Raises OptionError for options that the command has not, and for
        want of one that it needs."""
        found = [verb, "."]
        for name, value in given.items():
            if name not in self.options:
                raise OptionError("the request: an option that this step has not")
            found.append(self.options[name].argument(name, value))
        for name, option in self.options.items():
            asked = isinstance(option, Text) and option.only is not None and given.get(option.only[0]) == option.only[1]
            if asked and not str(given.get(name) or "").strip():
                raise OptionError(f"{option.title}: wanted e.g. {option.example}")  # type: ignore[union-attr]
        return [one for one in found if one]

    def record(self) -> dict[str, Any]:
        """As JSON, for a form."""
        options = {
            name: {"kind": type(option).__name__.lower(), **{key: _plain(value) for key, value in vars(option).items()}}
            for name, option in self.options.items()
        }
        return {"title": self.title, "about": self.about, "minutes": self.minutes, "options": options}


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else value


_RIB = r"(?:[1-9]|1[0-2])(?:\.\d)?"
MESH = Choice("Mesh", {"fine": "fine: the result", "coarse": "coarse: a quick look, about a minute"})
REFIT_MESH = Choice("Mesh of the refits", {"coarse": "coarse: some minutes", "fine": "fine: long"})
REDO = Switch("Do everything again, also what has not changed")
VERBS: Mapping[str, Verb] = {
    "run": Verb(
        "Estimate the stiffness",
        "Follows the corners through the pushes, shapes the torso, estimates, checks and writes the report. Only what "
        "changed is done again.",
        {"mesh": MESH, "redo": REDO},
        "four minutes for a usual subject",
    ),
    "plan": Verb(
        "Plan the next push",
        "Which side, rib and force would narrow the result most. It writes a sheet to print, and the report anew.",
        {
            "target": Choice(
                "What should become more certain",
                {
                    "bending": "bending of the spine",
                    "tissue": "soft tissue",
                    "rotation": "axial rotation, where it is estimated",
                    "cobb": "the Cobb angle under another push",
                },
            ),
            "under": Text(
                "Under which push",
                rf"(left|right),{_RIB},\d{{1,3}}(\.\d)?",
                "right,8,60",
                fields={"from the": "right|left", "at rib": "", "with": "N"},
                only=("target", "cobb"),
            ),
            "side": Choice("Side to push", {"both": "left or right", "left": "left", "right": "right"}),
            "ribs": Text("Ribs to push", rf"{_RIB}(,{_RIB}){{0,20}}", "5,7,9", f"Empty: {RIBS[0]:g} to {RIBS[-1]:g}."),
            "views": Choice(
                "Radiographs of a pushed state",
                {"both": "whichever narrows more", "frontal": "frontal", "frontal+lateral": "frontal and lateral"},
            ),
            "limit": Number("Largest force", LEAST_LIMIT_N, GAUGE_LIMIT_N, COMFORT_N, "N"),
            "exposures": Number("Further radiographs at most", 2, MOST_EXPOSURES, EXPOSURES, "", True),
        },
        "a minute or two",
    ),
    "sensitivity": Verb(
        "If something had been otherwise",
        "The estimate again with force, pushed rib, corners, mesh and geometry changed, one at a time.",
        {"mesh": REFIT_MESH},
        "some minutes",
    ),
    "parameters": Verb(
        "Which parameters at all",
        "What six stiffness parameters do to this spine, and which of them the radiographs tell of.",
        {"mesh": REFIT_MESH},
        "some minutes",
    ),
    "report": Verb("Write the report", "The report alone, from what was found last.", {"redo": REDO}, "some seconds"),
    "view": Verb("Make the 3D view", "The torso from rest to full load, to turn around.", {}, "some seconds"),
    "frames": Verb(
        "Judge the frames",
        "Quality and support motion of every frame, and which to estimate from.",
        {"write": Switch("Put what it proposes into the values")},
        "some seconds",
    ),
}


def command_of(verb: str, given: Mapping[str, Any]) -> list[str]:
    """The command line of a job, in its subject's folder.

    Raises
    ------
    OptionError : no such verb or option, or a value that the option does not take.
    """
    if verb not in VERBS:
        raise OptionError("the request: no such step")
    return VERBS[verb].arguments(verb, given)
