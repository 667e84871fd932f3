"""The local page answers this machine's own page alone, and ends with the command."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, nullcontext
from http.client import HTTPConnection
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from oracles.explored import SMALL, TOKEN, served
from oracles.in_turn import in_turn
from pfdist.plugins.explorer.server import MOST_BYTES

FILES = ("", "explore.js", "explore.css")


@pytest.fixture(scope="module")
def port(address: str) -> int:
    found = urlsplit(address).port
    assert found is not None
    return found


class Answer(NamedTuple):
    status: int
    headers: Mapping[str, str]
    text: str


def asked(port: int, path: str, **headers: str) -> Answer:
    with closing(HTTPConnection("127.0.0.1", port, timeout=20)) as connection:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return Answer(answer.status, answer.headers, answer.read().decode())


def opened(port: int, path: str = f"/{TOKEN}/socket", origin: str = "own") -> Any:
    own = f"http://127.0.0.1:{port}" if origin == "own" else origin
    address = f"ws://127.0.0.1:{port}{path}"
    return connect(address, origin=own or None, proxy=None)  # type: ignore[arg-type]


@pytest.mark.parametrize("file", FILES)
def test_the_files_of_the_page_load_nothing_from_elsewhere(port: int, file: str) -> None:
    answer = asked(port, f"/{TOKEN}/{file}")
    assert answer.status == 200
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'")
    assert "unsafe" not in policy
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert "server" not in answer.headers
    text = answer.text.replace("http://www.w3.org/2000/svg", "")  # a name, which is not loaded
    assert "http://" not in text
    assert "https://" not in text
    assert "innerHTML" not in text


@pytest.mark.parametrize("path", ["/", "/explore.js", "/wrong/", f"/{TOKEN[:-1]}/", f"/{TOKEN}x/"])
def test_the_token_is_needed(port: int, path: str) -> None:
    assert asked(port, path).status == 404


@pytest.mark.parametrize("file", FILES)
@in_turn(
    "headers",
    [
        {"host": "evil.example"},
        {"host": "127.0.0.1"},
        {"host": "evil.example:{port}"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "https://127.0.0.1:{port}"},
        {"host": "localhost:{port}", "origin": "http://127.0.0.1:{port}"},
    ],
)
def test_another_host_or_origin_is_refused(port: int, file: str, headers: dict[str, str]) -> None:
    filled = {name: value.format(port=port) for name, value in headers.items()}
    assert asked(port, f"/{TOKEN}/{file}", **filled).status == 403


def test_its_own_names_are_answered(port: int) -> None:
    for host in (f"127.0.0.1:{port}", f"localhost:{port}"):
        assert asked(port, f"/{TOKEN}/", host=host).status == 200
        same = asked(port, f"/{TOKEN}/", host=host, origin=f"http://{host}")
        assert same.status == 200


@pytest.mark.parametrize(
    ("path", "origin", "status"),
    [
        ("/socket", None, 403),
        ("/wrong/socket", None, 403),
        (f"/{TOKEN}/socket", "http://evil.example", 403),
        (f"/{TOKEN}/socket", "null", 403),
        (f"/{TOKEN}/socket", "", 403),  # a browser always names the origin
    ],
)
def test_the_socket_refuses_others(port: int, path: str, origin: str | None, status: int) -> None:
    given = {} if origin is None else {"origin": origin}
    with pytest.raises(InvalidStatus) as refused, opened(port, path, **given):
        pass
    assert refused.value.response.status_code == status


def test_the_socket_refuses_another_host(port: int) -> None:
    lines = [
        f"GET /{TOKEN}/socket HTTP/1.1", f"Host: evil.example:{port}", "Connection: Upgrade",
        f"Origin: http://evil.example:{port}", "Upgrade: websocket", "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==", "", "",
    ]  # fmt: skip
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall("\r\n".join(lines).encode())
        assert connection.recv(100).startswith(b"HTTP/1.1 403")
        own = [line.replace("evil.example", "127.0.0.1") for line in lines]
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall("\r\n".join(own).encode())
        assert connection.recv(100).startswith(b"HTTP/1.1 101")


def test_the_socket_answers_and_a_message_that_is_too_long_closes_it(port: int) -> None:
    with opened(port) as page:
        page.send(json.dumps({"ask": "answer", "times": [0, 4, 8, 12], "id": 1}))
        answer = json.loads(page.recv(20))
        assert answer["id"] == 1
        assert answer["times"] == [0, 4, 8, 12]
        for wrong in ("{", "[" * 100_000, '{"id": NaN}', '{"ask": 7}', "", b"\x00\xff", "9" * 5000):
            page.send(wrong)
            assert json.loads(page.recv(20))["error"]
        page.send(json.dumps({"ask": "answer", "times": "0" * MOST_BYTES}))
        with pytest.raises(ConnectionClosed):
            page.recv(20)


def test_a_long_judgement_keeps_nobody_waiting(port: int) -> None:
    with opened(port) as page, opened(port) as other:
        page.send(json.dumps({"ask": "judge", "name": "a", "times": [1, 4, 8, 12], "id": "slow"}))
        other.send(json.dumps({"ask": "answer", "times": [0, 4, 8, 12], "id": "quick"}))
        assert json.loads(other.recv(20))["id"] == "quick"
        assert json.loads(page.recv(20))["id"] == "slow"


def test_the_questions_of_a_page_are_answered_one_at_a_time_and_in_order() -> None:
    at_work, most = threading.Semaphore(0), list[int]()

    def answer(times: object, _: int) -> dict[str, object]:
        at_work.release()
        most.append(at_work._value)
        time.sleep(0.01)
        at_work.acquire()
        return {"times": times}

    asked = [{"ask": "answer", "times": [number], "id": number} for number in range(8)]
    session = SimpleNamespace(answer=answer)
    with served(session) as address, opened(urlsplit(address).port or 0) as page:
        for message in asked:
            page.send(json.dumps(message))
        assert [json.loads(page.recv(20)) for _ in asked] == asked
    assert most == [1] * 8


# --- the command ----------------------------------------------------------------------------------


# As a terminal starts it: SIGINT is not ignored, as it is behind a shell's &.
BEGINS = """
import signal
import sys

signal.signal(signal.SIGINT, signal.default_int_handler)
from pfdist.cli.main import main

sys.exit(main())
"""


@pytest.fixture
def command(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    started = list[subprocess.Popen[str]]()

    def start(*options: str, **variables: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-c", BEGINS, "explore", str(SMALL), *options]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        environment = {**os.environ, **variables}
        started.append(
            subprocess.Popen(words, cwd=tmp_path, text=True, env=environment, **pipes)  # type: ignore[call-overload]
        )
        return started[-1]

    yield start
    for each in started:
        each.kill()
        each.communicate()


# It stays until the page is served, as one in a terminal does, and writes what it has seen.
BROWSER = """
import json, os, re, sys, urllib.request
from pathlib import Path

link = Path(sys.argv[1].removeprefix("file://"))
modes = [oct(path.stat().st_mode)[-3:] for path in (link.parent, link)]
address = re.search('url=([^"]+)', link.read_text())[1]
status = urllib.request.urlopen(address, timeout=20).status
Path("seen").write_text(json.dumps([sys.argv[1], modes, address, status]))
os.rename("seen", "seen.json")
"""


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_a_browser_that_stays_gets_a_private_file_without_the_token_and_a_signal_ends_the_command(
    command: Callable[..., subprocess.Popen[str]], tmp_path: Path, number: signal.Signals
) -> None:
    (tmp_path / "browser.py").write_text(BROWSER)
    process = command(BROWSER=f"{sys.executable} {tmp_path / 'browser.py'} %s")
    assert process.stdout is not None
    address = process.stdout.readline().strip()
    host, port, path = (getattr(urlsplit(address), part) for part in ("hostname", "port", "path"))
    assert host == "127.0.0.1"
    assert len(path) > 40  # a token of 32 bytes
    assert asked(port, path).status == 200  # it listens already
    seen = tmp_path / "seen.json"
    for _ in range(400):
        if not seen.exists():
            time.sleep(0.05)
    link, modes, found, status = json.loads(seen.read_text())
    assert path.strip("/") not in link
    assert (modes, found, status) == (["700", "600"], address, 200)
    with opened(port, path + "socket") as page:
        page.send(json.dumps({"ask": "state", "id": 1}))
        assert json.loads(page.recv(20))["model"] == "ungm"
        process.send_signal(number)
        with pytest.raises(ConnectionClosed):
            page.recv(20)
    _, error = process.communicate(timeout=20)
    assert process.returncode == {signal.SIGINT: 130, signal.SIGTERM: 75}[number]
    assert error.splitlines()[-1] == "pfdist: Stopped."
    assert "Traceback" not in error
    assert not Path(link.removeprefix("file://")).parent.exists()


def test_no_browser_is_opened_where_none_is_wanted(
    call: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened_beside = list[object]()

    async def serve(server: object, listening: object, beside: object) -> None:
        opened_beside.append(beside)

    monkeypatch.setattr("pfdist.plugins.explorer.server._serve", serve)
    assert call(f"explore {SMALL} --no-browser").code == 0
    assert [type(each) for each in opened_beside] == [nullcontext]


def test_a_port_in_use_is_an_error_of_one_line(port: int, call: Callable[..., Any]) -> None:
    code, out, error = call(f"explore {SMALL} --no-browser --port {port}")
    assert (code, out) == (1, "")
    assert error == f"pfdist: --port: {port} cannot be used: Address already in use\n"
    code, _, error = call(f"explore {SMALL} --no-browser --port 70000")
    assert (code, error) == (1, "pfdist: --port must be 0 to 65,535, got 70000\n")
