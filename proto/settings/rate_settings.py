"""Rates of the topics of robots, in place of those of their descriptions."""

from typing import Annotated

import msgspec

from zensim.proto.settings.setting import Setting


class RateOverrides(msgspec.Struct, frozen=True):
    """Rates [Hz, simulation time] of the topics of robots."""

    odom_hz: Annotated[
        float | None,
        Setting(
            help="Odometry rate; 0 = every state.",
            panel="Telemetry",
            metavar="HZ",
            unit="Hz",
            clock="simulation time",
            least=0.0,
            usual="from the robot description",
            key="agents[0].odom_rate",
        ),
    ] = None
    tf_hz: Annotated[
        float | None,
        Setting(
            help="Rate of tf; 0 = every state.",
            panel="Telemetry",
            metavar="HZ",
            unit="Hz",
            clock="simulation time",
            least=0.0,
            usual="`odom_hz`, or from the robot description",
            key="agents[0].tf_rate",
        ),
    ] = None
