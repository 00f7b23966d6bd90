"""The templates for SLURM (examples/cluster) on a SLURM of one node, with a quick runner in place of the steps."""

from __future__ import annotations

import os
import shutil
import socket
import sqlite3
import subprocess
import sys
import time
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

import pytest

from cohort_runners import QUICK, cohort_of
from spinestiff.cohort.asked import Cohort
from spinestiff.cohort.marker import Order
from spinestiff.cohort.supervisor import run_participants
from spinestiff.errors import SubjectError
from spinestiff.files import regular_files

ROOT = Path(__file__).parents[2]
TEMPLATES = ROOT / "examples" / "cluster"
TOOLS = ("sbatch", "squeue", "sinfo", "slurmctld", "slurmd")
LONGEST_S = 300.0
COMMAND = f"""#!{sys.executable}
from spinestiff.app import cohort
from spinestiff.cohort.marker import Order
cohort.order_of = lambda settings: Order(runner="{QUICK}", settings={{}}, version="1")
from spinestiff.app.start import main
main()
"""
CONFIGURATION = """
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
AuthType=auth/none
CredType=cred/none
SlurmUser={user}
SlurmdUser={user}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MpiDefault=none
SwitchType=switch/none
ReturnToService=2
NodeName={host} NodeAddr=127.0.0.1 CPUs={processors} RealMemory=4200 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""

needs_slurm = pytest.mark.skipif(not all(map(shutil.which, TOOLS)), reason=f"no SLURM here ({', '.join(TOOLS)})")


def free_ports(count: int) -> list[int]:
    with ExitStack() as held:
        sockets = [held.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """A SLURM of this machine alone, for as long as the test; skipped, with the reason, where it doesn't come up."""
    folder = tmp_path / "slurm"
    for name in ("", "state", "spool"):
        (folder / name).mkdir()
    host, processors = socket.gethostname().split(".")[0], min(2, os.cpu_count() or 1)
    user = subprocess.run(["id", "-un"], capture_output=True, text=True, check=True).stdout.strip()
    content = CONFIGURATION.format(host=host, ports=free_ports(2), user=user, folder=folder, processors=processors)
    (folder / "slurm.conf").write_text(content, encoding="utf-8")
    monkeypatch.setenv("SLURM_CONF", str(folder / "slurm.conf"))
    with ExitStack() as ends:
        for daemon in ("slurmctld", "slurmd"):
            with (folder / f"{daemon}.out").open("wb") as log:
                process = subprocess.Popen([daemon, "-D"], stdout=log, stderr=log, start_new_session=True)
            ends.callback(process.wait)
            ends.callback(process.terminate)
        latest = time.monotonic() + 60.0
        while "idle" not in (said := ran("sinfo", "-h", "-o", "%T")):
            if time.monotonic() > latest:
                logs = "; ".join(path.read_text(errors="replace")[-300:] for path in sorted(folder.glob("*.log")))
                pytest.skip(f"SLURM did not come up: sinfo says '{said}'; {logs}")
            time.sleep(0.2)
        yield folder
        subprocess.run(["scancel", "-u", user], check=False)
        ended(lambda: not ran("squeue", "-h"))


def ran(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return (done.stdout + done.stderr).strip()


def ended(sure) -> None:
    latest = time.monotonic() + LONGEST_S
    while not sure():
        assert time.monotonic() < latest
        time.sleep(0.2)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a cohort, in which ``spinestiff`` is the program with the quick runner."""
    folder = tmp_path / "place"
    (folder / "bin").mkdir(parents=True)
    (folder / "bin" / "spinestiff").write_text(COMMAND, encoding="utf-8")
    (folder / "bin" / "spinestiff").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}")
    names = cohort_of(folder / "study", 4, sub_003="refuse")
    here = Cohort(folder / "study", tmp_path / "here", names, Order(runner=QUICK, settings={}, version="1"))
    run_participants(here, 2)
    return folder, here


def published(target: Path, names: tuple[str, ...]) -> dict[str, bytes]:
    return {
        path.relative_to(target).as_posix(): path.read_bytes()
        for name in names
        if (target / name / "results").exists()
        for path in regular_files(target / name / "results", SubjectError)
    }


def tries(target: Path) -> list[tuple[str, str]]:
    connection = sqlite3.connect(target / "ledger.sqlite")
    found = connection.execute("SELECT participant, ended FROM tries ORDER BY participant, try").fetchall()
    connection.close()
    return found


EXPECTED = [("sub-001", "done"), ("sub-002", "done"), ("sub-003", "refused"), ("sub-004", "done")]


@needs_slurm
@pytest.mark.slow
def test_an_array_of_jobs_runs_a_cohort(slurm, place):
    folder, here = place
    script = (TEMPLATES / "slurm_array.sh").read_text(encoding="utf-8")
    (folder / "array.sh").write_text(script.replace("--array=1-1000", "--array=1-4"), encoding="utf-8")
    said = ran("sbatch", f"--chdir={folder}", str(folder / "array.sh"))
    assert said.startswith("Submitted batch job "), said
    ended(lambda: not ran("squeue", "-h"))
    logs = "\n".join(path.read_text(errors="replace") for path in sorted(folder.glob("slurm-*.out")))
    assert published(folder / "results", here.participants) == published(here.target, here.participants), logs
    assert "failed: sub-003: sub-003 can't be estimated" in logs
    group = subprocess.run(
        ["spinestiff", "cohort", "study", "results", "group"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert group.stdout.splitlines()[0] == "group: 3 done, 1 failed", group.stderr
    assert tries(folder / "results") == EXPECTED


@needs_slurm
@pytest.mark.slow
@pytest.mark.skipif(
    find_spec("dask_jobqueue") is None or find_spec("distributed") is None,
    reason="the extra [cluster] is not installed",
)
def test_workers_of_dask_jobqueue_run_a_cohort(slurm, place):
    folder, here = place
    script = (TEMPLATES / "slurm_dask.py").read_text(encoding="utf-8")
    assert "JOBS = 50" in script and 'MEMORY = "4GB"' in script
    script = script.replace("JOBS = 50", "JOBS = 1").replace("INTERFACE = None", 'INTERFACE = "lo"')
    (folder / "slurm_dask.py").write_text(script, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "slurm_dask.py", "study", "results"],
        cwd=folder, capture_output=True, text=True, timeout=LONGEST_S, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert done.stdout.splitlines()[0] == "participants: 3 run, 0 up to date, 1 failed", done.stderr
    assert published(folder / "results", here.participants) == published(here.target, here.participants)
    assert tries(folder / "results") == EXPECTED


def test_the_page_shows_the_array_script_as_it_was_tried():
    page = (ROOT / "docs" / "cohort.md").read_text(encoding="utf-8")
    assert (TEMPLATES / "slurm_array.sh").read_text(encoding="utf-8") in page
