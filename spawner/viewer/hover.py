"""The script that shows a robot's name under the pointer; viser tells the server of clicks only.

It reads what viser's page keeps on `window` for tests; where that is missing, no name appears.
"""

from typing import Final

SCRIPT: Final = """
(() => {
  "use strict";
  const REACH_PX = 10, REFRESH_MS = 1000;
  const tip = document.createElement("div");
  tip.id = "zensim-name";
  tip.style.cssText = "position:fixed;z-index:50;display:none;pointer-events:none;" +
    "padding:2px 8px;border-radius:5px;background:rgba(18,20,24,.88);color:#eef1f5;" +
    "font:600 13px system-ui,sans-serif;white-space:nowrap";
  let names = {}, askedAt = -Infinity, pointer = null;
  const extents = new WeakMap();

  async function refresh() {
    if (performance.now() - askedAt < REFRESH_MS) return;
    askedAt = performance.now();
    const answer = await fetch("/names").catch(() => null);
    if (answer && answer.ok) names = await answer.json();
  }

  function extentOf(vertices) {
    if (!extents.has(vertices)) {
      let most = 0;
      for (let i = 0; i < vertices.length; i += 3) {
        most = Math.max(most, Math.hypot(vertices[i], vertices[i + 1], vertices[i + 2]));
      }
      extents.set(vertices, most);
    }
    return extents.get(vertices);
  }

  function apply(m, v) {
    const row = (r) => m[r] * v[0] + m[r + 4] * v[1] + m[r + 8] * v[2] + m[r + 12];
    return [row(0), row(1), row(2), row(3)];
  }

  function nearest() {
    const page = window.__viserMutable, tree = window.__viserSceneTree;
    if (!page || !page.camera || !page.canvas || !tree) return "";
    const box = page.canvas.getBoundingClientRect();
    const {projectionMatrix, matrixWorldInverse} = page.camera;
    let best = "", bestDistance = 1;
    for (const [path, node] of Object.entries(tree.getState())) {
      const cohort = /^\\/robots\\/[0-9]+/.exec(path);
      const list = cohort && names[cohort[0]];
      const props = node && node.message && node.message.props;
      const object = page.nodeRefFromName[path];
      if (!list || !object || !props || !props.batched_positions) continue;
      const all = props.batched_positions, extent = extentOf(props.vertices);
      for (let i = 0; i < Math.min(list.length, all.length / 3); i++) {
        const world = apply(object.matrixWorld.elements, all.slice(3 * i, 3 * i + 3));
        const seen = apply(projectionMatrix.elements, apply(matrixWorldInverse.elements, world));
        if (seen[3] <= 0) continue;
        const x = box.left + (seen[0] / seen[3] + 1) / 2 * box.width;
        const y = box.top + (1 - seen[1] / seen[3]) / 2 * box.height;
        const size = projectionMatrix.elements[5] * extent / seen[3] / 2 * box.height;
        const distance = Math.hypot(x - pointer.clientX, y - pointer.clientY) /
          Math.max(REACH_PX, size);
        if (distance < bestDistance) [best, bestDistance] = [list[i], distance];
      }
    }
    return best;
  }

  function update() {
    const page = window.__viserMutable;
    const isFree = pointer && page && pointer.target === page.canvas && !pointer.buttons;
    const name = isFree ? nearest() : "";
    tip.style.display = name ? "block" : "none";
    if (!name) return;
    tip.textContent = name;
    tip.style.left = pointer.clientX + 14 + "px";
    tip.style.top = pointer.clientY + 12 + "px";
  }

  addEventListener("DOMContentLoaded", () => document.body.append(tip));
  addEventListener("pointermove", (event) => {
    pointer = event;
    refresh().then(update);
  });
  addEventListener("pointerdown", () => { pointer = null; update(); });
})();
"""
