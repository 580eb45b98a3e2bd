"""Ctrl-C while Python runs what cannot raise: it ends the command all the same."""

import signal
import sys
import threading

import pytest

from mavproxy_fault.cli import _handle_signals


class Destroyed:
    """An object in whose destructor a signal arrives."""

    def __init__(self, number: signal.Signals) -> None:
        self.number = number

    def __del__(self) -> None:
        signal.raise_signal(self.number)


def interrupted(number: signal.Signals) -> None:
    with _handle_signals(last=False):
        Destroyed(number)
        threading.Event().wait(60.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_a_destructor_is_not_lost(number: signal.Signals) -> None:
    hook = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt):
        interrupted(number)
    assert sys.unraisablehook is hook
