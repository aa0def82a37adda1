"""Requests take turns by client, within the time, the number and the bytes that they may use."""

from typing import cast

import pytest

from tests.fakes import MemoryCall
from zensim.proto.network_protocols import ServiceCall
from zensim.sim_server.runtime.request_queue import (
    LATE_NS,
    MAX_CLIENTS,
    MAX_WAITING,
    MAX_WAITING_BYTES,
    RequestBudget,
    RequestBusy,
    RequestQueue,
)

STEP_NS = 4_000_000
BUDGET_NS = STEP_NS // 4


class Thread:
    """CPU time of the loop's thread."""

    def __init__(self) -> None:
        self.used_ns = 0

    def read(self) -> int:
        return self.used_ns


class Requests:
    """A queue whose requests take a set time."""

    def __init__(self) -> None:
        self.thread = Thread()
        self.budget = RequestBudget(self.thread.read)
        self.backlogged: set[str] = set()
        self.queue = RequestQueue(self.budget, self.backlogged.__contains__)
        self.budget.begin_step(STEP_NS)

    def add(self, client: str, name: str = "info", size: int = 0) -> None:
        call = MemoryCall(f"sim/w/{name}", bytes(size), "", b"")
        call.client = client
        self.queue.add(cast("ServiceCall", call))

    def handle_all(self, **cost_ns: int) -> list[str]:
        """Handle what may run now; return the clients in order."""
        handled = []
        while (call := self.queue.take_next()) is not None:
            with self.budget.charge(call.client):
                self.thread.used_ns += cost_ns[call.client]
            handled.append(call.client)
        return handled


def test_clients_take_turns() -> None:
    requests = Requests()
    for client in "aaabbc":
        requests.add(client)

    assert requests.handle_all(a=1, b=1, c=1) == list("abcaba")


def test_order_of_a_client_is_kept() -> None:
    requests = Requests()
    for name in ("first", "second", "third"):
        requests.add("a", name)

    taken = [requests.queue.take_next() for _ in range(3)]

    assert [call.name for call in taken if call is not None] == ["first", "second", "third"]
    assert requests.queue.is_idle


def test_client_whose_replies_are_not_sent_waits_alone() -> None:
    requests = Requests()
    for client in "aab":
        requests.add(client)
    requests.backlogged.add("a")

    assert requests.handle_all(a=1, b=1) == ["b"]
    was_idle = requests.queue.is_idle
    requests.backlogged.clear()
    assert (was_idle, requests.queue.is_idle) == (True, False)
    assert requests.handle_all(a=1) == ["a", "a"]


def test_no_client_uses_the_budget_up_alone() -> None:
    requests = Requests()
    for _ in range(100):
        requests.add("a")
    assert len(requests.handle_all(a=BUDGET_NS // 20)) == 15

    requests.add("b")

    assert requests.handle_all(a=1, b=BUDGET_NS // 20) == ["b"]


def test_requests_wait_for_the_next_step_when_the_budget_is_used_up() -> None:
    requests = Requests()
    for client in "abcde":
        requests.add(client)
    assert requests.handle_all(**dict.fromkeys("abcde", BUDGET_NS // 2)) == ["a", "b"]

    requests.budget.begin_step(STEP_NS)

    assert requests.handle_all(**dict.fromkeys("abcde", BUDGET_NS // 2)) == ["c", "d"]


@pytest.mark.parametrize(("late_ns", "handled"), [(LATE_NS, 75), (LATE_NS + 1, 38)])
def test_requests_get_half_as_much_while_the_loop_is_late(late_ns: int, handled: int) -> None:
    requests = Requests()
    for _ in range(100):
        requests.add("a")

    requests.budget.begin_step(STEP_NS, late_ns)

    assert len(requests.handle_all(a=BUDGET_NS // 100)) == handled


def test_fee_of_a_request_counts_as_its_time() -> None:
    requests = Requests()

    with requests.budget.charge("a", fee_ns=BUDGET_NS):
        pass

    assert requests.budget.is_used_up


def test_client_of_an_expensive_request_waits_until_its_time_is_paid_and_others_do_not() -> None:
    requests = Requests()
    for _ in range(2):
        requests.add("heavy")
    assert requests.handle_all(heavy=10 * BUDGET_NS) == ["heavy"]
    waited = 0

    while True:
        requests.budget.begin_step(STEP_NS)
        requests.add("light")
        if "heavy" in requests.handle_all(heavy=10 * BUDGET_NS, light=1000):
            break
        assert "light" not in requests.queue._clients  # noqa: SLF001
        waited += 1

    assert 8 <= waited <= 10


def test_requests_use_a_quarter_of_the_time_whatever_they_cost() -> None:
    requests, steps = Requests(), 400
    for _ in range(steps):
        for client, count in (("a", 3), ("b", 2), ("c", 1)):
            while len(waiting_of(requests, client)) < count:
                requests.add(client)
        requests.handle_all(a=5 * BUDGET_NS, b=BUDGET_NS // 3, c=BUDGET_NS // 50)
        requests.budget.begin_step(STEP_NS)

    assert requests.thread.used_ns <= 1.05 * steps * BUDGET_NS


def waiting_of(requests: Requests, client: str) -> list[ServiceCall]:
    waiting = requests.queue._clients.get(client)  # noqa: SLF001
    return [] if waiting is None else list(waiting.calls)


def test_slice_forgets_what_steps_would_have_paid() -> None:
    requests = Requests()
    for _ in range(2):
        requests.add("a")
    assert requests.handle_all(a=10 * BUDGET_NS) == ["a"]

    requests.budget.begin_slice()

    assert requests.handle_all(a=10 * BUDGET_NS) == ["a"]


def test_queue_refuses_a_client_beyond_its_number_and_no_other() -> None:
    requests = Requests()
    for _ in range(MAX_WAITING):
        requests.add("a")

    with pytest.raises(RequestBusy, match=str(MAX_WAITING)):
        requests.add("a")
    requests.add("b")


def test_queue_refuses_a_client_beyond_its_bytes_and_no_other() -> None:
    requests = Requests()
    requests.add("a", size=MAX_WAITING_BYTES)

    with pytest.raises(RequestBusy, match=str(MAX_WAITING_BYTES)):
        requests.add("a", size=1)
    requests.add("b", size=1)


def test_queue_refuses_clients_beyond_their_number() -> None:
    requests = Requests()
    for number in range(MAX_CLIENTS):
        requests.add(str(number))

    with pytest.raises(RequestBusy, match=str(MAX_CLIENTS)):
        requests.add("one more")


def test_queue_has_room_again_when_requests_are_taken() -> None:
    requests = Requests()
    requests.add("a", size=MAX_WAITING_BYTES)
    requests.handle_all(a=1)

    requests.add("a", size=MAX_WAITING_BYTES)

    assert not requests.queue.is_idle


def test_begun_requests_have_three_quarters_of_the_time_until_the_next_step() -> None:
    requests = Requests()
    requests.budget.begin_step(STEP_NS, spare_ns=STEP_NS)
    finished = 0
    while requests.budget.may_finish("a"):
        with requests.budget.charge("a"):
            requests.thread.used_ns += STEP_NS // 8
        finished += 1

    assert finished == 6  # eighths of a step
    assert not requests.budget.may_run("a")


def test_begun_request_that_uses_all_spare_time_goes_on_after_the_next_step() -> None:
    requests = Requests()
    for _ in range(3):
        requests.budget.begin_step(STEP_NS, spare_ns=STEP_NS)
        assert requests.budget.may_finish("a")
        with requests.budget.charge("a"):
            requests.thread.used_ns += STEP_NS


def test_begun_requests_have_a_quarter_of_a_step_when_no_time_is_left() -> None:
    requests = Requests()
    requests.budget.begin_step(STEP_NS, spare_ns=-STEP_NS)
    finished = 0
    while requests.budget.may_finish("a"):
        with requests.budget.charge("a"):
            requests.thread.used_ns += BUDGET_NS // 4
        finished += 1

    assert finished == 3


def test_begun_requests_in_spare_time_leave_the_budget_to_new_ones() -> None:
    requests = Requests()
    requests.budget.begin_step(STEP_NS, spare_ns=STEP_NS)
    with requests.budget.charge("a", is_begun=True):
        requests.thread.used_ns += STEP_NS // 2

    assert not requests.budget.may_run("a")
    assert requests.budget.may_run("b")
