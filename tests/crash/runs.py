"""Runs in processes of their own, for tests that end them."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path

import psutil
from psutil import Process

from oracles.bytes_of import hashes

WORKER = "ray::pfdist"  # begins the title of a worker's process while it has a task
PATIENCE_SECONDS = 180.0
# As a terminal starts it: a shell's background jobs have SIGINT ignored, and `nohup` SIGHUP.
PROGRAM = """
import signal, sys
from pfdist.cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
sys.exit(main())
"""
# After which nothing of a program that has ended may live: agents of Ray look for a server that has
# ended before them for 60 s.
GONE_SECONDS = 120.0


class Running:
    """``pfdist run`` or another command in a process of its own, whose processes are known.

    Its process is the parent, whose child computes. It does not outlive the test, nor do its
    workers.
    """

    def __init__(
        self, job: Path, run: Path, *options: str, word: str = "run", **environment: str
    ) -> None:
        command = [sys.executable, "-c", PROGRAM, word, job, "--results", run, *options]
        self.run, self._errors = run, run.with_name(f"{run.name}.stderr")
        with self._errors.open("ab") as errors:
            self.process = subprocess.Popen(
                command,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                env=os.environ | environment,
                start_new_session=True,  # as a job of a shell
            )

    @property
    def computing(self) -> list[Process]:
        """The process that computes, once it has begun."""
        return family(self.process.pid)[:1]

    def family(self, word: str = "") -> list[Process]:
        """Processes below that, from those of its children whose command has a word in it."""
        return [each for process in self.computing for each in family(process.pid, word)]

    def workers(self) -> list[Process]:
        """Its Ray workers that have a task in their hands."""
        return [process for process in self.family("raylet") if WORKER in command_of(process)]

    def wait_for(self, reached: Callable[[], object]) -> None:
        """Wait until something is reached while it runs."""
        until(lambda: self.process.poll() is not None or reached())
        assert self.process.poll() is None, f"it ended before it got so far: {self.said[-3:]}"

    def parts(self, table: str) -> int:
        """How many commits of a table are not published yet."""
        return len(list((self.run / "parts" / table).glob("[!.]*.parquet")))

    def kill(self) -> bool:
        """End it and the process that computes at once; give whether it still ran."""
        computing = self.computing
        self.process.kill()
        killed = self.process.wait() == -signal.SIGKILL
        until(lambda: all_gone(computing), GONE_SECONDS)
        return killed

    def wait(self) -> int:
        """Give its exit code."""
        return self.process.wait(PATIENCE_SECONDS)

    @property
    def said(self) -> list[str]:
        """Lines on standard error."""
        return self._errors.read_text().splitlines()


@contextmanager
def running(
    job: Path, run: Path, *options: str, word: str = "run", **environment: str
) -> Iterator[Running]:
    """Start a run; when the test is over, whatever way, nothing of it is left."""
    driver = Running(job, run, *options, word=word, **environment)
    try:
        yield driver
    finally:
        left = [*driver.computing, *driver.family()]
        driver.process.kill()
        driver.process.wait()
        end(left)


def finish(job: Path, run: Path, *options: str) -> dict[str, str]:
    """Run it to its end, and give the hashes of what it has made."""
    with running(job, run, *options) as driver:
        assert driver.wait() == 0, driver.said[-3:]
    return hashes(run)


def until(reached: Callable[[], object], seconds: float = PATIENCE_SECONDS) -> None:
    """Wait until something is reached."""
    deadline = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < deadline, f"not reached in {seconds:.0f} s"
        time.sleep(0.005)


def family(parent: int, word: str = "") -> list[Process]:
    """The processes below a process: its children whose command has the word, and theirs."""
    found: list[Process] = []
    with suppress(psutil.NoSuchProcess):
        for child in Process(parent).children():
            if word in command_of(child):
                found.append(child)
                with suppress(psutil.NoSuchProcess):
                    found += child.children(recursive=True)
    return found


def command_of(process: Process) -> str:
    """A process's command, or how it calls itself; empty once it has ended."""
    try:
        return Path(f"/proc/{process.pid}/cmdline").read_text(errors="replace")
    except OSError:
        return ""


def listening(processes: Iterable[int]) -> Iterator[IPv4Address | IPv6Address]:
    """Addresses at which these wait for connections; see proc(5)."""
    sockets = set()
    for process in processes:
        for handle in Path(f"/proc/{process}/fd").glob("*"):
            with suppress(OSError):  # it is closed, or the process gone
                sockets.add(str(handle.readlink()))
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if state == "0A" and f"socket:[{rest[5]}]" in sockets:
                address = bytes.fromhex(local.partition(":")[0])
                words = range(0, len(address), 4)  # each in the machine's own order
                found = ip_address(b"".join(address[k : k + 4][::-1] for k in words))
                yield getattr(found, "ipv4_mapped", None) or found


def marked(name: str, value: str) -> list[Process]:
    """The processes that began with a variable of this value, and all processes below them."""
    found, mark = list[Process](), f"{name}={value}".encode()
    for process in psutil.process_iter():
        with suppress(OSError, psutil.NoSuchProcess):
            if mark in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0"):
                found += [process, *process.children(recursive=True)]
    return [process for process in {*found} if command_of(process)]


def end(processes: Iterable[Process]) -> None:
    """Kill the processes that still live."""
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            process.kill()


def all_gone(processes: list[Process]) -> bool:
    """Whether none of these lives; of one that is dead and not buried the command is empty."""
    return not any(map(command_of, processes))
