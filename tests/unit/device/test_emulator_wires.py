"""Wires with emulators: a signal that ends the wait for an emulator leaves its thread to be waited for."""

from __future__ import annotations

import signal

import pytest

from eal_actors.device.emulator_wires import PtyWire
from eal_actors.kernel.posix import HAS_TERMINALS


class Echo:
    """An emulated device that repeats what it hears."""

    def feed(self, data: bytes, now_s: float) -> bytes:
        return data


class SignalledError(BaseException):
    """A signal has come."""


@pytest.mark.skipif(not HAS_TERMINALS, reason="needs pseudo-terminals")
def test_a_signal_during_the_wait_does_not_hide_the_running_emulator() -> None:
    def end(*_: object) -> None:
        raise SignalledError

    former = signal.signal(signal.SIGALRM, end)
    wire = PtyWire(Echo)
    wire.plug_in()
    thread = wire._thread
    assert thread is not None
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        with pytest.raises(SignalledError):
            wire.join()
        assert thread.is_alive()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
        wire.close()
    assert not thread.is_alive()
