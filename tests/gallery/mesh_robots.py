"""Robots with meshes of each kind that public robots collide with: wheels, bases, arms, scales."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh

WHEEL_RADIUS_M, WHEEL_WIDTH_M = 0.08, 0.04
FORMATS = ("stl", "dae", "obj", "glb")
UNITS = {"millimetres": 1e-3, "micrometres": 1e-6, "kilometres": 1e3}
"""Length [m] of one unit of the file."""
ROBOTS = ("arm", *(f"rover_{kind}" for kind in (*FORMATS, *UNITS)))
DRIVE = (
    '<gazebo><plugin name="d" filename="libgazebo_ros_diff_drive.so"><left_joint>left</left_joint>'
    "<right_joint>right</right_joint><wheel_separation>0.3</wheel_separation>"
    f"<wheel_diameter>{2 * WHEEL_RADIUS_M}</wheel_diameter></plugin></gazebo>"
)
ARM_JOINTS, MESHES_OF_ARM = 7, 17


def write_robot(folder: Path, name: str) -> Path:
    """Write the robot of a name with its meshes."""
    _, _, kind = name.partition("_")
    if kind in FORMATS:
        return write_rover(folder, name, ending=kind)
    return write_rover(folder, name, unit_m=UNITS[kind]) if kind else write_arm(folder)


def write_rover(folder: Path, name: str, *, ending: str = "stl", unit_m: float = 1.0) -> Path:
    """Write a robot with two wheels of many triangles, a concave base and a ball caster."""
    meshes = {"base": make_base(), "wheel": make_wheel(), "ball": make_ball()}
    for part, mesh in meshes.items():
        mesh.vertices /= unit_m
        mesh.export(folder / f"{name}_{part}.{ending}")

    def write_link(link: str, part: str, mass_kg: float) -> str:
        moment = mass_kg * 0.004
        return (
            f'<link name="{link}"><inertial><mass value="{mass_kg}"/><inertia ixx="{moment}" '
            f'iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial><collision>'
            f'<geometry><mesh filename="{name}_{part}.{ending}" '
            f'scale="{unit_m} {unit_m} {unit_m}"/></geometry></collision></link>'
        )

    wheels = "".join(
        write_link(f"{side}_wheel", "wheel", 0.5)
        + f'<joint name="{side}" type="continuous"><parent link="base"/>'
        f'<child link="{side}_wheel"/><origin xyz="0 {y} 0"/><axis xyz="0 1 0"/></joint>'
        for side, y in (("left", 0.15), ("right", -0.15))
    )
    casters = "".join(
        write_link(f"ball_{end}", "ball", 0.1)
        + f'<joint name="to_ball_{end}" type="fixed"><parent link="base"/>'
        f'<child link="ball_{end}"/><origin xyz="{x} 0 {0.02 - WHEEL_RADIUS_M}"/></joint>'
        f'<gazebo reference="ball_{end}"><mu1>0</mu1><mu2>0</mu2></gazebo>'
        for end, x in (("front", 0.14), ("rear", -0.14))
    )
    text = f'<robot name="{name}">{write_link("base", "base", 4.0)}{wheels}{casters}{DRIVE}</robot>'
    file = folder / f"{name}.urdf"
    file.write_text(text, encoding="utf-8")
    return file


def make_wheel() -> trimesh.Trimesh:
    """Make a wheel about y with 4,000 triangles, whose corners are on two circles and planes."""
    wheel: trimesh.Trimesh = trimesh.creation.cylinder(
        radius=WHEEL_RADIUS_M, height=WHEEL_WIDTH_M, sections=1000
    )
    wheel.apply_transform(turn_about((1, 0, 0), np.pi / 2))
    return wheel


def turn_about(axis: tuple[int, int, int], angle_rad: float) -> npt.NDArray[np.float64]:
    """Make the homogeneous matrix of a turn."""
    matrix = np.eye(4)
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix[:3, :3] += np.sin(angle_rad) * cross + (1.0 - np.cos(angle_rad)) * cross @ cross
    return matrix


def join(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Make one mesh of several."""
    joined = trimesh.util.concatenate(parts)
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def make_base() -> trimesh.Trimesh:
    """Make a tray: five finely divided plates, each in a plane."""
    plates = [
        trimesh.creation.box((0.34, 0.22, 0.01)),
        *(
            trimesh.creation.box((0.34, 0.01, 0.08)).apply_translation((0, y, 0.04))
            for y in (-0.105, 0.105)
        ),
        *(
            trimesh.creation.box((0.01, 0.22, 0.08)).apply_translation((x, 0, 0.04))
            for x in (-0.165, 0.165)
        ),
    ]
    return join([plate.subdivide().subdivide().subdivide() for plate in plates])


def make_ball() -> trimesh.Trimesh:
    """Make a ball with 5,120 triangles."""
    ball: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    return ball


def write_arm(folder: Path) -> Path:
    """Write an arm with seven joints, whose links have seventeen detailed meshes in all."""
    links, joints = [], []
    for number in range(MESHES_OF_ARM):
        make_casting(number).export(folder / f"arm_{number}.stl")
    for number in range(ARM_JOINTS + 1):
        shapes = "".join(
            f'<collision><geometry><mesh filename="arm_{mesh}.stl"/></geometry></collision>'
            for mesh in range(number, MESHES_OF_ARM, ARM_JOINTS + 1)
        )
        links.append(
            f'<link name="l{number}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" '
            f'izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{shapes}</link>'
        )
        if number:
            joints.append(
                f'<joint name="j{number}" type="revolute"><parent link="l{number - 1}"/>'
                f'<child link="l{number}"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>'
                '<limit lower="-2" upper="2" effort="100" velocity="2"/></joint>'
            )
    text = (
        f'<robot name="arm"><link name="world"/>{"".join(links)}{"".join(joints)}'
        '<joint name="held" type="fixed"><parent link="world"/><child link="l0"/></joint></robot>'
    )
    file = folder / "arm.urdf"
    file.write_text(text, encoding="utf-8")
    return file


def make_casting(seed: int) -> trimesh.Trimesh:
    """Make a part of rings in two directions: corners on common circles and planes."""
    random = np.random.default_rng(seed)
    parts = []
    for axis in (0, 2):
        ring = trimesh.creation.annulus(0.02, random.uniform(0.04, 0.08), 0.08, sections=120)
        ring.apply_transform(turn_about((0, 1, 0), axis * np.pi / 4))
        parts.append(ring.apply_translation((0, 0, random.uniform(0, 0.1))))
    return join(parts)
