#!/bin/bash
#SBATCH --array=1-1000
#SBATCH --cpus-per-task=1
#SBATCH --mem=4G
#SBATCH --time=04:00:00
export SPINESTIFF_THREADS=1 OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1
spinestiff cohort study results participant --index "$SLURM_ARRAY_TASK_ID" --minutes 115 --memory 3.8
