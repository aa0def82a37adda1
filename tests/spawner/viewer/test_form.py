import msgspec
import pytest

from tests.spawner.viewer.builders import CUBE, a_robot
from zensim.proto.messages.model_messages import Joint, Link, Model, Shape
from zensim.spawner.viewer.form import NotATree, form_of


def test_robots_have_one_form_when_only_their_names_differ() -> None:
    assert form_of(a_robot("r1")) == form_of(a_robot("r2"))


def test_robots_have_two_forms_when_a_colour_differs() -> None:
    red = a_robot("r2", shape=msgspec.structs.replace(CUBE, rgba=(1.0, 0.0, 0.0, 1.0)))

    assert form_of(a_robot("r1")) != form_of(red)


def test_collisions_are_drawn_when_all_visuals_are_files() -> None:
    link = Link("base", collisions=(CUBE,), visuals=(Shape("mesh", mesh="body.dae"),))

    assert form_of(Model("bot", (link,))).links == ((CUBE,),)


def test_mesh_is_drawn_once_it_is_here() -> None:
    mesh = Shape("mesh", (1.0, 1.0, 1.0), mesh="sha")
    model = Model("bot", (Link("base", collisions=(CUBE,), visuals=(mesh, CUBE)),))

    assert form_of(model).links == ((CUBE,),)
    assert form_of(model, {"sha"}).links == ((mesh, CUBE),)


def test_nothing_is_drawn_when_a_link_has_collisions_only() -> None:
    assert form_of(Model("bot", (Link("base", collisions=(CUBE,)),))).links == ((),)


def test_ground_is_not_drawn() -> None:
    link = Link("base", visuals=(Shape("plane"), CUBE))

    assert form_of(Model("ground", (link,))).links == ((CUBE,),)


@pytest.mark.parametrize(
    "model",
    [
        Model("empty", ()),
        Model("loose", (Link("base"), Link("wheel"))),
        Model("swapped", (Link("base"), Link("wheel")), (Joint("j", "fixed", "wheel", "base"),)),
        Model("orphan", (Link("base"), Link("wheel")), (Joint("j", "fixed", "gone", "wheel"),)),
        Model("own_parent", (Link("base"), Link("arm")), (Joint("j", "fixed", "arm", "arm"),)),
    ],
    ids=lambda model: model.name,
)
def test_form_is_refused_when_the_model_is_no_tree(model: Model) -> None:
    with pytest.raises(NotATree, match=model.name):
        form_of(model)
