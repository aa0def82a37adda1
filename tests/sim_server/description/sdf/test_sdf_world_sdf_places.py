"""Named poses of a world: its frames."""

import math

import pytest

from zensim.proto.messages.entity_messages import Bounds, BoundsType
from zensim.proto.messages.standard_messages import Point, Vector3
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.sdf.sdf_world import NamedPlace, read_world
from zensim.sim_server.errors import ModelError

GROUND = "<include><uri>model://ground_plane</uri></include>"


def places(inside: str, declared: str = "") -> dict[str, NamedPlace]:
    text = f"<sdf version='1.9' {declared}><world name='w'>{GROUND}{inside}</world></sdf>"
    return {place.pose.name: place for place in read_world(text).places}


@pytest.mark.parametrize("declared", ["", "xmlns:zensim='urn:zensim'"])
def test_frame_is_a_named_pose_with_words_and_room(declared: str) -> None:
    found = places(
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


def test_frame_without_words_is_a_pose_without_bounds() -> None:
    bare = places("<frame name='bare'/>")["bare"]

    assert (bare.bounds, bare.pose.tags) == (Bounds(), ())


def test_frame_may_stand_in_another() -> None:
    found = places(
        "<frame name='gate'><pose relative_to='dock'>1 0 0 0 0 0</pose></frame>"
        f"<frame name='dock'><pose>0 3 0 0 0 {math.pi / 2}</pose></frame>"
    )

    place = found["gate"].pose.pose.position
    assert (place.x, place.y, place.z) == pytest.approx((0.0, 4.0, 0.0))


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
        places(f"<frame name='dock'>{inside}</frame>")

    assert caught.value.slug == "sdf.named_pose"


@pytest.mark.parametrize("name", list_builtin_worlds())
def test_shipped_world_has_a_place_to_spawn_at_and_is_read_in_full(name: str) -> None:
    world = read_world(read_builtin_world(name))

    assert any("spawn" in place.pose.tags for place in world.places)
    assert {entry.status for entry in world.report} <= {"applied", "ignored"}
