"""Signals as data: who hears them, and what is left when the command has ended."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from pfdist.common import stopping
from pfdist.common.stopping import check, exit_code, listening

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)


def mine(number: int, frame: object) -> None:
    raise AssertionError("nobody was to call this handler")


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """As a terminal starts a program: a shell's background jobs, as CI may be, ignore SIGINT."""
    before = {number: signal.signal(number, mine) for number in NUMBERS}
    yield
    assert {signal.signal(number, before[number]) for number in NUMBERS} == {mine}


def until_heard() -> None:
    deadline = time.monotonic() + 60.0
    while exit_code() is None:
        assert time.monotonic() < deadline
        time.sleep(0.001)


@pytest.mark.parametrize(("number", "code"), [*zip(NUMBERS, (130, 75, 75), strict=True)])
def test_a_signal_is_raised_where_it_is_looked_at_and_nowhere_else(
    number: signal.Signals, code: int, capfd: pytest.CaptureFixture[str]
) -> None:
    with listening(ends=False):
        check()
        signal.raise_signal(number)
        until_heard()  # nothing is raised here
        assert exit_code() == code
        for _ in range(2):  # also after something has swallowed the first
            with pytest.raises(KeyboardInterrupt):
                check()
        with pytest.raises(KeyboardInterrupt):
            stopping.sleep(600.0)
        stopping.answered()
        check()
        assert exit_code() == code
    said = capfd.readouterr().err
    assert said == ("pfdist: Stopping after the work in flight; press Ctrl-C again to end now\n")
    check()  # nobody listens
    with listening(ends=False):  # the next command knows nothing of it
        check()
        assert exit_code() is None


def test_the_handlers_that_ray_has_replaced_are_set_again() -> None:
    with listening(ends=False):
        check()
        signal.signal(signal.SIGTERM, mine)
        stopping.renew()
        signal.raise_signal(signal.SIGTERM)
        until_heard()
    stopping.renew()  # the fixture sees that this does nothing once the command has ended


def test_the_same_signal_of_a_batch_system_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = list[int]()
    monkeypatch.setattr(os, "_exit", ended.append)
    with listening(ends=False):
        check()
        for _ in range(3):
            signal.raise_signal(signal.SIGTERM)
        until_heard()
        time.sleep(0.1)
        assert ended == []
        monkeypatch.setattr(stopping, "_SAME_SECONDS", 0.0)  # as if it were later
        signal.raise_signal(signal.SIGTERM)
        time.sleep(0.1)
    assert ended == [75]


def test_after_the_notice_of_a_batch_system_the_process_ends_whatever_it_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ended = threading.Event()
    monkeypatch.setattr(os, "_exit", lambda code: code == 75 and ended.set())
    monkeypatch.setattr(stopping, "_NOTICE_SECONDS", 0.01)
    with listening(ends=False):
        check()
        signal.raise_signal(signal.SIGUSR1)
        assert ended.wait(60.0)


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # as `nohup` does
    with listening(ends=False):
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    assert signal.signal(signal.SIGINT, mine) is signal.SIG_IGN


def test_the_wakeup_descriptor_of_the_caller_is_set_again() -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer)
    with listening(ends=False):
        pass
    assert signal.set_wakeup_fd(before) == writer
    os.close(reader)
    os.close(writer)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_forked_child_ends_by_a_signal_that_its_parent_does_not_hear(
    number: signal.Signals,
) -> None:
    signal.signal(number, signal.SIG_DFL)
    with listening(ends=False):
        check()
        child = os.fork()
        if not child:
            time.sleep(60.0)
            os._exit(1)
        time.sleep(0.1)
        os.kill(child, number)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -number
        time.sleep(0.1)
        assert exit_code() is None
    signal.signal(number, mine)


@pytest.mark.parametrize("installs", [True, False])
def test_other_threads_are_not_interrupted_and_install_nothing(installs: bool) -> None:
    passed = list[bool]()

    def other() -> None:
        if installs:
            with listening(ends=False):
                passed.append(signal.getsignal(signal.SIGTERM) is mine)
        else:
            check()
            passed.append(True)

    def run(function: Callable[[], None]) -> None:
        thread = threading.Thread(target=function)
        thread.start()
        thread.join()

    if installs:
        run(other)
    else:
        with listening(ends=False):
            check()
            signal.raise_signal(signal.SIGTERM)
            until_heard()
            run(other)
    assert passed == [True]
