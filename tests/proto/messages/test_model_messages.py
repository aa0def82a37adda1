"""Derived properties of a model."""

import gc

import msgspec

from tests.models import a_box_bot
from zensim.proto.messages.drive_messages import DiffDrive, PlanarMove, WheelPair
from zensim.proto.messages.model_messages import Inertial, Link, Model

BASE = Link("base_link", Inertial(mass_kg=5.0))
WHEEL = Link("wheel", Inertial(mass_kg=0.25))


def test_mass_of_a_model_is_that_of_its_links() -> None:
    assert Model("box", (BASE, WHEEL, WHEEL)).mass_kg == 5.5
    assert Model("nothing", ()).mass_kg == 0.0


def test_model_has_the_actuators_of_its_drive() -> None:
    drive = DiffDrive((WheelPair("left", "right"),))

    model = Model("rover", (BASE,), drive=drive)

    assert model.actuators == drive.actuators
    assert model.target_count == 2


def test_target_of_a_planar_move_is_three_numbers() -> None:
    assert Model("puck", (BASE,), drive=PlanarMove()).target_count == 3


def test_model_without_a_drive_has_no_actuators() -> None:
    assert Model("box", (BASE,)).actuators == ()
    assert Model("box", (BASE,)).target_count == 0


def test_garbage_collector_does_not_track_the_parts_of_models() -> None:
    encoded = msgspec.json.encode(a_box_bot())
    gc.collect()
    before = len(gc.get_objects())

    models = [msgspec.json.decode(encoded, type=Model) for _ in range(100)]
    gc.collect()

    assert len(gc.get_objects()) - before < 2 * len(models)
