"""A ROS package on disk with meshes of our own, for tests."""

import struct
from pathlib import Path

CORNERS = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


def tetrahedron(scale: float = 1.0) -> bytes:
    """Write a tetrahedron with legs of 0.1 m as binary STL."""
    facets = b"".join(
        struct.pack("<12fH", 0.0, 0.0, 0.0, *(scale * x for i in face for x in CORNERS[i]), 0)
        for face in FACES
    )
    return b"tetrahedron".ljust(80) + struct.pack("<I", len(FACES)) + facets


def robot_of(collision: str, visual: str = "", name: str = "meshed") -> str:
    """Describe a robot of one link with these meshes."""
    drawn = f'<visual><geometry><mesh filename="{visual}"/></geometry></visual>' if visual else ""
    return (
        f'<robot name="{name}"><link name="base">'
        '<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" '
        'izz="0.01"/></inertial>'
        f'<collision><geometry><mesh filename="{collision}"/></geometry></collision>{drawn}'
        "</link></robot>"
    )


def make_package(folder: Path, name: str = "my_robot") -> Path:
    """Make a package with urdf/ and meshes/base.stl, meshes/drawn.stl."""
    package = folder / name
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    (package / "package.xml").write_text(f"<package><name>{name}</name></package>")
    (package / "meshes" / "base.stl").write_bytes(tetrahedron())
    (package / "meshes" / "drawn.stl").write_bytes(tetrahedron(1.5))
    return package
