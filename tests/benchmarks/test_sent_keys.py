"""Keys after which the page's script sends, and those after which it does not."""

import pytest

from benchmarks.bench_page_control import make_sent_figures


def test_delays_of_the_script_are_in_milliseconds() -> None:
    missing, delay = make_sent_figures("here", [0.02, 0.04])

    assert (missing.samples, missing.is_missed) == ((0.0,), False)
    assert delay.samples == pytest.approx((20.0, 40.0))


def test_keys_without_a_message_are_counted_and_missed() -> None:
    missing, delay = make_sent_figures("here", [0.02, None, None])

    assert (missing.samples, missing.is_missed) == ((2.0,), True)
    assert delay.samples == pytest.approx((20.0,))


def test_only_the_number_is_left_when_no_key_has_a_message() -> None:
    (missing,) = make_sent_figures("here", [None])

    assert missing.is_missed
