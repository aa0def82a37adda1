"""Lights of a world and of its links at one step: diffuse light, without shadows.

Sources: SDFormat's `<light>`; the fading of spot lights to the edge of their cones is that of OGRE,
with which Gazebo renders.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zensim.proto.forward_kinematics import compute_link_poses
from zensim.proto.messages.model_messages import Light
from zensim.proto.messages.world_messages import Scene
from zensim.proto.se3 import IDENTITY_POSE, FloatArray, rotate, transform_points
from zensim.sim_server.scene.scene import ModelGroup, SceneLayout

SKY_RGB = (0.70, 0.76, 0.84)
AMBIENT_RGB = (0.40, 0.40, 0.40)
"""Ambient light of a world that specifies none."""
SUN = Light("sun", "directional", direction=(-0.5, 0.1, -0.9), rgba=(0.8, 0.8, 0.8, 1.0))
"""Light of `model://sun`; also where a world has no light."""
MAX_LIGHTS = 8
"""Lights that shine in one image."""
FULL_CONE_RAD = math.radians(60.0)
"""Cone of a spot light that specifies none."""
EVERYWHERE = -1e9
"""Cosine of the half angle of the cone of a light that is no spot light: nothing is beyond it."""
MIN_ATTENUATION = 1e-6
MIN_DISTANCE_M = 1e-9


@dataclass(frozen=True)
class Lighting:
    """Lights (k,) in the world.

    Attributes:
        ambient: (3,) red, green, blue.
        background: (3,).
        places: (k, 4) position [m] and 1, or unit vector towards a directional light and 0.
        colours: (k, 3), intensity included.
        fades: (k, 4) c, l, q of 1 / (c + l d + q d^2) at the distance d, and the largest d [m].
        cones: (k, 4) unit vector along a spot light, and the cosine of half its full angle; 0 and
            `EVERYWHERE` for other lights.
    """

    ambient: FloatArray
    background: FloatArray
    places: FloatArray
    colours: FloatArray
    fades: FloatArray
    cones: FloatArray

    def choose_brightest(self, point: FloatArray) -> "Lighting":
        """Choose at most `MAX_LIGHTS` lights: directional ones, then those nearest to a point."""
        away = np.linalg.norm(self.places[:, :3] - point, axis=1) * self.places[:, 3]
        chosen = np.argsort(away, kind="stable")[:MAX_LIGHTS]
        parts = (self.places, self.colours, self.fades, self.cones)
        return Lighting(self.ambient, self.background, *(part[chosen] for part in parts))

    def shade(self, colours: FloatArray, points: FloatArray, normals: FloatArray) -> FloatArray:
        """Find the colours (n, 3) of surfaces of these colours at points with unit normals."""
        light = np.repeat(self.ambient[None], len(points), axis=0)
        for number, colour in enumerate(self.colours):
            share = self._find_share(number, points, normals)
            light += np.maximum(share, 0.0)[:, None] * colour
        return np.minimum(colours * light, 1.0)

    def _find_share(self, number: int, points: FloatArray, normals: FloatArray) -> FloatArray:
        """Find the share (n,) of one light that points scatter; negative on the far side."""
        place, fade, cone = self.places[number], self.fades[number], self.cones[number]
        if not place[3]:
            return np.asarray(np.einsum("ij,j->i", normals, place[:3]))
        towards = place[:3] - points
        away = np.maximum(np.linalg.norm(towards, axis=1), MIN_DISTANCE_M)
        share = np.einsum("ij,ij->i", towards, normals) / away
        attenuation = np.maximum(fade[0] + away * (fade[1] + away * fade[2]), MIN_ATTENUATION)
        inside = (-np.einsum("ij,j->i", towards, cone[:3]) / away - cone[3]) / (1.0 - cone[3])
        return np.asarray(share * (away <= fade[3]) * np.clip(inside, 0.0, 1.0) / attenuation)


DARKNESS = Lighting(
    np.zeros(3), np.zeros(3), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 4))
)


class SceneLights:
    """The lights of a world and of the links of its entities."""

    def __init__(self, layout: SceneLayout, scene: Scene) -> None:
        """Prepare lights without poses.

        Args:
            layout: Of what cameras see.
            scene: Lights and colours of the world.
        """
        self._scene = scene
        self._carriers = [
            group for group in layout.groups if any(link.lights for link in group.model.links)
        ]

    @cached_property
    def _fixed(self) -> Lighting:
        """Lighting of the world, without lights of links."""
        scene = self._scene
        lights = [*scene.lights, *([SUN] if scene.has_sun or not scene.lights else [])]
        rows = [_place_light(light, IDENTITY_POSE[None]) for light in lights]
        return Lighting(
            np.array(scene.ambient[:3] if scene.ambient else AMBIENT_RGB),
            np.array(scene.background[:3] if scene.background else SKY_RGB),
            *map(np.concatenate, zip(*rows, strict=True)),
        )

    def place(self, base: FloatArray, joint_positions: FloatArray) -> Lighting:
        """Find the lights at one step.

        Args:
            base: (n, 7) or more columns: poses of the root links in the world.
            joint_positions: (k,) of all entities, in the order of `Model.joints`.
        """
        fixed = self._fixed
        rows = [
            part
            for group in self._carriers
            for part in _place_carried(group, base, joint_positions)
        ]
        if not rows:
            return fixed
        rows.insert(0, (fixed.places, fixed.colours, fixed.fades, fixed.cones))
        parts = map(np.concatenate, zip(*rows, strict=True))
        return Lighting(fixed.ambient, fixed.background, *parts)


LightRows = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Places, colours, fades and cones (n, ...) of a light; see `Lighting`."""


def _place_carried(
    group: ModelGroup, base: FloatArray, joint_positions: FloatArray
) -> Iterator[LightRows]:
    """Place the lights of the links of the entities of a group."""
    rows = group.rows
    links = compute_link_poses(group.model, base[rows, :7], joint_positions[group.joints])
    for link in group.model.links:
        for light in link.lights:
            yield _place_light(light, links[link.name])


def _place_light(light: Light, owners: FloatArray) -> LightRows:
    """Place a light of owners at poses (n, 7)."""
    count = len(owners)
    length = math.hypot(*light.direction) or 1.0
    directions = rotate(owners[:, 3:], np.array(light.direction) / length)
    if light.kind == "directional":
        places = np.column_stack([-directions, np.zeros(count)])
    else:
        points = transform_points(owners, np.array(light.origin.position))
        places = np.column_stack([points, np.ones(count)])
    colour = np.array(light.rgba[:3]) * light.intensity
    cones = np.column_stack([0.0 * directions, np.full(count, EVERYWHERE)])
    if light.kind == "spot":
        half_rad = (light.outer_angle_rad or FULL_CONE_RAD) / 2.0
        cones = np.column_stack([directions, np.full(count, math.cos(min(half_rad, math.pi)))])
    fade = np.array([*light.attenuation, light.range_m])
    return places, np.repeat(colour[None], count, 0), np.repeat(fade[None], count, 0), cones
