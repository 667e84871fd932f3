"""A Ray cluster of nodes on loopback, each of which a test may kill, stop and let go on."""

import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from crash.runs import end, family, until

Node = subprocess.Popen[bytes]


class Nodes:
    """A cluster whose nodes have a core and a folder of their own.

    Attributes
    ----------
    address : str
    jobs : str
        The address of the server of ``ray job``, if there is one.
    environment : dict of str
        With which its nodes, and nobody else, can reach it.
    """

    def __init__(self, folder: Path, sockets: str, takes_jobs: bool = False) -> None:
        with socket.socket() as server, socket.socket() as jobs_server:
            server.bind(("127.0.0.1", 0))
            jobs_server.bind(("127.0.0.1", 0))
            port, jobs_port = server.getsockname()[1], jobs_server.getsockname()[1]
        self.address, self.jobs = f"127.0.0.1:{port}", f"http://127.0.0.1:{jobs_port}"
        self.environment = {
            "RAY_USAGE_STATS_ENABLED": "0",
            "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN": secrets.token_hex(32),
            "RAY_JOB_STOP_WAIT_TIME_S": "60",
        }
        self.all: list[Node] = []
        self._folder = folder
        temporary = f"--temp-dir={sockets}"
        ports = f"--port={port}", f"--dashboard-port={jobs_port}"
        self._start("--head", *ports, f"--include-dashboard={takes_jobs}", temporary)

    def add(self) -> Node:
        """Add a node."""
        return self._start(f"--address={self.address}")

    def _start(self, *options: str) -> Node:
        folder = self._folder / f"node-{len(self.all)}"
        folder.mkdir()
        alone = ["--min-worker-port=0", "--max-worker-port=0", "--object-store-memory=100000000"]
        alone += ["--dashboard-agent-listen-port=0"]
        here = ["--block", "--num-cpus=1", "--node-ip-address=127.0.0.1"]
        with (folder / "said").open("wb") as said:
            node = subprocess.Popen(
                [sys.executable, "-m", "ray.scripts.scripts", "start", *here, *alone, *options],
                cwd=folder,
                stdout=said,
                stderr=said,
                env=os.environ | self.environment,
            )
        self.all.append(node)

        def has_started() -> bool:
            said = (folder / "said").read_text()
            assert node.poll() is None, said[-2000:]
            return "Ray runtime started" in said

        until(has_started)
        return node


def signal_all(node: Node, number: signal.Signals) -> None:
    """Send a signal to all processes of a node."""
    for process in [psutil.Process(node.pid), *family(node.pid)]:
        with suppress(psutil.NoSuchProcess):
            process.send_signal(number)


def kill(node: Node) -> None:
    """End all processes of a node at once."""
    left = family(node.pid)
    node.kill()
    node.wait()
    end(left)


@contextmanager
def nodes(folder: Path, count: int, takes_jobs: bool = False) -> Iterator[Nodes]:
    """So many nodes; when the test is over, whatever way, nothing of them is left."""
    # A short path, for Ray's sockets, and not where other clusters say that they are.
    with tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp", ignore_cleanup_errors=True) as path:
        cluster = Nodes(folder, path, takes_jobs)
        try:
            for _ in range(count - 1):
                cluster.add()
            yield cluster
        finally:
            for node in cluster.all:
                kill(node)
