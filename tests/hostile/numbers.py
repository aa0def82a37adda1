"""Malformed, impossible, and too many numbers."""

from collections.abc import Callable, Iterator

from tests.hostile.case import BODY, INERTIA, MASS, NO_NUMBERS, Case, alone, pair, robot, solid

PLACES: dict[str, Callable[[str], str]] = {
    "mass": lambda n: alone(f'<inertial><mass value="{n}"/>{INERTIA}</inertial>'),
    "moment": lambda n: alone(
        f'<inertial>{MASS}<inertia ixx="{n}" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    ),
    "radius": lambda n: alone(BODY + solid(f'<sphere radius="{n}"/>')),
    "length": lambda n: alone(BODY + solid(f'<cylinder radius="1" length="{n}"/>')),
    "position": lambda n: pair(f'<origin xyz="0 0 {n}"/>'),
    "angle": lambda n: pair(f'<origin rpy="0 {n} 0"/>'),
    "axis": lambda n: pair(f'<axis xyz="0 {n} 0"/>'),
    "limit": lambda n: pair(f'<limit lower="{n}" upper="1" effort="1" velocity="1"/>', "revolute"),
    "damping": lambda n: pair(f'<dynamics damping="{n}"/>'),
    "multiplier": lambda n: pair(f'<mimic joint="k" multiplier="{n}"/>'),
}
"""Template of a robot with one number to fill in."""


def numbers() -> Iterator[Case]:
    """Make robots with one invalid number."""
    for place, robot_with in PLACES.items():
        for name, text in NO_NUMBERS.items():
            is_default = name == "empty" and place in ("limit", "damping", "multiplier")
            slug = "" if is_default else "urdf.number"
            yield Case(f"{place}_{name}", robot_with(text), slug)
    yield from _too_many()
    yield from _impossible()
    yield from _absurd()


def _too_many() -> Iterator[Case]:
    texts = {
        "box_of_two": alone(solid('<box size="1 1"/>')),
        "box_of_four": alone(solid('<box size="1 1 1 1"/>')),
        "box_of_100000": alone(solid(f'<box size="{"1 " * 100_000}"/>')),
        "position_of_two": pair('<origin xyz="0 0"/>'),
        "angle_of_four": pair('<origin rpy="0 0 0 1"/>'),
        "scale_of_two": alone(solid('<mesh filename="a.stl" scale="1 1"/>', "visual")),
        "colour_of_five": alone(
            solid('<sphere radius="1"/>', "visual").replace(
                "</visual>", '<material name="m"><color rgba="1 1 1 1 1"/></material></visual>'
            )
        ),
        "radius_of_two": alone(solid('<sphere radius="1 2"/>')),
    }
    for name, text in texts.items():
        is_seen_only = name in ("scale_of_two", "colour_of_five")
        yield Case(f"count_{name}", text, "" if is_seen_only else "urdf.number")


def _impossible() -> Iterator[Case]:
    for name, shape in {
        "zero_box": '<box size="0 1 1"/>',
        "negative_box": '<box size="1 -1 1"/>',
        "zero_sphere": '<sphere radius="0"/>',
        "negative_sphere": '<sphere radius="-1"/>',
        "zero_cylinder": '<cylinder radius="1" length="0"/>',
        "negative_cylinder": '<cylinder radius="-1" length="1"/>',
        "negative_capsule": '<capsule radius="-1" length="1"/>',
        "underflow": '<sphere radius="1e-400"/>',
    }.items():
        is_empty = name.startswith("zero") or name == "underflow"
        yield Case(f"size_{name}", alone(BODY + solid(shape)), "" if is_empty else "urdf.size")
    for name, body in {
        "negative_mass": f'<inertial><mass value="-1"/>{INERTIA}</inertial>',
        "negative_mass_of_little": f'<inertial><mass value="-1e-300"/>{INERTIA}</inertial>',
    }.items():
        yield Case(name, alone(body), "urdf.mass")
    yield Case("negative_moment", alone(BODY.replace('ixx="1"', 'ixx="-1"')), "")
    yield Case("zero_axis", pair('<axis xyz="0 0 0"/>'), "urdf.axis")
    yield Case("axis_that_underflows", pair('<axis xyz="1e-400 0 0"/>'), "urdf.axis")
    yield Case("negative_damping", pair('<dynamics damping="-1"/>'), "")
    yield Case("negative_friction", pair('<dynamics friction="-1"/>'), "")


def _absurd() -> Iterator[Case]:
    for place in ("mass", "moment", "radius", "length", "position"):
        for number in ("1e300", "-1e300", "1e13"):
            yield Case(f"absurd_{place}_{number}", PLACES[place](number), "urdf.number")
    far = '<inertial><origin xyz="1e200 0 0"/>' + MASS + INERTIA + "</inertial>"
    yield Case("absurd_centre", robot(f'<link name="a">{far}</link>'), "urdf.number")
