"""StopFlag: set by the first stop signal, which raises KeyboardInterrupt before `arm`."""

import signal
from collections.abc import Iterator

import pytest

from zensim.proto.stop_signal import STOP_SIGNALS, StopFlag


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    kept = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_flag_is_set_by_a_stop_signal(number: signal.Signals) -> None:
    stop = StopFlag()
    was_set = stop()

    signal.raise_signal(number)

    assert (was_set, stop()) == (False, True)


def test_flag_interrupts_once_before_it_is_armed() -> None:
    stop = StopFlag(is_armed=False)

    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    signal.raise_signal(signal.SIGTERM)

    assert stop()


def test_second_signal_is_urgent() -> None:
    calls: list[str] = []
    stop = StopFlag(on_stop=lambda: calls.append("stop"))

    signal.raise_signal(signal.SIGTERM)
    was_urgent = stop.is_urgent
    signal.raise_signal(signal.SIGTERM)

    assert (was_urgent, stop.is_urgent) == (False, True)
    assert calls == ["stop"]


def test_flag_no_longer_interrupts_when_armed() -> None:
    stop = StopFlag(is_armed=False)
    stop.arm()

    signal.raise_signal(signal.SIGINT)

    assert stop()
