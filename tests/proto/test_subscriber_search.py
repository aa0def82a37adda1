"""Which of many keys have subscribers, found by few probes."""

from collections.abc import Iterable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes import ManualClock, MemoryBus
from zensim.proto.keys import intersect
from zensim.proto.memory_bus import MemorySubscriberWatch
from zensim.proto.subscriber_search import (
    MAX_NAMED,
    SEARCH_PERIOD_S,
    KeyRanges,
    MessageBudget,
    SubscribedKeys,
    SubscriberSearch,
    SubscriberWatches,
)

NAMES = st.text("ab1_", min_size=1, max_size=5)


class CountingWatch:
    """Counts probes; see `SubscriberWatch`."""

    def __init__(self, bus: MemoryBus) -> None:
        self.probes: list[str] = []
        self._watch = bus.watch_subscribers(())
        self.advertise = self._watch.advertise
        self.close = self._watch.close

    def has_subscribers(self, key: str) -> bool:
        self.probes.append(key)
        return self._watch.has_subscribers(key)


class Searched:
    """A search among robots, and its time."""

    def __init__(self, names: Iterable[str], pattern: str = "*/odom") -> None:
        self.bus = MemoryBus()
        self.watch = CountingWatch(self.bus)
        self.search = SubscriberSearch(self.watch, pattern)
        keys = [f"{name}/odom" for name in names]
        self.search.set_keys(lambda: keys)
        self._now_s = 0.0

    def run(self) -> SubscribedKeys:
        """Search once, to the end."""
        self._now_s += SEARCH_PERIOD_S
        self.search.poll(self._now_s)
        while self.search.is_searching:
            self.search.poll(self._now_s)
        return self.search.found


@given(st.sets(NAMES, min_size=1, max_size=40), st.data())
def test_search_finds_those_with_subscribers(names: set[str], data: st.DataObject) -> None:
    searched = Searched(names)
    subscribed = data.draw(st.sets(st.sampled_from(sorted(names)), min_size=1))
    for name in subscribed:
        searched.bus.subscribe(f"{name}/odom")

    found = searched.run()

    assert found == SubscribedKeys(named=frozenset(f"{name}/odom" for name in subscribed))


@given(st.sets(st.tuples(NAMES, NAMES), min_size=1, max_size=30))
def test_ranges_of_nested_namespaces_fit_their_keys_only(names: set[tuple[str, str]]) -> None:
    ranges = KeyRanges("*/*/odom", [f"{one}/{two}/odom" for one, two in names])
    split = list(ranges.split(ranges.whole))

    for part in split:
        fits = [key for key in ranges.keys if intersect(part.expression, key)]
        assert set(ranges.keys[part.start : part.end]) <= set(fits)
    covered = [key for part in split for key in ranges.keys[part.start : part.end]]
    assert covered == list(ranges.keys)


def test_ten_of_many_are_found_by_few_probes() -> None:
    searched = Searched(f"box_bot{number}" for number in range(5000))
    wanted = {f"box_bot{number}/odom" for number in range(0, 5000, 500)}
    for key in wanted:
        searched.bus.subscribe(key)

    found = searched.run()

    assert found.named == wanted
    assert len(searched.watch.probes) < 500


def test_wildcard_covers_all_and_costs_two_probes() -> None:
    searched = Searched(f"box_bot{number}" for number in range(1000))
    searched.bus.subscribe("*/odom")

    found = searched.run()

    assert (len(found.named), len(found.others)) == (0, 1000)
    assert len(searched.watch.probes) == 2


def test_robot_with_a_subscriber_before_a_wildcard_keeps_it() -> None:
    searched = Searched(f"box_bot{number}" for number in range(1000))
    searched.bus.subscribe("box_bot7/odom")
    searched.run()
    searched.bus.subscribe("*/odom")

    found = searched.run()

    assert found.named == {"box_bot7/odom"}
    assert len(found.others) == 999


def test_wildcard_for_a_part_covers_that_part() -> None:
    searched = Searched(f"box_bot{number}" for number in range(5000))
    searched.bus.subscribe("box_bot1$*/odom")

    found = searched.run()

    assert len(found.others) > MAX_NAMED
    assert all(key.startswith("box_bot1") for key in found.others)


def test_search_that_sees_no_subscriber_keeps_what_was_found() -> None:
    searched = Searched(["r1", "r2"])
    received = searched.bus.subscribe("r1/odom")
    searched.run()
    received.close()

    assert searched.run().named == {"r1/odom"}


def test_removed_subscriber_is_found_while_others_stay() -> None:
    searched = Searched(["r1", "r2"])
    received = searched.bus.subscribe("r1/odom")
    searched.bus.subscribe("r2/odom")
    before = searched.run()
    received.close()

    assert len(before.named) == 2
    assert set(searched.run().named) == {"r2/odom"}


def test_new_keys_are_searched_next() -> None:
    searched = Searched(["r1"])
    searched.bus.subscribe("*/odom")
    searched.run()

    searched.search.set_keys(lambda: ["r1/odom", "r2/odom"])

    assert searched.run().named == {"r1/odom", "r2/odom"}


def test_budget_is_shared_by_the_topics_that_ask() -> None:
    clock = ManualClock()
    budget = MessageBudget(1000.0, clock)

    alone = taken_in_a_second(budget, clock, "odom")
    both = taken_in_a_second(budget, clock, "odom", "tf")

    assert alone == pytest.approx(1000, rel=0.15)
    assert both == pytest.approx(1000, rel=0.15)
    assert budget.withheld_hz > 5000


def taken_in_a_second(
    budget: MessageBudget, clock: ManualClock, *topics: str, steps: Sequence[int] = ()
) -> int:
    """Take messages of topics 50 times, after states with these steps in turn."""
    taken = 0
    for number in range(50):
        clock.sleep(0.02)
        if steps:
            budget.note_state(steps[number % len(steps)])
        taken += sum(budget.take(topic, 100) for topic in topics)
    return taken


def test_budget_falls_while_states_are_missed_and_grows_again() -> None:
    clock = ManualClock()
    budget = MessageBudget(1000.0, clock)

    driven = taken_in_a_second(budget, clock, "odom", steps=(12,))
    late = [taken_in_a_second(budget, clock, "odom", steps=(12, 24)) for _ in range(12)]
    again = [taken_in_a_second(budget, clock, "odom", steps=(12,)) for _ in range(25)]

    assert driven == pytest.approx(1000, rel=0.15)
    assert late[2] < 0.6 * late[0]
    assert late[-1] == pytest.approx(50, abs=25)
    assert again[3] < again[8] < again[-1]
    assert again[-1] == pytest.approx(1000, rel=0.15)


def test_budget_stays_when_states_come_at_other_distances() -> None:
    clock = ManualClock()
    budget = MessageBudget(1000.0, clock)

    taken = [
        taken_in_a_second(budget, clock, "odom", steps=(steps,))
        for steps in (1, 1, 12, 12, 12, 12, 5, 5)
    ]

    assert taken[-1] > 0.3 * taken[0]


def test_misses_without_messages_do_not_lower_the_budget() -> None:
    clock = ManualClock()
    budget = MessageBudget(1000.0, clock)

    for _ in range(20):
        clock.sleep(0.5)
        budget.note_state(1)
        budget.note_state(9)
        budget.update()

    assert taken_in_a_second(budget, clock, "odom") == pytest.approx(1000, rel=0.15)


def test_budget_withholds_nothing_from_few() -> None:
    clock = ManualClock()
    budget = MessageBudget(1000.0, clock)
    clock.sleep(0.1)

    assert sum(budget.take("odom", 10) for _ in range(10)) == 100
    clock.sleep(1.0)
    budget.update()
    assert budget.withheld_hz == 0


class OpeningBus(MemoryBus):
    """Keeps the patterns of its watches."""

    def __init__(self) -> None:
        super().__init__()
        self.opened: list[tuple[str, ...]] = []

    def watch_subscribers(self, patterns: Iterable[str]) -> MemorySubscriberWatch:
        self.opened.append(tuple(patterns))
        return super().watch_subscribers(patterns)


def test_one_session_watches_all_patterns_that_are_known() -> None:
    bus = OpeningBus()
    watches = SubscriberWatches(bus)
    for pattern in ("*/odom", "*/tf"):
        watches.include(pattern)

    same = watches.find("*/odom") is watches.find("*/tf")
    watches.include("*/imu")
    watches.find("*/imu")

    assert (same, bus.opened) == (True, [("*/odom", "*/tf"), ("*/imu",)])
