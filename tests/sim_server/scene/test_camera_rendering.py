"""Rendered images show what rays hit, in the colours and under the lights of the world."""

import math
from collections.abc import Callable, Sequence

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from zensim.proto.messages.model_messages import Light, Link, Model, Origin, Shape, Texture
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.messages.world_messages import Scene
from zensim.proto.se3 import FloatArray, from_rpy, rotate
from zensim.sim_server.scene.camera_casting import RayRenderer
from zensim.sim_server.scene.camera_images import (
    CameraImages,
    CameraRenderer,
    list_visible_shapes,
    make_pixel_directions,
)
from zensim.sim_server.scene.camera_rendering import OpenGlRenderer
from zensim.sim_server.scene.ray_casting import GROUND, NO_ENTITY, Rays, cast_rays_exactly
from zensim.sim_server.scene.scene import SceneLayout
from zensim.sim_server.scene.scene_lights import MAX_LIGHTS, SceneLights

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
TRIANGLES = CORNERS[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(-1, 3)
JOINTS = np.zeros(0)
QUADRANTS = ((255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255))
"""Of the image, row by row from its top left corner."""
SQUARE = np.array([[0.0, y, z] for y, z in ((1, -1), (-1, -1), (-1, 1), (1, 1))])[
    [0, 1, 2, 0, 2, 3]
]
"""Corners of a wall that a camera along x sees, from its lower left corner on."""
SQUARE_PLACES = np.array([(0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)], "<f4")
RED = (1.0, 0.0, 0.0, 1.0)
BOX = Shape("box", (0.4, 0.8, 1.2), rgba=RED)
PLAIN = Scene()
CAMERA = CameraSensor(width=80, height=60, horizontal_fov_rad=1.2, near_m=0.1, far_m=30.0)
AT_EYE_HEIGHT = np.array([0.0, 0.0, 1.0, *from_rpy(0.0, 0.05, 0.0)])
ERRORS = {"box": 1e-5, "mesh": 1e-4, "sphere": 0.05, "cylinder": 0.05, "capsule": 0.05}
SHAPES = [
    BOX,
    Shape("sphere", (0.5, 0.0, 0.0)),
    Shape("cylinder", (0.3, 1.0, 0.0)),
    Shape("capsule", (0.3, 1.0, 0.0)),
    Shape("mesh", (1.0, 1.0, 1.5), mesh="tetrahedron"),
]


def a_model(*visuals: Shape) -> Model:
    return Model("m", (Link("base", visuals=visuals),))


class Quadrants:
    """The files of an image of four quadrants, and of its places on the wall; of nothing else."""

    def find_picture(self, image: str) -> npt.NDArray[np.uint8] | None:
        pixels = np.array(QUADRANTS, np.uint8).reshape(2, 2, 3)
        return pixels.repeat(32, 0).repeat(32, 1) if image == "quadrants" else None

    def find_places(self, coordinates: str) -> npt.NDArray[np.float32]:
        return SQUARE_PLACES if coordinates == "places" else SQUARE_PLACES[:0]


MakeRenderer = Callable[[SceneLayout], CameraRenderer]
RENDERERS: dict[str, MakeRenderer] = {
    "opengl": lambda layout: OpenGlRenderer(layout, Quadrants()),
    "rays": RayRenderer,
}


@pytest.fixture(params=RENDERERS, autouse=True)
def renderer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(Studio, "make_renderer", staticmethod(RENDERERS[request.param]))
    return str(request.param)


class Studio:
    """Models that are rendered."""

    make_renderer: MakeRenderer = staticmethod(RENDERERS["opengl"])

    def __init__(
        self, placed: Sequence[tuple[Model, list[float]]], scene: Scene = PLAIN, *, ground: bool
    ) -> None:
        models = [model for model, _ in placed]
        self.layout = SceneLayout(
            models,
            lambda name: SQUARE if name == "square" else TRIANGLES,
            has_ground=ground,
            list_shapes=lambda link: list_visible_shapes(link, lambda _: True),
        )
        self.base = np.array([pose for _, pose in placed]).reshape(-1, 7)
        self.lights = SceneLights(self.layout, scene)
        self.renderer = self.make_renderer(self.layout)

    def render(
        self, camera: CameraSensor = CAMERA, pose: FloatArray = AT_EYE_HEIGHT
    ) -> CameraImages:
        lighting = self.lights.place(self.base, JOINTS)
        self.renderer.place(self.layout.place(self.base, JOINTS), lighting)
        return self.renderer.render(camera, pose)

    def cast(self, camera: CameraSensor, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find depths and entities of the pixels by rays."""
        directions = make_pixel_directions(camera).reshape(-1, 3)
        lengths = np.linalg.norm(directions, axis=1)
        turned = rotate(pose[3:], directions / lengths[:, None])
        origins = np.repeat(pose[None, :3], len(turned), axis=0)
        rays = Rays(origins, turned, 1e9, np.full(len(turned), NO_ENTITY))
        hits = cast_rays_exactly(self.layout.place(self.base, JOINTS), rays)
        shape = camera.height, camera.width
        depth = (hits.ranges / lengths).reshape(shape)
        is_far = depth > camera.far_m
        entities = np.where(is_far, NO_ENTITY, hits.entities.reshape(shape))
        return np.where(is_far, np.inf, depth), entities


def at(x: float, y: float, z: float, *rpy: float) -> list[float]:
    return [x, y, z, *from_rpy(*(rpy or (0.0, 0.0, 0.0)))]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.kind)
def test_depth_and_labels_are_those_of_rays_through_the_pixels(shape: Shape) -> None:
    studio = Studio(
        [
            (a_model(shape), at(3.0, 0.4, 1.0, 0.3, 0.2, 0.5)),
            (a_model(shape), at(5.0, -1.0, 0.7, 1.0, 0.0, 2.0)),
        ],
        ground=True,
    )

    images = studio.render()

    depth, entities = studio.cast(CAMERA, AT_EYE_HEIGHT)
    is_same = entities == images.labels
    is_hit = is_same & (entities >= 0)
    assert {0, 1, GROUND, NO_ENTITY} <= set(images.labels.reshape(-1).tolist())
    assert is_same.mean() > 0.99
    assert np.abs(images.depth[is_hit] - depth[is_hit]).max() < ERRORS[shape.kind]
    is_ground = is_same & (entities == GROUND) & np.isfinite(depth)
    assert np.abs(images.depth[is_ground] - depth[is_ground]).max() < 1e-3
    assert (images.depth[images.labels == NO_ENTITY] == np.inf).all()


def test_centre_of_a_pixel_is_where_camera_info_says() -> None:
    camera = CameraSensor(width=4, height=2, horizontal_fov_rad=np.pi / 2.0)

    directions = make_pixel_directions(camera)

    # f = 2, cx = 2, cy = 1: y is left, z is up.
    assert directions[1, 2] == pytest.approx([1.0, 0.0, 0.0])
    assert directions[0, 0] == pytest.approx([1.0, 1.0, 0.5])


def test_image_has_the_right_way_up_and_round() -> None:
    left = a_model(Shape("box", (0.2, 1.0, 1.0), rgba=RED))
    above = a_model(Shape("box", (0.2, 1.0, 1.0), rgba=(0.0, 1.0, 0.0, 1.0)))
    studio = Studio([(left, at(4.0, 1.5, 1.0)), (above, at(4.0, 0.0, 2.2))], ground=False)

    labels = studio.render(pose=np.array(at(0.0, 0.0, 1.0))).labels

    rows, columns = np.nonzero(labels == 0)
    assert (columns.max() < 40, abs(rows.mean() - 30) < 1) == (True, True)
    rows, columns = np.nonzero(labels == 1)
    assert (rows.max() < 30, abs(columns.mean() - 40) < 1) == (True, True)


def test_moved_entity_is_drawn_where_it_is() -> None:
    studio = Studio([(a_model(BOX), at(3.0, 0.0, 1.0))], ground=False)
    before = studio.render().labels

    studio.base = np.array([at(3.0, 1.0, 1.0)])
    after = studio.render().labels

    assert np.nonzero(after == 0)[1].mean() < np.nonzero(before == 0)[1].mean() - 10


@pytest.mark.parametrize(
    ("near_m", "far_m", "is_seen"), [(0.1, 9.0, True), (4.0, 9.0, False), (0.1, 2.0, False)]
)
def test_surfaces_out_of_the_limits_are_not_seen(
    near_m: float, far_m: float, is_seen: object
) -> None:
    studio = Studio([(a_model(BOX), at(3.0, 0.0, 1.0))], ground=False)

    images = studio.render(CameraSensor(width=80, height=60, near_m=near_m, far_m=far_m))

    assert np.isfinite(images.depth).any() == is_seen


def test_colour_is_that_of_the_surface_times_the_light() -> None:
    towards_camera = Light(
        "lamp", "directional", direction=(1.0, 0.0, 0.0), rgba=(0.5, 0.5, 0.5, 1)
    )
    scene = Scene(
        ambient=(0.2, 0.2, 0.2, 1.0), background=(0.0, 0.0, 1.0, 1.0), lights=(towards_camera,)
    )
    wall = a_model(Shape("box", (0.2, 1.0, 1.0), rgba=(0.8, 0.4, 0.0, 1.0)))
    studio = Studio([(wall, at(3.0, 0.0, 1.0))], scene, ground=False)

    rgb = studio.render(pose=np.array(at(0.0, 0.0, 1.0))).rgb

    assert rgb[30, 40].tolist() == pytest.approx([0.7 * 0.8 * 255, 0.7 * 0.4 * 255, 0.0], abs=1.0)
    assert rgb[0, 0].tolist() == [0, 0, 255]


def test_point_light_lights_what_faces_it() -> None:
    lamp = Light("lamp", "point", Origin((2.0, 0.0, 1.0)))
    wall = Shape("box", (0.2, 9.0, 9.0), rgba=(1.0, 1.0, 1.0, 1.0))
    scene = Scene(ambient=(0.0, 0.0, 0.0, 1.0), lights=(lamp,))
    studio = Studio([(a_model(wall), at(4.0, 0.0, 1.0))], scene, ground=False)

    rgb = studio.render(pose=np.array(at(0.0, 0.0, 1.0))).rgb

    assert rgb[30, 40, 0] > 250
    assert rgb[30, 0, 0] < rgb[30, 20, 0] < rgb[30, 40, 0]


WALL = a_model(Shape("box", (0.2, 9.0, 9.0), rgba=(1.0, 1.0, 1.0, 1.0)))
DARK = Scene(ambient=(0.0, 0.0, 0.0, 1.0), lights=(Light("off", "directional", intensity=0.0),))


def a_lamp_carrier(*lights: Light) -> Model:
    return Model("m", (Link("base", lights=lights),))


def light_wall(scene: Scene, *placed: tuple[Model, list[float]]) -> FloatArray:
    """Render a wall 3.9 m in front of a camera; return how bright its pixels (h, w) are, 0 to 1."""
    studio = Studio([(WALL, at(4.0, 0.0, 1.0)), *placed], scene, ground=False)
    return np.asarray(studio.render(pose=np.array(at(0.0, 0.0, 1.0))).rgb[:, :, 0] / 255.0)


def test_lamp_of_a_robot_shines_from_where_the_robot_is() -> None:
    lamp = a_lamp_carrier(Light("lamp", "point", Origin((0.5, 0.0, 0.0)), attenuation=(0, 0, 1)))

    near, far, turned = (
        light_wall(DARK, (lamp, pose))
        for pose in (at(1.4, 0.0, 1.0), at(-0.6, 0.0, 1.0), at(1.4, 0.0, 1.0, 0.0, 0.0, np.pi))
    )

    # 1 / d^2 at 2, 4 and 3 m.
    seen = [one[30, 40] for one in (near, far, turned)]
    assert seen == pytest.approx([0.25, 1 / 16, 1 / 9], abs=0.005)


def test_light_beyond_its_range_has_no_effect() -> None:
    lamp = a_lamp_carrier(Light("lamp", "point", range_m=2.5))

    bright = light_wall(DARK, (lamp, at(2.0, 0.0, 1.0)))

    assert bright[30, 40] > 0.9
    assert bright[30, 0] == 0.0


def test_spot_light_shines_in_its_cone_alone_and_turns_with_its_robot() -> None:
    spot = Light("spot", "spot", direction=(1.0, 0.0, 0.0), outer_angle_rad=math.radians(40.0))
    lamp = a_lamp_carrier(spot)

    ahead = light_wall(DARK, (lamp, at(0.0, 0.0, 1.0)))
    left = light_wall(DARK, (lamp, at(0.0, 0.0, 1.0, 0.0, 0.0, 0.4)))

    assert ahead[30, 40] > 0.95
    assert ahead[30, 0] == ahead[30, 79] == 0.0
    assert left[30, :40].max() > 0.8
    assert left[30, 45:].max() == 0.0


def test_of_too_many_lights_the_nearest_shine() -> None:
    lamp = a_lamp_carrier(Light("lamp", "point", attenuation=(0.0, 0.0, 1.0)))
    dim = [(lamp, at(-5.0 - i, 0.0, 1.0)) for i in range(MAX_LIGHTS)]

    bright = light_wall(DARK, *dim, (lamp, at(1.9, 0.0, 1.0)))

    assert bright[30, 40] > 0.25


def show_wall(image: str, places: str) -> list[list[int]]:
    """Render a wall with an image in plain light; return the colours of its quadrants."""
    wall = Shape("mesh", (1.0, 1.0, 1.0), mesh="square", texture=Texture(image, places))
    scene = Scene(ambient=(1.0, 1.0, 1.0, 1.0), lights=DARK.lights)
    coloured = msgspec.structs.replace(wall, rgba=(1.0, 1.0, 0.5, 1.0))
    studio = Studio([(a_model(coloured), at(3.0, 0.0, 1.0))], scene, ground=False)
    rgb = studio.render(pose=np.array(at(0.0, 0.0, 1.0))).rgb
    return [rgb[row, column].tolist() for row in (25, 35) for column in (35, 45)]


def test_opengl_draws_the_image_of_a_mesh_the_right_way_up_and_round(renderer: str) -> None:
    drawn = QUADRANTS if renderer == "opengl" else [(255, 255, 255)] * 4

    assert show_wall("quadrants", "places") == [
        pytest.approx([red, green, blue / 2.0], abs=1.0) for red, green, blue in drawn
    ]


@pytest.mark.parametrize(("image", "places"), [("absent", "places"), ("quadrants", "absent")])
def test_mesh_has_its_plain_colour_where_its_image_cannot_be_drawn(image: str, places: str) -> None:
    assert show_wall(image, places) == [pytest.approx([255, 255, 128], abs=1.0)] * 4


def test_two_sizes_of_images_keep_their_buffers_apart() -> None:
    studio = Studio([(a_model(BOX), at(3.0, 0.0, 1.0))], ground=True)
    small, large = CameraSensor(width=40, height=30), CameraSensor(width=160, height=120)

    first, other, again = (studio.render(camera) for camera in (small, large, small))

    assert (first.depth.shape, other.rgb.shape) == ((30, 40), (120, 160, 3))
    assert first.rgb.tobytes() == again.rgb.tobytes()


def test_empty_world_is_all_background() -> None:
    images = Studio([], ground=False).render()

    assert (images.labels == NO_ENTITY).all()


def test_collisions_are_drawn_where_no_visual_can_be() -> None:
    mesh = Shape("mesh", mesh="absent")
    box = Shape("box", (1.0, 1.0, 1.0))

    shown = [
        list_visible_shapes(Link("l", collisions=(box,), visuals=visuals), lambda _: False)
        for visuals in ((mesh,), (), (BOX,), (Shape("box", rgba=(0, 0, 0, 0)),))
    ]

    assert shown == [(box,), (), (BOX,), (box,)]
