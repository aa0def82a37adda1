"""Every drive is read from a plug-in, documented, and moves robots as the kinematic tier does."""

import math
from typing import Any, get_args

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.contract.repository import ROOT
from tests.proto.drives.single_drive import SingleDrive
from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    OmniDrive,
    PlanarMove,
    SteeringDrive,
    TricycleDrive,
)
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.plugins.drive_controllers import DRIVE_CONTROLLERS
from zensim.sim_server.description.plugins.drive_plugin import DrivePlugin
from zensim.sim_server.description.plugins.plugin_registry import DRIVE_PLUGINS
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.kinematic.kinematic_robots import compute_steered_twists
from zensim.sim_server.physics.kinematic.planar_vehicle import make_mesh_reader, make_planar_vehicle


def read_model(name: str) -> Model:
    """Read a model; a tricycle gets the steering angle as target, not its rate."""
    model = read_urdf(read_builtin_model(name))
    if not isinstance(model.drive, TricycleDrive):
        return model
    drive = msgspec.structs.replace(model.drive, max_steering_speed=0.0)
    return msgspec.structs.replace(model, drive=drive)


# A skid-steered robot turns less than commanded, and a planar one takes the twist itself.
MODELS = {name: read_model(name) for name in ("box_bot", "car_bot", "trike_bot")}
TRIKE_WHEELBASE_M = 0.3
ALL_DRIVES: list[DrivePlugin[Any]] = [*DRIVE_PLUGINS, *DRIVE_CONTROLLERS]
CONTROLLER_FIELDS = (
    *("odometry_source", "publish_odom", "publish_wheel_tf", "covariance_x", "covariance_y"),
    *("covariance_yaw", "command_topic", "odometry_topic", "ros"),
)
COMPUTED_FIELDS: dict[type[Drive], set[str]] = {
    DiffDrive: {"pairs", "linear_limits", "angular_limits"},
    PlanarMove: {"pose_covariance", "twist_covariance"},
    AckermannDrive: {
        *("wheel_radius_m", "wheelbase_m", "track_m", "wheel_effort_nm", "steering_effort_nm"),
        *("odometry_rate_hz", "pose_covariance", "twist_covariance"),
    },
    TricycleDrive: {
        *("steering_effort_nm", "odometry_rate_hz", "pose_covariance", "twist_covariance")
    },
    SteeringDrive: {
        *(
            "traction",
            "steering",
            "counter_steering",
            "reversed_wheels",
            "passive",
            "is_traction_steered",
            "wheel_radius_m",
        ),
        *("wheelbase_m", "traction_track_m", "steering_track_m", "max_speed"),
        *("wheel_effort_nm", "steering_effort_nm"),
        *(field for field in CONTROLLER_FIELDS if not field.endswith("_topic")),
    },
    OmniDrive: {*("wheels", "max_torque_nm", "linear_limits", "lateral_limits", "angular_limits")},
}
"""Fields without a parameter: measured from links, set by several tags, or not in the plug-in."""


@pytest.mark.parametrize("drive", get_args(Drive), ids=lambda drive: drive.__name__)
def test_drive_is_read_from_a_plugin(drive: type[Drive]) -> None:
    assert drive in {plugin.drive_type for plugin in ALL_DRIVES}


@pytest.mark.parametrize("plugin", ALL_DRIVES, ids=lambda plugin: plugin.filenames[0])
def test_drive_plugin_is_documented(plugin: DrivePlugin[Any]) -> None:
    page = (ROOT / "docs" / "drive_plugins.md").read_text(encoding="utf-8")

    assert any(name in page for name in plugin.filenames)


@pytest.mark.parametrize("drive", get_args(Drive), ids=lambda drive: drive.__name__)
def test_every_field_of_a_drive_is_set_by_a_plugin(drive: type[Drive]) -> None:
    read = {
        parameter.field or parameter.tag
        for plugin in ALL_DRIVES
        if plugin.drive_type is drive
        for parameter in plugin.parameters
    }

    assert set(drive.__struct_fields__) - read == COMPUTED_FIELDS[drive] | {"tf_rate_hz", "compat"}


@pytest.mark.parametrize("plugin", ALL_DRIVES, ids=lambda plugin: plugin.filenames[0])
def test_parameter_of_a_drive_plugin_sets_a_field(plugin: DrivePlugin[Any]) -> None:
    fields = {
        name
        for parameter in plugin.parameters
        for name in (parameter.field or parameter.tag, parameter.default_field)
        if name
    }

    assert fields - set(plugin.drive_type.__struct_fields__) == set()


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@given(speed=st.floats(-0.5, 0.5), turn=st.floats(-0.5, 0.5))
def test_targets_of_a_drive_move_its_vehicle_as_commanded(
    model: Model, speed: float, turn: float
) -> None:
    ahead, spin = find_axle_twist(model, find_targets(model, speed, turn))

    assert (ahead, spin) == pytest.approx(find_commanded_twist(model, speed, turn), abs=1e-6)


def find_targets(model: Model, speed: float, turn: float) -> np.ndarray:
    assert model.drive is not None
    measured = (0.0,) * len(model.actuators)
    drive = SingleDrive(model.drive)
    # Long enough for every limit of acceleration.
    return np.array(drive.update(speed, turn, positions=measured, velocities=measured, dt_s=1.0))


def find_axle_twist(model: Model, targets: np.ndarray) -> tuple[float, float]:
    """Find the speed of the unsteered axle and the turn rate by the vehicle's geometry."""
    vehicle = make_planar_vehicle(model, make_mesh_reader(""), 9.81)[0]
    plan = make_actuation(model)
    speeds = targets[list(plan.speeds.columns)]
    if vehicle.matrix:
        ahead, _, spin = np.array(vehicle.matrix).reshape(3, -1) @ speeds
    else:
        angles = targets[list(plan.angles.columns)]
        ahead, _, spin = compute_steered_twists(vehicle, speeds[None], angles[None])[:, 0]
    return float(ahead - spin * vehicle.axle[1]), float(spin)


def find_commanded_twist(model: Model, speed: float, turn: float) -> tuple[float, float]:
    drive = model.drive
    if isinstance(drive, AckermannDrive):
        angle = turn * math.copysign(1.0, speed)
        return speed, speed * math.tan(angle) / drive.wheelbase_m
    if isinstance(drive, TricycleDrive):
        return speed * math.cos(turn), speed * math.sin(turn) / TRIKE_WHEELBASE_M
    return speed, turn
