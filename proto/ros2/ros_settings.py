"""How a program appears in ROS 2: domain, distribution, tf, bridge."""

from typing import Final, Literal, get_args

import msgspec

from zensim.proto.names import check_frame
from zensim.proto.ros2.rmw_keys import OFF, parse_domain

TfScope = Literal["global", "namespaced", "both"]
"""Where transforms are told: on `/tf` with frames that begin with the namespace, on `/ns/tf`."""
DISTRIBUTION_WITHOUT_HASHES: Final = "humble"
DISTRIBUTIONS: Final = ("humble", "iron", "jazzy", "kilted", "lyrical", "rolling")


class RosSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Which domain, and in what manner."""

    domain: int | None = 0
    """None = not at all."""
    has_hashes: bool = True
    """Whether types have hashes, which humble's have not."""
    tf: TfScope = "both"
    tf_root: str = "world"
    """Frame on `/tf_static` that the robots' odometry frames hang from; empty for none."""
    is_bridged: bool = False
    """Whether zenoh-bridge-ros2dds is told too."""

    @property
    def has_global_tf(self) -> bool:
        """Whether transforms are told on `/tf`."""
        return self.tf != "namespaced"

    @property
    def has_namespaced_tf(self) -> bool:
        """Whether transforms are told on the robot's own topics."""
        return self.tf != "global"


NO_ROS: Final = RosSettings(domain=None, tf="namespaced")


def parse_ros_settings(
    domain: str, distribution: str, tf: str = "both", tf_root: str = "world", *, is_bridged: bool
) -> RosSettings:
    """Read what a command line says.

    Raises:
        ValueError: A word is not known, or the domain or the root frame is none.
    """
    if distribution not in DISTRIBUTIONS:
        raise ValueError(
            f"--ros-distro {distribution!r} is unknown; use {', '.join(DISTRIBUTIONS)}"
        )
    return RosSettings(
        domain=parse_domain(domain),
        has_hashes=distribution != DISTRIBUTION_WITHOUT_HASHES,
        tf=_parse_tf_scope(tf),
        tf_root="" if tf_root == OFF else check_frame(tf_root),
        is_bridged=is_bridged,
    )


def to_cli_arguments(settings: RosSettings) -> tuple[str, ...]:
    """Write the settings of a server as words of a command line: it tells no transforms."""
    domain = OFF if settings.domain is None else str(settings.domain)
    return (
        *("--ros-domain", domain),
        *(() if settings.has_hashes else ("--ros-distro", DISTRIBUTION_WITHOUT_HASHES)),
        *(("--ros-bridge",) if settings.is_bridged else ()),
    )


def _parse_tf_scope(word: str) -> TfScope:
    for known in get_args(TfScope):
        if known == word:
            return known  # type: ignore[no-any-return]
    raise ValueError(f"--tf {word!r} is unknown; use {', '.join(get_args(TfScope))}")
