"""Ctrl-C is heard even while the garbage collector runs a callback."""

import gc
import signal
import threading
import time

import pytest

from jaxgrow.cli.interrupts import heard_interrupts


@pytest.fixture(autouse=True)
def default_handling():
    """What a program in the foreground has; a background one may ignore SIGINT."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@heard_interrupts()
def _interrupt():
    signal.raise_signal(signal.SIGINT)


@heard_interrupts()
def _collect():
    gc.collect()
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        time.sleep(0.005)


def test_interrupt_is_raised_at_once():
    with pytest.raises(KeyboardInterrupt):
        _interrupt()


def test_interrupt_during_garbage_collection_is_raised_afterwards():
    def callback(phase, info):
        if phase == "start" and not reached:
            reached.append(phase)
            signal.raise_signal(signal.SIGINT)

    reached = []
    gc.callbacks.append(callback)
    try:
        with pytest.raises(KeyboardInterrupt):
            _collect()
        assert reached
    finally:
        gc.callbacks.remove(callback)


def test_handler_is_put_back():
    with heard_interrupts():
        assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_other_handling_is_left_alone():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with heard_interrupts():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_other_threads_change_nothing():
    seen = []

    def work():
        with heard_interrupts():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]
