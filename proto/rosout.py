"""Warnings and errors of a program on `/rosout`, as the nodes of ROS 2 publish theirs."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import NANOSECONDS, time_from_ns
from zensim.proto.network_protocols import Stamp, TopicNetwork
from zensim.proto.printable_text import printable_lines
from zensim.proto.ros2.node_messages import LogLevel, RosoutLog
from zensim.proto.ros2.qos_profiles import Qos
from zensim.proto.ros2.rmw_attachment import Attachment, write_attachment
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, RosTopic, gid_from_endpoint
from zensim.proto.topic_endpoints import make_cache_key

ROSOUT: Final = RosTopic(
    "rosout", RosoutLog, Qos(durability="transient_local", depth=1000, lifespan_ns=10 * NANOSECONDS)
)
"""The profile of rcl_qos_profile_rosout_default."""
LOGGER: Final = logging.getLogger("zensim")
MAX_WAITING: Final = 100
"""Lines that wait for their publication; further ones are counted only."""
RATE_HZ: Final = 10
BURST: Final = 50
"""Lines that are published at once after a silence; then `RATE_HZ`."""
MAX_TEXT: Final = 1024
"""Characters of a line."""
QUERY_DEPTH: Final = 64
FOR_OPERATORS: Final = {"is_for_operators": True}
"""Extra of a log record that names users: it is not published to all of ROS 2."""
PACKAGE: Final = "zensim"


class LogCollector(logging.Handler):
    """Keeps log records of any thread until they are taken."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.ignored_thread = 0
        """Thread that publishes now: what it logs would be published again and again."""
        self._waiting: deque[logging.LogRecord] = deque()
        self._left_out = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record, or count it."""
        if record.thread == self.ignored_thread or FOR_OPERATORS.items() <= vars(record).items():
            return
        if len(self._waiting) < MAX_WAITING:
            self._waiting.append(record)
        else:
            self._left_out += 1

    def start(self) -> None:
        """Collect warnings and errors of this process from now on."""
        LOGGER.addHandler(self)

    def stop(self) -> None:
        """Collect nothing more; further calls do nothing."""
        LOGGER.removeHandler(self)

    def take(self) -> logging.LogRecord | None:
        """Take the oldest record."""
        return self._waiting.popleft() if self._waiting else None

    def take_left_out(self) -> int:
        """Count the records since the last call that were not kept."""
        self.acquire()
        try:
            count, self._left_out = self._left_out, 0
        finally:
            self.release()
        return count


def make_log(record: logging.LogRecord, logger: str) -> RosoutLog:
    """Convert a log record; the file is that below the folder of the package."""
    _, folder, file = record.pathname.rpartition(f"/{PACKAGE}/")
    return RosoutLog(
        stamp=time_from_ns(round(record.created * NANOSECONDS)),
        level=_find_level(record.levelno),
        name=logger,
        msg=printable_lines(_find_text(record)[:MAX_TEXT]),
        file=f"{folder.lstrip('/')}{file}",
        function=record.funcName or "",
        line=record.lineno,
    )


def _find_text(record: logging.LogRecord) -> str:
    try:
        text = record.getMessage()
    except (TypeError, ValueError):
        text = str(record.msg)  # its arguments do not fit
    error = record.exc_info[1] if record.exc_info else None
    return text if error is None else f"{text}: {type(error).__name__}: {error}"


def _find_level(level: int) -> LogLevel:
    if level >= logging.CRITICAL:
        return LogLevel.FATAL
    return LogLevel.ERROR if level >= logging.ERROR else LogLevel.WARN


class _KeptLine(NamedTuple):
    payload: bytes
    attachment: bytes
    stamp: Stamp


class _LinePublisher:
    """Publisher of one node, whose late subscribers get the lines that are kept."""

    def __init__(self, network: TopicNetwork, node: RosNode, kept: deque[_KeptLine]) -> None:
        self.node = node
        self.logger = node.full_name.strip("/").replace("/", ".")
        self._kept = kept
        self._network = network
        self._gid = gid_from_endpoint(node.add_topic_endpoint("MP", ROSOUT))
        self._key = node.data_key(ROSOUT)
        keys = (self._key, ROSOUT.key) if node.graph.settings.is_bridged else (self._key,)
        self._publishers = [network.advertise(key, ROSOUT.encoding) for key in keys]
        cache_key = make_cache_key(self._key, node.graph.zid)
        self._queries = network.serve(cache_key, QUERY_DEPTH)
        node.announce_cache(cache_key)
        self._sent = 0

    def send(self, log: RosoutLog) -> None:
        """Publish a line, and keep it for late subscribers."""
        self._sent += 1
        line = _KeptLine(
            encode(log, Format.CDR),
            write_attachment(Attachment(self._sent, time.time_ns(), self._gid)),
            self._network.stamp(),
        )
        self._kept.append(line)
        for publisher in self._publishers:
            publisher.send(*line)

    def reply_to_late_joiners(self) -> None:
        """Reply to all queued queries."""
        for call in self._queries.take():
            for line in self._kept:
                call.add_reply(
                    self._key, line.payload, ROSOUT.encoding, line.attachment, line.stamp
                )
            call.drop()

    def close(self) -> None:
        """Undeclare the publisher; its node undeclares the endpoint."""
        for publisher in self._publishers:
            publisher.close()
        self._queries.close()


class Rosout:
    """Warnings and errors of this process on `/rosout`, from the first of its nodes."""

    def __init__(
        self,
        network: TopicNetwork,
        graph: RosGraph,
        collector: LogCollector | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Publish nothing yet.

        Args:
            network: Session of the publisher.
            graph: With the nodes of this process.
            collector: With what was logged so far; None = begin to collect now, if there are ROS 2
                endpoints.
            now_s: Wall time [s] from any origin.
        """
        self._network = network
        self._graph = graph
        self._now_s = now_s
        self._collector = collector or LogCollector()
        self._kept: deque[_KeptLine] = deque(maxlen=ROSOUT.qos.depth)
        self._publisher: _LinePublisher | None = None
        self._is_closed = False
        self._credit, self._credited_s = float(BURST), now_s()
        if collector is None and graph.domain is not None:
            self._collector.start()

    def poll(self) -> None:
        """Publish what was logged, at a limited rate, and reply to late subscribers."""
        publisher = self._find_publisher()
        if publisher is None:
            return
        self._collector.ignored_thread = threading.get_ident()
        try:
            self._publish_some(publisher)
            publisher.reply_to_late_joiners()
        finally:
            self._collector.ignored_thread = 0

    def close(self) -> None:
        """Publish what was logged last, and stop."""
        self._collector.stop()
        self.poll()
        self._is_closed = True
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None

    def _find_publisher(self) -> _LinePublisher | None:
        """Find the publisher; if its node has left the graph, make one at another."""
        if self._publisher is not None and self._publisher.node.is_closed:
            self._publisher.close()
            self._publisher = None
        if self._publisher is None and self._graph.nodes and not self._is_closed:
            # The node of a pool rather than that of one of its robots.
            node = min(self._graph.nodes, key=lambda one: one.full_name.count("/"))
            self._publisher = _LinePublisher(self._network, node, self._kept)
        return self._publisher

    def _publish_some(self, publisher: _LinePublisher) -> None:
        now_s = self._now_s()
        self._credit = min(BURST, self._credit + (now_s - self._credited_s) * RATE_HZ)
        self._credited_s = now_s
        while self._credit >= 1.0:
            if (record := self._collector.take()) is None:
                self._publish_count(publisher)
                return
            self._credit -= 1.0
            publisher.send(make_log(record, publisher.logger))

    def _publish_count(self, publisher: _LinePublisher) -> None:
        """Publish how many lines were left out."""
        if count := self._collector.take_left_out():
            self._credit -= 1.0
            stamp = time_from_ns(time.time_ns())
            text = f"{count} further warnings and errors were not published; see standard error"
            log = RosoutLog(stamp, LogLevel.WARN, publisher.logger, text)
            publisher.send(log)
