"""Times of messages, from their stamps and steps; messages that are missing between them."""

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.message_times import choose_time, count_missing, make_step_reader
from zensim.proto.messages.standard_messages import String

SECOND = 1_000_000_000
PERIOD = SECOND // 50


def test_missing_messages_are_counted_by_the_usual_period() -> None:
    times = [10 * SECOND + number * PERIOD for number in range(5)]

    assert count_missing(times[0] - PERIOD, times) == 0
    assert count_missing(times[0] - 8 * PERIOD, times) == 7
    assert count_missing(None, times) == 0
    assert count_missing(0, times[:1]) == 0


def test_text_of_an_event_has_the_time_of_its_step() -> None:
    payload = encode(String('{"kind":"spawned","entity":"r1","step":480}'), Format.CDR)

    assert make_step_reader(SECOND // 240)(payload) == 480 * (SECOND // 240)
    assert make_step_reader(0)(payload) is None


def test_stamp_of_another_clock_is_not_used() -> None:
    assert choose_time(5 * SECOND, 6 * SECOND) == 5 * SECOND
    assert choose_time(1_700_000_000 * SECOND, 6 * SECOND) == 6 * SECOND
    assert choose_time(None, 6 * SECOND) == 6 * SECOND
