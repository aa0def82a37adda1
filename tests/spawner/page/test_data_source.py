from hashlib import sha256
from typing import Final

import msgspec
import numpy as np
import pytest

from tests.fakes import ManualClock, MemoryBus
from tests.spawner.page.builders import World, a_robot, a_snapshot, a_wall, models_of
from zensim.proto import keys, topic_catalog
from zensim.proto.messages.asset_messages import GetAssetRequest, GetAssetResponse
from zensim.proto.messages.model_messages import Shape
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.standard_messages import Twist, TwistStamped, Vector3
from zensim.proto.messages.telemetry_messages import GetModelsRequest, GetModelsResponse
from zensim.proto.messages.world_messages import Scene
from zensim.proto.stl import write_corners
from zensim.spawner.page.data_source import (
    MIN_FRAME_PERIOD_S,
    MODELS_RETRY_S,
    SERVER_TIMEOUT_S,
    MeshFetcher,
    ViewerDataSource,
    ViewState,
)
from zensim.spawner.page.render_state import LastCommand

SNAPSHOT: Final = topic_catalog.SNAPSHOT.key("default")
NOBODY: Final[frozenset[str]] = frozenset()


class Stand:
    """A feed with the world that it listens to."""

    def __init__(self) -> None:
        self.bus = MemoryBus()
        self.clock = ManualClock()
        self.world = World(self.bus, models_of(r1=a_robot("r1"), r2=a_robot("r2")))
        self.token = self.bus.token(keys.alive_server("default"))
        fetcher = MeshFetcher(self.bus, "default", self.clock)
        self.feed = ViewerDataSource(self.bus, "default", self.clock, fetcher)

    def see(self, *names: str, roster: int = 1, at_x: float = 0.0) -> ViewState | None:
        """Let time pass and a snapshot come."""
        self.clock.sleep(1.0)
        joints = sum(name.startswith("r") for name in names)
        self.world.publish(a_snapshot(*names, roster=roster, joints=joints, at_x=at_x))
        return self.feed.newest()


def test_feed_shows_the_snapshot_with_its_status() -> None:
    stand = Stand()

    view = stand.see("r1", "r2", at_x=5.0)

    assert view is not None
    assert view.frame.base[:, 0].tolist() == [5.0, 6.0]
    assert (view.status.state, view.status.sim_time_s, view.status.robots) == ("playing", 1.0, 2)


def test_feed_shows_nothing_when_nothing_has_come() -> None:
    assert Stand().feed.newest() is None


def test_feed_asks_for_models_once_when_nobody_comes_or_goes() -> None:
    stand = Stand()

    first, second = stand.see("r1", "r2"), stand.see("r1", "r2")

    assert first is not None
    assert second is not None
    assert first.fleet is second.fleet
    assert stand.world.count(GetModelsRequest) == 1


def test_feed_asks_for_models_again_when_the_roster_changes() -> None:
    stand = Stand()
    stand.see("r1", "r2")
    stand.world.models = models_of(2, r1=a_robot(), r2=a_robot(), w1=a_wall())

    view = stand.see("r1", "r2", "w1", roster=2)

    assert view is not None
    assert (view.status.robots, view.status.entities) == (2, 3)


def test_feed_takes_the_new_model_when_a_name_is_used_again() -> None:
    stand = Stand()
    stand.see("r1", "r2")
    stand.world.models = models_of(2, r1=a_robot(), r2=a_wall())

    stand.clock.sleep(1.0)
    stand.world.publish(a_snapshot("r1", "r2", roster=2, joints=1))
    view = stand.feed.newest()

    assert view is not None
    assert view.fleet.robots == ("r1",)


def test_feed_shows_nothing_when_a_snapshot_is_ahead_of_the_models() -> None:
    stand = Stand()

    assert stand.see("r1", "r2", "r3", roster=2) is None


def test_feed_shows_meshes_once_they_have_come() -> None:
    stand = Stand()
    data = write_corners(np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]))
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh=sha256(data).hexdigest())
    stand.world.models = models_of(r1=a_robot("r1", shape=shape))
    stand.world.answers["get_asset"] = GetAssetResponse(data=data, total=len(data))

    first, second = stand.see("r1"), stand.see("r1")

    assert first is not None
    assert second is not None
    assert first.fleet.forms["r1"].links[0] == ()
    assert second.fleet.forms["r1"].links[0] == (shape,)
    assert list(second.fleet.meshes) == [shape.mesh]


def test_feed_asks_for_no_mesh_while_the_server_is_gone() -> None:
    stand = Stand()
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="a" * 64)
    stand.world.models = models_of(r1=a_robot("r1", shape=shape))
    stand.see("r1")

    stand.token.close()
    stand.clock.sleep(1.0)
    stand.feed.newest()

    assert stand.world.count(GetAssetRequest) == 0


def test_feed_tells_how_the_world_is_lit() -> None:
    stand = Stand()
    scene = Scene(background=(0.0, 0.0, 1.0, 1.0))
    stand.world.models = msgspec.structs.replace(stand.world.models, scene=scene)

    view = stand.see("r1", "r2")

    assert view is not None
    assert view.fleet.scene == scene


def test_feed_does_not_ask_at_every_snapshot_when_models_lag() -> None:
    stand = Stand()
    stand.see("r1", "r3", roster=7)
    asked = stand.world.count(GetModelsRequest)

    stand.clock.sleep(MODELS_RETRY_S / 2.0)
    stand.world.publish(a_snapshot("r1", "r3", roster=8, joints=2))
    stand.feed.newest()

    assert stand.world.count(GetModelsRequest) == asked


@pytest.mark.parametrize("payload", [b"", b"\x00", b"\xff\xff", b"{}", b"\x81\xa1a\x01"])
def test_feed_goes_on_when_bytes_are_no_snapshot(payload: bytes) -> None:
    stand = Stand()
    stand.see("r1", "r2")

    stand.clock.sleep(1.0)
    stand.bus.put(SNAPSHOT, payload)

    assert stand.feed.newest() is None
    assert stand.see("r1", "r2") is not None


def test_feed_leaves_frames_out_when_they_come_too_fast() -> None:
    stand = Stand()
    stand.see("r1", "r2")

    stand.clock.sleep(MIN_FRAME_PERIOD_S / 2.0)
    stand.world.publish(a_snapshot("r1", "r2", joints=2))
    too_early = stand.feed.newest()
    stand.clock.sleep(MIN_FRAME_PERIOD_S)

    assert too_early is None
    assert stand.feed.newest() is not None


def test_feed_tells_of_trouble_when_the_models_are_refused() -> None:
    stand = Stand()
    refusal = Result(ResultCode.OPERATION_FAILED, "refused")
    stand.world.answers["get_models"] = GetModelsResponse(refusal)

    assert stand.see("r1", "r2") is None
    assert "refused" in stand.feed.error_text


def test_feed_recovers_when_the_models_come_after_all() -> None:
    stand = Stand()
    stand.world.is_deaf = True
    stand.see("r1", "r2")
    trouble = stand.feed.error_text
    stand.world.is_deaf = False

    assert stand.see("r1", "r2") is not None
    assert "no answer" in trouble
    assert stand.feed.error_text == ""


def test_feed_is_silent_at_once_when_the_server_goes() -> None:
    stand = Stand()
    stand.see("r1", "r2")

    stand.token.close()
    stand.feed.newest()

    assert stand.feed.is_silent


def test_feed_is_silent_when_no_snapshot_comes_for_long() -> None:
    stand = Stand()
    stand.see("r1", "r2")

    stand.clock.sleep(SERVER_TIMEOUT_S + 0.1)

    assert stand.feed.newest() is None
    assert stand.feed.is_silent


def test_feed_asks_for_models_again_when_another_server_comes() -> None:
    stand = Stand()
    stand.see("r1", "r2")
    stand.token.close()
    stand.world.models = models_of(r1=a_wall(), r2=a_robot())
    stand.bus.token(keys.alive_server("default"))

    stand.clock.sleep(1.0)
    stand.world.publish(a_snapshot("r1", "r2", joints=1))
    view = stand.feed.newest()

    assert view is not None
    assert view.fleet.robots == ("r2",)
    assert not stand.feed.is_silent


def test_feed_listens_to_the_commands_of_followed_robots_only() -> None:
    stand = Stand()
    stand.see("r1", "r2")

    stand.feed.commands(frozenset({"r1", "gone"}))

    assert stand.bus.is_heard("r1/cmd_vel")
    assert not stand.bus.is_heard("r2/cmd_vel")
    stand.feed.commands(NOBODY)
    assert not stand.bus.is_heard("r1/cmd_vel")


@pytest.mark.parametrize("is_stamped", [False, True])
def test_feed_tells_the_last_command_and_its_age(*, is_stamped: bool) -> None:
    stand = Stand()
    stand.see("r1", "r2")
    stand.feed.commands(frozenset({"r1"}))
    twist = Twist(Vector3(x=0.2), Vector3(z=-0.5))

    stand.bus.put_message("r1/cmd_vel", TwistStamped(twist=twist) if is_stamped else twist)
    stand.feed.commands(frozenset({"r1"}))
    stand.clock.sleep(2.0)

    commands = stand.feed.commands(frozenset({"r1"}))

    assert commands == {"r1": LastCommand(0.2, -0.5, age_s=2.0)}


def test_feed_keeps_the_last_command_when_garbage_follows() -> None:
    stand = Stand()
    stand.see("r1", "r2")
    stand.feed.commands(frozenset({"r1"}))
    stand.bus.put_message("r1/cmd_vel", Twist(Vector3(x=0.2)))
    stand.feed.commands(frozenset({"r1"}))

    stand.bus.put("r1/cmd_vel", b"\x07garbage")

    assert stand.feed.commands(frozenset({"r1"}))["r1"].forward_mps == 0.2


def test_feed_tells_no_command_when_none_was_given() -> None:
    stand = Stand()
    stand.see("r1", "r2")

    assert stand.feed.commands(frozenset({"r1"})) == {}


def test_feed_listens_to_nothing_when_closed() -> None:
    stand = Stand()
    stand.see("r1", "r2")
    stand.feed.commands(frozenset({"r1"}))

    stand.feed.close()

    assert not stand.bus.is_heard("**")
