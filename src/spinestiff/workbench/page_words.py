"""Messages of the command line as the page says them: no options, and no commands to be typed."""

from __future__ import annotations

import re

_COMMAND = re.compile(r"run spinestiff \w+(?: again| --redo)*(?: with --method weighed)?")
_OPTIONS = (
    (", or, if the log has no times but a steady rate, give --log-rate HZ", ""),
    (", or give --log-rate HZ", ""),
    (", or, where the same radiographs were annotated again, --annotators", ""),
    ("name them as it does with --log-columns TIME,FORCE", "name them as it does"),
    ("give --log-columns TIME,FORCE", "give the names of both columns"),
    ("--log-units", "the units"),
)


def page_words(words: str) -> str:
    """A message in one line, with what the page has in the place of commands and options."""
    for option, here in _OPTIONS:
        words = words.replace(option, here)
    return " ".join(_COMMAND.sub("run it again", words).split())
