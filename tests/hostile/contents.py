"""Missing or unknown parts, missing meshes, plug-ins with unusual numbers."""

from collections.abc import Iterator

from tests.hostile.case import BODY, INERTIA, MASS, NO_NUMBERS, Case, alone, link, robot, solid

ELSEWHERE = (
    "/etc/passwd",
    "../../../../etc/passwd",
    "file:///etc/passwd",
    "file://localhost/etc/shadow",
    "FILE:///etc/passwd",
    "package://../../etc/passwd",
    "package://r/../../../etc/passwd",
    "package:///etc/passwd",
    "model://../secret.stl",
    "http://127.0.0.1:9/a.stl",
    "ftp://127.0.0.1/a.stl",
    "\\\\host\\share\\a.stl",
    "C:\\windows\\a.stl",
    "~/a.stl",
    "$HOME/a.stl",
    "/proc/self/environ",
    "/dev/zero",
    "data:model/stl;base64,AAAA",
    "a.stl%00.obj",
    "package://r/%2e%2e/%2e%2e/a.stl",
    "./././a.stl",
    "a" * 250 + ".stl",
)
"""Locations without meshes."""


def contents() -> Iterator[Case]:
    """Make robots with missing, unknown or external parts."""
    for i, uri in enumerate(ELSEWHERE):
        yield Case(f"mesh_{i}", alone(solid(f'<mesh filename="{uri}"/>')), "mesh.missing")
        seen = alone(BODY + solid(f'<mesh filename="{uri}"/>', "visual"))
        yield Case(f"visual_mesh_{i}", seen, "")
    yield from _parts()
    yield from _plugins()
    yield from _odd_but_read()


def _parts() -> Iterator[Case]:
    shapes = {
        "nothing": ("", "urdf.geometry"),
        "torus": ("<torus/>", "urdf.geometry"),
        "plane": ('<plane normal="0 0 1"/>', "urdf.geometry"),
        "box_without_size": ("<box/>", "urdf.size"),
        "sphere_without_radius": ("<sphere/>", "urdf.radius"),
        "cylinder_without_length": ('<cylinder radius="1"/>', "urdf.length"),
        "mesh_without_filename": ("<mesh/>", "urdf.filename"),
        "mesh_of_empty_filename": ('<mesh filename=""/>', "urdf.filename"),
        "mesh_of_long_filename": (f'<mesh filename="{"a" * 5000}"/>', "urdf.text"),
        "mesh_of_scale_0": ('<mesh filename="a.stl" scale="0 1 1"/>', ""),
    }
    for name, (shape, slug) in shapes.items():
        yield Case(f"geometry_{name}", alone(solid(shape)), slug)
    parts = {
        "collision_without_geometry": ("<collision/>", "urdf.geometry"),
        "visual_without_geometry": ("<visual/>", ""),
        "inertial_without_mass": (f"<inertial>{INERTIA}</inertial>", "urdf.mass"),
        "inertial_without_inertia": (f"<inertial>{MASS}</inertial>", ""),
        "mass_without_value": (f"<inertial><mass/>{INERTIA}</inertial>", "urdf.value"),
        "mass_as_text": (f"<inertial><mass>1</mass>{INERTIA}</inertial>", "urdf.value"),
        "inertia_without_ixx": (
            f'<inertial>{MASS}<inertia iyy="1" izz="1"/></inertial>',
            "urdf.ixx",
        ),
    }
    for name, (inside, slug) in parts.items():
        yield Case(name, alone(inside), slug)


def _plugins() -> Iterator[Case]:
    wheels = link("l") + link("r")
    joints = "".join(
        f'<joint name="{side}" type="continuous"><parent link="a"/><child link="{side}"/></joint>'
        for side in "lr"
    )
    for tag in ("wheel_separation", "wheel_diameter", "max_wheel_torque", "update_rate"):
        for name in ("nan", "infinite", "word", "too_large"):
            block = (
                '<gazebo><plugin name="d" filename="libgazebo_ros_diff_drive.so">'
                "<left_joint>l</left_joint><right_joint>r</right_joint>"
                f"<{tag}>{NO_NUMBERS[name]}</{tag}></plugin></gazebo>"
            )
            text = robot(link("a"), wheels, joints, block)
            yield Case(f"drive_{tag}_{name}", text, f"drive.{tag}")
    for tag, number, slug in (
        ("wheel_separation", "1e308", "drive.wheel_separation"),
        ("wheel_diameter", "1e-320", "drive.wheel_diameter"),
        ("wheel_separation", "${track}", "urdf.xacro"),
        ("num_wheel_pairs", "-3", "drive.num_wheel_pairs"),
        ("num_wheel_pairs", "1e11", ""),
    ):
        block = (
            '<gazebo><plugin name="d" filename="libgazebo_ros_diff_drive.so">'
            "<left_joint>l</left_joint><right_joint>r</right_joint>"
            f"<{tag}>{number}</{tag}></plugin></gazebo>"
        )
        text = robot(link("a"), wheels, joints, block)
        yield Case(f"drive_{tag}_{number}", text, slug)
    for name, number in {"nan": "nan", "negative": "-1", "word": "much"}.items():
        block = f'<gazebo reference="a"><mu1>{number}</mu1></gazebo>'
        yield Case(f"friction_{name}", robot(link("a"), block), "gazebo.mu1")
    for tag, text in {"pose": "0 0", "update_rate": "nan"}.items():
        inside = f'<sensor type="imu" name="s"><{tag}>{text}</{tag}></sensor>'
        block = f'<gazebo reference="a">{inside}</gazebo>'
        yield Case(f"sensor_with_{tag}_{text}", robot(link("a"), block), f"sensor.{tag}")
    block = '<gazebo reference="a"><sensor type="ray"/></gazebo>' * 9000
    yield Case("sensors_9000", robot(link("a"), block), "sensor.count")


def _odd_but_read() -> Iterator[Case]:
    blocks = {
        "plugin_of_no_name": '<gazebo><plugin filename="x"/></gazebo>',
        "plugin_of_no_file": '<gazebo><plugin name="x"/></gazebo>',
        "plugin_by_path": '<gazebo><plugin name="x" filename="/bin/sh"/></gazebo>',
        "plugin_without_anything": "<gazebo><plugin/></gazebo>",
        "empty_block": "<gazebo/>",
        "block_of_a_ghost": '<gazebo reference="ghost"><mu1>1</mu1></gazebo>',
        "blocks_5000": "<gazebo/>" * 5000,
        "unknown_tags_5000": "".join(f"<t{i}/>" for i in range(5000)),
        "misspelt_tags_5000": "<lnik/>" * 5000,
        "plugins_9000": '<gazebo><plugin filename="libgazebo_ros_diff_drive.so"/></gazebo>' * 9000,
        "hyphens_in_9000_comments": "<!-- -- -->" * 9000,
        "cdata": "<![CDATA[ <link name='b'/> ]]>",
        "instruction": "<?php system('true'); ?>",
        "transmission": "<transmission><x y='z'/></transmission>" * 100,
    }
    for name, block in blocks.items():
        yield Case(f"odd_{name}", robot(link("a"), block), "")
    for name in ("a b", "a/b", "../a", "-a", "a.b", "\u673a\u5668\u4eba", "'", "%s", "{0}", "a\\n"):
        yield Case(f"odd_link_name_{name!r}", robot(link(name)), "")
    head = '<?xml version="1.0" encoding="{}"?>'
    for encoding in ("utf-16", "latin-1", "no-such", "UTF-7"):
        yield Case(f"odd_encoding_{encoding}", head.format(encoding) + robot(link("\xe4")), "")
