"""A loop that is asked to quit ends by itself, once everybody has been answered."""

from tests.sim_server.fakes import a_server
from zensim.proto.messages.simulation_messages import (
    SetSimulationStateRequest,
    SimulationState,
    State,
)

QUIT = SetSimulationStateRequest(SimulationState(State.QUITTING))


class SlowDisk:
    """A journal that keeps everything, the third time it is looked at."""

    earlier_responses = ()
    position = 1
    is_failing = False

    def __init__(self) -> None:
        self.looked_at = 0

    @property
    def durable(self) -> int:
        return int(self.looked_at > 3)

    def record(self, *_: object, **__: object) -> int:
        return self.position

    def poll(self) -> str:
        self.looked_at += 1
        return ""

    def retry(self) -> int:
        return 1

    def is_decided(self, attempt: int) -> bool:
        return bool(attempt)


def test_loop_ends_after_the_answer_when_it_is_asked_to_quit() -> None:
    server = a_server("r0")
    call = server.ask("set_simulation_state", QUIT)

    server.loop.run(lambda: False)

    assert len(call.answers) == 1
    assert server.world.clock.state == State.QUITTING
    assert server.world.clock.steps == 0


def test_loop_waits_for_the_disk_before_it_ends() -> None:
    disk = SlowDisk()
    server = a_server("r0", journal=disk)
    call = server.ask("set_simulation_state", QUIT)

    server.loop.run(lambda: False)

    assert len(call.answers) == 1
    assert disk.looked_at > 3
