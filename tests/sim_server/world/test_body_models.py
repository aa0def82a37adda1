"""BodyModels: one model for all that engines build alike."""

import msgspec

from tests.models import a_cart
from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import Model, ReportEntry
from zensim.sim_server.world.body_models import MAX_BODY_MODELS, BodyModels

replace = msgspec.structs.replace


def in_namespace(model: Model, namespace: str) -> Model:
    assert model.drive is not None
    return replace(model, drive=replace(model.drive, ros=RosBlock(namespace)))


def test_models_that_differ_in_topics_and_reports_share_one() -> None:
    models, cart = BodyModels(), a_cart()

    found = models.find(cart)

    assert found is cart
    assert models.find(in_namespace(cart, "r1")) is cart
    assert models.find(replace(cart, report=(ReportEntry("applied", "x"),))) is cart


def test_models_that_are_built_otherwise_do_not_share() -> None:
    models, cart = BodyModels(), a_cart()
    models.find(cart)
    static = replace(cart, is_static=True)
    kinematic = replace(cart, dynamics="kinematic")
    other = replace(cart, name="other")

    assert models.find(static) is static
    assert models.find(kinematic) is kinematic
    assert models.find(other) is other
    assert models.find(replace(cart)) is cart


def test_oldest_model_is_forgotten() -> None:
    models, cart = BodyModels(), a_cart()
    models.find(cart)
    for number in range(MAX_BODY_MODELS):
        joints = tuple(replace(one, damping=float(number + 1)) for one in cart.joints)
        models.find(replace(cart, joints=joints))

    copy = replace(cart)

    assert models.find(copy) is copy
