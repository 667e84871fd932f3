"""All that a command starts ends with the command, whatever ends the command."""

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pfdist.pools.guard import Guard, end, environment, marked, python_command

# Begins something that leaves its session and its parent, as Ray's agents do.
ORPHAN = "import subprocess; subprocess.Popen(['sleep', '60'], start_new_session=True)"
DRIVER = f"""
import subprocess, sys, time
from pfdist.pools.guard import Guard

def main():
    with Guard() as guard:
        with guard.watching():
            subprocess.run([sys.executable, "-c", {ORPHAN!r}], check=True)
        print("started", flush=True)
        time.sleep(60)
"""


def _until(reached: Callable[[], bool], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < deadline, f"not reached in {seconds:.0f} s"
        time.sleep(0.02)


def test_a_mark_is_inherited_and_found_though_sessions_and_parents_change() -> None:
    value = secrets.token_hex(8)
    with environment({"PFDIST_TEST": value}):
        subprocess.run([sys.executable, "-c", ORPHAN], check=True)
    assert "PFDIST_TEST" not in os.environ
    _until(lambda: len(marked("PFDIST_TEST", value)) == 1)  # the child has begun its program
    (found,) = marked("PFDIST_TEST", value)
    assert marked("PFDIST_TEST", value[:-1]) == []
    end([found])
    _until(lambda: not marked("PFDIST_TEST", value))


def test_a_child_that_lost_the_mark_is_found_below_its_parent() -> None:
    """Ray's agents overwrite their environment; their parent keeps the mark."""
    value = secrets.token_hex(8)
    parent = "import subprocess; subprocess.run(['sleep', '60'], env={})"
    with subprocess.Popen(
        [sys.executable, "-c", parent], env=os.environ | {"PFDIST_TEST": value}
    ) as started:
        _until(lambda: len(marked("PFDIST_TEST", value)) == 2)
        found = marked("PFDIST_TEST", value)
        assert found[0].pid == started.pid
        end(found)
    _until(lambda: not any(process.is_running() for process in found))


def test_what_begins_under_a_guard_ends_with_it_and_nothing_else() -> None:
    value = secrets.token_hex(8)
    with environment({"PFDIST_TEST": value}), Guard() as guard:
        with guard.watching():
            subprocess.run([sys.executable, "-c", ORPHAN], check=True)
        outside = subprocess.Popen(["sleep", "60"])
        assert len(marked("PFDIST_TEST", value)) == 3  # the guard, the orphan and the other
    assert [process.pid for process in marked("PFDIST_TEST", value)] == [outside.pid]
    outside.kill()
    outside.wait()


@pytest.mark.fault
@pytest.mark.usefixtures("hangup_ends_children")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_nothing_outlives_a_command_that_is_killed(
    number: signal.Signals, record_property: Callable[[str, object], None]
) -> None:
    value = secrets.token_hex(8)
    command = [sys.executable, "-c", f"{DRIVER}\nmain()"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, env=os.environ | {"PFDIST_TEST": value}
    ) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == b"started\n"
        assert len(marked("PFDIST_TEST", value)) == 3
        driver.send_signal(number)
        assert driver.wait() == -number
    _until(lambda: not marked("PFDIST_TEST", value))
    record_property("faults", "nothing hangs: 1")


@pytest.mark.fault
def test_a_process_that_lost_mark_and_parent_ends_with_its_command() -> None:
    """Ray's agents do, when the kernel ends their server together with the command."""
    value = secrets.token_hex(8)
    agent = "import subprocess; subprocess.run(['sleep', '60'], env={'PFDIST_TEST': 'VALUE'})"
    server = f"""
        with guard.watching():
            server = subprocess.Popen([sys.executable, "-c", {agent.replace("VALUE", value)!r}])
            time.sleep(2.0)
        server.kill()
"""
    start, rest = DRIVER.split("        with guard.watching():\n")
    driver = f"{start}{server.lstrip(chr(10))}{rest[rest.index('        print') :]}"
    with subprocess.Popen(
        [sys.executable, "-c", f"{driver}\nmain()"], stdout=subprocess.PIPE
    ) as started:
        assert started.stdout is not None
        assert started.stdout.readline() == b"started\n"
        (lost,) = marked("PFDIST_TEST", value)
        started.kill()
    _until(lambda: not lost.is_running())


def test_a_module_is_not_looked_for_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ray.py").write_text("print('planted')")
    monkeypatch.chdir(tmp_path)
    command = python_command("pfdist.pools.ray_rehearsal", "127.0.0.1:0")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "must be host:port" in done.stdout
    assert "planted" not in done.stdout + done.stderr


LEFT_OPEN = """
from pfdist.pools.ray_pool import RayPool

if __name__ == "__main__":
    pool = RayPool(1).__enter__()
    raise RuntimeError("never left")
"""


@pytest.mark.fault
def test_a_script_that_never_leaves_its_pool_ends(tmp_path: Path) -> None:
    """Python then leaves it while it ends, when no thread can start any more."""
    script = tmp_path / "script.py"
    script.write_text(LEFT_OPEN)
    ended = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=120, check=False
    )
    assert ended.returncode == 1
    assert ended.stderr.rstrip().endswith("RuntimeError: never left")
