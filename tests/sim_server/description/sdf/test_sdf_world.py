"""SDF worlds: built-in includes, placed models, physics, lights and named poses."""

import math

import msgspec
import pytest

from tests.sim_server.description.robots import mentions, subjects
from tests.sim_server.description.sdf_robots import a_joint, a_link, a_pose
from zensim.proto.messages.entity_messages import Bounds, BoundsType
from zensim.proto.messages.model_messages import Light, Origin
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.messages.sensing_messages import SphericalCoordinates
from zensim.proto.messages.standard_messages import Point, Vector3
from zensim.proto.messages.world_messages import Scene
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.link_surfaces import INFINITE_FRICTION
from zensim.sim_server.description.sdf.sdf_world import read_world
from zensim.sim_server.description.world_model import BoundedPose, PhysicsSettings, WorldModel
from zensim.sim_server.errors import ModelError

GROUND = "<include><uri>model://ground_plane</uri></include>"


def a_world(*parts: str, attributes: str = 'name="w"', version: str = "1.6") -> str:
    return f'<sdf version="{version}"><world {attributes}>{"".join(parts)}</world></sdf>'


def test_empty_world_has_sun_ground_and_gravity() -> None:
    world = read_world(read_builtin_world("empty"))

    assert (world.name, world.scene.has_sun, world.ground_plane) == ("default", True, True)
    assert world.gravity == (0.0, 0.0, -9.8)
    assert world.models == ()


def test_world_without_a_name_is_refused() -> None:
    with pytest.raises(ModelError) as caught:
        read_world(a_world(attributes=""))

    assert caught.value.slug == "sdf.name"


def test_gravity_is_that_of_the_file() -> None:
    assert read_world(a_world("<gravity>0 0 -1.62</gravity>")).gravity == (0.0, 0.0, -1.62)


@pytest.mark.parametrize("gravity", ["0 0", "0 0 nan", "down", ""])
def test_gravity_is_refused_when_it_is_not_a_vector(gravity: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_world(a_world(f"<gravity>{gravity}</gravity>"))

    assert caught.value.slug == "sdf.gravity"


def test_magnetic_field_is_that_of_the_file() -> None:
    world = read_world(a_world("<magnetic_field>1e-6 2e-6 -3e-6</magnetic_field>"))

    assert world.magnetic_field == (1e-6, 2e-6, -3e-6)
    assert "world: <magnetic_field>" in subjects(world.report, "applied")


def test_spherical_coordinates_are_those_of_the_file() -> None:
    world = read_world(
        a_world(
            "<spherical_coordinates><surface_model>EARTH_WGS84</surface_model>"
            "<world_frame_orientation>ENU</world_frame_orientation>"
            "<latitude_deg>48.1</latitude_deg><longitude_deg>11.5</longitude_deg>"
            "<elevation>520</elevation><heading_deg>90</heading_deg></spherical_coordinates>"
        )
    )

    assert world.spherical_coordinates == SphericalCoordinates(48.1, 11.5, 520.0, 90.0)


def test_world_without_spherical_coordinates_has_none() -> None:
    assert read_world(a_world()).spherical_coordinates is None


def test_spherical_coordinates_of_another_frame_are_left_out_and_reported() -> None:
    world = read_world(
        a_world(
            "<spherical_coordinates><world_frame_orientation>NED</world_frame_orientation>"
            "<latitude_deg>48.1</latitude_deg></spherical_coordinates>"
        )
    )

    assert world.spherical_coordinates is None
    assert mentions(world.report, "suspicious", "'NED'", "ENU")


@pytest.mark.parametrize(
    ("content", "slug"),
    [
        ("<magnetic_field>1 2</magnetic_field>", "sdf.magnetic_field"),
        ("<magnetic_field>0 0 1e9</magnetic_field>", "sdf.magnetic_field"),
        (
            "<spherical_coordinates><latitude_deg>91</latitude_deg></spherical_coordinates>",
            "sdf.spherical_coordinates",
        ),
    ],
)
def test_environment_is_refused_when_it_is_impossible(content: str, slug: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_world(a_world(content))

    assert caught.value.slug == slug


def test_world_without_ground_is_reported() -> None:
    world = read_world(a_world())

    assert not world.ground_plane
    assert subjects(world.report, "suspicious") == ["world"]
    assert mentions(world.report, "suspicious", "ground_plane")


@pytest.mark.parametrize(
    "uri", ["model://house", "file:///etc/passwd", "https://example.org/sun", ""]
)
def test_include_is_refused_when_it_is_not_built_in(uri: str) -> None:
    with pytest.raises(ModelError, match=repr(uri)) as caught:
        read_world(a_world(f"<include><uri>{uri}</uri></include>"))

    assert (caught.value.code, caught.value.slug) == (SpawnCode.MISSING_ASSETS, "sdf.include")


@pytest.mark.parametrize("tag", ["actor", "road", "joint"])
def test_unsupported_element_is_left_out(tag: str) -> None:
    world = read_world(a_world(GROUND, f'<{tag} name="x"/>'))

    (entry,) = subjects(world.report, "suspicious")
    assert entry == f"world: <{tag}> 'x'"


def test_tag_with_a_prefix_without_a_namespace_is_reported() -> None:
    world = read_world(a_world(GROUND, "<own:tags>a</own:tags>"))

    assert mentions(world.report, "unknown", "<own:tags>")


@pytest.mark.parametrize(
    "text",
    [
        '<sdf version="1.6"/>',
        '<sdf version="1.6"><model name="m"/></sdf>',
        '<sdf version="1.6"><world name="a"/><world name="b"/></sdf>',
    ],
)
def test_file_is_refused_when_it_is_not_one_world(text: str) -> None:
    with pytest.raises(ModelError, match="<world>") as caught:
        read_world(text)

    assert (caught.value.code, caught.value.slug) == (SpawnCode.UNSUPPORTED_FORMAT, "sdf.world")


@pytest.mark.parametrize("text", ["<robot/>", "<sdf>", "<!DOCTYPE sdf><sdf/>", ""])
def test_file_is_refused_when_it_is_no_sdf(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_world(text)

    assert caught.value.slug.startswith(("sdf.", "xml."))


def test_world_reports_elements_without_effect() -> None:
    world = read_world(
        a_world(
            GROUND,
            "<physics><ode/></physics>",
            "<scene><shadows>1</shadows></scene><gravty>0</gravty><zebra/>",
            "<include><uri>model://sun</uri><pose>0 0 9</pose></include>",
            version="9.9",
        )
    )

    assert subjects(world.report, "ignored") == [
        "include model://sun: <pose>",
        "physics: <ode>",
        "scene: <shadows>",
    ]
    assert subjects(world.report, "unknown") == ["world: <zebra>"]
    assert subjects(world.report, "suspicious") == ["sdf", "world: <gravty>"]
    assert mentions(world.report, "suspicious", "'9.9'", "1.2", "1.12")
    assert mentions(world.report, "suspicious", "<gravty>", "<gravity>")


def a_crate(name: str = "crate", inside: str = "") -> str:
    return f'<model name="{name}">{inside}{a_link("box")}</model>'


def test_model_is_placed_with_its_pose() -> None:
    world = read_world(a_world(GROUND, a_crate(inside=a_pose("1 2 3 0 0 0"))))

    (placed,) = world.models
    assert (placed.name, placed.model.is_static) == ("crate", False)
    assert placed.origin.position == (1.0, 2.0, 3.0)


def test_model_may_be_placed_relative_to_another_or_to_a_frame() -> None:
    world = read_world(
        a_world(
            GROUND,
            a_crate("a", a_pose("1 0 0 0 0 0", 'relative_to="corner"')),
            a_crate("b", a_pose("1 0 0 0 0 0", 'relative_to="a"')),
            '<frame name="corner"><pose relative_to="world">5 0 0 0 0 0</pose></frame>',
        )
    )

    assert [placed.origin.position[0] for placed in world.models] == [6.0, 7.0]


def test_pose_of_a_model_is_that_of_its_placement_frame() -> None:
    link = a_link("box", a_pose("0 0 2 0 0 0"))

    world = read_world(a_world(GROUND, f'<model name="m" placement_frame="box">{link}</model>'))

    assert world.models[0].origin.position == (0.0, 0.0, -2.0)


def test_saved_state_overrides_the_pose_of_a_model() -> None:
    state = '<state><model name="crate"><pose>9 0 0 0 0 0</pose></model></state>'

    world = read_world(a_world(GROUND, a_crate(), state))

    assert world.models[0].origin.position == (9.0, 0.0, 0.0)


def test_included_model_comes_from_the_resolver() -> None:
    include = "<include><uri>model://crate</uri><name>c1</name><pose>1 0 0 0 0 0</pose></include>"
    files = {"model://crate": f'<sdf version="1.6">{a_crate()}</sdf>'}

    world = read_world(a_world(GROUND, include), resolve=files.get)

    assert [(p.name, p.origin.position) for p in world.models] == [("c1", (1.0, 0.0, 0.0))]


@pytest.mark.parametrize(
    ("written", "name"),
    [
        ("grey wall", "grey_wall"),
        ("1st", "m1st"),
        ("a-b", "a_b"),
        ("é", "m_"),
        ("x" * 90, "x" * 56),
    ],
)
def test_entity_name_is_valid(written: str, name: str) -> None:
    assert read_world(a_world(GROUND, a_crate(written))).models[0].name == name


def test_entity_names_are_unique() -> None:
    world = read_world(a_world(GROUND, a_crate("a b"), a_crate("a-b")))

    assert [placed.name for placed in world.models] == ["a_b", "a_b_2"]


@pytest.mark.parametrize(("normal", "is_warned"), [("1 0 0", True), ("0.3 0 1", False)])
def test_world_whose_plane_is_a_wall_is_reported(normal: str, *, is_warned: bool) -> None:
    plane = f"<plane><normal>{normal}</normal></plane>"
    collision = f"<collision name='c'><geometry>{plane}</geometry></collision>"
    model = f"<model name='m'><static>true</static><link name='l'>{collision}</link></model>"

    world = read_world(a_world(model))

    assert mentions(world.report, "suspicious", "robots will fall") == is_warned


def test_level_plane_is_the_ground_plane() -> None:
    mu = "<surface><friction><ode><mu>0.4</mu></ode></friction></surface>"
    plane = f'<collision name="c"><geometry><plane/></geometry>{mu}</collision>'
    ground = f'<model name="g"><static>1</static><link name="l">{plane}</link></model>'

    world = read_world(a_world(ground))

    assert (world.ground_plane, world.ground_friction, world.models) == (True, 0.4, ())


def test_tilted_plane_is_a_model() -> None:
    plane = '<collision name="c"><geometry><plane/></geometry></collision>'
    inside = f'{a_pose("0 0 0 0.1 0 0")}<static>1</static><link name="l">{plane}</link>'

    world = read_world(a_world(f'<model name="ramp">{inside}</model>'))

    assert (world.ground_plane, [placed.name for placed in world.models]) == (False, ["ramp"])


@pytest.mark.parametrize(
    ("physics", "settings"),
    [
        ("", PhysicsSettings()),
        ("<max_step_size>0.002</max_step_size>", PhysicsSettings(0.002, None)),
        ("<real_time_factor>0.5</real_time_factor>", PhysicsSettings(None, 0.5)),
        (
            "<max_step_size>0.002</max_step_size><real_time_factor>1</real_time_factor>"
            "<real_time_update_rate>1000</real_time_update_rate>",
            PhysicsSettings(0.002, 2.0),
        ),
        ("<real_time_update_rate>0</real_time_update_rate>", PhysicsSettings(None, 0.0)),
    ],
)
def test_physics_settings_are_read(physics: str, settings: PhysicsSettings) -> None:
    assert read_world(a_world(GROUND, f"<physics>{physics}</physics>")).physics == settings


def test_default_of_several_physics_is_used() -> None:
    steps = "<physics{}><max_step_size>{}</max_step_size></physics>"
    others = steps.format("", 0.01), steps.format(" default='false'", 0.02)

    world = read_world(a_world(GROUND, *others, steps.format(" default='true'", 0.004)))

    assert world.physics.step_s == 0.004
    assert mentions(world.report, "suspicious", "default='true'")


def test_light_of_a_world_may_be_placed_at_a_frame() -> None:
    frame = '<frame name="mast"><pose>1 2 3 0 0 0</pose></frame>'
    light = '<light name="l" type="point"><pose relative_to="mast">0 0 1 0 0 0</pose></light>'

    world = read_world(a_world(frame, light))

    assert [one.origin.position for one in world.scene.lights] == [(1.0, 2.0, 4.0)]


def test_first_of_repeated_settings_of_a_world_is_used() -> None:
    world = read_world(a_world("<gravity>0 0 -1</gravity><gravity>0 0 -2</gravity>"))

    assert world.gravity == (0.0, 0.0, -1.0)
    assert "gravity" in subjects(world.report, "suspicious")


def test_lights_and_colours_are_read() -> None:
    light = (
        '<light name="lamp" type="point"><pose>0 0 3 0 0 0</pose><diffuse>1 0 0 1</diffuse></light>'
    )

    world = read_world(a_world(light, "<scene><background>0 0 1</background></scene>"))

    lamp = Light("lamp", "point", Origin((0.0, 0.0, 3.0)), rgba=(1.0, 0.0, 0.0, 1.0))
    assert world.scene == Scene(None, (0.0, 0.0, 1.0, 1.0), (lamp,))


def test_unsupported_model_is_left_out() -> None:
    joint = '<joint name="j" type="screw"><parent>world</parent><child>box</child></joint>'

    world = read_world(a_world(GROUND, a_crate(inside=joint)))

    assert world.models == ()
    assert mentions(world.report, "suspicious", "model 'crate'", "sdf.joint_type")


@pytest.mark.parametrize(
    ("inside", "slug"),
    [
        (a_crate(inside=a_pose("0 0 nan 0 0 0")), "sdf.pose"),
        (a_crate("a", a_pose("0 0 0 0 0 0", 'relative_to="a"')), "sdf.pose_cycle"),
        (a_crate("a", a_pose("0 0 0 0 0 0", 'relative_to="z"')), "sdf.unknown_frame"),
        ("<physics><max_step_size>0</max_step_size></physics>", "sdf.physics"),
        ("<physics><max_step_size>fast</max_step_size></physics>", "sdf.number"),
        ("".join(a_crate(f"m{i}") for i in range(5001)), "sdf.size"),
    ],
)
def test_invalid_world_is_refused(inside: str, slug: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_world(a_world(GROUND, inside))

    assert caught.value.slug == slug


GROUND = "<include><uri>model://ground_plane</uri></include>"


def named_poses(inside: str, declared: str = "") -> dict[str, BoundedPose]:
    text = f"<sdf version='1.9' {declared}><world name='w'>{GROUND}{inside}</world></sdf>"
    return {named.pose.name: named for named in read_world(text).named_poses}


@pytest.mark.parametrize("declared", ["", "xmlns:zensim='urn:zensim'"])
def test_frame_is_a_named_pose_with_tags_and_bounds(declared: str) -> None:
    found = named_poses(
        "<frame name='dock'><pose>1 2 0 0 0 0</pose>"
        "<zensim:description> by the door </zensim:description>"
        "<zensim:tags>parking, charging parking</zensim:tags>"
        "<zensim:size>2 4 6</zensim:size></frame>",
        declared,
    )

    pose = found["dock"].pose
    assert (pose.description, pose.tags) == ("by the door", ("parking", "charging"))
    assert pose.pose.position == Point(1.0, 2.0, 0.0)
    assert found["dock"].bounds == Bounds(BoundsType.BOX, (Vector3(1, 2, 3), Vector3(-1, -2, -3)))


def test_frame_without_tags_is_a_pose_without_bounds() -> None:
    bare = named_poses("<frame name='bare'/>")["bare"]

    assert (bare.bounds, bare.pose.tags) == (Bounds(), ())


def test_frame_may_be_attached_to_another() -> None:
    found = named_poses(
        "<frame name='gate'><pose relative_to='dock'>1 0 0 0 0 0</pose></frame>"
        f"<frame name='dock'><pose>0 3 0 0 0 {math.pi / 2}</pose></frame>"
    )

    named = found["gate"].pose.pose.position
    assert (named.x, named.y, named.z) == pytest.approx((0.0, 4.0, 0.0))


@pytest.mark.parametrize(
    ("inside", "value"),
    [
        ("<zensim:size>1 2</zensim:size>", "'1 2'"),
        ("<zensim:size>1 2 0</zensim:size>", "1 2 0"),
        (f"<zensim:tags>{' '.join(f't{i}' for i in range(65))}</zensim:tags>", "65"),
        (f"<zensim:tags>{'t' * 129}</zensim:tags>", "128"),
        (f"<zensim:description>{'d' * 5000}</zensim:description>", "5000"),
    ],
)
def test_frame_with_a_bad_text_is_refused(inside: str, value: str) -> None:
    with pytest.raises(ModelError, match=value) as caught:
        named_poses(f"<frame name='dock'>{inside}</frame>")

    assert caught.value.slug == "sdf.named_pose"


@pytest.mark.parametrize("name", list_builtin_worlds())
def test_built_in_world_has_a_spawn_pose(name: str) -> None:
    world = read_world(read_builtin_world(name))

    assert any("spawn" in named.pose.tags for named in world.named_poses)
    assert {entry.status for entry in world.report} <= {"applied", "ignored"}


def test_encoded_names_of_a_world_are_those_of_journals() -> None:
    assert {"pace", "places"} <= set(msgspec.to_builtins(WorldModel("w")))


FUEL = "https://fuel.gazebosim.org/1.0/OpenRobotics/models"


@pytest.mark.parametrize("ground", ["Ground Plane", "ground_plane/2", "Ground%20Plane"])
def test_ground_and_sun_of_fuel_are_built_in(ground: str) -> None:
    includes = f"<include><uri>{FUEL}/{ground}</uri></include><include><uri>{FUEL}/Sun</uri>"

    world = read_world(a_world(includes, "</include>"))

    assert (world.ground_plane, world.scene.has_sun, world.models) == (True, True, ())


def test_ground_plane_below_the_origin_is_a_model() -> None:
    include = GROUND.replace("</include>", "<pose>0 0 -2 0 0 0</pose></include>")

    world = read_world(a_world(include))

    assert (world.ground_plane, world.models[0].origin.position) == (False, (0.0, 0.0, -2.0))


def test_all_missing_includes_are_named_at_once() -> None:
    includes = [f"<include><uri>model://{name}</uri></include>" for name in ("oak", "elm")]

    with pytest.raises(ModelError, match=r"'model://oak', 'model://elm'") as caught:
        read_world(a_world(*includes))

    assert caught.value.slug == "sdf.include"


def a_nested(inside: str, name: str = "outer") -> str:
    return f'<model name="{name}">{inside}</model>'


def test_model_that_holds_only_a_static_model_is_static() -> None:
    inner = a_nested("<static>1</static>" + a_link("l", a_pose("0 0 1 0 0 0")), "inner")

    (placed,) = read_world(a_world(a_nested(a_pose("2 0 0 0 0 0") + inner))).models

    assert (placed.name, placed.model.is_static) == ("outer", True)
    assert placed.origin.position == (2.0, 0.0, 0.0)


def test_links_that_no_joint_connects_are_separate_entities() -> None:
    links = a_link("a") + a_link("b", a_pose("0 3 0 0 0 0"))

    first, second = read_world(a_world(a_nested(a_pose("1 0 0 0 0 0") + links))).models

    assert (first.name, first.origin.position) == ("outer", (1.0, 0.0, 0.0))
    assert (second.name, second.origin.position) == ("outer__b", (1.0, 3.0, 0.0))
    assert [link.name for link in second.model.links] == ["b"]


def test_joints_inside_of_separate_entities_are_not_reported() -> None:
    links = a_link("a") + a_link("arm") + a_link("b")

    world = read_world(a_world(a_nested(links + a_joint("j", ("a", "arm")))))

    reports = (*world.report, *(entry for one in world.models for entry in one.model.report))
    assert len(world.models) == 2
    assert not [one for one in subjects(reports, "suspicious") if "joint" in one]


def test_pose_of_a_model_is_relative_to_another_model() -> None:
    world = read_world(
        a_world(
            a_crate("a", a_pose("1 0 0 0 0 0")),
            a_crate("b", a_pose("0 1 0 0 0 0", 'relative_to="a"')),
            version="1.9",
        )
    )

    assert world.models[1].origin.position == (1.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("frames", "slug"),
    [
        (
            '<frame name="f" attached_to="g"><pose relative_to="world"/></frame>'
            '<frame name="g" attached_to="f"><pose relative_to="world"/></frame>',
            "sdf.attachment_cycle",
        ),
        (
            '<frame name="f" attached_to="z"><pose relative_to="world"/></frame>',
            "sdf.unknown_frame",
        ),
        ('<frame name="f"/><frame name="f"/>', "sdf.duplicate_name"),
        ('<frame name="crate"/>' + "<model name='crate'><link name='l'/></model>",
         "sdf.duplicate_name"),
    ],
)  # fmt: skip
def test_wrong_frames_are_refused(frames: str, slug: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_world(a_world(frames, version="1.9"))

    assert caught.value.slug == slug


def test_frames_of_a_model_attached_in_a_cycle_are_refused() -> None:
    frames = (
        '<frame name="f" attached_to="g"><pose relative_to="__model__"/></frame>'
        '<frame name="g" attached_to="f"><pose relative_to="__model__"/></frame>'
    )

    with pytest.raises(ModelError) as caught:
        read_world(a_world(a_crate("a", frames), version="1.9"))

    assert caught.value.slug == "sdf.attachment_cycle"


@pytest.mark.parametrize(("version", "is_read"), [("1.2", True), ("1.3", True), ("1.0", False)])
def test_gazebo_root_is_read_as_of_version_1_2(version: str, is_read: bool) -> None:  # noqa: FBT001
    text = f'<gazebo version="{version}"><world name="old">{a_crate("a")}</world></gazebo>'
    if is_read:
        assert read_world(text).models[0].name == "a"
        return

    with pytest.raises(ModelError) as caught:
        read_world(text)

    assert caught.value.slug == "sdf.version"


def test_collision_without_its_mesh_is_refused_and_a_visual_is_not() -> None:
    part = '<{0} name="{0}"><geometry><mesh><uri>a.stl</uri></mesh></geometry></{0}>'
    seen = a_world(GROUND, a_crate("a", ""), a_nested(a_link("l", part.format("visual"))))
    solid = a_world(GROUND, a_nested(a_link("l", part.format("collision"))))

    with pytest.raises(ModelError) as caught:
        read_world(solid)

    assert (caught.value.slug, caught.value.code) == ("mesh.missing", SpawnCode.MISSING_ASSETS)
    assert len(read_world(seen).models) == 2
    assert len(read_world(solid, allow_missing=True).models) == 1


def test_large_worlds_are_read() -> None:
    world = read_world(a_world(*(a_crate(f"c{i}") for i in range(3000))))

    assert len(world.models) == 3000


def test_world_may_have_the_reserved_name_world() -> None:
    world = read_world(a_world(GROUND).replace('name="w"', 'name="world"'))

    assert world.name == "world"
    assert subjects(world.report, "suspicious") == ["world"]


def test_model_of_missing_includes_only_is_left_out() -> None:
    nested = '<model name="bed"><include><uri>model://bed</uri></include></model>'

    world = read_world(a_world(GROUND, nested), allow_missing=True)

    assert world.models == ()
    assert mentions(world.report, "suspicious", "model 'bed'", "sdf.no_links")


@pytest.mark.parametrize("inside", ["<static>true</static>", "", "<static>true</static><pose/>"])
def test_model_without_links_is_left_out_by_name(inside: str) -> None:
    world = read_world(a_world(GROUND, f'<model name="anchor">{inside}</model>', a_crate()))

    assert [placed.name for placed in world.models] == ["crate"]
    assert mentions(world.report, "suspicious", "model 'anchor'", "sdf.no_links")


@pytest.mark.parametrize(
    "fault",
    [
        a_link("l", "<pose>1 2</pose>"),
        a_link("l") + a_joint("j", ("l", "gone")),
        "<static>maybe</static>" + a_link("l"),
    ],
)
def test_refusal_names_the_model(fault: str) -> None:
    nested = a_nested(fault, name="shelf_7")

    with pytest.raises(ModelError) as caught:
        read_world(a_world(GROUND, a_crate(), nested))

    assert "model 'shelf_7'" in caught.value.fault


def test_refusal_of_a_frame_inside_a_model_names_the_model() -> None:
    frame = '<frame name="a"><pose relative_to="shelf_7::lid"/></frame>'

    with pytest.raises(ModelError) as caught:
        read_world(a_world(GROUND, a_crate("shelf_7"), frame))

    assert "model 'shelf_7'" in caught.value.fault


def test_missing_mesh_of_a_collision_is_refused_with_the_name_of_its_model() -> None:
    mesh = "<geometry><mesh><uri>gone.stl</uri></mesh></geometry>"
    solid = a_link("l", f'<collision name="c">{mesh}</collision>')

    with pytest.raises(ModelError) as caught:
        read_world(a_world(GROUND, a_nested(solid, name="shelf_7")))

    assert "model 'shelf_7'" in caught.value.fault


@pytest.mark.parametrize("text", ["Inf", "inf", "+INF"])
def test_infinite_friction_is_a_large_one(text: str) -> None:
    mu = f"<surface><friction><ode><mu>{text}</mu><mu2>{text}</mu2></ode></friction></surface>"
    box = "<geometry><box><size>1 1 1</size></box></geometry>"
    solid = a_link("l", f'<collision name="c">{box}{mu}</collision>')

    world = read_world(a_world(GROUND, a_nested(solid)))

    assert world.models[0].model.links[0].collisions[0].friction == INFINITE_FRICTION


def test_models_of_one_name_are_renamed_and_reported() -> None:
    include = "<include><uri>model://crate</uri></include>"
    crate = f'<sdf version="1.6">{a_crate("box")}</sdf>'

    world = read_world(a_world(GROUND, include, a_crate("box_2"), include), resolve=lambda _: crate)

    assert [placed.name for placed in world.models] == ["box", "box_2", "box_3"]
    assert mentions(world.report, "suspicious", "model 'box'", "'box_3'")


def test_model_whose_name_is_valid_keeps_it() -> None:
    names = ("a-b", "a.b", "a_b", "1x")

    world = read_world(a_world(GROUND, *(a_crate(name) for name in names)))

    assert [placed.name for placed in world.models] == ["a_b_2", "a_b_3", "a_b", "m1x"]
    assert mentions(world.report, "suspicious", "model 'a-b'", "'a_b_2'")
    assert mentions(world.report, "applied", "model '1x'", "'m1x'")


def test_links_of_one_name_are_renamed_and_reported() -> None:
    joint = a_joint("j", ("a", "b"))
    nested = a_nested(a_link("a") + a_link("b") + a_link("b") + joint, "door")

    world = read_world(a_world(GROUND, nested))

    assert sum(placed.model.mass_kg for placed in world.models) == 6.0
    assert mentions(world.report, "suspicious", "model 'door': link 'b'", "'b_2'")


@pytest.mark.parametrize("parts", [(a_crate(), a_crate()), (a_nested(a_link("b") + a_link("b")),)])
def test_equal_names_are_refused_from_sdf_1_7_on(parts: tuple[str, ...]) -> None:
    with pytest.raises(ModelError) as caught:
        read_world(a_world(GROUND, *parts, version="1.7"))

    assert caught.value.slug in ("sdf.duplicate_name", "sdf.duplicate_link")


def test_negative_real_time_factor_is_as_fast_as_possible() -> None:
    world = read_world(a_world("<physics><real_time_factor>-1</real_time_factor></physics>"))

    assert world.physics.real_time_factor == 0.0
    assert subjects(world.report, "suspicious") == ["physics: <real_time_factor>", "world"]


@pytest.mark.parametrize("uri", ["model:///ground_plane", "model://ground_plane//"])
def test_built_in_model_is_found_whatever_the_slashes(uri: str) -> None:
    world = read_world(a_world(f"<include><uri>{uri}</uri></include>"))

    assert world.ground_plane


def test_frame_of_a_world_may_be_relative_to_a_frame_inside_a_model() -> None:
    link = a_link("l", a_pose("0 1 0 0 0 0"))
    inner = '<model name="m"><pose>0 0 1 0 0 0</pose>' + link + "</model>"
    outer = f'<model name="arm"><pose>5 0 0 0 0 0</pose>{inner}</model>'
    frames = (
        '<frame name="a"><pose relative_to="arm::m::l">1 0 0 0 0 0</pose></frame>'
        '<frame name="b" attached_to="arm::m"/>'
    )

    world = read_world(a_world(GROUND, outer, frames))

    points = {one.pose.name: one.pose.pose.position for one in world.named_poses}
    assert points == {"a": Point(6.0, 1.0, 1.0), "b": Point(5.0, 0.0, 1.0)}


def test_frame_inside_a_model_that_does_not_exist_is_refused() -> None:
    frame = '<frame name="a"><pose relative_to="crate::lid"/></frame>'

    with pytest.raises(ModelError) as caught:
        read_world(a_world(a_crate(), frame))

    assert caught.value.slug == "sdf.unknown_frame"
