"""The signal that ends pauses, and the queue that gives it."""

from zensim.proto.bus.bus_session import ArrivalSignal, ArrivedQueue

LONG_S = 60.0
SHORT_S = 0.001


def test_signal_of_what_arrived_before_ends_one_pause() -> None:
    signal = ArrivalSignal()
    queue: ArrivedQueue[int] = signal.make_queue(4, is_of_requests=False)
    for number in range(3):
        queue.add(number)

    signal.wait(LONG_S)
    signal.wait(SHORT_S)

    assert not signal.take_requests()


def test_signal_says_once_that_there_were_requests() -> None:
    signal = ArrivalSignal()
    queue: ArrivedQueue[int] = signal.make_queue(4, is_of_requests=True)
    for number in range(3):
        queue.add(number)

    signal.wait(LONG_S)

    assert [signal.take_requests(), signal.take_requests()] == [True, False]


def test_queue_keeps_the_newest() -> None:
    queue: ArrivedQueue[int] = ArrivalSignal().make_queue(2, is_of_requests=False)

    for number in range(4):
        queue.add(number)

    assert [queue.try_recv() for _ in range(3)] == [2, 3, None]
