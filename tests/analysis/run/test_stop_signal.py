"""The first stop request is handled between steps; the second one interrupts."""

import signal
from collections.abc import Iterator

import pytest

from analysis.run.stop_signal import stop_requests


@pytest.fixture(autouse=True)
def python_handles_sigint() -> Iterator[None]:
    """Let Python handle SIGINT, which a shell ignores for background processes."""
    inherited = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, inherited)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_request_interrupts_nothing_and_is_reported(
    number: signal.Signals, capfd: pytest.CaptureFixture[str]
) -> None:
    with stop_requests() as stop:
        assert not stop()
        signal.raise_signal(number)
        assert stop()
    assert "press Ctrl-C again to end at once" in capfd.readouterr().err


def test_the_second_ctrl_c_interrupts() -> None:
    with stop_requests():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_afterwards_ctrl_c_interrupts_as_before() -> None:
    with stop_requests():
        pass
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
