"""Which keys of many have subscribers, found by key expressions that split where they match."""

import os
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from zensim.proto.keys import NO_NAMESPACE
from zensim.proto.network_protocols import AgentNetwork, SubscriberWatch

MAX_PUBLISHERS: Final = 300
"""Robots of a topic whose publishers are all declared while there are subscribers. The time of a
router for a message grows with the declarations, as that for one more does."""
MAX_PUBLISHERS_AMONG_MANY: Final = 20
"""The same where there are thousands of robots, whose commands are on keys that are not declared:
100 declared publishers beside 10,000 commands a second take 0.3 of a core of the router."""
MAX_NAMED: Final = 300
"""Keys with subscribers of their own; beyond it a topic counts as subscribed by wildcard."""
PROBES_AT_ONCE: Final = 24
"""Key expressions that one poll tries: about a millisecond."""
MAX_PROBES: Final = 4096
"""Probes in one search; what is left then counts as subscribed."""
SEARCH_PERIOD_S: Final = 0.3
"""Time from the end of a search to the next."""


@dataclass(frozen=True)
class SubscribedKeys:
    """Keys that have subscribers.

    Attributes:
        named: Those with subscribers of their own, `MAX_NAMED` at most.
        others: Those that a wildcard covers, or that are too many.
    """

    named: frozenset[str] = frozenset()
    others: frozenset[str] = frozenset()


@dataclass(frozen=True)
class KeyRange:
    """Successive keys of a sorted sequence, and a key expression that fits them all."""

    start: int
    end: int
    expression: str


class KeyRanges:
    """Sorted keys of one pattern, in ranges by their common beginning."""

    def __init__(self, pattern: str, keys: Iterable[str]) -> None:
        """Sort the keys.

        Args:
            pattern: Has a `*` for each chunk in which keys may differ.
            keys: Without wildcards; all fit the pattern.
        """
        self.pattern = pattern
        self.keys: Sequence[str] = sorted(set(keys))
        self._chunks = pattern.split("/")

    @property
    def whole(self) -> KeyRange:
        """The range of all keys."""
        return KeyRange(0, len(self.keys), self.pattern)

    def split(self, given: KeyRange) -> Iterator[KeyRange]:
        """Split a range of several keys by the first character in which they differ."""
        keys, start = self.keys, given.start
        common = _find_common((keys[start], keys[given.end - 1]))
        while start < given.end:
            head = keys[start][: len(common) + 1]
            following = head[:-1] + chr(ord(head[-1]) + 1)
            end = bisect_left(keys, following, start, given.end)
            yield KeyRange(start, end, self._make_expression(start, end))
            start = end

    def _make_expression(self, start: int, end: int) -> str:
        first = self.keys[start]
        if end - start == 1:
            return first
        *chunks, part = _find_common((first, self.keys[end - 1])).split("/")
        left = self._chunks[len(chunks) + 1 :]
        return "/".join([*chunks, f"{part}$*" if part else "*", *left])


def _find_common(texts: Sequence[str]) -> str:
    return os.path.commonprefix(texts)  # noqa: RUF071 - keys are texts, not paths


class SubscriberSearch:
    """Searches the keys of one topic for those with subscribers, again and again.

    A search costs tens of probes for each key that has a subscriber, however many keys there are.
    """

    def __init__(self, watch: SubscriberWatch, pattern: str) -> None:
        self.found = SubscribedKeys()
        """Result of the last search."""
        self.watch = watch
        self._ranges = KeyRanges(pattern, ())
        self._new_keys: Callable[[], Iterable[str]] | None = None
        self._no_key = "/".join(
            NO_NAMESPACE if chunk == "*" else chunk for chunk in pattern.split("/")
        )
        self._untried: deque[KeyRange] = deque()
        self._matched: list[str] = []
        self._probes = 0
        self._is_early = False
        self._next_s = 0.0

    @property
    def is_searching(self) -> bool:
        """Whether a search is under way."""
        return bool(self._untried)

    def set_keys(self, keys: Callable[[], Iterable[str]]) -> None:
        """Set what lists the keys, which have changed; the next search is among them."""
        self._new_keys = keys

    def poll(self, now_s: float) -> bool:
        """Continue the search, while there are subscribers; whether `found` has changed."""
        if not self._untried:
            if now_s < self._next_s:
                return False
            self._begin()
        for _ in range(PROBES_AT_ONCE):
            if not self._untried or self._probes >= MAX_PROBES:
                break
            self._try_next()
        if self._untried and self._probes < MAX_PROBES:
            return False
        self._next_s = now_s + SEARCH_PERIOD_S
        return self._finish()

    def _begin(self) -> None:
        if self._new_keys is not None:
            self._ranges = KeyRanges(self._ranges.pattern, self._new_keys())
            self._new_keys = None
        self._matched, self._probes, self._is_early = [], 0, False
        if self._ranges.keys:
            self._untried.append(self._ranges.whole)

    def _try_next(self) -> None:
        tried = self._untried.popleft()
        self._probes += 1
        is_whole = tried.expression == self._ranges.pattern
        if not self.watch.has_subscribers(tried.expression):
            # The caller knows of a subscriber, so the watch does not know of all yet.
            self._is_early = is_whole
        elif is_whole and self._is_subscribed_by_wildcard():
            self._matched.extend(self._ranges.keys)
        elif tried.end - tried.start == 1 and not is_whole:
            self._matched.append(self._ranges.keys[tried.start])
        else:
            self._untried.extend(self._ranges.split(tried))

    def _is_subscribed_by_wildcard(self) -> bool:
        self._probes += 1
        return self.watch.has_subscribers(self._no_key)

    def _finish(self) -> bool:
        if self._is_early:
            return False
        for tried in self._untried:
            self._matched += self._ranges.keys[tried.start : tried.end]
        self._untried.clear()
        matched = frozenset(self._matched)
        if len(matched) <= MAX_NAMED and not self._covers_all(matched):
            found = SubscribedKeys(named=matched)
        else:
            # Nothing tells apart who else has a subscriber of its own; who had one keeps it.
            named = self.found.named & matched
            found = SubscribedKeys(named, matched - named)
        has_changed = found != self.found
        self.found = found
        return has_changed

    def _covers_all(self, matched: frozenset[str]) -> bool:
        return len(matched) == len(self._ranges.keys) > MAX_NAMED


WILDCARD_MESSAGES_HZ: Final = 10_000.0
"""Messages a second that a process publishes at most to subscribers by wildcard on topics of many
robots: a fifth of a core of a router, and as much of the process."""
BUDGET_WINDOW_S: Final = 1.0
"""A topic that took nothing for so long leaves its part to others; counts are of such a window."""
MAX_SAVED_S: Final = 0.1
"""What a topic did not take is kept for so long."""
MAX_MISSED_SHARE: Final = 0.05
"""Share of drive states of a window that may be missed before the limit falls."""
LEAST_SHARE: Final = 0.05
"""Least share of the limit, however many states are missed."""
GROWTH: Final = 1.2
"""Growth of a lowered limit in each window in which few states are missed."""


class MessageBudget:
    """Limits the messages that go to subscribers by wildcard, in equal parts for each topic.

    The limit is halved in each second in which the process misses drive states, and grows again
    after it, so that robots are driven on any machine.
    """

    def __init__(
        self, limit_hz: float = WILDCARD_MESSAGES_HZ, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.withheld_hz = 0
        """Messages that were withheld in the last whole window, a second; 0 if it is over."""
        self._limit_hz = self._most_hz = limit_hz
        self._taken = self._states = self._missed = self._least_steps = self._former_steps = 0
        """Messages, and drive states, of the window; steps from one state to the next, 0 = none."""
        self._clock = clock
        self._left: dict[object, tuple[float, float]] = {}
        """Time of the last call [s] and messages left, by topic."""
        self._withheld = 0
        self._window_s = clock()

    def take(self, topic: object, count: int) -> int:
        """Take as many of these messages as may be published now."""
        now_s = self._clock()
        self.update(now_s)
        active = {one for one, (at_s, _) in self._left.items() if now_s - at_s < BUDGET_WINDOW_S}
        part_hz = self._limit_hz / len(active | {topic})
        before_s, left = self._left.get(topic, (now_s - MAX_SAVED_S, 0.0))
        left = min(left + (now_s - before_s) * part_hz, MAX_SAVED_S * part_hz)
        taken = min(count, int(left))
        self._left[topic] = now_s, left - taken
        self._taken += taken
        self._withheld += count - taken
        return taken

    def note_state(self, steps: int) -> None:
        """Note a drive state that is answered, by its steps since the one before, > 0.

        States are published at equal distances: the least of this window and the one before.
        """
        self._least_steps = min(steps, self._least_steps or steps)
        passed = steps // min(self._least_steps, self._former_steps or steps)
        self._states += passed
        self._missed += passed - 1

    def update(self, now_s: float | None = None) -> None:
        """Set `withheld_hz` and the limit if a window is over."""
        now_s = self._clock() if now_s is None else now_s
        if (passed_s := now_s - self._window_s) >= BUDGET_WINDOW_S:
            self.withheld_hz = round(self._withheld / passed_s)
            self._limit_hz = self._find_limit_hz()
            self._taken = self._withheld = self._states = self._missed = 0
            self._former_steps, self._least_steps = self._least_steps, 0
            self._window_s = now_s

    def _find_limit_hz(self) -> float:
        is_late = self._missed > MAX_MISSED_SHARE * self._states
        # Misses without messages, as at the start of a fleet, have other causes.
        if is_late and self._taken:
            return max(self._limit_hz / 2.0, LEAST_SHARE * self._most_hz)
        return self._limit_hz if is_late else min(GROWTH * self._limit_hz, self._most_hz)


class SubscriberWatches:
    """The watches of one process: few, as each is a session."""

    def __init__(self, network: AgentNetwork) -> None:
        self.budget = MessageBudget()
        """Budget of all topics of the process."""
        self._max_publishers = MAX_PUBLISHERS
        self._network = network
        self._unwatched: dict[str, None] = {}
        self._watches: dict[str, SubscriberWatch] = {}
        self._opened: list[SubscriberWatch] = []

    def set_world_robots(self, count: int) -> None:
        """Set how many robots the world has; topics of few of many declare fewer publishers."""
        is_among_many = count > MAX_PUBLISHERS
        self._max_publishers = MAX_PUBLISHERS_AMONG_MANY if is_among_many else MAX_PUBLISHERS

    def is_crowded(self, members: int) -> bool:
        """Whether a topic of so many robots must declare no publishers."""
        return members > self._max_publishers

    def include(self, pattern: str) -> None:
        """Watch a pattern, too, once one is searched."""
        if pattern not in self._watches:
            self._unwatched[pattern] = None

    def find(self, pattern: str) -> SubscriberWatch:
        """Find the watch of a pattern; open one if there is none."""
        if pattern not in self._watches:
            self.include(pattern)
            opened = self._network.watch_subscribers(tuple(self._unwatched))
            self._opened.append(opened)
            self._watches |= dict.fromkeys(self._unwatched, opened)
            self._unwatched.clear()
        return self._watches[pattern]

    def close(self) -> None:
        """Close all watches."""
        for opened in self._opened:
            opened.close()
        self._opened, self._watches = [], {}
