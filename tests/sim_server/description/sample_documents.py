"""A URDF, an SDF model and an SDF world with every element that is read."""

INERTIA = "<inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/>"
SURFACE = """<surface>
<bounce><restitution_coefficient>0.5</restitution_coefficient><threshold>0.1</threshold></bounce>
<friction><ode><mu>0.5</mu><mu2>0.4</mu2><fdir1>1 0 0</fdir1></ode>
<bullet><friction>0.5</friction></bullet></friction>
<contact><ode><kp>1e5</kp><kd>10</kd><max_vel>1</max_vel><min_depth>0</min_depth></ode></contact>
</surface>"""
SDF_MATERIAL = """<material><ambient>1 0 0 1</ambient><diffuse>1 0 0 1</diffuse>
<script><uri>file://gazebo.material</uri><name>Gazebo/Red</name></script>
<pbr><metal><albedo_map>a.png</albedo_map></metal>
<specular><albedo_map>b.png</albedo_map></specular></pbr></material>"""
NOISE = "<noise type='gaussian'><mean>0</mean><stddev>0.1</stddev></noise>"
SENSORS = f"""<sensor name="lidar" type="gpu_lidar"><pose>0 0 0.1 0 0 0</pose><topic>scan</topic>
<update_rate>10</update_rate><always_on>true</always_on>
<lidar><scan><horizontal><samples>36</samples><resolution>1</resolution><min_angle>-1</min_angle>
<max_angle>1</max_angle></horizontal></scan><range><min>0.1</min><max>10</max></range>
{NOISE}</lidar></sensor>
<sensor name="imu" type="imu"><topic>imu</topic><imu><angular_velocity><x>{NOISE}</x>
</angular_velocity></imu></sensor>
<sensor name="cam" type="camera"><camera name="c"><pose>0 0 0 0 0 0</pose>
<horizontal_fov>1</horizontal_fov><image><width>32</width><height>24</height>
<format>R8G8B8</format></image><clip><near>0.1</near><far>10</far></clip></camera>
<plugin name="cam_ros" filename="libgazebo_ros_camera.so"><ros><namespace>team</namespace>
<remapping>image_raw:=image</remapping></ros><camera_name>front</camera_name></plugin></sensor>"""
PLUGINS = """<plugin name="drive" filename="libgazebo_ros_diff_drive.so">
<ros><namespace>team</namespace><remapping>odom:=odometry</remapping></ros>
<left_joint>left</left_joint><right_joint>right</right_joint>
<wheel_separation>0.4</wheel_separation><wheel_diameter>0.2</wheel_diameter></plugin>
<plugin name="states" filename="libgazebo_ros_joint_state_publisher.so">
<update_rate>30</update_rate><joint_name>left</joint_name></plugin>
<plugin name="truth" filename="libgazebo_ros_p3d.so"><body_name>base</body_name>
<frame_name>map</frame_name></plugin>
<plugin name="old_imu" filename="libgazebo_ros_imu.so"><bodyName>base</bodyName>
<updateRate>20</updateRate></plugin>"""
WHEEL = f"""<inertial><mass value="1"/>{INERTIA}</inertial>
<collision><geometry><cylinder radius="0.1" length="0.05"/></geometry></collision>"""
SHAPES = """<box size="1 1 0.1"/>|<sphere radius="0.1"/>|<cylinder radius="0.1" length="0.1"/>|
<capsule radius="0.1" length="0.1"/>|<ellipsoid radii="0.1 0.2 0.3"/>|
<cone radius="0.1" length="0.1"/>|<mesh filename="a.stl" scale="1 1 1"/>"""
COLLISIONS = "".join(
    f'<collision name="c"><origin xyz="0 0 1" rpy="0 0 0"/><geometry>{shape}</geometry></collision>'
    for shape in SHAPES.split("|")
)
VISUALS = "".join(
    f'<visual name="v"><origin xyz="0 0 1" rpy="0 0 0"/><geometry>{shape}</geometry>'
    '<material name="own"><color rgba="1 0 0 1"/><texture filename="a.png"/></material></visual>'
    for shape in SHAPES.split("|")
)
URDF = f"""<robot name="sample" version="1.0">
<material name="grey"><color rgba="0.5 0.5 0.5 1"/><texture filename="a.png"/></material>
<link name="base"><inertial><origin xyz="0 0 0"/><mass value="5"/>{INERTIA}</inertial>
{COLLISIONS}{VISUALS}</link>
<link name="l">{WHEEL}</link><link name="r">{WHEEL}</link><link name="mast"/><link name="arm">
{WHEEL}</link>
<joint name="left" type="continuous"><parent link="base"/><child link="l"/>
<origin xyz="0 0.2 0" rpy="0 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="right" type="continuous"><parent link="base"/><child link="r"/>
<origin xyz="0 -0.2 0" rpy="0 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="fixed" type="fixed"><parent link="base"/><child link="mast"/></joint>
<joint name="lift" type="prismatic"><parent link="base"/><child link="arm"/>
<limit lower="0" upper="1" effort="10" velocity="1"/><dynamics damping="1" friction="0"/>
<mimic joint="left" multiplier="1" offset="0"/></joint>
<transmission name="t"><joint name="lift">
<hardwareInterface>hardware_interface/PositionJointInterface</hardwareInterface></joint>
<actuator name="m"><hardwareInterface>x</hardwareInterface></actuator></transmission>
<ros2_control name="c" type="system"><joint name="lift"><command_interface name="position">
<param name="min">0</param><param name="max">1</param></command_interface>
<state_interface name="position"><param name="initial_value">0.5</param></state_interface></joint>
</ros2_control>
<gazebo><static>false</static><self_collide>false</self_collide>{PLUGINS}</gazebo>
<gazebo reference="base"><mu1>0.5</mu1><mu2>0.4</mu2><fdir1>1 0 0</fdir1><kp>1e5</kp><kd>10</kd>
<minDepth>0</minDepth><maxVel>1</maxVel><min_depth>0</min_depth><max_vel>1</max_vel>
<gravity>true</gravity><turnGravityOff value="false"/><dampingFactor>0.1</dampingFactor>
<selfCollide>false</selfCollide><self_collide>false</self_collide>
<collision>{SURFACE}</collision><visual>{SDF_MATERIAL}</visual>
<material>Gazebo/Red</material>{SENSORS}</gazebo>
<gazebo reference="fixed"><preserveFixedJoint>true</preserveFixedJoint>
<disableFixedJointLumping>true</disableFixedJointLumping></gazebo>
<gazebo reference="lift"><springStiffness>10</springStiffness>
<springReference>0</springReference></gazebo>
</robot>"""
SDF_SHAPES = """<box><size>1 1 0.1</size></box>|<sphere><radius>0.1</radius></sphere>|
<cylinder><radius>0.1</radius><length>0.1</length></cylinder>|
<capsule><radius>0.1</radius><length>0.1</length></capsule>|
<cone><radius>0.1</radius><length>0.1</length></cone>|
<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>|
<mesh><uri>a.stl</uri><scale>1 1 1</scale></mesh>|
<polyline><point>0 0</point><point>1 0</point><point>0 1</point><height>1</height></polyline>"""
POSE = '<pose relative_to="__model__" degrees="true" rotation_format="euler_rpy">0 0 1 0 0 0</pose>'
SDF_PARTS = "".join(
    f'<collision name="c{number}">{POSE}<density>9</density><geometry>{shape}</geometry>'
    f"{'' if number else SURFACE}</collision>"
    f'<visual name="v{number}">{POSE}<geometry>{shape}</geometry>'
    f"{'' if number else SDF_MATERIAL}<transparency>0.1</transparency></visual>"
    for number, shape in enumerate(SDF_SHAPES.split("|"))
)
SDF_INERTIAL = f"""<inertial auto="true">{POSE}<mass>1</mass><density>9</density>
<inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"""
LIGHT = """<light name="lamp" type="spot"><pose>0 0 1 0 0 0</pose><diffuse>1 1 1 1</diffuse>
<intensity>1</intensity><direction>0 0 -1</direction><light_on>true</light_on>
<cast_shadows>false</cast_shadows><attenuation><range>10</range><constant>1</constant>
<linear>0</linear><quadratic>0</quadratic></attenuation>
<spot><outer_angle>1</outer_angle></spot></light>"""
AXIS = """<xyz expressed_in="__model__">0 1 0</xyz>
<use_parent_model_frame>false</use_parent_model_frame>
<limit><lower>-1</lower><upper>1</upper><effort>10</effort><velocity>1</velocity></limit>
<dynamics><damping>1</damping><friction>0</friction><spring_stiffness>1</spring_stiffness>
<spring_reference>0</spring_reference></dynamics>
<mimic joint="left"><joint>left</joint><multiplier>1</multiplier><offset>0</offset>
<reference>0</reference></mimic>"""


def _wheel_joint(name: str, child: str) -> str:
    return (
        f'<joint name="{name}" type="continuous"><pose>0 0 0 0 0 0</pose><parent>base</parent>'
        f"<child>{child}</child><axis><xyz>0 1 0</xyz></axis></joint>"
    )


SDF_WHEELS = "".join(
    f'<link name="{name}"><pose>0 {y} 0 0 0 0</pose>{SDF_INERTIAL}<collision name="c"><geometry>'
    "<cylinder><radius>0.1</radius><length>0.1</length></cylinder></geometry></collision></link>"
    for name, y in (("l", 0.2), ("r", -0.2), ("a", 0.5))
)
SDF_MODEL = f"""<sdf version="1.9"><model name="sample" canonical_link="base">
<static>false</static><self_collide>false</self_collide>
<zensim:dynamics xmlns:zensim="urn:zensim">auto</zensim:dynamics>
<pose>0 0 0 0 0 0</pose>
<frame name="f" attached_to="base"><pose>0 0 1 0 0 0</pose></frame>
<link name="base"><pose>0 0 0 0 0 0</pose>{SDF_INERTIAL}{SDF_PARTS}{LIGHT}{SENSORS}
<gravity>true</gravity><self_collide>false</self_collide>
<velocity_decay><linear>0</linear><angular>0</angular></velocity_decay></link>
{SDF_WHEELS}{_wheel_joint("left", "l")}{_wheel_joint("right", "r")}
<joint name="u" type="universal"><pose>0 0 0 0 0 0</pose><parent>base</parent><child>a</child>
<axis>{AXIS}</axis><axis2>{AXIS}</axis2></joint>
<model name="inner"><pose>0 0 1 0 0 0</pose><link name="n">{SDF_INERTIAL}</link></model>
<joint name="k" type="fixed"><parent>base</parent><child>inner::n</child></joint>
{PLUGINS}</model></sdf>"""
PLANE = "<plane><normal>0 0 1</normal><size>1 1</size></plane>"
SDF_WORLD = f"""<sdf version="1.9"><world name="sample" xmlns:zensim="urn:zensim">
<zensim:description>a hall</zensim:description><zensim:tags>indoor</zensim:tags>
<gravity>0 0 -9.8</gravity><magnetic_field>0 0 1e-5</magnetic_field>
<physics name="p" default="true"><max_step_size>0.004</max_step_size>
<real_time_factor>1</real_time_factor><real_time_update_rate>250</real_time_update_rate></physics>
<scene><ambient>1 1 1</ambient><background>1 1 1</background></scene>{LIGHT}
<spherical_coordinates><surface_model>EARTH_WGS84</surface_model>
<world_frame_orientation>ENU</world_frame_orientation><latitude_deg>1</latitude_deg>
<longitude_deg>1</longitude_deg><elevation>1</elevation><heading_deg>0</heading_deg>
</spherical_coordinates>
<include><uri>model://sun</uri></include>
<include><uri>model://ground_plane</uri><name>floor</name><static>true</static>
<pose>0 0 0 0 0 0</pose></include>
<frame name="dock" attached_to="box"><pose relative_to="box">1 0 0 0 0 0</pose>
<zensim:description>a dock</zensim:description><zensim:tags>dock</zensim:tags>
<zensim:size>1 1 1</zensim:size></frame>
<model name="box"><static>true</static><pose>3 0 0 0 0 0</pose><link name="l">
<collision name="c"><geometry>{PLANE}</geometry></collision>
<visual name="v"><geometry><empty/></geometry></visual></link></model>
<population name="crowd"><pose>9 0 0 0 0 0</pose><model name="can"><static>true</static>
<link name="l"><collision name="c"><geometry><sphere><radius>0.1</radius></sphere></geometry>
</collision></link></model><model_count>2</model_count>
<distribution><type>random</type></distribution><box><size>1 1 1</size></box></population>
<population name="queue"><model name="post"><static>true</static>
<link name="l"><collision name="c"><geometry><sphere><radius>0.1</radius></sphere></geometry>
</collision></link></model><distribution><type>grid</type><rows>2</rows><cols>1</cols>
<step>1 1 0</step></distribution></population>
<population name="ring"><model name="cone"><static>true</static>
<link name="l"><collision name="c"><geometry><sphere><radius>0.1</radius></sphere></geometry>
</collision></link></model><model_count>2</model_count><cylinder><radius>1</radius>
<length>1</length></cylinder></population>
<state world_name="sample"><model name="box"><pose>3 1 0 0 0 0</pose></model></state>
</world></sdf>"""
INCLUDING_WORLD = """<sdf version="1.9"><world name="w"><include merge="false">
<uri>model://thing</uri><name>first</name><pose>0 0 0 0 0 0</pose><static>true</static>
<placement_frame>l</placement_frame></include>
<model name="owner"><static>true</static><include merge="true"><uri>model://thing</uri>
</include></model></world></sdf>"""
INCLUDED = """<sdf version="1.9"><model name="thing"><pose>0 0 0 0 0 0</pose><link name="l">
<collision name="c"><geometry><sphere><radius>0.1</radius></sphere></geometry></collision>
</link></model></sdf>"""
