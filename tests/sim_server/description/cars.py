"""URDF texts of cars and tricycles for tests."""

from tests.sim_server.description.robots import a_joint, a_link, a_robot, an_inertial

TYRE = (
    '<collision><origin rpy="1.5707963267948966 0 0"/>'
    '<geometry><cylinder radius="0.1" length="0.05"/></geometry></collision>'
)
AXLE = '<axis xyz="0 1 0"/>'
LIMIT = '<limit lower="-0.8" upper="0.8" effort="7" velocity="5"/>'
KINGPIN = f'<axis xyz="0 0 1"/>{LIMIT}'


def a_rolling(name: str, parent: str, place: str, tyre: str = TYRE) -> str:
    """A wheel on joint `<name>_joint`."""
    return a_link(name, an_inertial() + tyre) + a_joint(
        f"{name}_joint", (parent, name), "continuous", f'<origin xyz="{place}"/>{AXLE}'
    )


def a_steered(name: str, place: str, tyre: str = TYRE) -> str:
    """A wheel on `<name>_joint` that `<name>_steer_joint` turns."""
    fork = a_link(f"{name}_fork", an_inertial()) + a_joint(
        f"{name}_steer_joint",
        ("base", f"{name}_fork"),
        "revolute",
        f'<origin xyz="{place}"/>{KINGPIN}',
    )
    return fork + a_rolling(name, f"{name}_fork", "0 0 0", tyre)


def a_car(*parts: str, tyre: str = TYRE) -> str:
    """A base with four wheels: wheelbase 0.6 m, track 0.4 m; ten kilograms."""
    return a_robot(
        a_link("base", an_inertial("4")),
        a_rolling("rl", "base", "-0.3 0.2 0", tyre),
        a_rolling("rr", "base", "-0.3 -0.2 0", tyre),
        a_steered("fl", "0.3 0.2 0", tyre),
        a_steered("fr", "0.3 -0.2 0", tyre),
        *parts,
    )


def a_trike(*parts: str) -> str:
    """A base with a wheel in front that drives and steers, and two behind."""
    return a_robot(
        a_link("base", an_inertial("4")),
        a_steered("front", "0.4 0 0"),
        a_rolling("left", "base", "-0.2 0.2 0"),
        a_rolling("right", "base", "-0.2 -0.2 0"),
        *parts,
    )
