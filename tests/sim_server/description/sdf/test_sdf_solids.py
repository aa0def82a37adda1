"""Solids, surfaces, colours, textures and lights of SDF files."""

import pytest
from lxml import etree

from tests.sim_server.description.robots import subjects
from tests.sim_server.description.sdf_robots import a_link, read
from zensim.proto.messages.model_messages import Contact, Origin, Shape, Texture
from zensim.proto.rigid_transforms import rotate
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.sdf.sdf_solids import (
    apply_transparency,
    make_ground_slab,
    make_visual_sheet,
    read_colour,
    read_geometry,
    read_surface,
)
from zensim.sim_server.errors import ModelError


def a_part(inside: str) -> etree._Element:
    return etree.fromstring(f"<visual>{inside}</visual>".encode(), etree.XMLParser())


def solid(inside: str) -> Shape | None:
    shapes = read_geometry(a_part(f"<geometry>{inside}</geometry>"), "here", ParseReport())
    return shapes[0] if shapes else None


@pytest.mark.parametrize(
    ("inside", "expected"),
    [
        ("<box><size>1 2 3</size></box>", Shape("box", (1.0, 2.0, 3.0))),
        ("<sphere><radius>2</radius></sphere>", Shape("sphere", (2.0, 0.0, 0.0))),
        (
            "<cylinder><radius>2</radius><length>3</length></cylinder>",
            Shape("cylinder", (2.0, 3.0, 0.0)),
        ),
        (
            "<capsule><radius>2</radius><length>3</length></capsule>",
            Shape("capsule", (2.0, 3.0, 0.0)),
        ),
        ("<plane><normal>0 0 1</normal><size>9 8</size></plane>", Shape("plane", (9.0, 8.0, 0.0))),
        ("<mesh><uri>m.dae</uri></mesh>", Shape("mesh", (1.0, 1.0, 1.0), mesh="m.dae")),
        ("<empty/>", None),
    ],
)
def test_solid_has_its_kind_and_size(inside: str, expected: Shape | None) -> None:
    assert solid(inside) == expected


@pytest.mark.parametrize("normal", ["1 0 0", "0 -2 0", "0 0 -1", "1 2 3"])
def test_plane_is_rotated_to_its_normal(normal: str) -> None:
    plane = solid(f"<plane><normal>{normal}</normal></plane>")

    assert plane is not None
    up = rotate(plane.origin.orientation, (0.0, 0.0, 1.0))
    length = sum(float(n) ** 2 for n in normal.split()) ** 0.5
    assert up == pytest.approx([float(n) / length for n in normal.split()], abs=1e-9)


@pytest.mark.parametrize("tag", ["heightmap", "image", "fog"])
def test_unsupported_geometry_is_reported(tag: str) -> None:
    report = ParseReport()

    assert read_geometry(a_part(f"<geometry><{tag}/></geometry>"), "here", report) == []
    assert len(subjects(report.entries(), "suspicious")) == 1


@pytest.mark.parametrize(
    ("inside", "slug"),
    [
        ("<box><size>1 -1 3</size></box>", "sdf.size"),
        ("<box><size>1 2</size></box>", "sdf.number"),
        ("<sphere><radius>-1</radius></sphere>", "sdf.size"),
        ("<plane><normal>0 0 0</normal></plane>", "sdf.size"),
        ("<plane><size>1</size></plane>", "sdf.number"),
        ("<mesh/>", "sdf.uri"),
    ],
)
def test_geometry_is_refused_when_a_value_is_invalid(inside: str, slug: str) -> None:
    with pytest.raises(ModelError) as caught:
        solid(inside)

    assert caught.value.slug == slug


@pytest.mark.parametrize(
    "inside",
    [
        "<box><size>1 0 3</size></box>",
        "<plane><size>1 0.0</size></plane>",
        "<cylinder><radius>0</radius><length>1</length></cylinder>",
        "<mesh><uri>a</uri><scale>1 0 1</scale></mesh>",
    ],
)
def test_geometry_of_size_0_is_left_out_and_reported(inside: str) -> None:
    report = ParseReport()

    assert read_geometry(a_part(f"<geometry>{inside}</geometry>"), "here", report) == []
    assert subjects(report.entries(), "suspicious") == ["here"]


def test_surface_is_that_of_ode() -> None:
    report = ParseReport()
    part = a_part(
        "<surface><friction><ode><mu>0.5</mu><mu2>0.25</mu2><fdir1>0 2 0</fdir1></ode></friction>"
        "<contact><ode><kp>1e5</kp><kd>1</kd><max_vel>1</max_vel></ode></contact></surface>"
    )

    surface = read_surface(part, "here", report)

    assert (surface.friction, surface.contact) == (0.5, Contact(1e5, 1.0, (0.0, 1.0, 0.0), 0.25))
    assert len(subjects(report.entries(), "applied")) == 4
    assert len(subjects(report.entries(), "ignored")) == 1


def test_negative_friction_is_refused() -> None:
    part = a_part("<surface><friction><ode><mu>-1</mu></ode></friction></surface>")

    with pytest.raises(ModelError) as caught:
        read_surface(part, "here", ParseReport())

    assert caught.value.slug == "sdf.friction"


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        ("<diffuse>1 0 0 0.5</diffuse><ambient>0 1 0 1</ambient>", (1.0, 0.0, 0.0, 0.5)),
        ("<ambient>0 1 0</ambient>", (0.0, 1.0, 0.0, 1.0)),
        ("<script><name>Gazebo/Red</name></script>", (1.0, 0.0, 0.0, 1.0)),
        ("<script>Gazebo/Blue</script>", (0.0, 0.0, 1.0, 1.0)),
        ("<diffuse>3 0 0 1</diffuse>", (1.0, 0.0, 0.0, 1.0)),
        ("<script><name>Gazebo/Nowhere</name></script>", None),
    ],
)
def test_colour_is_that_of_the_script_or_diffuse(
    material: str, expected: tuple[float, ...] | None
) -> None:
    part = a_part(f"<material>{material}</material>")

    assert read_colour(part, "here", ParseReport()) == expected


def test_transparency_is_applied_to_the_colour() -> None:
    assert apply_transparency((1.0, 0.0, 0.0, 1.0), 0.25) == (1.0, 0.0, 0.0, 0.75)
    assert apply_transparency(None, 0.0) is None
    assert apply_transparency(None, 1.0) == (1.0, 1.0, 1.0, 0.0)


def test_plane_has_a_slab_as_collision_and_a_sheet_as_visual() -> None:
    plane = Shape("plane", (3.0, 2.0, 0.0), Origin((0.0, 0.0, 5.0)))

    slab, sheet = make_ground_slab(plane), make_visual_sheet(plane)

    assert slab.kind == sheet.kind == "box"
    assert slab.origin.position[2] + slab.size[2] / 2.0 == 5.0
    assert sheet.size[:2] == (3.0, 2.0)


def a_solid(geometry: str) -> str:
    return f'<collision name="c"><geometry>{geometry}</geometry></collision>'


def collisions_of(geometry: str) -> tuple[Shape, ...]:
    return read(a_link("a", a_solid(geometry))).links[0].collisions


def test_ellipsoid_and_cone_have_their_size() -> None:
    (ellipsoid,) = collisions_of("<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>")
    (cone,) = collisions_of("<cone><radius>0.2</radius><length>0.5</length></cone>")

    assert (ellipsoid.size, cone.size) == ((0.1, 0.2, 0.3), (0.2, 0.2, 0.5))


def test_polyline_is_extruded_along_z() -> None:
    points = "".join(f"<point>{x} {y}</point>" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))

    shapes = collisions_of(f"<polyline>{points}<height>2</height></polyline>")

    assert [shape.size for shape in shapes] == [(1.0, 1.0, 2.0)] * 2


@pytest.mark.parametrize(
    "light",
    [
        '<light name="l" type="beam"/>',
        '<light name="l" type="point"><light_on>0</light_on></light>',
    ],
)
def test_light_that_is_off_or_of_no_known_type_is_left_out(light: str) -> None:
    assert read(a_link("a", light)).links[0].lights == ()


@pytest.mark.parametrize("workflow", ["metal", "specular"])
def test_albedo_map_is_the_texture_of_a_visual(workflow: str) -> None:
    pbr = f"<pbr><{workflow}><albedo_map>a.png</albedo_map></{workflow}></pbr>"
    visual = f"<visual name='v'><geometry><box/></geometry><material>{pbr}</material></visual>"

    model = read(a_link("a", visual))

    assert model.links[0].visuals[0].texture == Texture("a.png")
    assert subjects(model.report, "unknown") == []
