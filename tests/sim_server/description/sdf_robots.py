"""SDF texts of small models for tests."""

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model

INERTIAL = (
    "<inertial><mass>2</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia>"
    "</inertial>"
)
BALL = "<geometry><sphere><radius>0.1</radius></sphere></geometry>"
PIONEER = """<?xml version="1.0"?>
<sdf version="1.4"><model name="two_wheels">
  <link name="chassis"><pose>0 0 0.16 0 0 0</pose>
    <inertial><mass>5</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
    <collision name="box"><geometry><box><size>0.4 0.3 0.17</size></box></geometry></collision>
  </link>
  <link name="left"><pose>0.1 0.17 0.11 0 1.5707963 1.5707963</pose>
    <inertial><mass>0.5</mass><inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia>
    </inertial>
    <collision name="tyre"><geometry><cylinder><radius>0.11</radius><length>0.05</length></cylinder>
    </geometry></collision>
  </link>
  <link name="right"><pose>0.1 -0.17 0.11 0 1.5707963 1.5707963</pose>
    <inertial><mass>0.5</mass><inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia>
    </inertial>
    <collision name="tyre"><geometry><cylinder><radius>0.11</radius><length>0.05</length></cylinder>
    </geometry></collision>
  </link>
  <joint type="revolute" name="left_hinge"><parent>chassis</parent><child>left</child>
    <axis><xyz>0 1 0</xyz></axis></joint>
  <joint type="revolute" name="right_hinge"><parent>chassis</parent><child>right</child>
    <axis><xyz>0 1 0</xyz></axis></joint>
  <plugin name="drive" filename="libgazebo_ros_diff_drive.so">
    <left_joint>left_hinge</left_joint><right_joint>right_hinge</right_joint>
    <wheel_separation>0.34</wheel_separation><wheel_diameter>0.22</wheel_diameter>
    <robot_base_frame>chassis</robot_base_frame>
  </plugin>
</model></sdf>"""
"""A robot whose chassis and wheels are placed in the model, with an axis in the model's frame."""


def a_model(*parts: str, attributes: str = 'name="m"', version: str = "1.9") -> str:
    return f'<sdf version="{version}"><model {attributes}>{"".join(parts)}</model></sdf>'


def a_link(name: str, inside: str = "", *, inertial: str = INERTIAL) -> str:
    return f'<link name="{name}">{inertial}{inside}</link>'


def a_joint(name: str, ends: tuple[str, str], kind: str = "fixed", inside: str = "") -> str:
    parent, child = ends
    return (
        f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>'
        f"{inside}</joint>"
    )


def an_axis(xyz: str, inside: str = "", attributes: str = "") -> str:
    return f"<axis><xyz {attributes}>{xyz}</xyz>{inside}</axis>"


def a_pose(numbers: str, attributes: str = "") -> str:
    return f"<pose {attributes}>{numbers}</pose>"


def read(*parts: str) -> Model:
    return read_sdf_model(a_model(*parts))
