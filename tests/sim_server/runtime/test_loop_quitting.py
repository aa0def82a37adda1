"""A loop ends after the reply to a request to quit."""

from tests.sim_server.fakes import a_server
from zensim.proto.messages.simulation_messages import (
    SetSimulationStateRequest,
    SimulationState,
    State,
)

QUIT = SetSimulationStateRequest(SimulationState(State.QUITTING))


class SlowDisk:
    """A journal whose records are durable after three polls."""

    earlier_responses = ()
    position = 1
    is_failing = False

    def __init__(self) -> None:
        self.polls = 0

    @property
    def durable(self) -> int:
        return int(self.polls > 3)

    def record(self, *_: object, **__: object) -> int:
        return self.position

    def poll(self) -> str:
        self.polls += 1
        return ""

    def retry(self) -> int:
        return 1

    def is_decided(self, attempt: int) -> bool:
        return bool(attempt)


def test_loop_ends_after_the_reply_to_quit() -> None:
    server = a_server("r0")
    call = server.request("set_simulation_state", QUIT)

    server.loop.run(lambda: False)

    assert len(call.answers) == 1
    assert server.world.clock.state == State.QUITTING
    assert server.world.clock.steps == 0


def test_loop_waits_for_the_journal_before_it_ends() -> None:
    disk = SlowDisk()
    server = a_server("r0", journal=disk)
    call = server.request("set_simulation_state", QUIT)

    server.loop.run(lambda: False)

    assert len(call.answers) == 1
    assert disk.polls > 3
