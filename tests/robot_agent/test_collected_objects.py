"""Objects of robots that stay are frozen, and what others leave is collected."""

import pytest

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.robot_agent.collected_objects import FREEZE_AFTER_S, LEAST_GONE, CollectedObjects


class FakeCollector:
    """Counts what is frozen and unfrozen, and lists what happens while robots are added."""

    def __init__(self) -> None:
        self.frozen = self.unfrozen = 0
        self.happened: list[str] = []
        self.objects = CollectedObjects(
            self._freeze,
            self._unfreeze,
            lambda: self.happened.append("collect"),
            lambda: self.happened.append("pause"),
            lambda: self.happened.append("resume"),
        )

    def add_robots(self, now_s: float) -> None:
        """Add robots, which takes no time."""
        with self.objects.adding(now_s):
            self.happened.append("add")

    def _freeze(self) -> None:
        self.frozen += 1
        self.happened.append("freeze")

    def _unfreeze(self) -> None:
        self.unfrozen += 1


def test_nothing_is_collected_while_robots_are_added_and_they_are_frozen_before_it_is() -> None:
    collector = FakeCollector()

    with pytest.raises(MalformedPayload), collector.objects.adding(1.0):
        raise MalformedPayload("a claim")
    collector.add_robots(2.0)

    assert collector.happened == ["pause", "freeze", "resume", "pause", "add", "freeze", "resume"]


def test_objects_of_robots_are_frozen_once_more_after_the_last_of_them() -> None:
    collector = FakeCollector()

    collector.add_robots(1.0)
    collector.add_robots(2.0)
    collector.frozen, counts = 0, []
    for now_s in (1.0 + FREEZE_AFTER_S, 2.0 + FREEZE_AFTER_S, 100.0):
        collector.objects.poll(now_s)
        counts.append(collector.frozen)

    assert counts == [0, 1, 1]


def test_objects_are_collected_again_when_as_many_robots_have_gone_as_are_left() -> None:
    collector = FakeCollector()

    collector.objects.note_gone_robots(1, 3, 1.0)
    before = collector.unfrozen
    collector.objects.note_gone_robots(1, 2, 2.0)
    collector.objects.poll(2.0 + FREEZE_AFTER_S)

    assert (before, collector.unfrozen, collector.frozen) == (0, 1, 1)


def test_what_robots_leave_is_collected_before_others_freeze_it() -> None:
    collector = FakeCollector()

    for number in range(2 * LEAST_GONE):
        collector.add_robots(0.1 * number)
        collector.objects.note_gone_robots(1, 0, 0.1 * number)

    assert collector.happened.count("collect") == 2
