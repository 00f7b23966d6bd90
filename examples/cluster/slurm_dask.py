"""A cohort on SLURM through Dask: so many jobs at a time, each a worker that ends before its job's time is up.

``python slurm_dask.py IN OUT [options of spinestiff cohort]`` in the environment that has spinestiff with the extra
[cluster], on a machine that may submit jobs and that they can reach. Fit the values below to your cluster first.
"""

from __future__ import annotations

import subprocess
import sys

from dask_jobqueue import SLURMCluster

JOBS = 50
"""Side by side, one processor and one subject each."""
PARTITION = None
ACCOUNT = None
INTERFACE = None
"""Network by which jobs reach this machine, e.g. "ib0"; None takes the usual one."""
MEMORY = "4GB"
WALLTIME = "04:00:00"
LIFETIME, STAGGER = "210m", "15m"
"""A worker ends after LIFETIME plus or minus STAGGER: before WALLTIME, and not all of them at once."""


def main() -> int:
    """Start the cluster, run the cohort on it, end the cluster."""
    cluster = SLURMCluster(
        queue=PARTITION,
        account=ACCOUNT,
        interface=INTERFACE,
        cores=1,
        processes=1,
        memory=MEMORY,
        walltime=WALLTIME,
        worker_extra_args=["--lifetime", LIFETIME, "--lifetime-stagger", STAGGER],
        job_script_prologue=["export SPINESTIFF_THREADS=1 OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1"],
    )
    # Not scale(JOBS), which replaces no worker that has ended.
    cluster.adapt(minimum_jobs=JOBS, maximum_jobs=JOBS)
    with cluster:
        given = ["spinestiff", "cohort", *sys.argv[1:], "--scheduler", cluster.scheduler_address]
        return subprocess.run(given, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
