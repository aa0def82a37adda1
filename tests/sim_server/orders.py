"""Spawn orders of box_bots, and their reports."""

import math

from tests.sim_server.fakes import handle_request
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder, SpawnEntityReport
from zensim.proto.messages.standard_messages import Header, Point, Pose, PoseStamped, Quaternion
from zensim.sim_server.service_parts import ServerParts

BOX_BOT = Resource(uri="box_bot")
LYING = Quaternion(math.sin(math.pi / 4.0), 0.0, 0.0, math.cos(math.pi / 4.0))


def an_order(
    name: str = "r",
    *,
    place: tuple[float, float, float] = (0.0, 0.0, 0.06),
    orientation: Quaternion | None = None,
    frame_id: str = "",
    is_snapped: bool = False,
    bond: str = "",
) -> SpawnEntityOrder:
    pose = Pose(Point(*place), orientation or Quaternion())
    return SpawnEntityOrder(
        name,
        entity_resource=BOX_BOT,
        initial_pose=PoseStamped(Header(frame_id=frame_id), pose),
        snap_to_ground=is_snapped,
        bond=bond,
    )


def spawned(parts: ServerParts, order: SpawnEntityOrder) -> SpawnEntityReport:
    report = handle_request(parts, order)
    assert isinstance(report, SpawnEntityReport)
    return report


def suspicions(report: SpawnEntityReport) -> list[str]:
    return [entry.reason for entry in report.report if entry.status == "suspicious"]
