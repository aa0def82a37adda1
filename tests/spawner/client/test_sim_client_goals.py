"""Step goals of SimClient; the loop of the server runs while the client waits."""

from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from tests.sim_server.fakes import WallTime, a_world, make_parts
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import (
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepsProgress,
)
from zensim.proto.network_protocols import Sample
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.runtime.loop_channels import BusInbox, BusWorldPublisher
from zensim.spawner.client.sim_client import OnProgress, SimClient, run_step_goal

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus
    from zensim.proto.messages.simulation_messages import StepsGoalStatus
    from zensim.sim_server.world.simulated_world import SimulatedWorld


class ServedGoals:
    """A paused world; the server runs while the client waits."""

    def __init__(self) -> None:
        self.bus = MemoryBus()
        bus = cast("Bus", self.bus)
        self.world: SimulatedWorld = a_world("r0")
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


def test_goal_reports_its_progress_before_it_returns() -> None:
    served, seen = ServedGoals(), list[StepsProgress]()

    answer = served.reach(20, seen.append)

    assert (answer.status, answer.completed_steps) == ("succeeded", 20)
    assert seen[0].completed_steps == 0
    assert seen[-1] == StepsProgress("g", 20, 0, "succeeded")


def test_goal_ignores_progress_of_other_goals() -> None:
    served, seen = ServedGoals(), list[StepsProgress]()
    served.client.simulate_steps(3, goal_id="other")

    served.reach(3, seen.append)

    assert {one.goal_id for one in seen} == {"g"}


def test_goal_ignores_malformed_progress() -> None:
    served, seen = ServedGoals(), list[StepsProgress]()
    served.bus.pumps.append(
        lambda: served.bus.put("sim/default/simulate_steps_feedback", b"garbage")
    )

    served.reach(3, seen.append)

    assert seen[-1].status == "succeeded"


def test_refused_goal_raises() -> None:
    served = ServedGoals()

    with pytest.raises(ServiceError, match="steps=0"):
        served.reach(0, lambda _: None)


def test_steps_until_counts_steps() -> None:
    served = ServedGoals()
    served.client.step(24)

    steps = [served.client.steps_until(round(time_s * 1e9)) for time_s in (0.0, 0.1, 0.2, 0.201)]

    assert steps == [-24, 0, 24, 25]


def test_run_to_and_cancel_without_goals() -> None:
    served = ServedGoals()

    reached = served.client.run_to(100_000_000)

    assert reached.completed_steps == served.world.clock.steps == 24
    assert served.client.cancel_steps() == ()


def test_speed_is_set() -> None:
    served = ServedGoals()

    served.client.set_speed(2.5)

    assert served.client.info().target_real_time_factor == 2.5


class OvertakenProgress:
    """A bus on which the response of a goal comes before its last progress."""

    def __init__(self) -> None:
        self.batches = [["executing"], [], ["succeeded"]]

    def subscribe(self, *_: object) -> "OvertakenProgress":
        return self

    def call(self, *_: object, **__: object) -> SimulateStepsResponse:
        return SimulateStepsResponse()

    def take(self) -> list[Sample]:
        statuses = self.batches.pop(0) if self.batches else []
        progress = [StepsProgress("g", 1, 0, cast("StepsGoalStatus", one)) for one in statuses]
        return [Sample("", encode(one, Format.MSGPACK), "") for one in progress]

    def close(self) -> None:
        pass


def test_goal_reports_its_last_progress_when_the_response_overtakes_it() -> None:
    seen: list[StepsProgress] = []

    run_step_goal(
        cast("Bus", OvertakenProgress()),
        "default",
        SimulateStepsRequest(1, "g"),
        on_progress=seen.append,
        timeout_s=5.0,
    )

    assert [one.status for one in seen] == ["executing", "succeeded"]
