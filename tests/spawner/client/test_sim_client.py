"""SimClient with the handlers of the server, on a bus in memory."""

from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from tests.sim_server.fakes import WallTime, a_world, make_parts, names_in
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.simulation_messages import Feature, ResetScope, State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, Twist, Vector3
from zensim.proto.messages.telemetry_messages import Info
from zensim.sim_server.journal.restore_progress import RestoreProgress
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.runtime.loop_channels import BusInbox, BusWorldPublisher
from zensim.sim_server.runtime.restore_replies import RestoreReplies
from zensim.spawner.client.sim_client import SimClient

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus
    from zensim.proto.network_protocols import ServerNetwork


class ServedWorld:
    """A client and a server; the server runs while the client waits."""

    def __init__(self, *names: str) -> None:
        self.bus = MemoryBus()
        bus = cast("Bus", self.bus)
        self.world = a_world(*names)
        wall = WallTime()
        loop = ServerLoop(
            make_parts(self.world, wall),
            BusInbox(bus, "default"),
            BusWorldPublisher(bus, "default"),
            wall,
        )
        self.bus.pumps.append(loop.turn)
        self.client = SimClient(bus)


def test_client_spawns_and_deletes() -> None:
    served = ServedWorld("r0")

    report = served.client.spawn(SpawnEntityOrder("r1", entity_resource=Resource("box_bot")))
    served.client.delete("r0")

    assert (report.entity_name, report.entity_namespace) == ("r1", "r1")
    assert names_in(served.world) == ["r1"]
    assert served.client.entities() == ("r1",)


def test_refusal_is_raised() -> None:
    served = ServedWorld("r0")

    with pytest.raises(ServiceError, match="'r9'") as error:
        served.client.delete("r9")

    assert (error.value.service, error.value.code) == ("delete_entity", ResultCode.NOT_FOUND)


def test_entity_state_is_set() -> None:
    served = ServedWorld("r0")
    served.world.clock.pause()
    state = EntityState(pose=Pose(Point(1.0, 2.0, 3.0)), twist=Twist(Vector3(0.5)))

    served.client.set_entity_state("r0", state)

    found = served.client.entity_state("r0")
    assert found.pose.position == Point(1.0, 2.0, 3.0)
    assert found.twist.linear.x == 0.5


def test_models_have_agents() -> None:
    served = ServedWorld("r0", "r1")
    served.world.claim("a", ("r1",), "stop")

    models = served.client.models()

    assert [(one.entity, one.agent) for one in models.entities] == [("r0", ""), ("r1", "a")]
    assert served.client.entity_model("r1").agent == "a"


def test_simulation_is_paused_stepped_and_played() -> None:
    served = ServedWorld()
    served.client.set_simulation_state(State.PAUSED)
    before = served.client.info().steps

    served.client.step(20)

    assert served.client.info().steps == before + 20
    assert served.client.simulation_state() == State.PAUSED
    served.client.set_simulation_state(State.PLAYING)
    assert served.client.simulation_state() == State.PLAYING


def test_simulation_is_reset() -> None:
    served = ServedWorld("r0")

    served.client.reset(ResetScope.STATE)
    kept = served.client.entities()
    served.client.reset()

    assert (kept, served.client.entities()) == (("r0",), ())


def test_features_are_returned() -> None:
    features = ServedWorld().client.features()

    assert Feature.SPAWNING in features.features


def test_waiting_for_a_server_has_a_timeout() -> None:
    waits: list[int] = []
    client = SimClient(cast("Bus", MemoryBus()))

    with pytest.raises(NoServer):
        client.wait_for_server(0.0, lambda: waits.append(1))

    assert waits == []


def test_waiting_for_a_server_ends_when_it_starts() -> None:
    served = ServedWorld("r0")

    info = served.client.wait_for_server(0.0)

    assert (info.world, info.entities) == ("default", 1)


def test_waiting_for_a_server_waits_for_the_end_of_its_restore() -> None:
    bus, progress = MemoryBus(), RestoreProgress(total=2, done=1)
    replies = RestoreReplies(cast("ServerNetwork", bus), "default", progress, is_secured=False)
    bus.pumps.append(replies.poll)

    with pytest.raises(TimeoutError, match="1 of 2"):
        SimClient(cast("Bus", bus)).wait_for_server(0.0)


class RestoringClient(SimClient):
    """Of a server that restores for some calls."""

    def __init__(self, calls: int, timeout_s: float) -> None:
        super().__init__(cast("Bus", MemoryBus()), timeout_s=timeout_s)
        self._calls = calls

    def info(self) -> Info:
        self._calls -= 1
        return Info(state="restoring") if self._calls >= 0 else Info(state="playing", entities=3)


def test_info_is_read_again_until_a_restore_ends() -> None:
    assert RestoringClient(2, timeout_s=10.0).info_when_restored().entities == 3


def test_info_of_a_restore_that_outlasts_a_call_is_refused() -> None:
    with pytest.raises(TimeoutError):
        RestoringClient(10**6, timeout_s=0.0).info_when_restored()


def test_client_calls_its_own_world_only() -> None:
    served = ServedWorld()
    other = SimClient(cast("Bus", served.bus), "other")

    with pytest.raises(NoServer, match="sim/other/info"):
        other.info()


@pytest.mark.parametrize(("late_ns", "steps"), [(-1, 4), (0, 4), (1, 5)])
def test_steps_are_counted_until_the_first_at_or_after_a_time(late_ns: int, steps: int) -> None:
    served = ServedWorld("r0")
    served.world.clock.pause()
    info = served.client.info()
    now_ns = round(info.sim_time_s * 1e9)

    assert served.client.steps_until(now_ns + 4 * info.step_ns + late_ns) == steps
