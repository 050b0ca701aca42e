"""Processes that are kept for the next call, and when they end."""

import os
import signal
import subprocess
import sys
import time

import pytest

from jaxgrow.ensemble import worker_pool as processes


POSIX = pytest.mark.skipif(os.name != "posix", reason="sends signals")


@pytest.fixture(autouse=True)
def nothing_kept():
    processes.end_kept()
    yield
    processes.end_kept()


def numbers(borrowed):
    """The processes that answer."""
    with processes.quiet():
        return {borrowed.pool.submit(os.getpid).result(timeout=120)}


def waiting():
    """A process that is kept, and the loan that it was started for."""
    kept = processes.borrow(1)
    (number,) = numbers(kept)
    processes.give_back(kept)
    return kept, number


def has_ended(number):
    """Whether a process is gone, within seconds."""
    for _ in range(300):
        try:
            os.kill(number, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def test_the_next_call_takes_the_same_processes_if_nothing_has_changed(monkeypatch):
    _, number = waiting()
    again = processes.borrow(1)
    assert numbers(again) == {number}
    processes.give_back(again)
    monkeypatch.setenv("JAXGROW_KERNELS", "off")
    other = processes.borrow(1)
    assert numbers(other) != {number}
    assert has_ended(number)
    other.end()


def test_another_number_of_processes_starts_others():
    first = processes.borrow(1)
    processes.give_back(first)
    assert processes.borrow(2) is not first


def test_those_at_work_are_not_given_twice():
    assert processes.borrow(1) is not processes.borrow(1)


def test_they_end_after_a_while(monkeypatch):
    monkeypatch.setattr(processes, "KEPT_SECONDS", 0.2)
    kept, number = waiting()
    assert has_ended(number)
    assert processes.borrow(1) is not kept


def test_the_wait_begins_anew_with_every_call(monkeypatch):
    monkeypatch.setattr(processes, "KEPT_SECONDS", 0.6)
    kept = processes.borrow(1)
    for _ in range(4):
        processes.give_back(kept)
        time.sleep(0.3)
        assert processes.borrow(1) is kept
    kept.end()


@POSIX
def test_an_interrupt_while_they_wait_does_not_end_them():
    _, number = waiting()
    os.kill(number, signal.SIGINT)
    again = processes.borrow(1)
    assert numbers(again) == {number}
    again.end()


@POSIX
def test_those_that_were_ended_while_they_waited_are_not_given():
    _, number = waiting()
    os.kill(number, signal.SIGKILL)
    assert has_ended(number)
    other = processes.borrow(1)
    assert numbers(other) != {number}
    other.end()


@POSIX
def test_they_end_with_the_one_that_started_them(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import os, signal\n"
        "from jaxgrow.ensemble import worker_pool as processes\n"
        "if __name__ == '__main__':\n"
        "    kept = processes.borrow(1)\n"
        "    print(kept.pool.submit(os.getpid).result(), flush=True)\n"
        "    processes.give_back(kept)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert has_ended(int(done.stdout))


@pytest.mark.parametrize("own, members", [(None, "3"), ("1", "3"), ("0", "0")])
def test_level_of_the_log_is_the_users_if_there_is_one(monkeypatch, own, members):
    name = "TF_CPP_MIN_LOG_LEVEL"
    monkeypatch.setenv(name, "?")
    monkeypatch.delenv(name) if own is None else monkeypatch.setenv(name, own)
    with processes.quiet():
        assert os.environ[name] == members
    assert os.environ.get(name) == own
