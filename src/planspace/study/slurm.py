"""A job array for Slurm that runs the shards of a study."""

import math
import shlex
from pathlib import Path

from planspace.errors import check_setting
from planspace.study.design import Study
from planspace.study.eta import Timings, time_left
from planspace.study.shards import divide
from planspace.study.summary import folder_of_study

CORES = 4
"""Cores of a task, unless the user gives another number."""
MARGIN = 2
"""The time limit of a task is this many times the estimated time, rounded up to hours."""

SCRIPT = """\
#!/bin/bash
# {command} in {count} shards.
# The longest shard takes about {minutes} min on {cores} cores, guessed from the study's settings.
#
# Submit the shards, and then the merge, which waits until all of them are finished:
#   job=$(sbatch --parsable THIS_SCRIPT)
#   sbatch --dependency=afterok:$job --array=1 --cpus-per-task=1 THIS_SCRIPT merge
# If a shard fails or reaches its time limit, submit the shards again: finished units are kept.
#
#SBATCH --job-name={name}
#SBATCH --output={name}-%A-%a.log
#SBATCH --array=1-{count}
#SBATCH --nodes=1
#SBATCH --ntasks=1
#
# EDIT these lines for your cluster. All nodes need CPUs with the same vector instructions.
#SBATCH --cpus-per-task={cores}
#SBATCH --time={hours}:00:00
#SBATCH --mem-per-cpu=2G
##SBATCH --partition=NAME
##SBATCH --constraint=FEATURE

# EDIT: activate the environment in which planspace is installed, for example
# source ~/venv/bin/activate

if [ "${{1:-}}" = merge ]; then
    exec {command} --merge {folders}
fi
exec {command} --workers "$SLURM_CPUS_PER_TASK" --shard "$SLURM_ARRAY_TASK_ID/{count}"
"""


def slurm_script(study: Study, count: int, out: Path, workers: int = 0) -> str:
    """Return the script of a Slurm job array that runs a study in shards.

    Args:
        study: the study.
        count: number of shards.
        out: the folder of the studies.
        workers: cores of a task; 0 leaves the number to the user.

    Raises:
        UsageError: `count` is less than 1, or the study has fewer units of policies.
    """
    check_setting("--slurm", count, count >= 1, "at least 1")
    cores = workers or CORES
    seconds = max(time_left(part.units, {}, Timings(), cores) for part in divide(study, count))
    command = f"{study.command} --out {shlex.quote(str(out))}"
    name = folder_of_study(study, out).name
    return SCRIPT.format(
        command=command,
        count=count,
        cores=cores,
        name=name,
        minutes=math.ceil(seconds / 60),
        hours=math.ceil(MARGIN * seconds / 3600),
        folders=f"{shlex.quote(str(out))}/{shlex.quote(name)}-shard-*-of-{count}",
    )
