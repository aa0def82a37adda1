"""How a stopwatch shares time out."""

from collections.abc import Callable, Iterator

from benchmarks.part_timer import Stopwatch


class Clock:
    """Time that passes when told to."""

    def __init__(self) -> None:
        self.ns = 0

    def now_ns(self) -> int:
        return self.ns

    def passing(self, ns: int) -> Callable[[], None]:
        def work() -> None:
            self.ns += ns

        return work


def test_stopwatch_gives_a_part_its_own_time_without_that_of_the_parts_inside() -> None:
    clock = Clock()
    watch = Stopwatch(clock.now_ns)
    inner = watch.timed("inner", clock.passing(5))

    with watch.part("outer"):
        clock.passing(1)()
        inner()
        clock.passing(2)()
    clock.passing(100)()
    inner()

    assert watch.spent_ns == {"outer": 3, "inner": 10}


def test_stopwatch_closes_a_part_that_fails() -> None:
    clock = Clock()
    watch = Stopwatch(clock.now_ns)

    def fail() -> None:
        clock.passing(4)()
        raise KeyError

    try:
        watch.timed("failing", fail)()
    except KeyError:
        clock.passing(9)()
    with watch.part("next"):
        clock.passing(1)()

    assert watch.spent_ns == {"failing": 4, "next": 1}


def test_stopwatch_does_not_count_what_is_done_with_each_item() -> None:
    clock = Clock()
    watch = Stopwatch(clock.now_ns)

    def items() -> Iterator[int]:
        for item in (1, 2):
            clock.passing(3)()
            yield item

    seen = []
    for item in watch.timed_each("items", items)():
        clock.passing(50)()
        seen.append(item)

    assert seen == [1, 2]
    assert watch.spent_ns == {"items": 6}
