"""Hostile robots in SDF."""

from collections.abc import Iterator

from tests.hostile.case import NO_NUMBERS, Case
from tests.hostile.documents import documents

INERTIAL = (
    "<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>"
)
DEEP = 70


def sdf_cases() -> Iterator[Case]:
    """Make SDF robots that are refused."""
    yield from _documents()
    yield from _numbers()
    yield from _trees()


def model(*parts: str) -> str:
    return f'<sdf version="1.7"><model name="m">{"".join(parts)}</model></sdf>'


def link(name: str, inside: str = INERTIAL) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>'
        "<axis><xyz>0 0 1</xyz></axis></joint>"
    )


def _documents() -> Iterator[Case]:
    for case in documents():
        text = case.text.replace("robot", "sdf")
        if case.slug.startswith("xml.") and text.lstrip().startswith(("<sdf", "<!DOCTYPE")):
            yield Case(f"sdf_{case.name}", text, case.slug)


def _numbers() -> Iterator[Case]:
    for name in ("nan", "infinite", "word", "comma", "too_large", "hexadecimal", "many_digits"):
        text = NO_NUMBERS[name]
        for slug, inside in {
            "sdf.pose": f"<pose>0 0 {text} 0 0 0</pose>{INERTIAL}",
            "sdf.number": INERTIAL.replace("<mass>1", f"<mass>{text}"),
        }.items():
            yield Case(f"sdf_{slug}_{name}", model(link("a", inside)), slug)
    for name, shape in {
        "tiny": "<box><size>-1e-9 1 1</size></box>",
        "negative": "<sphere><radius>-1</radius></sphere>",
    }.items():
        solid = f'<collision name="c"><geometry>{shape}</geometry></collision>'
        yield Case(f"sdf_size_{name}", model(link("a", solid)), "sdf.size")


def _trees() -> Iterator[Case]:
    ring = joint("j", "a", "b") + joint("k", "b", "a")
    yield Case("sdf_duplicate", model(link("a"), link("a")), "sdf.duplicate_link")
    yield Case("sdf_unknown_parent", model(link("a"), joint("j", "g", "a")), "sdf.unknown_parent")
    yield Case("sdf_unknown_child", model(link("a"), joint("j", "a", "g")), "sdf.unknown_child")
    yield Case(
        "sdf_joint_type", model(link("a"), link("b"), joint("j", "a", "b", "x")), "sdf.joint_type"
    )
    yield Case("sdf_cycle", model(link("a"), link("b"), ring), "sdf.cycle")
    yield Case("sdf_no_links", model(), "sdf.no_links")
    yield Case("sdf_no_model", "<sdf version='1.7'/>", "sdf.model")
    yield Case(
        "sdf_two_models", model(link("a")).replace("<model", "<model name='n'/><model"), "sdf.model"
    )
    poses = "".join(
        f'<frame name="{a}" attached_to="a"><pose relative_to="{b}"/></frame>'
        for a, b in (("f", "g"), ("g", "f"))
    )
    lost = link("b", f'<pose relative_to="f"/>{INERTIAL}') + joint("j", "a", "b")
    yield Case("sdf_pose_cycle", model(link("a"), lost, poses), "sdf.pose_cycle")
    uris = ("file:///etc/passwd", "model://../../etc", "http://127.0.0.1:9/", "/etc/passwd")
    for i, uri in enumerate(uris):
        text = model(link("a"), f"<include><uri>{uri}</uri></include>")
        yield Case(f"sdf_include_{i}", text, "sdf.include")
    nested = "".join(f'<model name="n{i}">' for i in range(DEEP)) + "</model>" * DEEP
    yield Case("sdf_nested", model(link("a"), nested), "xml.depth")
