"""Addresses at which somebody listens who is no Ray cluster, or one that wants another token."""

import re
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from crash.nodes import nodes
from crash.runs import running
from pfdist import Job

_RAYS = re.compile(r"^\[|Traceback|ray/")  # lines of Ray's log


@pytest.fixture(params=["says-nothing", "closes-at-once", "says-rubbish"])
def port(request: pytest.FixtureRequest) -> Iterator[int]:
    """Where a server accepts, and does something else than Ray does."""
    kept = []

    def serve(server: socket.socket) -> None:
        while True:
            try:
                connection, _ = server.accept()
                if request.param == "closes-at-once":
                    connection.close()
                    continue
                kept.append(connection)
                if request.param == "says-rubbish":
                    connection.sendall(b"HTTP/1.0 400 rubbish\r\n\r\n" * 20)
            except OSError:
                if server.fileno() < 0:
                    return

    with socket.create_server(("", 0)) as server:
        threading.Thread(target=serve, args=[server], daemon=True).start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
    for connection in kept:
        connection.close()


@pytest.mark.crash
def test_a_server_that_is_no_ray_is_said_in_a_last_line_of_ours(
    port: int, small_job: Job, tmp_path: Path
) -> None:
    with running(
        small_job.path, tmp_path / "run", "--pool", "ray", "--address", f"127.0.0.1:{port}"
    ) as driver:
        assert driver.wait() == 1
        assert f"no Ray cluster at '127.0.0.1:{port}': " in driver.said[-1]


@pytest.mark.crash
@pytest.mark.parametrize(
    "address",
    [
        pytest.param("127.0.0.1:1", id="closed-port"),
        pytest.param("nowhere.invalid:6379", id="no-such-name"),
        pytest.param("auto", id="auto-with-RAY_ADDRESS"),
        pytest.param("ray://127.0.0.1:1", id="ray-client"),
    ],
)
def test_where_nobody_listens_a_run_ends_with_one_line_of_ours(
    address: str, small_job: Job, tmp_path: Path
) -> None:
    options = ("--pool", "ray", "--address", address)
    with running(small_job.path, tmp_path / "run", *options, RAY_ADDRESS="127.0.0.1:2") as driver:
        assert driver.wait() == 1
        assert "no Ray cluster at" in driver.said[-1]
        assert not [line for line in driver.said if _RAYS.search(line)]


@pytest.mark.crash
def test_a_cluster_that_wants_another_token_is_not_joined_and_not_waited_for(
    small_job: Job, tmp_path: Path
) -> None:
    with nodes(tmp_path, 1) as cluster:
        options = ("--pool", "ray", "--address", cluster.address)
        for number, token in enumerate(
            ({"RAY_AUTH_TOKEN": "0" * 64}, {"RAY_AUTH_MODE": "disabled"})
        ):
            run, given = tmp_path / f"run-{number}", cluster.environment | token
            with running(small_job.path, run, *options, **given) as driver:
                assert driver.wait() == 1
                assert "no Ray cluster at" in driver.said[-1]
