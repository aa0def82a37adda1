// The name of the robot under the pointer.
(() => {
  "use strict";
  const REACH_PX = 10, REFRESH_MS = 1000;
  const tip = document.createElement("div");
  tip.id = "zensim-name";
  tip.style.cssText = "position:fixed;z-index:50;display:none;pointer-events:none;" +
    "padding:2px 8px;border-radius:5px;background:rgba(18,20,24,.88);color:#eef1f5;" +
    "font:600 13px system-ui,sans-serif;white-space:nowrap";
  let names = {}, requestedAt = -Infinity, pointer = null;
  const extents = new WeakMap();

  async function refresh() {
    if (performance.now() - requestedAt < REFRESH_MS) return;
    requestedAt = performance.now();
    const response = await fetch("/names").catch(() => null);
    if (response && response.ok) names = await response.json();
  }

  function extentOf(vertices) {
    if (!extents.has(vertices)) {
      const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
      for (let i = 0; i < vertices.length; i++) {
        low[i % 3] = Math.min(low[i % 3], vertices[i]);
        high[i % 3] = Math.max(high[i % 3], vertices[i]);
      }
      extents.set(vertices, {low, high});
    }
    return extents.get(vertices);
  }

  function turnBack(q, v) {  // by the inverse of the quaternion w x y z
    const [w, x, y, z] = [q[0], -q[1], -q[2], -q[3]];
    const t = [2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])];
    return [
      v[0] + w * t[0] + y * t[2] - z * t[1],
      v[1] + w * t[1] + z * t[0] - x * t[2],
      v[2] + w * t[2] + x * t[1] - y * t[0],
    ];
  }

  function enter(start, way, {low, high}) {  // distance along the ray to the box, or Infinity
    let near = 0, far = Infinity;
    for (let axis = 0; axis < 3; axis++) {
      const a = (low[axis] - start[axis]) / way[axis], b = (high[axis] - start[axis]) / way[axis];
      if (Number.isNaN(a) || Number.isNaN(b)) continue;
      near = Math.max(near, Math.min(a, b));
      far = Math.min(far, Math.max(a, b));
    }
    return near <= far ? near : Infinity;
  }

  function apply(m, v) {
    const row = (r) => m[r] * v[0] + m[r + 4] * v[1] + m[r + 8] * v[2] + m[r + 12];
    return [row(0), row(1), row(2), row(3)];
  }

  function rayOf(page, box) {
    const {projectionMatrix: {elements: p}, matrixWorld: {elements: m}} = page.camera;
    const x = (pointer.clientX - box.left) / box.width * 2 - 1;
    const y = 1 - (pointer.clientY - box.top) / box.height * 2;
    const v = [(x + p[8]) / p[0], (y + p[9]) / p[5], -1];
    const way = [0, 1, 2].map((r) => m[r] * v[0] + m[r + 4] * v[1] + m[r + 8] * v[2]);
    return {start: [m[12], m[13], m[14]], way};
  }

  function intoFrame(m, v) {
    return [0, 4, 8].map((c) => m[c] * v[0] + m[c + 1] * v[1] + m[c + 2] * v[2]);
  }

  // The first thing under the pointer; else the one whose centre is nearest, if it is near.
  function nearest() {
    const page = window.__viserMutable, tree = window.__viserSceneTree;
    if (!page || !page.camera || !page.canvas || !tree) return "";
    const box = page.canvas.getBoundingClientRect();
    const {projectionMatrix, matrixWorldInverse} = page.camera;
    const ray = rayOf(page, box);
    let hit = "", hitDistance = Infinity, best = "", bestDistance = REACH_PX;
    for (const [path, node] of Object.entries(tree.getState())) {
      const group = /^\/robots\/[0-9]+/.exec(path);
      const list = group && names[group[0]];
      const props = node && node.message && node.message.props;
      const object = page.nodeRefFromName[path];
      if (!list || !object || !props || !props.batched_positions) continue;
      const m = object.matrixWorld.elements, all = props.batched_positions;
      const start = intoFrame(m, ray.start.map((v, axis) => v - m[12 + axis]));
      const way = intoFrame(m, ray.way);
      const extent = props.vertices && extentOf(props.vertices);
      for (let i = 0; i < Math.min(list.length, all.length / 3); i++) {
        const place = all.slice(3 * i, 3 * i + 3);
        const turn = props.batched_wxyzs.slice(4 * i, 4 * i + 4);
        if (extent) {
          const from = turnBack(turn, start.map((v, axis) => v - place[axis]));
          const distance = enter(from, turnBack(turn, way), extent);
          if (distance < hitDistance) [hit, hitDistance] = [list[i], distance];
        }
        const clip = apply(projectionMatrix.elements,
          apply(matrixWorldInverse.elements, apply(m, place)));
        if (clip[3] <= 0) continue;
        const x = box.left + (clip[0] / clip[3] + 1) / 2 * box.width;
        const y = box.top + (1 - clip[1] / clip[3]) / 2 * box.height;
        const distance = Math.hypot(x - pointer.clientX, y - pointer.clientY);
        if (distance < bestDistance) [best, bestDistance] = [list[i], distance];
      }
    }
    return hit || best;
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
