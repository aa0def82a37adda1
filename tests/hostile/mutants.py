"""Random changes of real descriptions, most of which a parser still accepts."""

import random
import re
from xml.etree import ElementTree as Et

from tests.hostile.case import BODY, joint, link, robot, solid
from tests.hostile.test_fuzz import damaged
from tests.sim_server.description.cars import a_car, a_trike
from tests.sim_server.description.robots import a_cart, a_drive
from tests.sim_server.description.sdf_robots import INERTIAL, PIONEER
from zensim.sim_server.description.builtin_models import list_builtin_models, read_builtin_model

NUMBER = re.compile(r"(?<![\w.#-])-?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
EXTREMES = (
    *("0", "-1", "1", "1e-12", "1e-6", "1e-3", "1e3", "1e6", "1e9", "1e15", "1e30", "1e100"),
    *("1e300", "1.7e308", "-1e9", "-1e30", "1e-300", "3.141592653589793", "nan", "inf"),
)
KINDS = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating", "ball", "screw")
KIND = re.compile(r'(<joint\b[^>]*\btype=["\'])(\w+)(["\'])')
LIMIT = '<limit lower="-1" upper="1" effort="5" velocity="2"/>'
PLACE = '<origin xyz="0 0 0.3" rpy="0.1 0 0"/><axis xyz="0 1 0"/>'
MESH_URI = "package://own/meshes/wedge.stl"
MAX_SEED_CHARACTERS = 200_000


def an_arm_of_all_joints() -> str:
    """A robot with damped, sprung, limited, mimicking and commanded joints, and a mesh."""
    mesh = f'<mesh filename="{MESH_URI}" scale="0.1 0.1 0.1"/>'
    shapes = (
        solid('<box size="0.2 0.2 0.1"/>'),
        solid('<cylinder radius="0.05" length="0.3"/>'),
        solid('<sphere radius="0.05"/>'),
        solid(mesh) + solid(mesh, "visual"),
        solid('<capsule radius="0.02" length="0.1"/>'),
    )
    links = [link(f"l{n}", BODY + shape) for n, shape in enumerate(shapes)]
    inside = f'{PLACE}{LIMIT}<dynamics damping="0.7" friction="0.1"/>'
    joints = [
        joint("turn", "l0", "l1", "continuous", inside),
        joint("bend", "l1", "l2", "revolute", inside),
        joint("slide", "l2", "l3", "prismatic", inside),
        joint("copy", "l2", "l4", "revolute", f'{inside}<mimic joint="bend" multiplier="-2"/>'),
    ]
    interfaces = "".join(
        f'<joint name="{name}"><command_interface name="{kind}"/>'
        '<state_interface name="position"/></joint>'
        for name, kind in (("turn", "velocity"), ("bend", "position"), ("slide", "effort"))
    )
    control = (
        '<ros2_control name="c" type="system"><hardware><plugin>gazebo_ros2_control/GazeboSystem'
        f"</plugin></hardware>{interfaces}</ros2_control>"
    )
    surfaces = (
        '<gazebo reference="l0"><mu1>0.6</mu1><mu2>0.3</mu2><fdir1>1 0 0</fdir1><kp>1e6</kp>'
        "<kd>100</kd><selfCollide>true</selfCollide></gazebo>"
        '<gazebo reference="bend"><springStiffness>30</springStiffness>'
        "<springReference>-0.5</springReference></gazebo>"
        '<gazebo reference="l3"><gravity>false</gravity></gazebo>'
    )
    return robot(*links, *joints, control, surfaces)


def a_nested_model() -> str:
    """An SDF model with a nested one, an axis with spring and damping, and several shapes."""
    box, cylinder, egg = (
        f"<collision name='c'><geometry>{shape}</geometry></collision>"
        for shape in (
            "<box><size>0.3 0.2 0.1</size></box>",
            "<cylinder><radius>0.1</radius><length>0.2</length></cylinder>",
            "<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>",
        )
    )
    axis = (
        "<axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper><effort>9</effort></limit>"
        "<dynamics><damping>0.4</damping><friction>0.1</friction><spring_reference>0.2"
        "</spring_reference><spring_stiffness>5</spring_stiffness></dynamics></axis>"
    )
    return (
        "<sdf version='1.9'><model name='m'><velocity_decay><linear>0.1</linear><angular>0.2"
        f"</angular></velocity_decay><link name='a'>{INERTIAL}{box}</link>"
        f"<model name='n'><pose>0 0 0.4 0 0.1 0</pose><link name='b'>{INERTIAL}{cylinder}</link>"
        f"<link name='c'><pose>0 0 0.5 0 0 0</pose>{INERTIAL}{egg}</link>"
        f"<joint name='k' type='universal'><parent>b</parent><child>c</child>{axis}</joint></model>"
        f"<joint name='j' type='revolute'><parent>a</parent><child>n::b</child>{axis}</joint>"
        "</model></sdf>"
    )


def own_robots() -> list[str]:
    """Make the descriptions of this repository that have the most features."""
    shipped = [read_builtin_model(name) for name in list_builtin_models()]
    return [
        *(text for text in shipped if "<world" not in text),
        *(PIONEER, a_car(), a_trike(), a_cart(a_drive())),
        *(an_arm_of_all_joints(), a_nested_model()),
    ]


def mutate(text: str, chance: random.Random) -> str:
    """Change numbers, kinds of joints or elements of a description; rarely any bytes."""
    if chance.random() < 0.05:
        return damaged(text, chance)
    for _ in range(chance.choice((1, 1, 2, 3, 6, 12))):
        change = chance.choice((_change_number, _change_number, _change_kind, _change_element))
        text = change(text, chance)
    return text


def _change_number(text: str, chance: random.Random) -> str:
    found = list(NUMBER.finditer(text))
    if not found:
        return text
    one = chance.choice(found)
    if chance.random() < 0.4:
        value = chance.choice(EXTREMES)
    else:
        value = repr(float(one[0]) * 10.0 ** chance.uniform(-9.0, 9.0))
    return text[: one.start()] + value + text[one.end() :]


def _change_kind(text: str, chance: random.Random) -> str:
    found = list(KIND.finditer(text))
    if not found:
        return text
    one = chance.choice(found)
    return text[: one.start(2)] + chance.choice(KINDS) + text[one.end(2) :]


def _change_element(text: str, chance: random.Random) -> str:
    """Remove, repeat, move or scale an element."""
    try:
        root = Et.fromstring(text)
    except (Et.ParseError, ValueError):
        return text
    parents = [one for one in root.iter() if len(one)]
    if not parents:
        return text
    parent = chance.choice(parents)
    child = chance.choice(list(parent))
    action = chance.randrange(4)
    if action == 0:
        parent.remove(child)
    elif action == 1:
        parent.append(child)
    elif action == 2:
        inside = set(child.iter())
        chance.choice([one for one in parents if one not in inside]).append(child)
    else:
        _scale(child, 10.0 ** chance.uniform(-8.0, 8.0))
    return Et.tostring(root, encoding="unicode")


def _scale(element: Et.Element, factor: float) -> None:
    for one in element.iter():
        for key, value in one.attrib.items():
            one.set(key, NUMBER.sub(lambda found: repr(float(found[0]) * factor), value))
        if one.text:
            one.text = NUMBER.sub(lambda found: repr(float(found[0]) * factor), one.text)
