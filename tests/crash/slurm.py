"""A Slurm cluster of nodes on this machine, with daemons, keys and folders of its own."""

import getpass
import os
import secrets
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from crash.runs import end, family, until

START_SECONDS, END_SECONDS = 60.0, 600.0
SCRIPTS = Path(__file__).parents[2] / "jobs" / "slurm"
# One machine plays all nodes (`slurmd -N`). Control groups stay as they are. A job of the partition
# "urgent" takes the nodes of the other jobs, which are then requeued.
CONFIGURATION = """
ClusterName=test
FirstJobId={first}
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SlurmdParameters=config_overrides
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,bf_interval=1
PartitionName=usual Nodes=ALL Default=YES PriorityTier=1
PartitionName=urgent Nodes=ALL PriorityTier=2
"""


class Slurm:
    """A cluster at work.

    Attributes
    ----------
    environment : dict of str
        With which Slurm's commands reach this cluster, and no other.
    """

    def __init__(self, folder: Path, nodes: int) -> None:
        self._folder, self._nodes = folder, [f"n{number}" for number in range(nodes)]
        self._daemons: list[subprocess.Popen[bytes]] = []
        self._let_go: set[str] = set()  # requeues
        host, ports = socket.gethostname(), _free_ports(nodes + 1)
        facts = {"host": host, "port": ports[0], "folder": folder, "user": getpass.getuser()}
        # The port of a job's Ray cluster follows from its number; other tests may run beside this.
        text = CONFIGURATION.format(**facts, first=1 + secrets.randbelow(9000))
        for name, port in zip(self._nodes, ports[1:], strict=True):
            (folder / name).mkdir()
            text += f"NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port}"
            text += " CPUs=2 RealMemory=4000\n"
        configuration, key = folder / "slurm.conf", folder / "munge.key"
        configuration.write_text(text)
        (folder / "state").mkdir()
        key.touch(0o600)
        key.write_bytes(secrets.token_bytes(64))
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("SLURM")}
        self.environment |= {"PFDIST_VENV": sys.prefix, "SLURM_CONF": str(configuration)}

    def start(self) -> None:
        """Start all daemons, and wait until the nodes are idle."""
        (folder := self._folder).chmod(0o711)  # munged wants that others reach its socket
        own = [f"--{name}-file={folder}/munge.{name}" for name in ("key", "pid", "log", "seed")]
        self._start("munged", "--foreground", f"--socket={folder}/munge.socket", *own)
        until((folder / "munge.socket").exists, START_SECONDS)
        self._start("slurmctld", "-D", "-i")
        for name in self._nodes:
            self._start("slurmd", "-D", "-N", name)
        count = str(len(self._nodes))
        until(lambda: self.said("sinfo", "-h", "-t", "idle", "-o", "%D") == count, START_SECONDS)

    def _start(self, *command: str) -> None:
        with (self._folder / f"{command[0]}.out").open("ab") as out:
            daemon = subprocess.Popen(command, stdout=out, stderr=out, env=self.environment)
        self._daemons.append(daemon)

    def said(self, *command: str, folder: Path | None = None) -> str:
        """Standard output of a command of Slurm; empty if it fails."""
        done = subprocess.run(
            command,
            cwd=folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            check=False,
        )
        return done.stdout.strip()

    def submit(self, folder: Path, *words: str | Path) -> str:
        """Submit a batch script from a folder, and return the number of the job."""
        job = self.said("sbatch", "--parsable", *map(str, words), folder=folder)
        assert job, "sbatch has refused the job"
        return job

    def state(self, job: str) -> str:
        """States of a job or of the tasks of an array, and why they wait."""
        return self.said("squeue", "-h", "-j", job, "-t", "all", "-r", "-o", "%T %r")

    def started(self, job: str) -> int:
        """How often a job has been requeued."""
        _, _, restarts = self.said("scontrol", "show", "job", job).partition("Restarts=")
        return int(restarts.split()[0])

    def requeued(self, job: str, times: int) -> None:
        """Wait until a job runs after so many requeues."""
        until(lambda: self._runs_soon(job) and self.started(job) == times, END_SECONDS)

    def _runs_soon(self, job: str) -> bool:
        """Whether a job runs; a requeued job is let go without the two minutes' wait of Slurm."""
        state, requeue = self.state(job), f"{job} {self.started(job)}"
        if state == "PENDING BeginTime" and requeue not in self._let_go:
            self._let_go.add(requeue)
            # Within a second, the node would take the new start for the one that has ended.
            self.said("scontrol", "update", f"JobId={job}", "StartTime=now+3seconds")
        return state.startswith("RUNNING")

    def ended(self, job: str) -> str:
        """Wait until a job and its tasks have ended, and return the state and the exit code."""

        def has_ended() -> bool:
            alive = ("PENDING", "RUNNING", "COMPLETING", "CONFIGURING")
            return not self._runs_soon(job) and not any(map(self.state(job).__contains__, alive))

        until(has_ended, END_SECONDS)
        shown = self.said("scontrol", "show", "job", job).split()
        return " ".join(word for word in shown if word.startswith(("JobState=", "ExitCode=")))

    def close(self) -> None:
        """End all jobs and all daemons."""
        self.said("scancel", "--user", getpass.getuser())
        try:
            # The processes that run jobs are no children of the daemons.
            until(lambda: not self.said("squeue", "-h"))
        finally:
            left = [process for daemon in self._daemons for process in family(daemon.pid)]
            for daemon in reversed(self._daemons):
                daemon.terminate()
            for daemon in self._daemons:
                daemon.wait(20)
            end(left)


def _free_ports(count: int) -> list[int]:
    servers = [socket.socket() for _ in range(count)]
    for server in servers:
        server.bind(("127.0.0.1", 0))
    ports = [server.getsockname()[1] for server in servers]
    for server in servers:
        server.close()
    return ports


@contextmanager
def slurm(nodes: int) -> Iterator[Slurm]:
    """A cluster of so many nodes; when the test is over, whatever way, nothing of it is left."""
    # A short path, for the socket of munged.
    with tempfile.TemporaryDirectory(dir="/tmp", ignore_cleanup_errors=True) as folder:
        cluster = Slurm(Path(folder), nodes)
        try:
            cluster.start()
            yield cluster
        finally:
            cluster.close()
