"""Lidars and cameras that a host without some libraries measures slowly, or not at all."""

from collections.abc import Collection

import msgspec

from zensim.proto.messages.model_messages import Sensor
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor
from zensim.proto.sensor_libraries import ADVICE, Library

EXACT_RAY_S = 3e-5
"""CPU time of a ray that Embree does not cast, in a hall of 250 shapes."""
PIXEL_BY_RAYS_S = 4.4e-7
"""CPU time of a pixel without OpenGL."""
MAX_SHARE = 0.5
"""Share of a core for the rays of one lidar without Embree; others would have to wait."""


class SensorFault(msgspec.Struct, frozen=True):
    """What a sensor lacks on a host."""

    slug: str
    reason: str
    is_refused: bool
    """Whether the sensor is not measured there; otherwise it is slow."""

    def __str__(self) -> str:
        """Describe it with its slug first, as refusals are."""
        return f"{self.slug}: {self.reason}"


def find_sensor_fault(
    sensor: Sensor, rate_hz: float, missing: Collection[Library], *, is_level: bool
) -> SensorFault | None:
    """Find what a sensor lacks on a host.

    Args:
        sensor: Any.
        rate_hz: At which it is measured.
        missing: Libraries that the host lacks.
        is_level: Of a lidar: it has one row, and hardly leans.
    """
    settings = sensor.settings
    if isinstance(settings, CameraSensor) and "opengl" in missing:
        return _find_camera_fault(settings, has_embree="embree" not in missing)
    if isinstance(settings, RaySensor) and "embree" in missing and not is_level:
        return _find_lidar_fault(settings, rate_hz)
    return None


def has_one_level_row(settings: RaySensor) -> bool:
    """Whether a lidar has one row, at its own height."""
    return settings.vertical.count == 1 and settings.vertical.low_rad == 0.0


def _find_camera_fault(settings: CameraSensor, *, has_embree: bool) -> SensorFault:
    if not has_embree:
        reason = f"no images without OpenGL and Embree; {ADVICE['opengl']}"
        return SensorFault(slug="sensor.no_renderer", reason=reason, is_refused=True)
    each_s = PIXEL_BY_RAYS_S * settings.width * settings.height
    reason = f"without OpenGL an image takes about {each_s:.2g} s of CPU; {ADVICE['opengl']}"
    return SensorFault(slug="sensor.slow_renderer", reason=reason, is_refused=False)


def _find_lidar_fault(settings: RaySensor, rate_hz: float) -> SensorFault:
    each_s = EXACT_RAY_S * settings.horizontal.count * settings.vertical.count
    cost = f"without Embree a scan takes about {each_s:.2g} s of CPU; {ADVICE['embree']}"
    if settings.vertical.count > 1 and each_s * rate_hz > MAX_SHARE:
        return SensorFault(slug="sensor.no_embree", reason=f"no scans: {cost}", is_refused=True)
    return SensorFault(slug="sensor.slow_rays", reason=cost, is_refused=False)
