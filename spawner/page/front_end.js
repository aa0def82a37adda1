// Own controls of the page: head, list of entities and drive pad; what sticks to robots.
// The server puts empty elements with data-zensim-part into its panel; they are filled here.
(() => {
"use strict";
const REFRESH_MS = 120, SPARE_ROWS = 4;
// As in page_tools.css.
const NARROW = "(max-width: 640px)", BY_FINGER = `${NARROW}, (pointer: coarse)`;
const CATEGORIES = ["Robots", "Objects", "World"];
const STATUSES = {
  m: "moving", s: "standing", z: "asleep", n: "no agent", b: "blocked", t: "static",
};
const RESETS = {"time and poses": "Time and poses", poses: "Poses", time: "Time",
  all: "All, delete what was spawned"};
const SURE = "Press again to delete all", SURE_MS = 5000;
const PAD = [
  ["forward", "KeyW", "Forward", "W"], ["left", "KeyA", "Turn left", "A"],
  ["right", "KeyD", "Turn right", "D"], ["back", "KeyS", "Backward", "S"],
];
const ICONS = {
  Play: "M7 4.5v15l12-7.5z", Pause: "M7 5h4v14H7zM14 5h4v14h-4z",
  Step: "M6 5v14l9-7zM16 5h3v14h-3z",
  Reset: "M12 5V2L7 6l5 4V7a5 5 0 1 1-5 5H5a7 7 0 1 0 7-7z",
  All: "M4 9V4h5v2H6v3zM15 4h5v5h-2V6h-3zM4 15h2v3h3v2H4zM18 15h2v5h-5v-2h3z",
  forward: "M12 6l7 11H5z", back: "M12 18L5 7h14z", left: "M6 12l11-7v14z", right: "M18 12L7 19V5z",
  Stop: "M6 6h12v12H6z",
};

function send(message) {
  const page = window.__viserMutable;
  if (page && page.sendMessage) page.sendMessage(message);
}

function make(parent, kind, attributes, text) {
  const element = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  if (parent) parent.append(element);
  return element;
}

function makeButton(parent, label, icon, act, attributes = {}) {
  const button = make(parent, "button", {type: "button", ...attributes});
  if (icon) {
    const picture = `<svg viewBox="0 0 24 24" aria-hidden="true"><path d="${ICONS[icon]}"/></svg>`;
    button.insertAdjacentHTML("beforeend", picture);
  }
  make(button, "span", {}, label);
  if (act) button.addEventListener("click", act);
  return button;
}

// ---- Head: play or pause, step, reset.

function fillHead(place) {
  const bar = make(place, "div", {class: "zensim-head", role: "group", "aria-label": "Simulation"});
  const play = makeButton(bar, "Pause", "Pause", () => send({type: "ZensimAct", act: play.act}));
  play.classList.add("zensim-play");
  makeButton(bar, "Step", "Step", () => send({type: "ZensimAct", act: "Step"}));
  const box = make(bar, "div", {class: "zensim-menu"});
  const reset = makeButton(box, "Reset", "Reset", () => open(menu.hidden),
    {"aria-haspopup": "menu", "aria-expanded": "false"});
  const menu = make(box, "div", {role: "menu", "aria-label": "What to reset", hidden: ""});
  const open = (isOpen) => {
    menu.hidden = !isOpen;
    reset.setAttribute("aria-expanded", isOpen);
    menu.lastElementChild.textContent = RESETS.all;
    if (isOpen) menu.firstElementChild.focus();
  };
  for (const [scope, text] of Object.entries(RESETS)) {
    const item = make(menu, "button", {type: "button", role: "menuitem"}, text);
    item.addEventListener("click", (event) => {
      if (event.detail > 1) return;  // a double click is no second thought
      if (scope === "all" && item.textContent !== SURE) {
        item.textContent = SURE;
        setTimeout(() => { item.textContent = text; }, SURE_MS);
        return;
      }
      open(false);
      send({type: "ZensimAct", act: `Reset ${scope}`});
    });
  }
  box.addEventListener("focusout", (event) => {
    if (!menu.hidden && !box.contains(event.relatedTarget)) open(false);
  });
  box.addEventListener("keydown", (event) => {
    if (menu.hidden || !["Escape", "ArrowDown", "ArrowUp"].includes(event.key)) return;
    event.preventDefault();
    event.stopPropagation();
    if (event.key === "Escape") { open(false); reset.focus(); return; }
    const items = [...menu.children], step = event.key === "ArrowDown" ? 1 : -1;
    const at = items.indexOf(document.activeElement) + step;
    items[(at + items.length) % items.length].focus();
  });
  showHead(place);
}

function showHead(place) {
  const play = place.querySelector(".zensim-play");
  const status = document.querySelector(".zensim-status");
  const act = status && status.dataset.state === "playing" ? "Pause" : "Play";
  if (!play || play.act === act) return;
  play.act = act;
  play.querySelector("span").textContent = act;
  play.querySelector("path").setAttribute("d", ICONS[act]);
}

// ---- Connection: without one, viser sends by a mute function.

const LOST = `<div><dt>State</dt><dd><span style="color:var(--zensim-red)">&#9679;</span>
  no connection</dd></div><div role="alert">The page process has ended; start zensim up again</div>`;

function showConnection() {
  const page = window.__viserMutable, status = document.querySelector(".zensim-status");
  const isLost = !!(status && page && /is not connected/.test(page.sendMessage));
  document.documentElement.classList.toggle("zensim-lost", isLost);
  if (!isLost || status.dataset.state === "lost") return;
  status.dataset.state = "lost";  // a new connection has a new element
  status.innerHTML = LOST;
}

// ---- List: only the rows within view exist.

let entities = [], codes = "", speeds = [], selected = [], words = "", items = [], found = 0;

// Called by the server: name, number of category, other words to search, and colour of each.
window.zensimEntities = (list) => { entities = list; codes = ""; findItems(); };
// Called by the server: status letter and speed [cm/s] of each.
window.zensimStatuses = (letters, cmps) => {
  [codes, speeds] = [letters, cmps];
  if (words) findItems(); else showLists();
};
window.zensimMarks = (names) => { selected = names; showLists(); };

function findItems() {
  const wanted = words.toLowerCase().split(/\s+/).filter(Boolean);
  const groups = CATEGORIES.map(() => []);
  entities.forEach(([name, category, more], i) => {
    const text = `${name} ${more} ${STATUSES[codes[i]] || ""}`.toLowerCase();
    if (wanted.every((word) => text.includes(word))) groups[category].push(i);
  });
  found = groups.reduce((sum, group) => sum + group.length, 0);
  const isMixed = groups.filter((group) => group.length).length > 1;
  items = groups.flatMap((group, i) =>
    group.length && isMixed ? [`${CATEGORIES[i]} (${group.length})`, ...group] : group);
  showLists();
}

const places = (part) => document.querySelectorAll(`[data-zensim-part="${part}"]`);
function showLists() { places("list").forEach(showList); }

function fillList(place) {
  const bar = make(place, "div", {class: "zensim-search"});
  const field = make(bar, "input", {type: "text", "aria-label": "Search", autocomplete: "off",
    placeholder: "Name, model or status", spellcheck: "false"});
  field.value = words;
  field.addEventListener("input", () => { words = field.value; findItems(); });
  makeButton(bar, "Show all", "All", () => send({type: "ZensimAct", act: "Show all"}),
    {title: "Move the camera to show all"});
  make(place, "div", {class: "zensim-count", role: "status"});
  const view = make(place, "div", {class: "zensim-rows", role: "list", "aria-label": "Entities"});
  make(view, "div", {class: "zensim-room"});
  view.addEventListener("scroll", () => showList(place));
  showList(place);
}

function showList(place) {
  const view = place.querySelector(".zensim-rows"), room = view && view.firstElementChild;
  if (!room) return;
  const count = place.querySelector(".zensim-count");
  const text = entities.length ? `${found} of ${entities.length}` : place.dataset.empty;
  if (count.textContent !== text) count.textContent = text;
  const rowPx = matchMedia(BY_FINGER).matches ? 46 : 32;
  view.classList.toggle("is-short", selected.length > 0);
  room.style.height = `${items.length * rowPx}px`;
  const first = Math.max(0, Math.floor(view.scrollTop / rowPx) - SPARE_ROWS);
  const shown = Math.ceil((view.clientHeight || 600) / rowPx) + 2 * SPARE_ROWS;
  // The row of an item stays the same element while it is in view, so that it keeps the focus.
  const rows = new Map();
  for (const row of [...room.children]) {
    const at = Number(row.dataset.at);
    if (at < first || at >= Math.min(items.length, first + shown)) row.remove();
    else rows.set(at, row);
  }
  for (let at = first; at < Math.min(items.length, first + shown); at++) {
    const row = rows.get(at) || makeRow(room, at, rowPx);
    showRow(row, items[at]);
  }
}

function makeRow(room, at, rowPx) {
  const row = make(null, "div", {role: "listitem", "data-at": at});
  row.style.cssText = `top:${at * rowPx}px;height:${rowPx}px`;
  const next = [...room.children].find((one) => Number(one.dataset.at) > at);
  room.insertBefore(row, next || null);
  return row;
}

function showRow(row, item) {
  if (typeof item === "string") {
    if (row.textContent !== item) { row.innerHTML = ""; make(row, "h3", {}, item); }
    return;
  }
  const [name, , , colour] = entities[item], status = STATUSES[codes[item]] || "";
  let button = row.querySelector("button");
  if (!button) {
    row.innerHTML = "";
    button = make(row, "button", {type: "button"});
    for (const kind of ["dot", "name", "speed"]) make(button, "span", {class: kind});
    button.addEventListener("click", (event) => send(
      {type: "ZensimSelect", entity: button.entity, is_added: event.shiftKey}));
  }
  button.entity = name;
  const [dot, label, speed] = button.children;
  const set = (element, key, value) => { if (element[key] !== value) element[key] = value; };
  set(dot, "className", `dot is-${status.replace(" ", "-")}`);
  set(label, "textContent", name);
  set(speed, "textContent", status === "moving" ? `${(speeds[item] / 100).toFixed(2)} m/s` : status);
  const title = `${name} · ${status}`;
  if (button.getAttribute("aria-label") !== title) {
    button.setAttribute("aria-label", title);
    button.style.setProperty("--robot", colour || "transparent");
  }
  const isOn = String(selected.includes(name));
  if (button.getAttribute("aria-pressed") !== isOn) button.setAttribute("aria-pressed", isOn);
}

// ---- Pad: its buttons are held as keys are.

function fillPad(place) {
  const pad = make(place, "div", {class: "zensim-pad", role: "group", "aria-label": "Drive"});
  for (const [kind, code, label, key] of PAD) {
    const title = `${label}: hold it, or ${key}`;
    const button = makeButton(pad, label, kind, null, {"aria-label": label, title});
    button.classList.add(`is-${kind}`);
    const hold = (isDown) => {
      if (button.classList.contains("is-held") === isDown) return;
      button.classList.toggle("is-held", isDown);
      zensimHold(code, isDown);
    };
    button.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      button.setPointerCapture(event.pointerId);
      hold(true);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) {
      button.addEventListener(end, () => hold(false));
    }
    button.addEventListener("keydown", (event) => { if (event.key === "Enter") hold(true); });
    button.addEventListener("keyup", (event) => { if (event.key === "Enter") hold(false); });
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }
  makeButton(pad, "Stop", "Stop", () => zensimStop(), {title: "Stop the robot: Space"})
    .classList.add("is-stop");
}

// ---- Nodes of a visitor that stick to a robot: as it is drawn, not as it was sent.

let stuck = [];
// Called by the server: node, batch and instance of the robot, height above it (null = turns along).
window.zensimStick = (list) => { stuck = list; };

function findInstances(page, path) {
  const node = page.nodeRefFromName[path];
  let mesh = null;
  if (node) node.traverse((one) => { if (!mesh && one.getMatrixAt) mesh = one; });
  return mesh;
}

function stick() {
  requestAnimationFrame(stick);
  undrawn += 1;
  const page = window.__viserMutable;
  if (!page || !page.camera) return;
  if (page.scene && page.scene !== scene) watch(page.scene);
  for (const [name, batch, number, lift] of stuck) {
    const pose = page.nodePoseData[name], mesh = findInstances(page, batch);
    if (!pose || !mesh || number >= mesh.instancesCount) continue;
    const matrix = mesh.getMatrixAt(number), node = page.nodeRefFromName[name];
    const position = page.camera.position.clone().setFromMatrixPosition(matrix);
    const turn = page.camera.quaternion.clone().setFromRotationMatrix(matrix);
    pose.position = [position.x, position.y, position.z + (lift || 0)];
    if (lift === null) pose.wxyz = [turn.w, turn.x, turn.y, turn.z];
    if (node && pose.poseUpdateState === "updated") pose.poseUpdateState = "needsUpdate";
  }
}

// ---- Level of detail: far parts are boxes, then nothing; the largest part of a robot stays.

// Radius of a part [px] from which on it is drawn as a box, and not at all; with a graphics card, and
// without, where each triangle of a fleet takes about a microsecond.
const FAR_PX = {card: [3, 0.6], software: [6, 1.5]}, BOX_TRIANGLES = 12;
const BOX_INDEX = [
  ...[0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4],
  ...[2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5],
];
const levelled = new WeakSet();
let partCounts = {};

// The ground is transparent, too, and covers patches that are drawn before it.
function drawShadowsLast() {
  const nodes = window.__viserMutable ? window.__viserMutable.nodeRefFromName : {};
  for (const [path, node] of Object.entries(nodes)) {
    if (node && path.startsWith("/shadows/")) node.traverse((one) => { one.renderOrder = 1; });
  }
}

function addFarLevels() {
  const page = window.__viserMutable, models = {}, counts = {};
  if (!page || !page.camera || !page.canvas) return;
  for (const path of Object.keys(page.nodeRefFromName)) {
    const [, model] = path.match(/^(\/robots\/\d+)\//) || [];
    const mesh = model && findInstances(page, path);
    if (mesh) (models[model] ||= new Set()).add(mesh);
  }
  for (const [model, parts] of Object.entries(models)) {
    counts[model] = parts.size;
    if (counts[model] === partCounts[model]) addLevelsOf([...parts], page);  // no part is missing
  }
  partCounts = counts;
}

function addLevelsOf(parts, page) {
  if (parts.every((part) => levelled.has(part))) return;
  for (const {geometry} of parts) if (!geometry.boundingSphere) geometry.computeBoundingSphere();
  const radius = (part) => part.geometry.boundingSphere.radius;
  const largest = Math.max(...parts.map(radius));
  // Pixels of a length at a distance of the same length.
  const pixels = page.canvas.clientHeight / 2 / Math.tan(page.camera.fov * Math.PI / 360);
  const [boxPx, leastPx] = FAR_PX[isReduced() ? "software" : "card"];
  for (const part of parts.filter((one) => !levelled.has(one))) {
    levelled.add(part);
    const {geometry, material} = part, far = radius(part) * pixels;
    const isDetailed = geometry.index && geometry.index.count > 3 * BOX_TRIANGLES;
    if (isDetailed && !material.map && !Array.isArray(material)) {
      addLevel(part, makeBoxAround(geometry), far / boxPx);
    }
    if (radius(part) < largest) {
      addLevel(part, makeGeometry(geometry, [0, 0, 0], []), far / leastPx).visible = false;
    }
  }
}

function addLevel(part, geometry, distance) {
  const {material} = part;
  const own = Array.isArray(material) ? material.map((one) => one.clone()) : material.clone();
  part.addLOD(geometry, own, distance);
  part.geometry.addEventListener("dispose", () => {
    geometry.dispose();
    [own].flat().forEach((one) => one.dispose());
  });
  return part.LODinfo.objects.at(-1);
}

function makeBoxAround(geometry) {
  geometry.computeBoundingBox();
  const {min, max} = geometry.boundingBox, corners = [];
  for (const z of [min.z, max.z]) for (const y of [min.y, max.y]) for (const x of [min.x, max.x]) {
    corners.push(x, y, z);
  }
  return makeGeometry(geometry, corners, BOX_INDEX);
}

function makeGeometry(like, corners, index) {
  const made = new like.constructor(), Attribute = like.attributes.position.constructor;
  made.setAttribute("position", new Attribute(new Float32Array(corners), 3));
  made.setIndex(index);
  made.computeVertexNormals();
  return made;
}

// ---- Software WebGL: what a processor draws slowly is left out while something moves.
// An address with fixedDpr asks for the whole picture.

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
const NOTICE = "Software WebGL rendering detected";
const LEAST_DPR = 0.5, DPR_STEP = 0.1, WINDOW_MS = 1000, SLOW_HZ = 24, FAST_HZ = 40;
// viser draws for 250 ms after each change: still scenes have gaps, then one sharp picture.
// A slow browser takes long for each frame, but draws in each.
const GAP_MS = 400, GAP_FRAMES = 3, MOVING_MS = 600, NOTICE_MS = 5000;
const getContext = HTMLCanvasElement.prototype.getContext;
let scene = null, renderer = null, asked = 1, moving = 0.6, limit = moving;
let began = 0, last = 0, frames = 0, undrawn = 0, windowAt = 0, noticedAt = 0, isSlow;

// Whether the processor draws in place of a graphics card.
function isSoftware() {
  if (isSlow !== undefined) return isSlow;
  const gl = getContext.call(document.createElement("canvas"), "webgl2");
  const info = gl && gl.getExtension("WEBGL_debug_renderer_info");
  isSlow = SOFTWARE.test(info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "");
  if (gl) gl.getExtension("WEBGL_lose_context")?.loseContext();
  return isSlow;
}

const isReduced = () => !new URLSearchParams(location.search).has("fixedDpr") && isSoftware();

HTMLCanvasElement.prototype.getContext = function (kind, attributes, ...more) {
  const isScene = attributes && attributes.antialias && String(kind).startsWith("webgl");
  const wanted = isScene && isReduced() ? {...attributes, antialias: false} : attributes;
  return getContext.call(this, kind, wanted, ...more);
};

function watch(found) {
  scene = found;
  const before = scene.onBeforeRender;
  scene.onBeforeRender = (gl, ...more) => {
    before.call(scene, gl, ...more);
    if (isReduced() && !more[2]) reduce(gl);
  };
}

function reduce(gl) {
  if (renderer !== gl) {
    renderer = gl;
    asked = gl.getPixelRatio();
    const set = gl.setPixelRatio.bind(gl);
    gl.setPixelRatio = (ratio) => { asked = ratio; set(Math.min(ratio, limit)); };
    requestAnimationFrame(() => gl.setPixelRatio(asked));  // not within a frame
    scene.traverse(({material}) => { if (material) material.needsUpdate = true; });
  }
  gl.shadowMap.enabled = false;  // viser sets it with each size of the window
  const now = performance.now();
  if (isStill(now)) [began, windowAt, frames] = [now, now, 0];
  [last, frames, undrawn] = [now, frames + 1, 0];
}

const isStill = (now) => now - last > GAP_MS && undrawn > GAP_FRAMES;

// Called periodically: draws coarsely while something moves, and sharply once nothing does.
function chooseDpr() {
  if (!renderer) return;
  const now = performance.now();
  if (isStill(now)) return setLimit(1);
  if (now - began < MOVING_MS) return;
  if (now - windowAt > WINDOW_MS) {
    const hz = 1000 * frames / (now - windowAt);
    if (hz < SLOW_HZ) moving = Math.max(LEAST_DPR, moving - DPR_STEP);
    if (hz > FAST_HZ) moving = Math.min(1, moving + DPR_STEP);
    [windowAt, frames] = [now, 0];
  }
  setLimit(moving);
}

function setLimit(wanted) {
  if (limit === wanted) return;
  limit = wanted;
  renderer.setPixelRatio(asked);
  window.__viserMutable.requestRender();
}

// The notice of viser covers controls until it is closed; here it is read, then closed.
function closeNotice() {
  if (!isReduced() || noticedAt === Infinity) return;
  const all = [...document.querySelectorAll(".mantine-Notification-root")];
  const notice = all.find((one) => one.innerText.includes(NOTICE));
  noticedAt = noticedAt || (notice ? performance.now() : 0);
  if (!notice || performance.now() - noticedAt < NOTICE_MS) return;
  noticedAt = Infinity;
  notice.querySelector("button").click();
}

// ---- Parts are filled when the panel shows them.

const FILLERS = {head: fillHead, list: fillList, pad: fillPad};
function refresh() {
  showConnection();
  for (const [part, fill] of Object.entries(FILLERS)) {
    places(part).forEach((place) => { if (!place.firstChild) fill(place); });
  }
  places("head").forEach(showHead);
  keepTab();
  centreAboveSheet();
  drawShadowsLast();
  addFarLevels();
  chooseDpr();
  closeNotice();
}

// ---- Phone: the picture has its middle in what the sheet leaves free.

const SHEET = ".mantine-Paper-root[style*='position: fixed'][style*='bottom: 0']";
let shifted = "";

function centreAboveSheet() {
  const page = window.__viserMutable, camera = page && page.camera;
  if (!camera || !camera.setViewOffset) return;
  const sheet = matchMedia(NARROW).matches && document.querySelector(SHEET);
  const {clientWidth: width, clientHeight: height} = page.canvas;
  nameSheet(sheet);
  const shift = sheet ? Math.round(Math.min(sheet.offsetHeight, height / 2) / 2) : 0;
  const now = `${width} ${height} ${shift}`;
  if (now === shifted) return;
  shifted = now;
  if (shift) camera.setViewOffset(width, height, 0, shift, width, height);
  else camera.clearViewOffset();
  page.requestRender();
}

// viser makes the panel anew, with its first tab, when a phone is turned; it may not obey at once.
const MOST_PRESSES = 10;
let tabName = "", tabBar = null, presses = 0;

function keepTab() {
  const tabs = [...document.querySelectorAll("[data-dock-tab], .mantine-Tabs-tab")];
  const bar = tabs.length ? tabs[0].parentElement : null, name = (one) => one.innerText.trim();
  if (bar !== tabBar) [tabBar, presses] = [bar, MOST_PRESSES];
  const shown = tabs.find((one) => one.ariaSelected === "true");
  const former = presses && shown !== undefined && tabs.find((one) => name(one) === tabName);
  if (former && former !== shown) {
    presses -= 1;
    for (const kind of ["pointerdown", "pointerup"]) {  // of a mouse, for which tabs can be dragged
      former.dispatchEvent(new PointerEvent(kind, {bubbles: true, pointerId: 1, isPrimary: true}));
    }
    former.click();
  } else if (shown) [tabName, presses] = [name(shown), 0];
}

function nameSheet(sheet) {
  const title = sheet && [...sheet.querySelectorAll("[style*='cursor: pointer'] > div")]
    .find((one) => one.innerText);
  if (!title) return;
  const isOpen = sheet.offsetHeight > 2 * title.parentNode.offsetHeight;
  title.setAttribute("aria-label", `${isOpen ? "Collapse" : "Expand"} panel area`);
  if (title.tabIndex === 0) return;
  title.tabIndex = 0;
  title.setAttribute("role", "button");
  title.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") title.click();
  });
}

// Called by the server of the page: for what it waits for a click on the floor; empty = nothing.
window.zensimPicks = (purpose) => document.body.classList.toggle("zensim-picks", purpose !== "");

addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || !document.body.classList.contains("zensim-picks")) return;
  send({type: "ZensimAct", act: "Give up"});
});

// viser takes a captured pointer for that of handles; browsers capture each touch by themselves.
addEventListener("pointerdown", (event) => {
  const {target, pointerId} = event;
  if (!document.body.classList.contains("zensim-picks") || event.pointerType !== "touch") return;
  if (target.hasPointerCapture(pointerId)) target.releasePointerCapture(pointerId);
}, true);

addEventListener("DOMContentLoaded", () => {
  setInterval(refresh, REFRESH_MS);
  addEventListener("resize", showLists);
  stick();
});
})();
