"""Paths of what changes in odometry and transforms; see `zensim.proto.codec.cdr_layout`."""

from typing import Final

POSITION_AXES: Final = ("x", "y", "z")
QUATERNION_AXES: Final = ("x", "y", "z", "w")
ODOMETRY_PATHS: Final = (
    *(f"pose.pose.position.{axis}" for axis in POSITION_AXES),
    *(f"pose.pose.orientation.{axis}" for axis in QUATERNION_AXES),
    "twist.twist.linear.x",
    "twist.twist.linear.y",
    "twist.twist.angular.z",
)
ODOMETRY_COLUMNS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12)
"""Columns of the numbers of `ODOMETRY_PATHS` among those of `FleetOdometry`."""
HEADER_STAMP: Final = ("header.stamp",)


def list_tf_paths(count: int) -> tuple[str, ...]:
    """List the paths of the numbers of `count` transforms."""
    return tuple(
        f"transforms[{number}].transform.{part}"
        for number in range(count)
        for part in (
            *(f"translation.{axis}" for axis in POSITION_AXES),
            *(f"rotation.{axis}" for axis in QUATERNION_AXES),
        )
    )


def list_tf_stamps(count: int) -> tuple[str, ...]:
    """List the paths of the stamps of `count` transforms."""
    return tuple(f"transforms[{number}].header.stamp" for number in range(count))
