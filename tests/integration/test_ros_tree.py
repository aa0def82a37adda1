"""Transforms as used by RViz: one tree of all robots below the frame `world`.

The listener follows tf2: parents by child, poses multiplied up to the root.
"""

import math
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh

from tests.integration.processes import (
    Server,
    eventually,
    running,
    running_agents,
    serving,
    wait_for_agents,
)
from tests.integration.robots import drive_for, robot
from tests.integration.ros_client_process import session_of
from tests.integration.ros_subscriptions import (
    DISCOVERY_S,
    TF,
    key_of,
    publishers_of,
    subscribe_transient_local,
)
from tests.proto.ros_oracle import HUMBLE
from zensim.sim_server.description.builtin_models import read_builtin_model

ROBOTS = ("r1", "r2", "r3")
"""r3 uses wheel encoders; its initial yaw is 90 degrees."""
Flat = tuple[float, float, float]
"""x, y [m] and yaw [rad] in the parent."""


@pytest.fixture(scope="module", params=[pytest.param("each", marks=pytest.mark.long_form), "pool"])
def server(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Server]:
    file = tmp_path_factory.mktemp("robot") / "counting.urdf"
    text = read_builtin_model("box_bot")
    file.write_text(text.replace("<odometry_source>1", "<odometry_source>0"), encoding="utf-8")
    with serving("--ros-domain", "0") as found, ExitStack() as stack:
        for place, name in enumerate(ROBOTS[:2]):
            found.zensim("spawn", "box_bot", "-n", name, "-x", "1", "-y", str(place))
        found.zensim("spawn", str(file), "-n", "r3", "-x", "2", "-y", "5", "-Y", "1.5707963")
        if request.param == "pool":
            stack.enter_context(running("agent", "--pool", "0", "--connect", found.endpoint))
            wait_for_agents(found, ROBOTS)
        else:
            stack.enter_context(running_agents(found, *ROBOTS))
        drive_for(
            found.client,
            [robot(found.bus, name) for name in ROBOTS],
            linear=0.2,
            angular=0.3,
            sim_s=2.0,
        )
        yield found


class Listener:
    """Keeps the newest transform and all parents of each child frame."""

    def __init__(self) -> None:
        self.parents: dict[str, set[str]] = {}
        self.newest: dict[str, Flat] = {}

    def hear(self, sample: zenoh.Sample) -> None:
        message: Any = HUMBLE.deserialize_cdr(sample.payload.to_bytes(), TF)
        for edge in message.transforms:
            moved, turned = edge.transform.translation, edge.transform.rotation
            yaw = 2.0 * math.atan2(turned.z, turned.w)
            self.parents.setdefault(edge.child_frame_id, set()).add(edge.header.frame_id)
            self.newest[edge.child_frame_id] = (moved.x, moved.y, yaw)

    def pose_in_root(self, frame: str) -> tuple[str, Flat]:
        """Find the pose of a frame in the root frame."""
        x, y, yaw = 0.0, 0.0, 0.0
        while frame in self.newest:
            at_x, at_y, turned = self.newest[frame]
            cos, sin = math.cos(turned), math.sin(turned)
            x, y, yaw = at_x + cos * x - sin * y, at_y + sin * x + cos * y, yaw + turned
            (frame,) = self.parents[frame]
        return frame, (x, y, yaw)


@pytest.fixture(scope="module")
def listener(server: Server) -> Iterator[Listener]:
    found = Listener()
    with session_of(server) as session:
        keys = [key_of_topic(session, topic) for topic in ("/tf", "/tf_static")]
        subscriptions = [subscribe_transient_local(session, key, found.hear) for key in keys]
        bases = [f"{name}/{frame}" for name in ROBOTS for frame in ("base_footprint", "base_link")]
        eventually(lambda: set(bases) <= set(found.newest), DISCOVERY_S, "transforms")
        eventually(lambda: roots_of(found) == {"world"}, DISCOVERY_S, "one root")
        yield found
        for one in subscriptions:
            one.undeclare()


def key_of_topic(session: zenoh.Session, topic: str) -> str:
    """Find the key of a topic; an agent claims its robot before its node is known."""
    found = eventually(lambda: publishers_of(session, topic) or None, DISCOVERY_S, topic)
    return key_of(found[0])


def roots_of(listener: Listener) -> set[str]:
    return {listener.pose_in_root(frame)[0] for frame in tuple(listener.newest)}


def test_each_frame_has_one_parent_and_all_are_in_one_tree(listener: Listener) -> None:
    assert all(len(parents) == 1 for parents in listener.parents.values())
    assert roots_of(listener) == {"world"}
    assert {name.partition("/")[0] for name in listener.newest} == set(ROBOTS)


@pytest.mark.parametrize("name", ROBOTS)
def test_transforms_match_simulated_poses(server: Server, listener: Listener, name: str) -> None:
    truth = server.client.entity_state(name).pose.position

    _, (x, y, _) = listener.pose_in_root(f"{name}/base_link")

    # Encoder odometry drifts: wheels slip at the start and in turns.
    assert (x, y) == pytest.approx((truth.x, truth.y), abs=0.05)
    assert math.hypot(x - 1.0, y - ROBOTS.index(name)) > 0.2
