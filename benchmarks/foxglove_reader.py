"""A client of the Foxglove WebSocket protocol that reads all it gets, in a process of its own.

`python -m benchmarks.foxglove_reader URL ROBOTS [tf]` subscribes to the odometry of this number of
robots, and to `/tf` if that is given. It prints a line when it has subscribed, and then each
second how many messages came since.
"""

import json
import os
import struct
import sys
import threading
import time
from contextlib import closing
from typing import Any, NoReturn

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from zensim.proto.process_limits import die_with_supervisor

SUBPROTOCOL = Subprotocol("foxglove.sdk.v1")
TRANSFORMS = "/tf"
DATA_OP = 1
COUNT_AT = 4
"""Number of transforms in a message, behind the header of CDR."""
COUNT = struct.Struct("<I")
DATA_HEAD_BYTES = 13
SCHEMAS = ("nav_msgs/msg/Odometry",)
MAX_BYTES = 64 << 20


class Reader:
    """Counts odometry messages, and transforms in messages of all robots."""

    def __init__(self, connection: ClientConnection, wanted: int, *, wants_tf: bool) -> None:
        self._connection, self._wanted, self._wants_tf = connection, wanted, wants_tf
        self._transforms = -1
        self.odometry = self.transforms = 0
        self.has_all = threading.Event()
        self._numbers: set[int] = set()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for frame in self._connection:
            if isinstance(frame, bytes):
                self._count(frame)
            elif (message := json.loads(frame))["op"] == "advertise":
                self._subscribe(message["channels"])

    def _count(self, frame: bytes) -> None:
        if frame[0] != DATA_OP:
            return
        (subscription,) = COUNT.unpack_from(frame, 1)
        if subscription == self._transforms:
            self.transforms += COUNT.unpack_from(frame, DATA_HEAD_BYTES + COUNT_AT)[0]
        else:
            self.odometry += 1

    def _subscribe(self, channels: list[dict[str, Any]]) -> None:
        chosen = [one["id"] for one in channels if one["schemaName"] in SCHEMAS]
        chosen = chosen[: self._wanted - len(self._numbers)]
        self._numbers |= {*chosen}
        for one in channels:
            if one["topic"] == TRANSFORMS and self._wants_tf:
                self._transforms = one["id"]
                chosen.append(one["id"])
        subscriptions = [{"id": number, "channelId": number} for number in chosen]
        if subscriptions:
            text = json.dumps({"op": "subscribe", "subscriptions": subscriptions})
            self._connection.send(text)
        if len(self._numbers) >= self._wanted:
            self.has_all.set()


def main() -> NoReturn:
    """Subscribe, and print what comes."""
    die_with_supervisor(os.environ)
    url, wanted, *rest = sys.argv[1:]
    link = connect(url, subprotocols=[SUBPROTOCOL], max_size=MAX_BYTES, compression=None)
    with closing(link):
        reader = Reader(link, int(wanted), wants_tf=bool(rest))
        reader.has_all.wait()
        odometry = transforms = 0
        while True:
            sys.stdout.write(
                json.dumps([reader.odometry - odometry, reader.transforms - transforms])
            )
            sys.stdout.write("\n")
            sys.stdout.flush()
            odometry, transforms = reader.odometry, reader.transforms
            time.sleep(1.0)


if __name__ == "__main__":
    main()
