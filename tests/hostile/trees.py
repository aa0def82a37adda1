"""Links and joints that are not a tree, and invalid names."""

from collections.abc import Iterator

from tests.hostile.case import Case, joint, link, pair, robot

THREE = link("a") + link("b") + link("c")


def trees() -> Iterator[Case]:
    """Make robots with inconsistent links and joints."""
    yield from _cycles()
    yield from _ends()
    yield from _names()
    yield from _budgets()


def _cycles() -> Iterator[Case]:
    ring = joint("j", "a", "b") + joint("k", "b", "a")
    yield Case("cycle_of_two", robot(link("a"), link("b"), ring), "urdf.cycle")
    yield Case("cycle_beside_a_root", robot(THREE, link("root"), *_ring()), "urdf.cycle")
    yield Case("cycle_of_three", robot(THREE, *_ring()), "urdf.cycle")
    yield Case("cycle_of_fixed_joints", robot(THREE, *_ring("fixed")), "urdf.cycle")
    yield Case("joint_to_itself", robot(link("a"), joint("j", "a", "a")), "urdf.cycle")
    long = [link(f"l{i}") for i in range(200)]
    turns = [joint(f"j{i}", f"l{i}", f"l{(i + 1) % 200}", "fixed") for i in range(200)]
    yield Case("cycle_of_200", robot(*long, *turns), "urdf.cycle")
    yield Case("two_roots", robot(link("a"), link("b")), "urdf.two_roots")
    yield Case("roots_100", robot(*long[:100]), "urdf.two_roots")
    both = joint("j", "a", "c") + joint("k", "b", "c") + joint("l", "a", "b")
    yield Case("two_parents", robot(THREE, both), "urdf.two_parents")
    yield Case(
        "same_joint_twice_by_another_name",
        robot(link("a"), link("b"), joint("j", "a", "b"), joint("k", "a", "b")),
        "urdf.two_parents",
    )


def _ring(kind: str = "continuous") -> list[str]:
    ends = (("a", "b"), ("b", "c"), ("c", "a"))
    return [joint(f"j{i}", *end, kind) for i, end in enumerate(ends)]


def _ends() -> Iterator[Case]:
    ghost = joint("j", "ghost", "a")
    yield Case("unknown_parent", robot(link("a"), ghost), "urdf.unknown_parent")
    yield Case("unknown_child", robot(link("a"), joint("j", "a", "ghost")), "urdf.unknown_child")
    other = joint("j", "A", "b")
    yield Case("parent_of_other_case", robot(THREE, other), "urdf.unknown_parent")
    lone = '<joint name="j" type="fixed">{}</joint>'
    ends = {
        "no_parent": ('<child link="a"/>', "urdf.parent"),
        "no_child": ('<parent link="a"/>', "urdf.child"),
        "empty_parent": ('<parent link=""/><child link="a"/>', "urdf.link"),
        "parent_without_link": ('<parent/><child link="a"/>', "urdf.link"),
        "parent_as_text": ("<parent>a</parent><child>a</child>", "urdf.link"),
    }
    for name, (inside, slug) in ends.items():
        yield Case(f"joint_with_{name}", robot(link("a"), lone.format(inside)), slug)
    for kind in ("hinge", "Revolute", "spherical", "fixed ", "0", "revolut\u0435"):
        yield Case(f"joint_of_type_{kind!r}", pair(kind=kind), "urdf.joint_type")
    yield Case("joint_without_type", pair().replace(' type="continuous"', ""), "urdf.type")
    yield Case("joint_of_empty_type", pair(kind=""), "urdf.type")
    for kind in ("revolute", "prismatic"):
        yield Case(f"{kind}_without_limit", pair(kind=kind), "urdf.limit")


def _names() -> Iterator[Case]:
    yield Case("robot_without_name", f"<robot>{link('a')}</robot>", "urdf.name")
    yield Case("robot_of_empty_name", f'<robot name="">{link("a")}</robot>', "urdf.name")
    yield Case("link_without_name", robot("<link/>"), "urdf.name")
    yield Case("link_of_empty_name", robot(link("")), "urdf.name")
    yield Case("link_of_spaces", robot(link("   ")), "urdf.name")
    yield Case("joint_without_name", pair().replace('joint name="j"', "joint"), "urdf.name")
    yield Case("material_without_name", robot(link("a"), "<material/>"), "")
    yield Case("link_name_of_5000", robot(link("n" * 5000)), "urdf.text")
    yield Case("joint_name_of_5000", pair().replace('"j"', f'"{"j" * 5000}"'), "urdf.text")
    yield Case("robot_name_of_5000", f'<robot name="{"r" * 5000}"/>', "urdf.text")
    odd = {"newline": "&#10;", "escape": "&#x1b;[31m", "bell": "\u0085", "override": "\u202e"}
    for name, text in odd.items():
        slug = "xml.syntax" if name == "escape" else "urdf.text"
        yield Case(f"link_name_with_{name}", robot(link(f"a{text}b")), slug)
    yield Case("duplicate_link", robot(link("a"), link("a")), "urdf.duplicate_link")
    twins = joint("j", "a", "b") + joint("j", "a", "c")
    yield Case("duplicate_joint", robot(THREE, twins), "urdf.duplicate_joint")
    many = link("a") * 300
    yield Case("duplicate_links_300", robot(many), "urdf.duplicate_link")


def _budgets() -> Iterator[Case]:
    yield Case("no_links", robot(), "urdf.no_links")
    yield Case("links_501", _star(500, "fixed"), "urdf.size")
    yield Case("links_1500", _star(1499, "fixed"), "urdf.size")
    yield Case("links_5000", _star(4999, "fixed"), "xml.size")
    yield Case("joints_121", _star(121, "continuous"), "urdf.joints")
    yield Case("joints_499", _star(499, "continuous"), "urdf.joints")
    yield Case("joints_499_in_a_chain", _chain(499), "urdf.joints")
    yield Case("floating_joints_21", _star(21, "floating"), "urdf.joints")


def _star(arms: int, kind: str) -> str:
    return robot(
        link("hub"), *(link(f"a{i}") + joint(f"j{i}", "hub", f"a{i}", kind) for i in range(arms))
    )


def _chain(joints: int) -> str:
    return robot(
        link("l0"),
        *(link(f"l{i + 1}") + joint(f"j{i}", f"l{i}", f"l{i + 1}") for i in range(joints)),
    )
