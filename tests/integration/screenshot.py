"""`python -m tests.integration.screenshot URL FILE.png` saves a screenshot of a viewer page."""

import sys
from pathlib import Path

from tests.integration.chromium import open_page

ROBOTS = "Object.keys(window.__viserSceneTree.getState()).some(p => p.startsWith('/robots/'))"
SOFTWARE_NOTE = """
const style = document.createElement("style");
style.textContent = ".mantine-Notifications-root { display: none }";
document.head.append(style);
"""
SETTLED = "new Promise(done => setTimeout(done, 2500))"
"""The first frames precede shader compilation and the final camera pose."""


def screenshot(url: str) -> bytes:
    """Take a screenshot of the page as soon as it shows robots."""
    with open_page(url) as tab:
        tab.until(ROBOTS)
        tab.evaluate(SOFTWARE_NOTE)
        tab.evaluate(SETTLED)
        return tab.screenshot()


if __name__ == "__main__":
    target = Path(sys.argv[2])
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(screenshot(sys.argv[1]))
