// Tools that run in the browser alone; `texts` has the style and the help.
"use strict";
const NOTE_MS = 6000, SCALE_MS = 250, LINK_MS = 500, FRAMES_PER_S = 30;
const LONGEST_FILM_MS = 120000, FILM_PART_MS = 250;
const FILM_TYPES = ["video/webm;codecs=vp9", "video/webm", "video/mp4"];
const LEAST_SCALE_PX = 60;
const INPUTS = ":is(input, textarea, [role=slider]):is(:not([aria-label]), [aria-label=''])";
let film = null, noteTimer = 0;

function add(parent, kind, attributes, text) {
  const element = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text) element.textContent = text;
  parent.append(element);
  return element;
}

const style = document.createElement("style");
style.textContent = texts.style;
const bar = document.createElement("div");
bar.id = "zensim-tools";
bar.setAttribute("role", "toolbar");
bar.setAttribute("aria-label", "Tools");
const note = add(bar, "span", {id: "zensim-note", role: "status"});
const scale = add(bar, "div", {id: "zensim-scale", role: "img"});
const buttons = add(bar, "div", {});
const help = document.createElement("dialog");
help.id = "zensim-help";
help.setAttribute("role", "dialog");
help.setAttribute("aria-labelledby", "zensim-help-title");
add(help, "button", {type: "button", "aria-label": "Close help"}, "\u00d7")
  .addEventListener("click", () => help.close());
add(help, "h2", {id: "zensim-help-title"}, "Help");
help.insertAdjacentHTML("beforeend", texts.help);

function addTool(text, title, act) {
  const button = add(buttons, "button", {type: "button", title, "aria-label": title}, text);
  button.addEventListener("click", () => act(button));
  return button;
}
addTool("?", "Help: mouse, keys, what is drawn", () => help.showModal());
addTool("Link", "Copy a link to this view", copyLink);
addTool("Picture", "Save a picture of the view, PNG", savePicture);
if (window.MediaRecorder) addTool("Film", "Save a film of the view, WebM", toggleFilm);
const themeTool = addTool("Light", "Switch between light and dark", () => setTheme(!isDark()));

function say(text) {
  note.textContent = text;
  clearTimeout(noteTimer);
  noteTimer = setTimeout(() => { note.textContent = ""; }, NOTE_MS);
}

function page() {
  const found = window.__viserMutable;
  return found && found.camera && found.cameraControl && found.canvas ? found : null;
}

// Axes of the browser are -y, z, -x of the world.
const toWorld = ({x, y, z}) => [-z, -x, y].map((v) => Number(v.toFixed(4)));

// Set by the server of the page whenever the selection changes.
let selected = "";
window.zensimSelected = (names) => { selected = names[0] || ""; zensimMarks(names); };

// What the address of the page asks for is sent until the page has it; the theme, also to the
// process of the page that comes after another one.
const asked = new URLSearchParams(location.search);
let wantedRobot = asked.get("robot") || "", wantedTheme = firstTheme();
async function askForLinked() {
  const ground = page() && window.__viserSceneTree.getState()["/ground"];
  if (!ground) return;  // the theme of the page has not come yet
  const isGroundDark = ground.message.props.plane_color[0] < 128;
  if (isGroundDark !== wantedTheme) send({type: "ZensimTheme", is_dark: wantedTheme});
  if (selected === wantedRobot) wantedRobot = "";
  if (!wantedRobot) return;
  const response = await fetch("/names").catch(() => null);
  const names = response && response.ok ? await response.json() : {};
  if (Object.values(names).some((list) => list.includes(wantedRobot))) {
    send({type: "ZensimSelect", entity: wantedRobot});
  }
}

function makeLink() {
  const {camera, cameraControl} = page(), link = new URL(location.href);
  const target = cameraControl.getTarget(camera.position.clone());
  link.search = "";
  const values = {
    initialCameraPosition: toWorld(camera.position), initialCameraLookAt: toWorld(target),
    ...(selected ? {robot: encodeURIComponent(selected)} : {}), theme: isDark() ? "dark" : "light",
  };
  // Commas stay readable.
  link.search = Object.entries(values).map(([name, value]) => `${name}=${value}`).join("&");
  return link.href;
}

async function copyLink() {
  if (!page()) return;
  const link = makeLink();
  history.replaceState(null, "", link);
  try {
    await navigator.clipboard.writeText(link);
    say("The link to this view is copied, and in the address bar.");
  } catch (error) {
    say("The link to this view is in the address bar.");
  }
}

function save(blob, suffix) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = `zensim-${new Date().toISOString().slice(0, 19).replace(/:/g, "")}.${suffix}`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  say(`Saved ${link.download}.`);
}

function savePicture() {
  if (page()) page().canvas.toBlob((blob) => blob && save(blob, "png"), "image/png");
}

function toggleFilm(button) {
  if (film) { film.stop(); return; }
  if (!page()) return;
  const type = FILM_TYPES.find((one) => MediaRecorder.isTypeSupported(one));
  const parts = [], stream = page().canvas.captureStream(FRAMES_PER_S);
  film = new MediaRecorder(stream, type ? {mimeType: type} : {});
  const timer = setTimeout(() => film && film.stop(), LONGEST_FILM_MS);
  film.ondataavailable = (event) => {
    if (!event.data.size) return;
    parts.push(event.data);
    if (film) button.textContent = "Stop";
  };
  film.onstop = () => {
    clearTimeout(timer);
    stream.getTracks().forEach((track) => track.stop());
    const kind = film.mimeType;
    film = null;
    button.setAttribute("aria-pressed", "false");
    button.textContent = "Film";
    if (!parts.length) { say("No film was saved: nothing was drawn meanwhile."); return; }
    save(new Blob(parts, {type: kind}), kind.includes("mp4") ? "mp4" : "webm");
  };
  film.start(FILM_PART_MS);
  button.setAttribute("aria-pressed", "true");
  button.textContent = "Starting";  // until there is a first frame
  say("The film is being made, for two minutes at most.");
}

function isDark() {
  return document.documentElement.getAttribute("data-mantine-color-scheme") !== "light";
}

function send(message) {
  const found = window.__viserMutable;
  if (found && found.sendMessage) found.sendMessage(message);
}

function setTheme(dark) {
  const name = dark ? "dark" : "light";
  try { localStorage.setItem("zensim-theme", name); } catch (error) { /* private */ }
  wantedTheme = dark;
  askForLinked();
}

// Pictures of models in the form that spawns.
addEventListener("click", ({target}) => {
  const tile = target instanceof Element && target.closest("[data-zensim-model]");
  if (tile) send({type: "ZensimModel", model: tile.dataset.zensimModel});
});

function firstTheme() {
  const theme = asked.get("theme");
  let kept = "";
  try { kept = localStorage.getItem("zensim-theme"); } catch (error) { /* private */ }
  return (theme || kept || (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"))
    !== "light";
}

function drawScale() {
  const found = page();
  scale.style.display = found ? "block" : "none";
  if (!found) return;
  const box = found.canvas.getBoundingClientRect();
  bar.style.left = `${box.left + 12}px`;
  const distance = found.cameraControl.distance;
  const metres = 2 * distance * Math.tan(found.camera.fov * Math.PI / 360) / box.height;
  const least = LEAST_SCALE_PX * metres, power = 10 ** Math.floor(Math.log10(least));
  const length = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= least);
  const text = length < 1 ? `${Number((length * 100).toFixed(3))} cm`
    : length < 1000 ? `${Number(length.toFixed(3))} m` : `${length / 1000} km`;
  scale.style.width = `${Math.round(length / metres)}px`;
  if (scale.textContent === text) return;
  scale.textContent = text;
  scale.setAttribute("aria-label", `Scale: ${text}`);
}

// Controls of the library that have no name of their own.
const NAMES = {
  "tabler-icon-adjustments": "Settings", "tabler-icon-arrow-back": "Back to the controls",
  "tabler-icon-list-search": "Command palette", "tabler-icon-x": "Close", "loseButton": "Close",
};
function nameControls() {
  const found = page();
  for (const canvas of found ? document.querySelectorAll("canvas:not([aria-label])") : []) {
    canvas.setAttribute("role", "img");
    const name = canvas === found.canvas ? "3D view of the world" : "Markings";
    canvas.setAttribute("aria-label", name);
  }
  // One of them has another icon, and another effect, while the settings are shown.
  for (const button of document.querySelectorAll("button:is(:not([aria-label]), [data-zensim])")) {
    if (button.innerText.trim() || button.title) continue;
    const look = button.innerHTML + button.className;
    const kind = Object.keys(NAMES).find((one) => look.includes(one));
    if (!kind) continue;
    button.setAttribute("aria-label", NAMES[kind]);
    button.dataset.zensim = kind;
  }
  for (const icon of document.querySelectorAll("svg:not([aria-hidden]):not([aria-label])")) {
    icon.setAttribute("aria-hidden", "true");
  }
  for (const picture of document.querySelectorAll(".mantine-ScrollArea-content img:not([alt])")) {
    if (!picture.naturalHeight) continue;
    picture.alt = `Picture of ${findLabel(picture)}`;
    picture.scrollIntoView({block: "nearest"});  // it may be below the window
  }
  for (const input of document.querySelectorAll(INPUTS)) {
    // A label that may break is read with a space there.
    const label = input.labels && input.labels[0];
    if (label && !label.querySelector("wbr")) continue;
    const name = label ? label.textContent : input.placeholder || findLabel(input);
    if (name) input.setAttribute("aria-label", name);
  }
  for (const dialog of document.querySelectorAll(
    "[role=dialog]:not([aria-label], [aria-labelledby])")) {
    if (dialog.querySelector("[class*=Spotlight]") || dialog.closest("[class*=Spotlight]")) {
      dialog.setAttribute("aria-label", "Command palette");
    }
  }
}

// Folders of the library open by a click only; as buttons they work by keyboard, too. A folder that
// is created again with the next selection keeps its state.
const foldStates = new Map();
function nameFolds() {
  for (const icon of document.querySelectorAll(
    "svg.tabler-icon-chevron-up, svg.tabler-icon-chevron-down")) {
    const fold = icon.parentElement;
    if (!fold.matches(".mantine-Paper-root")) continue;
    fold.setAttribute("aria-expanded", icon.matches(".tabler-icon-chevron-up"));
    if (fold.matches(".zensim-fold")) continue;
    fold.classList.add("zensim-fold");
    fold.parentElement.classList.add("zensim-folder");
    fold.setAttribute("role", "button");
    fold.tabIndex = 0;
    fold.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      fold.click();
    });
    const label = fold.innerText, isOpen = () => !!fold.querySelector(".tabler-icon-chevron-up");
    fold.addEventListener("click", () => foldStates.set(label, !isOpen()));
    if (isOpen() !== (foldStates.get(label) ?? isOpen())) fold.click();
  }
}

function findLabel(input) {  // the text before it in the nearest container that has one
  for (let box = input.parentElement, i = 0; box && i < 9; box = box.parentElement, i++) {
    const text = [...box.querySelectorAll("label, .mantine-Text-root")]
      .map((one) => one.innerText.trim()).find((one) => one);
    if (text) return text;
  }
  return "";
}

function isTyping(target) {
  return target && (target.isContentEditable || /^(INPUT|TEXTAREA|SELECT)$/.test(target.tagName));
}

addEventListener("keydown", (event) => {
  if (event.key !== "?" || event.ctrlKey || event.metaKey || isTyping(event.target)) return;
  if (help.open) help.close(); else help.showModal();
});

function update() {
  drawScale();
  nameControls();
  nameFolds();
  themeTool.textContent = isDark() ? "Light" : "Dark";
}

addEventListener("DOMContentLoaded", () => {
  document.head.append(style);
  document.body.append(bar, help);
  setInterval(update, SCALE_MS);
  setInterval(askForLinked, LINK_MS);
});
