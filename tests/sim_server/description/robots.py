"""URDF texts of small robots for tests."""

from collections.abc import Iterable

from zensim.proto.messages.model_messages import Model, ReportEntry
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

BALL = '<geometry><sphere radius="0.1"/></geometry>'


def find_any_file(uri: str) -> tuple[str, bytes]:  # noqa: ARG001  every FindFile takes a URI
    return "", b""


def a_robot(*parts: str, attributes: str = 'name="r"') -> str:
    return f"<robot {attributes}>{''.join(parts)}</robot>"


def a_link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def a_joint(name: str, ends: tuple[str, str], kind: str = "fixed", inside: str = "") -> str:
    parent, child = ends
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


def an_inertial(mass: str = "1", diagonal: str = "0.1", origin: str = "") -> str:
    return (
        f'<inertial>{origin}<mass value="{mass}"/>'
        f'<inertia ixx="{diagonal}" iyy="{diagonal}" izz="{diagonal}"/></inertial>'
    )


def a_collision(geometry: str = BALL, origin: str = "") -> str:
    return f"<collision>{origin}{geometry}</collision>"


def a_visual(geometry: str = BALL, inside: str = "") -> str:
    return f"<visual>{geometry}{inside}</visual>"


def a_wheel(name: str, y: float, axis: str = "0 1 0") -> str:
    """A wheel of radius 0.1 m on link `base`, moved by joint `<name>_joint`."""
    place = f'<origin xyz="0 {y} 0"/><axis xyz="{axis}"/>'
    return a_link(name, an_inertial() + a_collision()) + a_joint(
        f"{name}_joint", ("base", name), "continuous", place
    )


def a_cart(*parts: str) -> str:
    """A base with a left and a right wheel, 0.4 m apart and 0.2 m in diameter."""
    return a_robot(
        a_link("base", an_inertial()), a_wheel("left", 0.2), a_wheel("right", -0.2), *parts
    )


def a_plugin(filename: str, inside: str = "", name: str = "p") -> str:
    return f'<gazebo><plugin name="{name}" filename="{filename}">{inside}</plugin></gazebo>'


WHEELS = "<left_joint>left_joint</left_joint><right_joint>right_joint</right_joint>"
SIZES = "<wheel_separation>0.4</wheel_separation><wheel_diameter>0.2</wheel_diameter>"
FRAME = "<robot_base_frame>base</robot_base_frame>"


def a_drive(inside: str = "", wheels: str = WHEELS, sizes: str = SIZES, frame: str = FRAME) -> str:
    return a_plugin("libgazebo_ros_diff_drive.so", f"{wheels}{sizes}{frame}{inside}")


def a_reference(name: str, inside: str) -> str:
    return f'<gazebo reference="{name}">{inside}</gazebo>'


def report_of(text: str) -> tuple[ReportEntry, ...]:
    return read_urdf(text).report


def subjects(entries: Iterable[ReportEntry], status: str) -> list[str]:
    return [entry.subject for entry in entries if entry.status == status]


def mentions(entries: Iterable[ReportEntry], status: str, *values: str) -> bool:
    """Whether one entry with a status contains all values."""
    texts = [f"{entry.subject}: {entry.reason}" for entry in entries if entry.status == status]
    return any(all(value in text for value in values) for text in texts)


def link_names(model: Model) -> list[str]:
    return [link.name for link in model.links]


def assert_only_fault(text: str, *values: str) -> None:
    """Assert that only the plug-in is suspicious, for a reason with these words."""
    entries = report_of(text)
    assert subjects(entries, "suspicious") == ["plugin 'p'"]
    assert mentions(entries, "suspicious", *values)


def suspicious(text: str) -> list[str]:
    """List the suspicious subjects of a URDF."""
    return subjects(report_of(text), "suspicious")
