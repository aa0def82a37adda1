"""Goals as a caller sees them, against a server whose loop turns while the caller waits."""

from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from tests.sim_server.fakes import WallTime, a_world, make_parts
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import (
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepsProgress,
)
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.runtime.loop_channels import BusInbox, BusWorldPublisher
from zensim.spawner.client.sim_client import OnProgress, SimClient, run_step_goal

if TYPE_CHECKING:
    from zensim.proto.bus import Bus
    from zensim.sim_server.world.simulated_world import World


class Served:
    """A paused world, whose server turns while somebody waits for it."""

    def __init__(self) -> None:
        self.bus = MemoryBus()
        bus = cast("Bus", self.bus)
        self.world: World = a_world("r0")
        self.world.clock.pause()
        wall = WallTime()
        parts = make_parts(self.world, wall)
        loop = ServerLoop(parts, BusInbox(bus, "default"), BusWorldPublisher(bus, "default"), wall)
        self.bus.pumps.append(loop.turn)
        self.client = SimClient(bus)

    def reach(
        self, steps: int, on_progress: OnProgress, goal_id: str = "g"
    ) -> SimulateStepsResponse:
        return run_step_goal(
            cast("Bus", self.bus),
            "default",
            SimulateStepsRequest(steps, goal_id),
            on_progress=on_progress,
            timeout_s=5.0,
        )


def test_goal_tells_its_progress_and_its_end_before_it_returns() -> None:
    served, seen = Served(), list[StepsProgress]()

    answer = served.reach(20, seen.append)

    assert (answer.status, answer.completed_steps) == ("succeeded", 20)
    assert seen[0].completed_steps == 0
    assert seen[-1] == StepsProgress("g", 20, 0, "succeeded")


def test_goal_tells_of_no_other_goal() -> None:
    served, seen = Served(), list[StepsProgress]()
    served.client.simulate_steps(3, goal_id="other")

    served.reach(3, seen.append)

    assert {one.goal_id for one in seen} == {"g"}


def test_goal_ignores_bytes_that_are_no_progress() -> None:
    served, seen = Served(), list[StepsProgress]()
    served.bus.pumps.append(
        lambda: served.bus.put("sim/default/simulate_steps_feedback", b"garbage")
    )

    served.reach(3, seen.append)

    assert seen[-1].status == "succeeded"


def test_goal_that_is_refused_says_so() -> None:
    served = Served()

    with pytest.raises(ServiceError, match="steps=0"):
        served.reach(0, lambda _: None)


def test_client_counts_the_steps_to_a_time() -> None:
    served = Served()
    served.client.step(24)

    steps = [served.client.steps_until(round(time_s * 1e9)) for time_s in (0.0, 0.1, 0.2, 0.201)]

    assert steps == [-24, 0, 24, 25]


def test_client_runs_to_a_time_and_cancels_what_is_not_there() -> None:
    served = Served()

    reached = served.client.run_to(100_000_000)

    assert reached.completed_steps == served.world.clock.steps == 24
    assert served.client.cancel_steps() == ()


def test_client_sets_the_speed() -> None:
    served = Served()

    served.client.set_speed(2.5)

    assert served.client.info().target_real_time_factor == 2.5
