"""Controls of the page as assistive programs see them, used by a real pointer and real keys."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from tests.integration.chromium import Tab
from tests.integration.processes import eventually

ROLES = frozenset(
    {"button", "checkbox", "combobox", "menuitem", "option", "slider", "spinbutton", "tab"}
    | {"textbox", "searchbox", "radio", "switch", "link"}
)
"""Of what a visitor can use."""
WITHIN_S = 60.0
PLACE = """
function () {
  // The input of a checkbox is transparent, beside its icon; a slider is used on its track.
  const shown = this.closest(".mantine-Slider-root") && this.getAttribute("role") === "slider" ?
    this.closest(".mantine-Slider-root").querySelector(".mantine-Slider-track") : this;
  shown.scrollIntoView({block: "center"});
  const {left, top, width, height} = shown.getBoundingClientRect();
  const [x, y] = [left + width / 2, top + height / 2];
  const hit = document.elementFromPoint(x, y);
  const own = hit && (this.contains(hit) || hit.contains(this) || shown.contains(hit) ||
    (this.labels && [...this.labels].some((label) => label.contains(hit))) ||
    hit.closest(".mantine-Input-wrapper, .mantine-Slider-root, .mantine-Checkbox-inner")
      ?.contains(this));
  return own && width ? [x, y, width, height] : null;
}
"""
"""Middle and size of an element [px]; null while another one covers it."""


Box = tuple[float, float, float, float]
"""Middle and size [px]."""


class Control(NamedTuple):
    """A control of the page."""

    tab: str
    """Title of the tab that it is in; empty = beside the tabs."""
    role: str
    name: str
    number: int = 0
    """Among those with the same role and name."""


class AccessibleNode(NamedTuple):
    """A node of the accessibility tree."""

    role: str
    name: str
    element: int
    """Number of the element in the browser."""


class PageControls:
    """Uses controls of a page; a click or a key goes to what the pointer or the focus is on.

    Attributes:
        used: Controls that were used.
    """

    def __init__(self, tab: Tab) -> None:
        """Use the controls of an open page."""
        self.tab = tab
        self.used: set[Control] = set()

    def list_nodes(self) -> list[AccessibleNode]:
        """List what can be used now, in the order of the page."""
        nodes = self.tab.call("Accessibility.getFullAXTree")["nodes"]
        return [found for one in nodes if (found := read_node(one)).role in ROLES]

    def list_of_tabs(self, *titles: str) -> set[Control]:
        """List the controls of each tab; those that all of them show are beside the tabs."""
        nodes_of: dict[str, list[AccessibleNode]] = {}
        for title in titles:
            self.turn_to(title)
            self.tab.evaluate("new Promise((done) => setTimeout(done, 600))")  # names come later
            nodes_of[title] = self.list_nodes()
        common = set.intersection(*({one.element for one in n} for n in nodes_of.values()))
        return {
            Control("" if node.element in common else title, node.role, node.name, number)
            for title, nodes in nodes_of.items()
            for node, number in count_equal(nodes)
        }

    def value_of(self, control: Control) -> str:
        """Return the text of a field."""
        self.turn_to(control.tab)
        found = self._call_on(control, "function () { return this.value; }")
        return "" if found is None else str(found)

    def find(self, control: Control) -> int | None:
        """Find the element of a control; None if it is not there."""
        document = self.tab.call("Runtime.evaluate", expression="document")["result"]["objectId"]
        nodes = self.tab.call(
            "Accessibility.queryAXTree",
            objectId=document,
            role=control.role,
            accessibleName=control.name,
        )["nodes"]
        found = [read_node(one).element for one in nodes if not one["ignored"]]
        return found[control.number] if control.number < len(found) else None

    def locate(self, control: Control) -> Box:
        """Scroll to a control; return its middle and size [px] once a pointer would hit it."""
        seen: list[Box | None] = [None]

        def find() -> Box | None:
            """Find it at rest: a folder opens and closes slowly."""
            seen.append(self._locate(control))
            return seen[-1] if seen[-1] == seen[-2] else None

        return eventually(find, WITHIN_S, f"{control} within reach")

    def turn_to(self, title: str) -> None:
        """Turn to a tab."""
        if title:
            self._click(Control("", "tab", title))

    def click(self, control: Control) -> None:
        """Click the middle of a control."""
        self.turn_to(control.tab)
        self._click(control)

    def slide(self, control: Control, share: float) -> None:
        """Click the track of a slider at a share of its length."""
        self.turn_to(control.tab)
        x, y, width, _ = self.locate(control)
        self.tab.click(x + (share - 0.5) * width, y)
        self.used.add(control)

    def write(self, control: Control, text: str) -> None:
        """Write a text in place of that in a field."""
        self.click(control)
        self.press_key("a", modifiers=2, commands=["selectAll"])
        if text:
            self.tab.call("Input.insertText", text=text)
        else:
            self.press_key("Delete")
        self.leave_field()

    def choose(self, control: Control, option: str) -> None:
        """Choose an option of a list that opens by a click."""
        self.click(control)
        self._click(Control(control.tab, "option", option))
        self.used.add(control)
        self.leave_field()

    @contextmanager
    def holding(self, control: Control) -> Iterator[None]:
        """Hold a button down until the block ends."""
        self.turn_to(control.tab)
        x, y, *_ = self.locate(control)
        button = {"button": "left", "clickCount": 1, "x": x, "y": y}
        self.tab.point(x, y)
        self.tab.call("Input.dispatchMouseEvent", type="mousePressed", **button)
        yield
        self.tab.call("Input.dispatchMouseEvent", type="mouseReleased", **button)
        self.used.add(control)

    @contextmanager
    def holding_key(self, code: str, key: str) -> Iterator[None]:
        """Hold a key down until the block ends."""
        self.tab.call("Input.dispatchKeyEvent", type="rawKeyDown", code=code, key=key)
        yield
        self.tab.call("Input.dispatchKeyEvent", type="keyUp", code=code, key=key)

    def press_key(self, key: str, *, modifiers: int = 0, **more: object) -> None:
        """Press and release a key; modifiers are bits: 1 alt, 2 control, 4 meta, 8 shift."""
        is_letter = len(key) == 1 and key.isalpha()
        number = ord(key.upper()) if is_letter else {"Delete": 46, "Escape": 27}.get(key, 0)
        fields: dict[str, Any] = {
            "key": key,
            "code": f"Key{key.upper()}" if is_letter else key,
            "windowsVirtualKeyCode": number,
            "modifiers": modifiers,
        }
        self.tab.call("Input.dispatchKeyEvent", type="rawKeyDown", **fields, **more)
        self.tab.call("Input.dispatchKeyEvent", type="keyUp", **fields)

    def leave_field(self) -> None:
        """Take the focus from a field, so that keys are commands again."""
        self.tab.evaluate("document.activeElement && document.activeElement.blur()")

    def drag(
        self, start: tuple[float, float], end: tuple[float, float], *, button: str = "left"
    ) -> None:
        """Drag from a place to another one [px]."""
        self.tab.point(*start)
        self._move("mousePressed", start, button=button, clickCount=1)
        for share in (0.25, 0.5, 0.75, 1.0):
            x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
            self._move("mouseMoved", (x, y), button=button, buttons={"left": 1, "right": 2}[button])
        self._move("mouseReleased", end, button=button, clickCount=1)

    def until(self, expression: str) -> Any:  # noqa: ANN401  it is JSON
        """Wait until an expression of the page is true; return it."""
        return self.tab.until(expression, WITHIN_S * 2.0)

    def until_text(self, text: str) -> None:
        """Wait until the page has a text."""
        self.until(f"document.body.innerText.includes({text!r})")

    def until_no_text(self, text: str) -> None:
        """Wait until the page does not have a text."""
        self.until(f"!document.body.innerText.includes({text!r})")

    def until_there(self, control: Control) -> None:
        """Wait until a control is there."""
        eventually(lambda: self.find(control) is not None, WITHIN_S, f"{control}")

    def _click(self, control: Control) -> None:
        x, y, *_ = self.locate(control)
        self.tab.click(x, y)
        self.used.add(control)

    def _locate(self, control: Control) -> Box | None:
        found = self._call_on(control, PLACE.strip())
        return tuple(found) if found else None

    def _call_on(self, control: Control, function: str) -> Any:  # noqa: ANN401  it is JSON
        """Call a function of the page on the element of a control; None if it is not there."""
        element = self.find(control)
        if element is None:
            return None
        with suppress(RuntimeError):  # it was replaced meanwhile
            handle = self.tab.call("DOM.resolveNode", backendNodeId=element)["object"]["objectId"]
            return self.tab.call(
                "Runtime.callFunctionOn",
                objectId=handle,
                functionDeclaration=function,
                returnByValue=True,
            )["result"].get("value")
        return None

    def _move(self, kind: str, place: tuple[float, float], **more: object) -> None:
        x, y = place
        self.tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)


def read_node(node: dict[str, Any]) -> AccessibleNode:
    """Read a node of the protocol; the role of one that is ignored is empty."""
    role = "" if node["ignored"] else str(node.get("role", {}).get("value", ""))
    name = str(node.get("name", {}).get("value", ""))
    return AccessibleNode(role, name, int(node.get("backendDOMNodeId", 0)))


def count_equal(nodes: list[AccessibleNode]) -> Iterator[tuple[AccessibleNode, int]]:
    """Give each node its number among those with the same role and name."""
    counts: Counter[tuple[str, str]] = Counter()
    for node in nodes:
        yield node, counts[node.role, node.name]
        counts[node.role, node.name] += 1
