"""Messages of the command line as the page says them: no options, and no commands to be typed."""

from __future__ import annotations

import re

_PATH, _AGAIN = r"(?: '[^']*'| [^\s;,]*/[^\s;,]*)?", r"(?: again| --redo)*"
_FURTHER = rf"(?:(?:,? or|,? and) (?:run )?spinestiff \w+{_AGAIN})*"
_COMMAND = re.compile(rf"run spinestiff \w+{_PATH}{_AGAIN}(?: with --method weighed)?{_FURTHER}")
_SAID = (
    ("give --log-rate HZ", "give its entries a second"),
    ("; leave out --log-rate for this log", "; leave out its entries a second"),
    (", or, where the same radiographs were annotated again, --annotators", ""),
    ("name them as it does with --log-columns TIME,FORCE", "name them as it does"),
    ("give --log-columns TIME,FORCE", "give the names of both columns"),
    ("name them as it does with --log-columns FORCE", "name it as it does"),
    ("give --log-columns FORCE, or NUMBER,FORCE", "give the name of the column of force"),
    ("give --log-columns FORCE", "give the name of the column of force"),
    ("--log-columns names time first, then force", "name time first, then force"),
    ("--log-units", "the units"),
    ("; name it with --frontal or --lateral, or in --pushes", "; choose it below, or name it in the table of pushes"),
    ("say which is at rest with --", "choose below which is at rest, "),
    ("named by --", "chosen as the radiograph at rest, "),
    ("but --frontal names another", "but another was chosen"),
    ("but --lateral names another", "but another was chosen"),
    ("if it is at rest name it with --frontal, if it shows", "if it is at rest choose it below, if it shows"),
    ("if it is at rest name it with --lateral, if it shows", "if it is at rest choose it below, if it shows"),
    ("if it shows a push in --pushes", "if it shows a push mark it with the others of that push"),
    ("name it there or, if it is at rest, with --frontal", "name it there or, if it is at rest, choose it below"),
    ("if it shows a push, name it in --pushes", "if it shows a push, mark it with the others of that push"),
    ("a push; name it in --pushes", "a push; mark it with the others of that push"),
    ("name it with --frontal", "choose it below"),
    ("--pushes", "the table of pushes"),
    (
        "wanted object_mm, object_px and perhaps plane; or vertebra and width_mm",
        "not whole yet: wanted length and both ends of an object, or a vertebra and its width",
    ),
)


def page_words(words: str) -> str:
    """A message in one line, with what the page has in the place of commands and options."""
    for option, here in _SAID:
        words = words.replace(option, here)
    return " ".join(_COMMAND.sub("run it again", words).split())
