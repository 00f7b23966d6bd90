"""The process of a job: it runs the command, keeps its log, gives signs of life and ends the command when asked to.

It is no child of the server, so that it goes on when that ends. The command's input stays open as long as this process
lives; where it dies, however, the command reads the end of it and ends, too (``app.job``).

A subject's folder may come from somebody else. Nothing in it is imported, nor read as settings of libraries, as Python,
Matplotlib and Numba do with the folder that they are started in: the command starts in an empty one.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from spinestiff.errors import SubjectError
from spinestiff.workbench.job_table import JobTable, State

COMMAND = (sys.executable, "-P", "-m", "spinestiff.app.job")
BEAT_S = 0.4
GRACE_S = 3.0
LARGEST_LOG = 4 * 2**20
"""Bytes."""
_OWN_WORDS = frozenset(
    {"rib", "push", "pushes", "frame", "rest", "subject", "tissue", "bending", "mesh", "fine", "coarse"}
)


def start_job(table: Path, job: str, folder: Path, arguments: list[str], log: Path) -> subprocess.Popen[bytes]:
    """Start the process of a job. Names of folders go to it by its input: its arguments are for everybody to see."""
    task = {"table": str(table), "job": job, "folder": str(folder), "arguments": arguments, "log": str(log)}
    flags: dict[str, Any] = {"start_new_session": True}
    if os.name == "nt":
        flags = {"creationflags": 0x00000208}  # CREATE_NEW_PROCESS_GROUP | DETACHED_PROCESS
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "spinestiff.workbench.job_process"],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=table.parent, **flags,
    )  # fmt: skip
    assert process.stdin is not None
    with contextlib.suppress(OSError):  # it ended at once: it will be found lost
        process.stdin.write(json.dumps(task).encode() + b"\n")
        process.stdin.close()
    # Waited for as long as the server lives: no zombie is left, and where the server ends first the process goes on.
    threading.Thread(target=process.wait, daemon=True).start()
    return process


def run_job(
    table: JobTable, job: str, folder: Path, arguments: list[str], log: Path, command: tuple[str, ...] = COMMAND
) -> State:
    """Run a command on a subject's folder, the first line of its input, to its end or until the table cancels it."""
    with tempfile.TemporaryDirectory(prefix="spinestiff-", ignore_cleanup_errors=True) as empty:
        return _run_job(table, job, folder, arguments, log, command, empty)


def _run_job(
    table: JobTable, job: str, folder: Path, arguments: list[str], log: Path, command: tuple[str, ...], empty: str
) -> State:
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "NO_COLOR": "1", "COLUMNS": "110", "TERM": "dumb"}
    process = subprocess.Popen(
        [*command, *arguments],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=empty,
        env={**environment, "PYTHONSAFEPATH": "1"}, start_new_session=os.name != "nt",
    )  # fmt: skip
    assert process.stdin is not None
    with contextlib.suppress(OSError):  # it ended at once
        process.stdin.write(os.fsencode(folder.absolute()) + b"\n")
        process.stdin.flush()
    reader = threading.Thread(target=_keep_log, args=(process, folder, log), daemon=True)
    reader.start()
    try:
        go_on = True
        while process.poll() is None:
            with contextlib.suppress(SubjectError):  # a table that is busy for once
                go_on = table.beat(job)
            if not go_on:
                end_group(process)
                break
            time.sleep(BEAT_S)
    finally:
        end_group(process)
    reader.join(timeout=5.0)
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    state: State = "cancelled" if not go_on else "done" if process.returncode == 0 else "failed"
    table.end(job, state, process.returncode)
    return state


def end_group(process: subprocess.Popen[bytes]) -> None:
    """End a process and all that it has started: asked first, killed after ``GRACE_S``."""
    if os.name == "nt":
        if process.poll() is None:
            subprocess.run(["taskkill", "/T", "/F", "/PID", str(process.pid)], capture_output=True, check=False)
        process.wait()
        return
    for number, wait in ((signal.SIGTERM, GRACE_S), (signal.SIGKILL, GRACE_S)):
        if process.poll() is not None and number == signal.SIGTERM:
            continue
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(wait)


def _keep_log(process: subprocess.Popen[bytes], folder: Path, log: Path) -> None:
    """Copy what the command says, without the folder's name: it may be a person's."""
    named = [re.escape(one) for one in sorted({str(folder), str(folder.resolve())}, key=len, reverse=True)]
    # What reads as a number of the program's, a vertebra or one of its words stands in what is said.
    named += [rf"(?<![\w.-]){re.escape(folder.name)}(?![\w-])"] if _may_name(folder.name) else []
    hidden = re.compile("|".join(named))
    assert process.stdout is not None
    written = 0
    with contextlib.ExitStack() as opened:
        file = None
        with contextlib.suppress(OSError):
            file = opened.enter_context(log.open("ab", buffering=0))
        # To its end, also where nothing can be written: a command whose output nobody takes waits for ever.
        for line in process.stdout:
            content = hidden.sub("subject", line.decode("utf-8", "replace")).encode()
            written += len(content)
            if file is not None and written < LARGEST_LOG:
                with contextlib.suppress(OSError):
                    file.write(content)


def _may_name(folder: str) -> bool:
    """Whether the name of a folder by itself may tell whose it is."""
    plain = folder.casefold()
    return len(folder) > 2 and plain not in _OWN_WORDS and not re.fullmatch(r"\d{1,3}([.,]\d{1,2})?|[tl]\d{1,2}", plain)


def main() -> None:
    """Run the job that standard input names."""
    task = json.loads(sys.stdin.buffer.readline())
    table = JobTable(Path(task["table"]))

    def stop(number: int, frame: object) -> None:
        raise SystemExit(1)

    signal.signal(signal.SIGTERM, stop)
    try:
        run_job(table, task["job"], Path(task["folder"]), list(task["arguments"]), Path(task["log"]))
    finally:
        table.end(task["job"], "lost", None)


if __name__ == "__main__":
    main()
