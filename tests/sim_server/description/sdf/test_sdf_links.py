"""Links of SDF files: what they hold, in their frame."""

import pytest

from tests.sim_server.description.robots import subjects
from tests.sim_server.description.sdf_robots import a_joint, a_link, a_pose, read


def test_light_of_a_link_is_in_the_frame_of_the_link_that_it_is_lumped_into() -> None:
    light = (
        '<light name="lamp" type="spot"><pose>1 0 0 0 0 0</pose><direction>1 0 0</direction>'
        "<intensity>2</intensity><spot><outer_angle>0.5</outer_angle></spot>"
        "<attenuation><range>7</range><linear>0.1</linear></attenuation></light>"
    )
    turned = a_link("b", a_pose("0 0 1 0 0 1.5707963267948966") + light)

    model = read(a_link("a"), turned, a_joint("j", ("a", "b"), kind="fixed"))

    (lamp,) = model.links[0].lights
    assert lamp.origin.position == pytest.approx((0.0, 1.0, 1.0))
    assert lamp.direction == pytest.approx((0.0, 1.0, 0.0))
    assert (lamp.kind, lamp.intensity, lamp.range_m) == ("spot", 2.0, 7.0)
    assert (lamp.attenuation, lamp.outer_angle_rad) == ((1.0, 0.1, 0.0), 0.5)


def test_visual_without_a_geometry_is_not_drawn() -> None:
    model = read(a_link("a", '<visual name="v"><plugin filename="p" name="p"/></visual>'))

    assert model.links[0].visuals == ()
    assert subjects(model.report, "suspicious") == ["link 'a', visual 'v'"]
