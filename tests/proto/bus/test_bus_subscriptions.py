"""The queue of messages that wait long."""

from zensim.proto.bus.bus_session import CopiedSamples
from zensim.proto.network_protocols import Sample


def fill(samples: CopiedSamples, *sizes: int) -> list[int]:
    for size in sizes:
        samples.add(Sample("k", bytes(size), "", b""))
    return [len(one.payload) for one in samples.take()]


def test_oldest_messages_are_dropped_beyond_the_bytes() -> None:
    samples = CopiedSamples(max_count=100, max_bytes=100)

    assert fill(samples, 60, 30, 20, 10) == [30, 20, 10]
    assert fill(samples, 60, 40) == [60, 40]
    assert samples.dropped == 1


def test_oldest_messages_are_dropped_beyond_the_count() -> None:
    samples = CopiedSamples(max_count=2, max_bytes=100)

    assert fill(samples, 1, 2, 3) == [2, 3]
    assert (fill(samples), samples.dropped) == ([], 1)


def test_newest_message_is_kept_whatever_its_size() -> None:
    samples = CopiedSamples(max_count=2, max_bytes=100)

    assert fill(samples, 1, 1000) == [1000]
