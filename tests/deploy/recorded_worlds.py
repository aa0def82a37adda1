"""Small recordings of worlds, as the page shows them."""

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType

import msgspec

from tests.recording.recordings import define_topics
from tests.spawner.page.builders import make_models, make_robot, make_snapshot
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import NANOSECONDS, Odometry, String
from zensim.proto.ros2.message_definitions import write_definition
from zensim.recording.mcap_records import AttachedFile, Channel, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.output_file import OutputFile

LENGTH_S = 10
MESH = b"solid" * 40_000
MESH_NAME = sha256(MESH).hexdigest()
SNAPSHOT_CHANNEL = 9


def write_world(
    path: Path,
    *,
    has_models: bool = True,
    begin_s: float = 100.0,
    models: Mapping[str, bytes] = MappingProxyType({}),
    malformed: bytes = b"",
) -> Path:
    """Write ten seconds of one robot, at 10 Hz: x is the time since the begin; r2 comes at 5 s.

    Args:
        path: Of the file.
        has_models: Whether it has the models of the robots.
        begin_s: Time of the first message.
        models: More files of models, by number of the roster.
        malformed: In place of the snapshots of the last two seconds; empty = as they are.
    """
    output = OutputFile(path)
    writer = McapWriter(output)
    (odom,) = define_topics(writer)
    writer.define(Schema(9, "std_msgs/msg/String", "ros2msg", write_definition(String).encode()))
    writer.define(Channel(SNAPSHOT_CHANNEL, 9, "/sim/default/snapshot", "cdr", {}))
    for number in range(10 * LENGTH_S + 1):
        passed_s, time_ns = number / 10.0, round(begin_s * NANOSECONDS) + number * 100_000_000
        names = ("r1",) if passed_s < 5.0 else ("r1", "r2")
        roster = 3 if passed_s < 5.0 else 8
        snapshot = make_snapshot(*names, roster=roster, joints=len(names), at_x=passed_s)
        text = encode(String(msgspec.json.encode(snapshot).decode()), Format.CDR)
        payload = malformed if malformed and passed_s > LENGTH_S - 2.0 else text
        writer.write_message(SNAPSHOT_CHANNEL, time_ns, 0, payload)
        writer.write_message(
            odom, time_ns, 0, encode(Odometry(child_frame_id=f"{number}"), Format.CDR)
        )
        if number % 20 == 19:
            writer.flush()
    for name, content in models.items():
        writer.attach(AttachedFile(f"models/{name}.json", "application/json", content))
    if has_models:
        for roster, names in ((4, ("r1",)), (9, ("r1", "r2"))):
            content = msgspec.json.encode(make_models(roster, **dict.fromkeys(names, make_robot())))
            writer.attach(AttachedFile(f"models/{roster}.json", "application/json", content))
    writer.attach(AttachedFile(f"meshes/{MESH_NAME}", "application/octet-stream", MESH))
    writer.flush()
    writer.close()
    output.close()
    return path
