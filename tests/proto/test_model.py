"""What a model tells of itself."""

from proto.model import DiffDrive, Inertial, Link, Model, WheelPair

BASE = Link("base_link", Inertial(mass_kg=5.0))
WHEEL = Link("wheel", Inertial(mass_kg=0.25))


def test_mass_of_a_model_is_that_of_its_links() -> None:
    assert Model("box", (BASE, WHEEL, WHEEL)).mass_kg == 5.5
    assert Model("nothing", ()).mass_kg == 0.0


def test_driven_joints_are_left_before_right_pair_by_pair() -> None:
    pairs = (WheelPair("front_left", "front_right"), WheelPair("rear_left", "rear_right"))

    model = Model("rover", (BASE,), drive=DiffDrive(pairs))

    assert model.driven_joints == ("front_left", "front_right", "rear_left", "rear_right")


def test_model_without_a_drive_has_no_driven_joints() -> None:
    assert Model("box", (BASE,)).driven_joints == ()
