"""Standard messages of ROS 2: builtin_interfaces, std_msgs, geometry_msgs, nav_msgs and others."""

from typing import ClassVar

import msgspec

from zensim.proto.messages.scalar_types import (
    ZERO_MATRIX3,
    ZERO_MATRIX3X4,
    ZERO_MATRIX6,
    Float32,
    Int8,
    Int8s,
    Int32,
    Matrix3,
    Matrix3x4,
    Matrix6,
    UInt8,
    UInt16,
    UInt32,
)

NANOSECONDS = 1_000_000_000


class Time(msgspec.Struct, frozen=True):
    """A moment of simulation time. Source: builtin_interfaces/msg/Time."""

    ros_type: ClassVar[str] = "builtin_interfaces/msg/Time"

    sec: Int32 = 0
    nanosec: UInt32 = 0


class Duration(msgspec.Struct, frozen=True):
    """A span of simulation time. Source: builtin_interfaces/msg/Duration."""

    ros_type: ClassVar[str] = "builtin_interfaces/msg/Duration"

    sec: Int32 = 0
    nanosec: UInt32 = 0


class Header(msgspec.Struct, frozen=True):
    """Time and frame of a message. Source: std_msgs/msg/Header."""

    ros_type: ClassVar[str] = "std_msgs/msg/Header"

    stamp: Time = Time()
    frame_id: str = ""


def time_from_ns(time_ns: int) -> Time:
    """Split simulation time [ns] into the ROS pair."""
    sec, nanosec = divmod(time_ns, NANOSECONDS)
    return Time(sec, nanosec)


def duration_from_ns(time_ns: int) -> Duration:
    """Split a span of simulation time [ns] into the ROS pair."""
    sec, nanosec = divmod(time_ns, NANOSECONDS)
    return Duration(sec, nanosec)


def ns_from_time(time: Time | Duration) -> int:
    """Join the ROS pair into simulation time [ns]; a span may be negative."""
    return time.sec * NANOSECONDS + time.nanosec


class Vector3(msgspec.Struct, frozen=True):
    """Three components along x, y, z. Source: geometry_msgs/msg/Vector3."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Vector3"

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Vector3Stamped(msgspec.Struct, frozen=True):
    """A vector in a frame, at a time. Source: geometry_msgs/msg/Vector3Stamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Vector3Stamped"

    header: Header = Header()
    vector: Vector3 = Vector3()


class Point(msgspec.Struct, frozen=True):
    """A position [m]. Source: geometry_msgs/msg/Point."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Point"

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class PointStamped(msgspec.Struct, frozen=True):
    """A position [m] in a frame, at a time. Source: geometry_msgs/msg/PointStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/PointStamped"

    header: Header = Header()
    point: Point = Point()


class Point32(msgspec.Struct, frozen=True):
    """A position [m] as float32. Source: geometry_msgs/msg/Point32."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Point32"

    x: Float32 = 0.0
    y: Float32 = 0.0
    z: Float32 = 0.0


class Quaternion(msgspec.Struct, frozen=True):
    """An orientation; defaults to identity. Source: geometry_msgs/msg/Quaternion."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Quaternion"

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class Pose(msgspec.Struct, frozen=True):
    """Position and orientation. Source: geometry_msgs/msg/Pose."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Pose"

    position: Point = Point()
    orientation: Quaternion = Quaternion()


class PoseStamped(msgspec.Struct, frozen=True):
    """A pose in a frame, at a time. Source: geometry_msgs/msg/PoseStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/PoseStamped"

    header: Header = Header()
    pose: Pose = Pose()


class PoseWithCovariance(msgspec.Struct, frozen=True):
    """A pose and its covariance. Source: geometry_msgs/msg/PoseWithCovariance."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/PoseWithCovariance"

    pose: Pose = Pose()
    covariance: Matrix6 = ZERO_MATRIX6


class Twist(msgspec.Struct, frozen=True):
    """Linear [m/s] and angular [rad/s] velocity. Source: geometry_msgs/msg/Twist."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Twist"

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


class TwistStamped(msgspec.Struct, frozen=True):
    """A twist in a frame, at a time. Source: geometry_msgs/msg/TwistStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/TwistStamped"

    header: Header = Header()
    twist: Twist = Twist()


class TwistWithCovariance(msgspec.Struct, frozen=True):
    """A twist and its covariance. Source: geometry_msgs/msg/TwistWithCovariance."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/TwistWithCovariance"

    twist: Twist = Twist()
    covariance: Matrix6 = ZERO_MATRIX6


class Accel(msgspec.Struct, frozen=True):
    """Linear [m/s^2] and angular [rad/s^2] acceleration. Source: geometry_msgs/msg/Accel."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Accel"

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


class Wrench(msgspec.Struct, frozen=True):
    """Force [N] and torque [N m]. Source: geometry_msgs/msg/Wrench."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Wrench"

    force: Vector3 = Vector3()
    torque: Vector3 = Vector3()


class Transform(msgspec.Struct, frozen=True):
    """Translation [m] and rotation. Source: geometry_msgs/msg/Transform."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Transform"

    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


class TransformStamped(msgspec.Struct, frozen=True):
    """Pose of child_frame_id in header.frame_id. Source: geometry_msgs/msg/TransformStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/TransformStamped"

    header: Header = Header()
    child_frame_id: str = ""
    transform: Transform = Transform()


class Odometry(msgspec.Struct, frozen=True):
    """Pose in header.frame_id, twist in child_frame_id. Source: nav_msgs/msg/Odometry."""

    ros_type: ClassVar[str] = "nav_msgs/msg/Odometry"

    header: Header = Header()
    child_frame_id: str = ""
    pose: PoseWithCovariance = PoseWithCovariance()
    twist: TwistWithCovariance = TwistWithCovariance()


class MapMetaData(msgspec.Struct, frozen=True):
    """Size and place of an occupancy grid. Source: nav_msgs/msg/MapMetaData."""

    ros_type: ClassVar[str] = "nav_msgs/msg/MapMetaData"

    map_load_time: Time = Time()
    resolution: Float32 = 0.0
    """[m/cell]."""
    width: UInt32 = 0
    """Cells along x."""
    height: UInt32 = 0
    """Cells along y."""
    origin: Pose = Pose()
    """Pose of the lower corner of cell (0, 0), in the frame of the map."""


class OccupancyGrid(msgspec.Struct, frozen=True):
    """Occupancy of the cells of a map. Source: nav_msgs/msg/OccupancyGrid."""

    ros_type: ClassVar[str] = "nav_msgs/msg/OccupancyGrid"

    header: Header = Header()
    info: MapMetaData = MapMetaData()
    data: Int8s = b""
    """Row by row, from cell (0, 0) along x: 0 free to 100 occupied, -1 (byte 255) unknown."""


class TFMessage(msgspec.Struct, frozen=True):
    """Transforms. Source: tf2_msgs/msg/TFMessage."""

    ros_type: ClassVar[str] = "tf2_msgs/msg/TFMessage"

    transforms: tuple[TransformStamped, ...] = ()


class Clock(msgspec.Struct, frozen=True):
    """Simulation time. Source: rosgraph_msgs/msg/Clock."""

    ros_type: ClassVar[str] = "rosgraph_msgs/msg/Clock"

    clock: Time = Time()


class JointState(msgspec.Struct, frozen=True):
    """Positions [rad or m], velocities, efforts by name. Source: sensor_msgs/msg/JointState."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/JointState"

    header: Header = Header()
    name: tuple[str, ...] = ()
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()


class Empty(msgspec.Struct, frozen=True):
    """Nothing but that it was sent. Source: std_msgs/msg/Empty."""

    ros_type: ClassVar[str] = "std_msgs/msg/Empty"


class String(msgspec.Struct, frozen=True):
    """Text, such as a robot description. Source: std_msgs/msg/String."""

    ros_type: ClassVar[str] = "std_msgs/msg/String"

    data: str = ""


class MultiArrayDimension(msgspec.Struct, frozen=True):
    """One dimension of an array. Source: std_msgs/msg/MultiArrayDimension."""

    ros_type: ClassVar[str] = "std_msgs/msg/MultiArrayDimension"

    label: str = ""
    size: UInt32 = 0
    stride: UInt32 = 0
    """Numbers from here on, in all further dimensions."""


class MultiArrayLayout(msgspec.Struct, frozen=True):
    """Dimensions of an array, the outermost first. Source: std_msgs/msg/MultiArrayLayout."""

    ros_type: ClassVar[str] = "std_msgs/msg/MultiArrayLayout"

    dim: tuple[MultiArrayDimension, ...] = ()
    data_offset: UInt32 = 0


class Float64MultiArray(msgspec.Struct, frozen=True):
    """Numbers without units. Source: std_msgs/msg/Float64MultiArray."""

    ros_type: ClassVar[str] = "std_msgs/msg/Float64MultiArray"

    layout: MultiArrayLayout = MultiArrayLayout()
    data: tuple[float, ...] = ()


class UInt8MultiArray(msgspec.Struct, frozen=True):
    """Bytes of any kind. Source: std_msgs/msg/UInt8MultiArray."""

    ros_type: ClassVar[str] = "std_msgs/msg/UInt8MultiArray"

    layout: MultiArrayLayout = MultiArrayLayout()
    data: bytes = b""


class LaserScan(msgspec.Struct, frozen=True):
    """Ranges of one sweep of rays in a plane. Source: sensor_msgs/msg/LaserScan."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/LaserScan"

    header: Header = Header()
    angle_min: Float32 = 0.0
    """Angle of the first ray, about z of the frame [rad]."""
    angle_max: Float32 = 0.0
    """Angle of the last ray [rad]."""
    angle_increment: Float32 = 0.0
    time_increment: Float32 = 0.0
    """Time between two rays [s]."""
    scan_time: Float32 = 0.0
    """Time between two scans [s]."""
    range_min: Float32 = 0.0
    range_max: Float32 = 0.0
    ranges: tuple[Float32, ...] = ()
    """[m]; -inf nearer than range_min, +inf beyond range_max (REP 117)."""
    intensities: tuple[Float32, ...] = ()
    """Intensities of all ranges, or none."""


class Range(msgspec.Struct, frozen=True):
    """The least distance in a cone. Source: sensor_msgs/msg/Range."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/Range"

    header: Header = Header()
    radiation_type: UInt8 = 0
    """0 ultrasound, 1 infrared."""
    field_of_view: Float32 = 0.0
    """[rad]."""
    min_range: Float32 = 0.0
    max_range: Float32 = 0.0
    range: Float32 = 0.0
    """[m]; -inf nearer than min_range, +inf with nothing up to max_range (REP 117)."""
    variance: Float32 = 0.0
    """[m^2]; 0 = unknown. Humble's message ends before this field."""


class PointField(msgspec.Struct, frozen=True):
    """One field of the points of a cloud. Source: sensor_msgs/msg/PointField."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/PointField"

    name: str = ""
    offset: UInt32 = 0
    """Offset in the point [bytes]."""
    datatype: UInt8 = 0
    """1 to 8: int8, uint8, int16, uint16, int32, uint32, float32, float64."""
    count: UInt32 = 0
    """Numbers in the field."""


class PointCloud2(msgspec.Struct, frozen=True):
    """Points as bytes, laid out as `fields` say. Source: sensor_msgs/msg/PointCloud2."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/PointCloud2"

    header: Header = Header()
    height: UInt32 = 0
    """Rows; 1 = not ordered."""
    width: UInt32 = 0
    """Points in a row."""
    fields: tuple[PointField, ...] = ()
    is_bigendian: bool = False
    point_step: UInt32 = 0
    """Size of a point [bytes]."""
    row_step: UInt32 = 0
    """Size of a row [bytes]."""
    data: bytes = b""
    is_dense: bool = False
    """Whether all points are finite."""


class ChannelFloat32(msgspec.Struct, frozen=True):
    """A number for each point of a cloud. Source: sensor_msgs/msg/ChannelFloat32."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/ChannelFloat32"

    name: str = ""
    values: tuple[Float32, ...] = ()


class PointCloud(msgspec.Struct, frozen=True):
    """Points one by one, as before PointCloud2. Source: sensor_msgs/msg/PointCloud."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/PointCloud"

    header: Header = Header()
    points: tuple[Point32, ...] = ()
    channels: tuple[ChannelFloat32, ...] = ()


class Imu(msgspec.Struct, frozen=True):
    """Orientation, turn rate and specific force of a sensor. Source: sensor_msgs/msg/Imu.

    Covariances are row-major about x, y, z: all zeros = unknown, first element -1 = the quantity is
    not measured.
    """

    ros_type: ClassVar[str] = "sensor_msgs/msg/Imu"

    header: Header = Header()
    orientation: Quaternion = Quaternion()
    orientation_covariance: Matrix3 = ZERO_MATRIX3
    angular_velocity: Vector3 = Vector3()
    """[rad/s]."""
    angular_velocity_covariance: Matrix3 = ZERO_MATRIX3
    linear_acceleration: Vector3 = Vector3()
    """Specific force [m/s^2]: +9.81 along the axis that points up at rest."""
    linear_acceleration_covariance: Matrix3 = ZERO_MATRIX3


class MagneticField(msgspec.Struct, frozen=True):
    """Magnetic field in the axes of the sensor. Source: sensor_msgs/msg/MagneticField."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/MagneticField"

    header: Header = Header()
    magnetic_field: Vector3 = Vector3()
    """[T]."""
    magnetic_field_covariance: Matrix3 = ZERO_MATRIX3


class Altimeter(msgspec.Struct, frozen=True):
    """Height of a sensor and its change. Source: ros_gz_interfaces/msg/Altimeter."""

    ros_type: ClassVar[str] = "ros_gz_interfaces/msg/Altimeter"

    header: Header = Header()
    vertical_position: float = 0.0
    """Height above `vertical_reference` [m]."""
    vertical_velocity: float = 0.0
    """[m/s]."""
    vertical_reference: float = 0.0
    """Height of the sensor at spawn, in the world [m]."""


class FluidPressure(msgspec.Struct, frozen=True):
    """Pressure of air or water. Source: sensor_msgs/msg/FluidPressure."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/FluidPressure"

    header: Header = Header()
    fluid_pressure: float = 0.0
    """Absolute [Pa]."""
    variance: float = 0.0
    """[Pa^2]; 0 = unknown."""


class NavSatStatus(msgspec.Struct, frozen=True):
    """Kind of a satellite fix. Source: sensor_msgs/msg/NavSatStatus."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/NavSatStatus"

    status: Int8 = 0
    """-1 no fix, 0 fix, 1 and 2 augmented."""
    service: UInt16 = 1
    """Bits: 1 GPS, 2 GLONASS, 4 COMPASS, 8 GALILEO."""


class NavSatFix(msgspec.Struct, frozen=True):
    """Geodetic position in WGS84. Source: sensor_msgs/msg/NavSatFix."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/NavSatFix"

    header: Header = Header()
    status: NavSatStatus = NavSatStatus()
    latitude: float = 0.0
    """[deg], positive north of the equator."""
    longitude: float = 0.0
    """[deg], positive east of Greenwich."""
    altitude: float = 0.0
    """Height above the ellipsoid [m]."""
    position_covariance: Matrix3 = ZERO_MATRIX3
    """East, north, up [m^2]."""
    position_covariance_type: UInt8 = 0
    """0 unknown, 1 approximated, 2 diagonal known, 3 known."""


class Image(msgspec.Struct, frozen=True):
    """An image, row by row from the top left. Source: sensor_msgs/msg/Image."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/Image"

    header: Header = Header()
    height: UInt32 = 0
    width: UInt32 = 0
    encoding: str = ""
    """Encoding of a pixel: rgb8, mono8, 32FC1, 32SC1 and others."""
    is_bigendian: UInt8 = 0
    step: UInt32 = 0
    """Size of a row [bytes]."""
    data: bytes = b""


class CompressedImage(msgspec.Struct, frozen=True):
    """An image in a compressed format. Source: sensor_msgs/msg/CompressedImage."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/CompressedImage"

    header: Header = Header()
    format: str = ""
    """jpeg, png; image_transport writes more, such as `rgb8; jpeg compressed bgr8`."""
    data: bytes = b""


class RegionOfInterest(msgspec.Struct, frozen=True):
    """Part of an image; all zeros = the whole. Source: sensor_msgs/msg/RegionOfInterest."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/RegionOfInterest"

    x_offset: UInt32 = 0
    y_offset: UInt32 = 0
    height: UInt32 = 0
    width: UInt32 = 0
    do_rectify: bool = False


class CameraInfo(msgspec.Struct, frozen=True):
    """Calibration of a camera. Source: sensor_msgs/msg/CameraInfo."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/CameraInfo"

    header: Header = Header()
    height: UInt32 = 0
    width: UInt32 = 0
    distortion_model: str = ""
    d: tuple[float, ...] = ()
    """Coefficients of plumb_bob: k1, k2, t1, t2, k3."""
    k: Matrix3 = ZERO_MATRIX3
    """Intrinsic matrix [pixel]: fx 0 cx, 0 fy cy, 0 0 1."""
    r: Matrix3 = ZERO_MATRIX3
    """Rectification."""
    p: Matrix3x4 = ZERO_MATRIX3X4
    """Projection of points in the optical frame to pixels."""
    binning_x: UInt32 = 0
    binning_y: UInt32 = 0
    roi: RegionOfInterest = RegionOfInterest()
