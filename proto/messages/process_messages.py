"""What a process uses of its host, as programs report it."""

from typing import ClassVar

import msgspec

from zensim.proto.messages.scalar_types import UInt32, UInt64


class ProcessUsage(msgspec.Struct, frozen=True):
    """CPU time and memory of a process; two of them give its share of a core."""

    ros_type: ClassVar[str] = "zensim/msg/ProcessUsage"

    host: str = ""
    process_id: UInt32 = 0
    wall_s: float = 0.0
    """Wall time at which this was read, from any origin."""
    cpu_s: float = 0.0
    """CPU time of all threads since the start of the process."""
    memory_bytes: UInt64 = 0
    """Resident memory; 0 = unknown."""


class AgentStats(msgspec.Struct, frozen=True):
    """Statistics of an agent since its start."""

    ros_type: ClassVar[str] = "zensim/msg/AgentStats"

    agent: str = ""
    robots: UInt32 = 0
    """Claimed now."""
    states: UInt64 = 0
    """Drive states that it has answered."""
    malformed: UInt64 = 0
    """Drive states and contacts that it could not read."""
    usage: ProcessUsage = ProcessUsage()
