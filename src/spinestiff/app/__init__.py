"""The command line: one verb a step."""

INTERRUPTED, READER_LEFT = 130, 141
"""Exit statuses by the shell's convention: 128 and the number of SIGINT, of SIGPIPE."""
STOPPED = "stopped; results of finished steps are kept"
