"""Robots on wheels for tests of drives: boxes with wheels of 0.1 m radius and 1 kg."""

from collections.abc import Sequence

from tests.sim_server.description.robots import (
    a_collision,
    a_joint,
    a_link,
    a_reference,
    a_robot,
    an_inertial,
)
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.pipeline import parse_description

TYRE = (
    '<origin rpy="1.5707963267948966 0 0"/><geometry><cylinder radius="0.1" length="0.04"/>'
    "</geometry>"
)
BODY = '<geometry><box size="0.5 0.3 0.1"/></geometry>'


def a_base(name: str = "base_link") -> str:
    """A box of 10 kg above its wheels."""
    place = '<origin xyz="0 0 0.1"/>'
    return a_link(name, an_inertial("10", origin=place) + a_collision(BODY, place))


def a_tyre(
    joint: str, x: float, y: float, *, parent: str = "base_link", axis: str = "0 1 0"
) -> str:
    """A wheel that turns about y."""
    link = f"{joint}_tyre"
    inside = f'<origin xyz="{x} {y} 0"/><axis xyz="{axis}"/>'
    wheel = a_link(link, an_inertial(diagonal="0.005") + f"<collision>{TYRE}</collision>")
    return wheel + a_joint(joint, (parent, link), "continuous", inside)


def a_steering(joint: str, x: float, y: float, limit: float = 0.7) -> str:
    """A steering joint with an upright axis."""
    inside = (
        f'<origin xyz="{x} {y} 0"/><axis xyz="0 0 1"/>'
        f'<limit lower="{-limit}" upper="{limit}" effort="100" velocity="10"/>'
    )
    knuckle = a_link(f"{joint}_knuckle", an_inertial("0.5", "0.005"))
    return knuckle + a_joint(joint, ("base_link", f"{joint}_knuckle"), "revolute", inside)


def a_diff_robot(*parts: str) -> str:
    """Two wheels 0.4 m apart, a ball behind."""
    return a_robot(a_base(), a_tyre("left", 0.0, 0.2), a_tyre("right", 0.0, -0.2), *parts)


def a_four_wheeler(*parts: str, names: Sequence[str] = ("fl", "fr", "rl", "rr")) -> str:
    """Wheels at x = ±0.25 m and y = ±0.2 m."""
    places = ((0.25, 0.2), (0.25, -0.2), (-0.25, 0.2), (-0.25, -0.2))
    wheels = (a_tyre(name, *place) for name, place in zip(names, places, strict=True))
    return a_robot(a_base(), *wheels, *parts)


def a_car(*parts: str) -> str:
    """Driven wheels at x = 0, steered wheels at x = 0.6 m, both 0.4 m apart."""
    return a_robot(
        a_base(),
        a_tyre("rear_left", 0.0, 0.2),
        a_tyre("rear_right", 0.0, -0.2),
        a_steering("steer_left", 0.6, 0.2),
        a_steering("steer_right", 0.6, -0.2),
        a_tyre("front_left", 0.0, 0.0, parent="steer_left_knuckle"),
        a_tyre("front_right", 0.0, 0.0, parent="steer_right_knuckle"),
        *parts,
    )


def reverse_axes(text: str, *joints: str) -> str:
    """Let the axes of wheels point to the right, as mirrored links of left and right have them."""
    for name in joints:
        head, found, tail = text.partition(f'<joint name="{name}"')
        text = head + found + tail.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', 1)
    return text


def a_tricycle(*parts: str) -> str:
    """A wheel that drives and steers at x = 0.5 m, two passive ones at x = 0."""
    return a_robot(
        a_base(),
        a_tyre("rear_left", 0.0, 0.2),
        a_tyre("rear_right", 0.0, -0.2),
        a_steering("steer", 0.5, 0.0, limit=1.5),
        a_tyre("front", 0.0, 0.0, parent="steer_knuckle"),
        *parts,
    )


def a_four_steerer(*parts: str) -> str:
    """Four driven wheels that steer, at x = ±0.3 m and y = ±0.2 m."""
    places = {"fl": (0.3, 0.2), "fr": (0.3, -0.2), "rl": (-0.3, 0.2), "rr": (-0.3, -0.2)}
    wheels = (
        a_steering(f"{name}_steer", *place) + a_tyre(name, 0.0, 0.0, parent=f"{name}_steer_knuckle")
        for name, place in places.items()
    )
    return a_robot(a_base(), *wheels, *parts)


FOUR_STEERER = "ackermann:fl,fr,rl,rr,fl_steer,fr_steer,rl_steer,rr_steer"
"""The drive of `a_four_steerer`."""


def a_virtual_car() -> str:
    """A car whose wheels and steering joints mimic joints that move no collision."""

    def follow(leader: str) -> str:
        return f'<mimic joint="{leader}"/>'

    text = a_car(
        a_link("ghost_wheel")
        + a_joint("drive", ("base_link", "ghost_wheel"), "continuous", '<axis xyz="0 1 0"/>'),
        a_link("ghost_fork")
        + a_joint(
            "steer",
            ("base_link", "ghost_fork"),
            "revolute",
            '<axis xyz="0 0 1"/><limit lower="-0.7" upper="0.7" effort="100" velocity="10"/>',
        ),
    )
    for name, leader in {
        "rear_left": "drive", "rear_right": "drive", "steer_left": "steer", "steer_right": "steer",
    }.items():  # fmt: skip
        head, name_at, tail = text.partition(f'<joint name="{name}"')
        text = head + name_at + tail.replace("</joint>", f"{follow(leader)}</joint>", 1)
    return text


def read_driven(text: str, *controllers: str, order: DriveOrder | None = None) -> Model:
    """Read a robot with controllers' files or an order."""
    return parse_description(
        text,
        assets={},
        allow_missing=False,
        compat="fixed",
        controllers=controllers,
        drive=order or DriveOrder(),
    ).model


BALLS = "".join(
    a_link(name, a_collision(origin=f'<origin xyz="{x} 0 0"/>'))
    + a_joint(f"{name}_joint", ("base_link", name))
    + a_reference(name, "<mu1>0</mu1><mu2>0</mu2>")
    for name, x in (("front_ball", 0.2), ("rear_ball", -0.2))
)
ORDERED_ROBOTS = {
    "diff": (a_diff_robot(BALLS), "diff:left,right"),
    "diff with reversed axes": (
        reverse_axes(a_diff_robot(BALLS), "left", "right"),
        "diff:left,right",
    ),
    "diff with one reversed axis": (reverse_axes(a_diff_robot(BALLS), "right"), "diff:left,right"),
    "car with reversed axes": (
        reverse_axes(a_car(), "rear_left"),
        "ackermann:rear_left,rear_right,steer_left,steer_right",
    ),
    "mecanum": (a_four_wheeler(), "mecanum:fl,fr,rl,rr"),
    "omni": (a_four_wheeler(), "omni:fl,fr,rl,rr"),
    "car": (a_car(), "ackermann:rear_left,rear_right,steer_left,steer_right"),
    "two steered axles": (a_four_steerer(), FOUR_STEERER),
    "tricycle": (a_tricycle(), "tricycle:front,steer"),
    "tricycle with two driven wheels": (a_tricycle(), "tricycle:rear_left,rear_right,steer"),
}
"""Descriptions whose wheels do not slip, and the drives that are ordered for them."""
