"""NewestMessages: the newest message of each key, all of some keys, and nothing twice."""

from collections import deque
from collections.abc import Iterator

from zensim.proto.network_protocols import Sample
from zensim.proto.newest_messages import NewestMessages


class Queue:
    """Messages that wait; those that were taken are counted."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[str, bytes]] = deque()
        self.copied = 0
        self.is_closed = False

    def receive(self) -> Iterator[tuple[str, bytes]]:
        while self.waiting:
            yield self.waiting.popleft()

    def copy(self, kept: list[bytes]) -> list[Sample]:
        self.copied += len(kept)
        return [Sample("", one, "") for one in kept]

    def close(self) -> None:
        self.is_closed = True


def take(newest: NewestMessages[bytes]) -> list[bytes]:
    return [one.payload for one in newest.take()]


def make(queue: Queue) -> NewestMessages[bytes]:
    return NewestMessages(queue.receive, queue.copy, queue.close, lambda key: key == "events")


def test_newest_of_each_key_and_all_events_are_taken_and_the_others_not_copied() -> None:
    queue = Queue()
    newest = make(queue)
    for number in (b"1", b"2"):
        queue.waiting += [("odom", number), ("events", number), ("imu", number)]
        newest.collect()
    queue.waiting.append(("odom", b"3"))

    assert take(newest) == [b"1", b"2", b"3", b"2"]
    assert queue.copied == 4
    assert take(newest) == []


def test_end_is_that_of_the_subscription() -> None:
    queue = Queue()

    make(queue).close()

    assert queue.is_closed
