"""Orders to spawn box_bots, and what came of them."""

import math

from zensim.proto import services
from zensim.proto.geometry import Point, Pose, PoseStamped, Quaternion
from zensim.proto.header import Header
from zensim.proto.services import Resource
from zensim.sim_server.desk import Desk
from zensim.sim_server.handlers.table import handle

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
) -> services.SpawnEntityOrder:
    pose = Pose(Point(*place), orientation or Quaternion())
    return services.SpawnEntityOrder(
        name,
        entity_resource=BOX_BOT,
        initial_pose=PoseStamped(Header(frame_id=frame_id), pose),
        snap_to_ground=is_snapped,
        bond=bond,
    )


def spawned(desk: Desk, order: services.SpawnEntityOrder) -> services.SpawnEntityReport:
    report = handle(desk, order)
    assert isinstance(report, services.SpawnEntityReport)
    return report


def suspicions(report: services.SpawnEntityReport) -> list[str]:
    return [entry.reason for entry in report.report if entry.status == "suspicious"]
