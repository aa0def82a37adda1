"""JoinedClients: clients that are awaited at their control steps, beside the one that steps."""

from dataclasses import dataclass

from zensim.sim_server.pacing.lockstep import Lockstep

MAX_JOINED = 64
"""Most clients that are awaited."""


@dataclass(frozen=True)
class JoinedState:
    """A control step that a client was woken at, and its reply; as `AwaitedState`, `StateReply`."""

    epoch: int
    step: int
    is_awaited: bool = False
    claims: bytes = b""
    order: int = 0


@dataclass
class JoinedClient:
    """A client that waits for its next control step, or works at the present one.

    Attributes:
        period: Steps between two of its control steps.
        wakes: Count of the control steps that it was woken at.
        is_gone: Whether its token has disappeared.
    """

    period: int
    wakes: int = 0
    is_gone: bool = False


class JoinedClients:
    """All clients that have joined, by name."""

    def __init__(self, lockstep: Lockstep) -> None:
        self._lockstep = lockstep
        self._clients: dict[str, JoinedClient] = {}

    def __len__(self) -> int:
        return len(self._clients)

    def __contains__(self, client: str) -> bool:
        """Whether a client has joined."""
        return client in self._clients

    def finish(self, client: str, period: int, state: JoinedState) -> JoinedClient:
        """Let a client wait for its next control step; it has finished this state."""
        joined = self._clients.setdefault(client, JoinedClient(period))
        joined.period = period
        self._lockstep.record_answer(client, state)
        return joined

    def wake(self, state: JoinedState, now_ns: int) -> tuple[str, ...]:
        """Wake the clients at their control steps; return those that were late before.

        Args:
            state: Of the present control step.
            now_ns: Wall time.
        """
        late = []
        for name, joined in self._clients.items():
            if state.step % joined.period == 0:
                joined.wakes += 1
                if not self._lockstep.record_sent(name, state, now_ns):
                    late.append(name)
        return tuple(late)

    def end(self, client: str) -> None:
        """Await a client no more: its token has disappeared."""
        if (joined := self._clients.pop(client, None)) is not None:
            joined.is_gone = True
            self._lockstep.forget(client)
