"""Includes of SDF are replaced by the models of the resolver."""

import pytest

from tests.sim_server.description.robots import mentions, subjects
from tests.sim_server.description.sdf_robots import a_joint, a_link, a_model, a_pose, an_axis
from zensim.proto.messages.model_messages import Model, Texture
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.errors import ModelError

HAND = a_model(a_pose("0 0 5 0 0 0"), a_link("palm"), attributes='name="hand"')

A_MESH = '<visual name="v"><geometry><mesh><uri>meshes/a.stl</uri></mesh></geometry></visual>'


def an_include(uri: str, inside: str = "") -> str:
    return f"<include><uri>{uri}</uri>{inside}</include>"


def read(files: dict[str, str], *parts: str) -> Model:
    return read_sdf_model(a_model(*parts), resolve=files.get)


def test_included_model_has_the_pose_of_its_include() -> None:
    include = an_include("model://hand", "<name>left</name><pose>0 1 0 0 0 0</pose>")

    model = read({"model://hand": HAND}, a_link("a"), include, a_joint("j", ("a", "left::palm")))

    assert [(f.name, f.origin.position) for f in model.frames] == [("left::palm", (0.0, 1.0, 0.0))]
    assert "include 'model://hand'" in [e.subject for e in model.report if e.status == "applied"]


def test_included_model_keeps_its_pose_and_name_by_default() -> None:
    parts = (a_link("a"), an_include("model://hand"), a_joint("j", ("a", "hand::palm")))

    model = read({"model://hand": HAND}, *parts)

    assert model.frames[0].origin.position == (0.0, 0.0, 5.0)


def test_model_may_be_included_twice_under_two_names() -> None:
    parts = [a_link("a")]
    for name in ("left", "right"):
        parts += [
            an_include("model://hand", f"<name>{name}</name>"),
            a_joint(name + "_j", ("a", f"{name}::palm")),
        ]

    assert read({"model://hand": HAND}, *parts).mass_kg == 6.0


def test_axes_of_an_included_file_are_those_of_its_version() -> None:
    turned = a_link("b", a_pose("0 0 0 0 0 3.14159265358979"))
    old = a_model(
        a_link("a"), turned, a_joint("j", ("a", "b"), "revolute", an_axis("1 0 0")), version="1.4"
    )
    parts = (a_link("base"), an_include("model://old"), a_joint("k", ("base", "m::a")))

    model = read({"model://old": old}, *parts)

    assert model.joints[0].axis == pytest.approx((-1.0, 0.0, 0.0), abs=1e-9)


def test_relative_meshes_of_two_included_models_differ() -> None:
    parts = []
    for name in ("left", "right"):
        hand = a_model(a_link("palm", A_MESH), attributes=f'name="{name}"')
        parts.append((f"model://{name}", hand, a_joint(f"j_{name}", ("a", f"{name}::palm"))))
    files = {uri: text for uri, text, _ in parts}
    here = {"model://left/meshes/a.stl": ("", b"")}

    model = read_sdf_model(
        a_model(a_link("a"), *map(an_include, files), *(joint for _, _, joint in parts)),
        resolve=files.get,
        find_mesh=here.get,
    )

    assert [shape.mesh for shape in model.links[0].visuals] == list(here)
    assert subjects(model.report, "suspicious") == ["link 'right::palm', visual 'v'"]
    assert mentions(model.report, "suspicious", "'model://right/meshes/a.stl'")


def test_relative_include_is_relative_to_its_model_first() -> None:
    arm = a_model(a_link("arm"), an_include("hand.sdf"), a_joint("j", ("arm", "hand::palm")))
    parts = (a_link("a"), an_include("model://arm/arm.sdf"), a_joint("k", ("a", "m::arm")))
    other = a_model(a_link("claw"), attributes='name="hand"')
    files = {"model://arm/arm.sdf": arm, "hand.sdf": other, "model://arm/hand.sdf": HAND}

    assert "m::hand::palm" in [frame.name for frame in read(files, *parts).frames]
    files.pop("model://arm/hand.sdf")
    files["hand.sdf"] = HAND
    assert "m::hand::palm" in [frame.name for frame in read(files, *parts).frames]


def test_model_that_includes_itself_is_refused() -> None:
    files = {
        "model://a": a_model(an_include("model://b")),
        "model://b": a_model(an_include("model://a")),
    }

    with pytest.raises(ModelError) as caught:
        read(files, an_include("model://a"))

    assert caught.value.slug == "sdf.include_cycle"


def test_includes_that_multiply_are_refused() -> None:
    def ten(of: str) -> str:
        return a_model(*(an_include(of, f"<name>n{i}</name>") for i in range(10)))

    files = {"x0": HAND, **{f"x{i}": ten(f"x{i - 1}") for i in range(1, 8)}}

    with pytest.raises(ModelError) as caught:
        read(files, an_include("x7"))

    assert caught.value.slug == "sdf.size"


@pytest.mark.parametrize(
    ("text", "slug"),
    [("<sdf version='1.9'/>", "sdf.model"), ("<robot/>", "sdf.root"), ("<sdf", "xml.syntax")],
)
def test_included_file_is_refused_when_it_is_not_a_model(text: str, slug: str) -> None:
    with pytest.raises(ModelError) as caught:
        read({"x": text}, an_include("x"))

    assert caught.value.slug == slug


def a_merge(inside: str = "") -> str:
    return an_include("x", inside).replace("<include>", '<include merge="true">')


def test_merged_include_becomes_part_of_its_model() -> None:
    pose = "<pose>1 0 0 0 0 1.5707963267948966</pose>"

    model = read({"x": HAND}, a_link("a"), a_merge(pose), a_joint("j", ("a", "palm")))

    (frame,) = model.frames
    assert frame.name == "palm"
    assert frame.origin.position == pytest.approx((1.0, 0.0, 0.0))


def test_merged_include_is_placed_by_its_placement_frame() -> None:
    hand = HAND.replace("</model>", '<frame name="grip"><pose>0 0 2 0 0 0</pose></frame></model>')
    inside = "<placement_frame>grip</placement_frame><pose>0 0 5 0 0 0</pose>"

    model = read({"x": hand}, a_link("a"), a_merge(inside), a_joint("j", ("a", "palm")))

    assert model.frames[0].origin.position == pytest.approx((0.0, 0.0, 3.0))


def test_relative_images_of_an_included_model_are_its_own() -> None:
    pbr = "<material><pbr><metal><albedo_map>materials/a.png</albedo_map></metal></pbr></material>"
    visual = f"<visual name='v'><geometry><box/></geometry>{pbr}</visual>"
    crate = a_model(a_link("box", visual), attributes='name="crate"')
    joint = a_joint("j", ("a", "crate::box"), kind="fixed")

    model = read_sdf_model(
        a_model(a_link("a"), an_include("model://crate"), joint),
        resolve={"model://crate": crate}.get,
    )

    assert [shape.texture for shape in model.links[0].visuals] == [
        Texture("model://crate/materials/a.png")
    ]
