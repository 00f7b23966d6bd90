"""``python -m spinestiff``: the command line, where the installed program is not on the path."""

from spinestiff.app.start import main

main()
