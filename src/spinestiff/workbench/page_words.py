"""Messages of the command line as the page says them: no options, and no commands to be typed."""

from __future__ import annotations

import re

_COMMAND = re.compile(r"run spinestiff \w+(?: again| --redo)*(?: with --method weighed)?")
_OPTIONS = (
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
)


def page_words(words: str) -> str:
    """A message in one line, with what the page has in the place of commands and options."""
    for option, here in _OPTIONS:
        words = words.replace(option, here)
    return " ".join(_COMMAND.sub("run it again", words).split())
