"""Publishes the statistics of a program, and replies to queries with them."""

import math
import os
import socket
import time
from collections.abc import Callable
from functools import cache

import msgspec

from zensim.proto.codec.message_codec import encode
from zensim.proto.messages.process_messages import ProcessUsage
from zensim.proto.network_protocols import AgentNetwork
from zensim.proto.process_memory import read_resident_bytes
from zensim.proto.topic_catalog import TopicSpec


@cache
def read_host_name() -> str:
    """Read the name of this host."""
    return socket.gethostname()


def read_process_usage() -> ProcessUsage:
    """Read what this process uses now."""
    return ProcessUsage(
        host=read_host_name(),
        process_id=os.getpid(),
        wall_s=time.monotonic(),
        cpu_s=time.process_time(),
        memory_bytes=read_resident_bytes(),
    )


class StatsPublisher:
    """Publishes statistics at the rate of their topic, while it has subscribers."""

    def __init__(
        self,
        network: AgentNetwork,
        topic: TopicSpec,
        key: str,
        make_stats: Callable[[], msgspec.Struct],
    ) -> None:
        self._topic = topic
        self._key = key
        self._make_stats = make_stats
        self._publisher = network.advertise(key, topic.encoding)
        self._queries = network.serve(key)
        self._next_s = -math.inf

    def poll(self, now_s: float) -> None:
        """Reply to queries; publish what is due if there are subscribers."""
        for query in self._queries.take():
            query.reply(self._encode(), self._topic.encoding, self._key)
        if now_s >= self._next_s:
            self._next_s = now_s + 1.0 / self._topic.rate_hz
            if self._publisher.is_matched:
                self._publisher.send(self._encode())

    def close(self) -> None:
        """Undeclare publisher and queryable."""
        self._publisher.close()
        self._queries.close()

    def _encode(self) -> bytes:
        return encode(self._make_stats(), self._topic.format)
