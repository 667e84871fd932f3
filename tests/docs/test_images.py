"""The files in docker/ fit each other, the lock and the command line."""

import re
import shlex
from pathlib import Path

import pytest
import yaml

from pfdist.cli.program import line_of

ROOT = Path(__file__).parents[2]
IMAGE = (ROOT / "docker" / "Dockerfile").read_text()
CLAIM, RAYJOB = yaml.safe_load_all((ROOT / "docker" / "rayjob.yaml").read_text())
COMPOSED = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())["services"]
CLUSTER = RAYJOB["spec"]["rayClusterSpec"]
HEAD, WORKERS = CLUSTER["headGroupSpec"], CLUSTER["workerGroupSpecs"][0]
PODS = [group["template"]["spec"] for group in (HEAD, WORKERS)]


def test_every_file_that_the_image_copies_exists_and_is_sent_to_the_builder() -> None:
    ignore = (ROOT / "docker" / "Dockerfile.dockerignore").read_text().splitlines()
    lines = re.findall(r"^COPY (?!--from)(.+) \S+$", IMAGE, re.MULTILINE)
    sources = {source for line in lines for source in line.split()}
    assert "requirements/locked.txt" in sources
    assert {line.removeprefix("!") for line in ignore if line.startswith("!")} == sources
    assert all((ROOT / source).exists() for source in sources)


def test_the_pods_are_of_one_image_and_of_the_lock() -> None:
    images = {container["image"] for pod in PODS for container in pod["containers"]}
    assert images == {service["image"] for service in COMPOSED.values()} == {"pfdist"}
    lock = (ROOT / "requirements" / "locked.txt").read_text()
    assert f"\nray=={CLUSTER['rayVersion']} " in lock


def test_the_claim_holds_what_the_run_writes() -> None:
    [head] = PODS[0]["containers"]
    [volume], [mount] = PODS[0]["volumes"], head["volumeMounts"]
    assert volume["persistentVolumeClaim"]["claimName"] == CLAIM["metadata"]["name"]
    assert mount["name"] == volume["name"]
    folder = re.findall(r"^WORKDIR (.+)$", IMAGE, re.MULTILINE)[-1]
    assert mount["mountPath"] == f"{folder}/results"
    user = re.findall(r"^USER (\d+)$", IMAGE, re.MULTILINE)[-1]
    assert PODS[0]["securityContext"]["fsGroup"] == int(user) > 0


@pytest.mark.parametrize("command", [RAYJOB["spec"]["entrypoint"]])
def test_the_command_of_a_run_on_kubernetes_is_accepted(command: str) -> None:
    program, *words = shlex.split(command)
    line = line_of(words)
    assert program == "pfdist"
    assert line is not None
    assert line.options["address"] == "auto"
    assert (ROOT / line.arguments[0]).is_file()
