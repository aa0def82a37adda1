"""Sessions with the settings of rmw_zenoh, and what two of them exchange.

Source of the settings: DEFAULT_RMW_ZENOH_SESSION_CONFIG.json5 of rmw_zenoh_cpp jazzy 0.2.10.
"""

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

import zenoh
import zenoh.ext

RMW_SETTINGS: Final[Mapping[str, object]] = {
    "mode": "peer",
    "listen/endpoints": ["tcp/localhost:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "scouting/gossip/multihop": False,
    "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
    "scouting/gossip/autoconnect": {"router": [], "peer": ["router", "peer"]},
    "timestamping/enabled": True,
    "queries_default_timeout": 600_000,
    "transport/link/tx/lease": 60_000,
    "transport/link/tx/keep_alive": 2,
}
"""Of each ROS 2 process, apart from the endpoint to connect to."""
RMW_DEPTH: Final = 100
"""Depth of the subscriptions of tf2_ros to `/tf` and `/tf_static`."""


@contextmanager
def open_rmw_session(
    endpoint: str, overrides: Mapping[str, object] | None = None
) -> Iterator[zenoh.Session]:
    """Open the session of a ROS 2 process.

    Args:
        endpoint: Router to connect to; empty if the overrides name it.
        overrides: Settings by path, as in ZENOH_CONFIG_OVERRIDE.
    """
    config = zenoh.Config()
    settings = {**RMW_SETTINGS, **(overrides or {})}
    if endpoint:
        settings["connect/endpoints"] = [endpoint]
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


@dataclass
class TopicReader:
    """What a subscription of rmw_zenoh received, and what the queue of its node kept of it."""

    depth: int
    samples: list[zenoh.Sample] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, sample: zenoh.Sample) -> None:
        """Take a sample."""
        with self._lock:
            self.samples.append(sample)

    def queued(self) -> list[zenoh.Sample]:
        """List what a node that was busy so far still has: the newest of its depth."""
        with self._lock:
            return self.samples[-self.depth :]


def subscribe_as_rmw(
    session: zenoh.Session, key: str, *, depth: int = RMW_DEPTH, is_transient_local: bool = False
) -> tuple[TopicReader, "zenoh.ext.AdvancedSubscriber[None]"]:
    """Subscribe as rmw_zenoh does, which uses an AdvancedSubscriber for every topic.

    Source: `SubscriptionData::init` of rmw_zenoh_cpp.
    """
    reader = TopicReader(depth)
    history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=depth)
    recovery = zenoh.ext.RecoveryConfig(heartbeat=True)  # type: ignore[call-arg]
    subscriber = zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        reader.add,
        history=history if is_transient_local else None,
        recovery=recovery if is_transient_local else None,
        subscriber_detection=is_transient_local,
    )
    return reader, subscriber
