"""What a vehicle can do and how large it is, from the model of its robot."""

import math

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    OmniDrive,
    PlanarMove,
    SteeringDrive,
    TricycleDrive,
)
from zensim.proto.messages.model_messages import Model
from zensim.vda5050.footprint_check import Box
from zensim.vda5050.path_follower import ACKERMANN, TRICYCLE, VehicleLimits
from zensim.vda5050.vehicle_reports import VehicleBody
from zensim.vda5050.vehicle_settings import FleetSettings

MAX_STEER_RAD = 1.2
"""Largest steering angle that is used: beyond it wheels slip aside."""


def describe_vehicle(model: Model, box: Box, settings: FleetSettings) -> VehicleBody:
    """Find limits and size of a vehicle."""
    limits = find_limits(model, settings)
    return VehicleBody(
        _round(2.0 * box.half_length),
        _round(2.0 * box.half_width),
        _round(box.top - box.bottom),
        limits,
        model.name,
    )


def find_limits(model: Model, settings: FleetSettings) -> VehicleLimits:
    """Find the limits: those of the settings, as far as the drive reaches them."""
    drive, curvature, steering, wheelbase = model.drive, math.inf, 0, 1.0
    speeds = [settings.max_speed]
    if isinstance(drive, DiffDrive | OmniDrive):
        speeds.append(drive.linear_limits.max_velocity or math.inf)
    elif isinstance(drive, AckermannDrive | SteeringDrive):
        wheelbase = drive.wheelbase_m
        speeds.append(drive.max_speed)
        curvature = math.tan(min(drive.max_steer, MAX_STEER_RAD)) / wheelbase
        steering = ACKERMANN if isinstance(drive, AckermannDrive) else 0
    elif isinstance(drive, TricycleDrive):
        joints = {one.name: one.origin.position[0] for one in model.joints}
        wheelbase = max(abs(joints.get(drive.steering_joint, 1.0)), 0.05)
        curvature, steering = math.tan(MAX_STEER_RAD) / wheelbase, TRICYCLE
    return VehicleLimits(
        speed=min(speeds),
        turn=settings.max_turn,
        acceleration=settings.acceleration,
        deceleration=settings.acceleration,
        curvature=curvature,
        is_sideways=isinstance(drive, PlanarMove | OmniDrive),
        steering=steering,
        wheelbase=wheelbase,
    )


def _round(length: float) -> float:
    return round(max(length, 0.001), 3)
