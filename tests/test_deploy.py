"""The templates in `deploy/` are what their schedulers read, and their commands are ours."""

import json
import shlex
import subprocess
from collections.abc import Callable

import pytest
import yaml

from multilight.datagen.cli import COMMANDS
from multilight.datagen.commands.arguments import parsed
from multilight.datagen.commands.dataset import Dataset
from multilight.datagen.production.shards import Shard, parse_shard
from tests import ROOT

FOLDER = ROOT / "deploy"


def slurm() -> list[str]:
    subprocess.run(["bash", "-n", FOLDER / "slurm.sh"], check=True)
    lines = (FOLDER / "slurm.sh").read_text().splitlines()
    given = [line.partition(" ")[2].split("  ")[0].split() for line in lines if line.startswith("#SBATCH")]
    assert [word for line in given for word in line if not word.startswith("--")] == []
    return next(shlex.split(line)[1:] for line in lines if line.startswith("exec "))


def kubernetes() -> list[str]:
    job = yaml.safe_load((FOLDER / "kubernetes.yaml").read_text())
    (container,) = job["spec"]["template"]["spec"]["containers"]
    (mount,) = container["volumeMounts"]
    assert [mount["name"]] == [volume["name"] for volume in job["spec"]["template"]["spec"]["volumes"]]
    assert job["spec"]["completionMode"] == "Indexed"
    assert job["spec"]["completions"] == 20
    command: list[str] = container["command"]
    return command


def aws_batch() -> list[str]:
    properties = json.loads((FOLDER / "aws-batch.json").read_text())["containerProperties"]
    (mount,) = properties["mountPoints"]
    assert [mount["sourceVolume"]] == [volume["name"] for volume in properties["volumes"]]
    command: list[str] = properties["command"]
    return command


@pytest.mark.parametrize(
    ("template", "environment"),
    [
        (slurm, {"SLURM_ARRAY_TASK_ID": "7", "SLURM_ARRAY_TASK_MIN": "0", "SLURM_ARRAY_TASK_COUNT": "20"}),
        (kubernetes, {"JOB_COMPLETION_INDEX": "7"}),
        (aws_batch, {"AWS_BATCH_JOB_ARRAY_INDEX": "7", "AWS_BATCH_JOB_ARRAY_SIZE": "20"}),
    ],
)  # fmt: skip
def test_templates_are_read_and_say_what_part(template: Callable[[], list[str]], environment: dict[str, str]) -> None:
    program, *words = template()
    assert program == "multilight"
    command = parsed(words, COMMANDS)
    assert isinstance(command, Dataset)
    assert parse_shard(command.shard or "", environment) == Shard(7, 20)
    assert str(command.out).startswith("/shared/")
