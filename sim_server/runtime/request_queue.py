"""Requests that wait for their turn: round robin by client, bounded by time, number and bytes."""

from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Final

from zensim.proto.network_protocols import ServiceCall
from zensim.sim_server.errors import SimError

MAX_WAITING: Final = 256
"""Requests of one client that may wait."""
MAX_WAITING_BYTES: Final = 16 << 20
"""Bytes of the requests of one client that may wait."""
MAX_CLIENTS: Final = 1024
"""Clients with waiting requests; a client may call itself by a new name each time."""
BUDGET_SHARE: Final = 4
"""Divisor of the time of a step: at most one part in so many goes to requests."""
SPARE_SHARE: Final = 0.75
"""Part of the time until the next step that requests that were begun may use, if that is more; the
rest is for the threads of the network."""
LATE_NS: Final = 20_000_000
"""A loop that is later than this gives requests half as much."""
SHARE_OF_CLIENT: Final = 0.75
"""Part of it that one client may use, so that others do not wait for the next step."""
MIN_BUDGET_NS: Final = 250_000
"""Least time for requests between two steps, so that short steps do not starve them."""
REQUEST_FEE_NS: Final = 50_000
"""What a request costs the threads of the network, which share the cores with the loop."""
SLICE_NS: Final = 2_000_000
"""Time for requests of a turn when no step is due, before other traffic is served."""


class RequestBusy(SimError):
    """Too many requests wait already."""

    slug = "request.busy"


class RequestBudget:
    """Time of the loop's thread for requests between two steps, shared by their clients.

    No client uses it up alone. A request that takes more than is left gives its client a debt,
    which the budgets of the next steps pay, in equal parts for all debtors; a client with a debt
    waits, and the others do not.
    """

    def __init__(self, used_ns: Callable[[], int]) -> None:
        """Start with the least budget.

        Args:
            used_ns: Reads the CPU time of the loop's thread.
        """
        self._read_used_ns = used_ns
        self._budget_ns = self._spare_ns = MIN_BUDGET_NS
        self._used_ns = self._begun_ns = 0
        self._used_by_ns: dict[str, int] = {}
        """Time used since the last step, and debt, by client."""

    @property
    def is_used_up(self) -> bool:
        """Whether all requests wait for the next step; begun ones first use the spare time."""
        spared_ns = min(self._begun_ns, max(self._spare_ns, 0))
        return self._used_ns - spared_ns >= self._budget_ns

    def may_run(self, client: str) -> bool:
        """Whether a client's next request may run now; after a step the first always may."""
        used_ns = self._used_by_ns.get(client, 0)
        return not self.is_used_up and used_ns < self._budget_ns * SHARE_OF_CLIENT

    def may_finish(self, client: str) -> bool:
        """Whether a client's request that was begun before may be finished now."""
        used_ns = self._used_by_ns.get(client, 0)
        is_spared = used_ns < max(self._budget_ns * SHARE_OF_CLIENT, self._spare_ns)
        return is_spared and self._used_ns < max(self._budget_ns, self._spare_ns)

    @contextmanager
    def charge(self, client: str, fee_ns: int = 0, *, is_begun: bool = False) -> Iterator[None]:
        """Count the time that the block takes for a client, and a fee; begun ones apart."""
        start_ns = self._read_used_ns()
        try:
            yield
        finally:
            used_ns = self._read_used_ns() - start_ns + fee_ns
            self._used_ns += used_ns
            self._begun_ns += used_ns if is_begun else 0
            self._used_by_ns[client] = self._used_by_ns.get(client, 0) + used_ns

    def begin_step(self, step_ns: int, late_ns: int = 0, spare_ns: int = 0) -> None:
        """Start the budget between two steps.

        Args:
            step_ns: Wall time of a step.
            late_ns: By how much the last one began late.
            spare_ns: Wall time until the next one is due.
        """
        share = BUDGET_SHARE * 2 if late_ns > LATE_NS else BUDGET_SHARE
        self._budget_ns = max(step_ns // share, MIN_BUDGET_NS)
        self._spare_ns = round(spare_ns * SPARE_SHARE)
        self._used_ns = self._begun_ns = 0
        # What nobody else needs pays debts, too: a large spawn uses an idle loop.
        if self._used_by_ns:
            self._used_by_ns = _pay(self._used_by_ns, max(self._budget_ns, self._spare_ns))

    def begin_slice(self) -> None:
        """Start a budget without debts: no step waits for requests."""
        self._budget_ns, self._spare_ns, self._used_ns = SLICE_NS, 0, 0
        self._begun_ns = 0
        self._used_by_ns.clear()


def _pay(used_by_ns: dict[str, int], budget_ns: int) -> dict[str, int]:
    """Divide a budget equally among debts; what small ones leave goes to the others."""
    debts_ns = {}
    by_size = sorted(used_by_ns.items(), key=itemgetter(1))
    for index, (client, debt_ns) in enumerate(by_size):
        paid_ns = min(debt_ns, budget_ns // (len(by_size) - index))
        budget_ns -= paid_ns
        if debt_ns > paid_ns:
            debts_ns[client] = debt_ns - paid_ns
    return debts_ns


@dataclass
class WaitingRequests:
    """Requests of one client, oldest first."""

    calls: deque[ServiceCall] = field(default_factory=deque)
    size: int = 0


class RequestQueue:
    """Waiting requests of all clients; each client's are in order."""

    def __init__(
        self, budget: RequestBudget, has_reply_backlog: Callable[[str], bool] = lambda _: False
    ) -> None:
        """Create an empty queue.

        Args:
            budget: Time for requests.
            has_reply_backlog: Whether a client has so many unsent replies that its requests
                wait.
        """
        self._budget = budget
        self._has_reply_backlog = has_reply_backlog
        self._clients: OrderedDict[str, WaitingRequests] = OrderedDict()

    @property
    def is_idle(self) -> bool:
        """Whether no request waits, but those of clients whose replies are not sent."""
        return all(map(self._has_reply_backlog, self._clients))

    def add(self, call: ServiceCall) -> None:
        """Append a request.

        Raises:
            RequestBusy: Too many requests wait, of this client or in all.
        """
        waiting = self._clients.get(call.client)
        if waiting is None:
            if len(self._clients) >= MAX_CLIENTS:
                raise RequestBusy(f"requests of {MAX_CLIENTS} clients wait, which is the limit")
            waiting = self._clients[call.client] = WaitingRequests()
        elif len(waiting.calls) >= MAX_WAITING:
            raise RequestBusy(
                f"{MAX_WAITING} requests of this client wait, which is the limit; "
                "send more when these have replies"
            )
        elif waiting.size + call.size > MAX_WAITING_BYTES:
            raise RequestBusy(
                f"requests of {MAX_WAITING_BYTES} bytes of this client wait, which is the limit; "
                "send more when these have replies"
            )
        waiting.calls.append(call)
        waiting.size += call.size

    def has_room(self, client: str) -> bool:
        """Whether another request of a client may wait, if it is not too large."""
        waiting = self._clients.get(client)
        return waiting is None or len(waiting.calls) < MAX_WAITING

    def take_next(self) -> ServiceCall | None:
        """Take the next request that may run now; clients take turns."""
        for client in self._clients:
            if self._budget.may_run(client) and not self._has_reply_backlog(client):
                return self._take_from(client)
        return None

    def _take_from(self, client: str) -> ServiceCall:
        waiting = self._clients[client]
        call = waiting.calls.popleft()
        waiting.size -= call.size
        if waiting.calls:
            self._clients.move_to_end(client)
        else:
            del self._clients[client]
        return call
