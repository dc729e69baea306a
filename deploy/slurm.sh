#!/bin/bash
# One dataset by an array of Slurm jobs: sbatch deploy/slurm.sh. Submitted again, it goes on with what is missing.
#SBATCH --job-name=multilight
#SBATCH --array=0-19                  # so many machines
#SBATCH --nodes=1 --ntasks=1
#SBATCH --cpus-per-task=32
#SBATCH --mem=64G
#SBATCH --time=24:00:00
#SBATCH --signal=B:TERM@60            # stops cleanly a minute before its time is up
#SBATCH --requeue                     # begins again where it was pre-empted or its machine died
#SBATCH --open-mode=append
#SBATCH --output=multilight-%A_%a.log

# A folder that all machines share, and a configuration in it.
exec multilight dataset --out /shared/set --config /shared/mine.toml --shard auto
