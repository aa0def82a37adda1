"""Tools of the page that run in the browser alone: help, link, picture, film, scale and names."""

from typing import Final

import msgspec

from zensim.proto.printable_text import to_html

MOUSE: Final = (
    ("Drag", "turn the camera"),
    ("Drag with the right button, or with two fingers", "move the camera"),
    ("Wheel, or two fingers apart", "zoom"),
    ("Click on a robot", "select it"),
    ("Shift and click on a robot", "add it to the selection, or remove it"),
    ("Pointer over a robot", "its name"),
)
KEYS: Final = (("?", "this help"),)
LEGEND: Final = (
    ("Grid", "fine lines each metre, strong lines each 5 m"),
    ("Red and green line", "x and y of the world, 1 m long, from its origin"),
    ("Bar beside the tools", "length at the distance of the point that the camera turns about"),
    ("Colours of robots", "by name, also in the list; colour-blind people can distinguish them"),
    ("Green, amber and red dot", "the simulation plays, is paused, or no server replies"),
    ("Dots of the list", "green: moves; grey: stands; amber ring: no agent; red: blocked"),
)
Rows = tuple[tuple[str, str], ...]


def make_help_html(keys: Rows) -> str:
    """Make the content of the help: what mouse and keys do, and what is drawn.

    Args:
        keys: Keys and what they do, beside those of this module.
    """
    sections = (("Mouse and touch", MOUSE), ("Keys", (*keys, *KEYS)), ("What is drawn", LEGEND))
    return "".join(
        f"<h3>{title}</h3><dl>"
        + "".join(f"<dt>{to_html(key)}</dt><dd>{to_html(what)}</dd>" for key, what in rows)
        + "</dl>"
        for title, rows in sections
    )


def make_tools_script(keys: Rows = ()) -> str:
    """Make the script of the tools; see `make_help_html`."""
    texts = msgspec.json.encode({"style": STYLE, "help": make_help_html(keys)}).decode()
    safe = texts.replace("</", r"<\/")  # "</script>" would end the script
    return f"((texts) => {{{SCRIPT}}})({safe});"


# The labels of viser have a contrast of 3; those here have 4.5 at least.
STYLE: Final = """
:root:root { --mantine-font-family: Inter, system-ui, -apple-system, "Segoe UI", Roboto,
  "Helvetica Neue", Arial, sans-serif; letter-spacing: normal; }
:root:root[data-mantine-color-scheme=light] { --mantine-color-dimmed: #59616b;
  --zensim-green: #1b7a4a; --zensim-amber: #8a5a00; --zensim-red: #b3261e;
  --zensim-raised: #eef1f5; --zensim-edge: #c3cad3; --zensim-on: #dbe8f7; --zensim-text: #1f242b; }
:root:root[data-mantine-color-scheme=dark] { --mantine-color-dimmed: #a6acb4;
  --zensim-green: #4cc38a; --zensim-amber: #e5b454; --zensim-red: #f0857b;
  --zensim-raised: #30353e; --zensim-edge: #474d58; --zensim-on: #23405f; --zensim-text: #eef1f5; }
#zensim-tools { position: fixed; left: 12px; bottom: 12px; z-index: 40; display: flex;
  flex-direction: column; align-items: flex-start; gap: 8px; pointer-events: none;
  font: 13px var(--mantine-font-family); --text: #23272e; --back: rgba(255, 255, 255, .92);
  --edge: #6b7480; color: var(--text); }
[data-mantine-color-scheme=dark] #zensim-tools { --text: #eef1f5; --back: rgba(24, 27, 33, .92);
  --edge: #8d96a3; }
#zensim-tools > div { display: flex; gap: 6px; flex-wrap: wrap; }
#zensim-tools button { pointer-events: auto; min-width: 32px; min-height: 32px; padding: 0 9px;
  border: 1px solid var(--edge); border-radius: 6px; background: var(--back);
  color: var(--text); font: inherit; cursor: pointer; }
#zensim-tools button:focus-visible { outline: 3px solid #4a90e2; outline-offset: 1px; }
#zensim-tools button[aria-pressed=true] { background: #b3261e; color: #fff; }
#zensim-scale { border: solid var(--text); border-width: 0 2px 2px; text-align: center;
  height: 22px; line-height: 18px; background: var(--back); box-sizing: border-box;
  border-radius: 4px 4px 0 0; white-space: nowrap; font-size: 12px; }
#zensim-note { padding: 5px 9px; border-radius: 6px; background: var(--back); max-width: 60vw;
  overflow-wrap: anywhere; }
#zensim-note:empty { display: none; }
#zensim-help { max-width: min(560px, calc(100vw - 32px)); max-height: calc(100vh - 32px);
  box-sizing: border-box; overflow: auto; border: 0; border-radius: 10px; padding: 8px 20px 20px;
  font: 14px/1.45 var(--mantine-font-family); background: #fff; color: #23272e; }
[data-mantine-color-scheme=dark] #zensim-help { background: #20242b; color: #eef1f5; }
#zensim-help::backdrop { background: rgba(0, 0, 0, .45); }
#zensim-help h2 { margin: 8px 0 0; } #zensim-help h3 { margin: 14px 0 4px; }
#zensim-help dl { display: grid; grid-template-columns: minmax(90px, 2fr) 3fr; gap: 3px 14px;
  margin: 0; }
#zensim-help dt { font-weight: 600; } #zensim-help dd { margin: 0; }
#zensim-help button { float: right; min-width: 44px; min-height: 44px; font: inherit;
  color: inherit; background: none; border: 1px solid currentColor; border-radius: 6px; }
@media (max-width: 640px), (pointer: coarse) {
  #zensim-tools button { min-width: 44px; min-height: 44px; }
}
@media (max-width: 640px) {
  #zensim-tools { bottom: auto; top: 12px; flex-direction: column-reverse; }
}
/* Controls of viser: a row each, a switch at its end, buttons and fields as those of the page. */
.mantine-Text-root:has(> label) { color: var(--zensim-text) !important;
  font-size: 13px !important; }
.mantine-Flex-root:has(> div .mantine-Checkbox-root) { justify-content: space-between;
  min-height: 30px; }
.mantine-Flex-root:has(> div .mantine-Checkbox-root) > div:first-child { width: auto !important;
  flex: 1; }
.mantine-Flex-root:has(> div .mantine-Checkbox-root) > div:last-child { line-height: 0;
  flex-grow: 0 !important; }
.mantine-Flex-root label { cursor: pointer; }
.mantine-Checkbox-inner, .mantine-Checkbox-input { width: 36px !important;
  height: 20px !important; }
.mantine-Checkbox-input { cursor: pointer; border-radius: 10px !important;
  border: 1px solid var(--mantine-color-dimmed) !important;
  background: radial-gradient(circle at 9px 50%, var(--mantine-color-dimmed) 6px, transparent 7px)
    var(--zensim-raised) !important; }
.mantine-Checkbox-input:checked { border-color: #2f6fb3 !important;
  background: radial-gradient(circle at 25px 50%, #fff 6px, transparent 7px) #2f6fb3 !important; }
.mantine-Checkbox-input:focus-visible { outline: 3px solid #4a90e2; outline-offset: 1px; }
.mantine-Checkbox-icon { display: none; }
.mantine-Button-root { border-radius: 6px !important; min-height: 32px; height: auto !important; }
.mantine-Button-root[style*="#424750"]:not(:disabled) {
  --button-bg: var(--zensim-raised) !important; --button-hover: var(--zensim-on) !important;
  --button-color: var(--zensim-text) !important;
  --button-bd: 1px solid var(--zensim-edge) !important; }
.mantine-Input-input { border-radius: 6px !important; background: none !important;
  border-color: var(--zensim-edge) !important; min-height: 30px !important;
  color: var(--zensim-text) !important; }
.zensim-folder { border: 0 !important; border-top: 1px solid var(--zensim-edge) !important;
  border-radius: 0 !important; margin: 10px 0 0 !important; padding-top: 30px; }
.zensim-folder > .zensim-fold { transform: none; top: 7px; left: .7em; padding: 0 !important;
  font-weight: 600; font-size: 13px; background: none; }
.mantine-Notification-description {
  color: var(--mantine-color-dimmed) !important; }
/* The head: state, time, factor and robots, and the buttons of the simulation. */
.zensim-status { display: flex; justify-content: space-between; gap: 4px 8px; flex-wrap: wrap;
  margin: 0; padding: 4px 12px; font: 12.5px/1.3 var(--mantine-font-family);
  font-variant-numeric: tabular-nums; }
.zensim-status > div { display: flex; flex-direction: column-reverse; }
.zensim-status dt { font-size: 10.5px; color: var(--mantine-color-dimmed); }
.zensim-status dd { margin: 0; font-weight: 600; white-space: nowrap; }
.zensim-lost canvas { filter: grayscale(1) brightness(.6); }
.zensim-lost [style*="opacity"]:has(.zensim-status) { opacity: 1 !important; }  /* else pale */
[data-zensim-part] { font: 13px/1.3 var(--mantine-font-family); color: var(--zensim-text); }
[data-zensim-part] button { font: inherit; color: inherit; cursor: pointer; display: inline-flex;
  align-items: center; justify-content: center; gap: 5px; min-height: 32px; border-radius: 6px;
  border: 1px solid var(--zensim-edge); background: var(--zensim-raised); padding: 0 10px;
  touch-action: manipulation; }
[data-zensim-part] button:hover { background: var(--zensim-on); }
[data-zensim-part] :is(button, input):focus-visible { outline: 3px solid #4a90e2;
  outline-offset: -1px; }
[data-zensim-part] svg { width: 17px; height: 17px; fill: currentColor; flex: none; }
.zensim-head { display: grid; grid-template-columns: 1fr 1fr 1fr; gap: 6px;
  padding: 4px 12px 8px; }
.zensim-head button { width: 100%; }
.zensim-head .zensim-play { background: var(--zensim-on); }
.zensim-menu { position: relative; }
.zensim-menu > [role=menu] { position: absolute; right: 0; top: 100%; z-index: 30; padding: 4px;
  margin-top: 4px; min-width: 230px; border-radius: 8px; border: 1px solid var(--zensim-edge);
  background: var(--mantine-color-body); box-shadow: 0 6px 20px rgba(0, 0, 0, .35); }
.zensim-menu [role=menuitem] { border: 0; background: none; justify-content: flex-start; }
/* The list: a dot for the status, the name, the speed. */
.zensim-search { display: flex; gap: 6px; padding: 8px 12px 2px; }
.zensim-search input { flex: 1; min-width: 0; font: inherit; color: inherit; padding: 0 10px;
  min-height: 32px; box-sizing: border-box; border: 1px solid var(--zensim-edge);
  border-radius: 6px; background: none; }
.zensim-search input::placeholder { color: var(--mantine-color-dimmed); opacity: 1; }
.zensim-count { padding: 3px 12px; font-size: 11.5px; color: var(--mantine-color-dimmed); }
.zensim-rows { overflow-y: auto; max-height: max(160px, calc(100vh - 330px)); margin: 0 4px;
  position: relative; scrollbar-width: thin; }
.zensim-rows.is-short { max-height: max(160px, 34vh); }
.zensim-room { position: relative; }
.zensim-room > div { position: absolute; left: 0; right: 0; padding: 1px 4px;
  box-sizing: border-box; }
.zensim-room h3 { font-size: 11.5px; font-weight: 600; margin: 0; padding: 9px 4px 0;
  color: var(--mantine-color-dimmed); }
.zensim-room button { width: 100%; height: 100%; min-height: 0; border: 0; background: none;
  gap: 8px; padding: 0 8px; border-radius: 0 6px 6px 0;
  box-shadow: inset 3px 0 var(--robot, transparent); }
.zensim-room button[aria-pressed=true] { background: var(--zensim-on); }
.zensim-room .name { flex: 1; text-align: left; overflow: hidden; text-overflow: ellipsis;
  white-space: nowrap; }
.zensim-room .speed { color: var(--mantine-color-dimmed); font-size: 12px;
  font-variant-numeric: tabular-nums; white-space: nowrap; }
.zensim-room button[aria-pressed=true] .speed { color: inherit; }
.zensim-room .dot { width: 9px; height: 9px; border-radius: 50%; flex: none; margin-left: 3px;
  box-sizing: border-box; border: 2px solid var(--mantine-color-dimmed); }
.zensim-room .dot.is-moving { background: var(--zensim-green); border-color: var(--zensim-green); }
.zensim-room .dot.is-standing { background: var(--mantine-color-dimmed); }
.zensim-room .dot.is-no-agent { border-color: var(--zensim-amber); }
.zensim-room .dot.is-blocked { background: var(--zensim-red); border-color: var(--zensim-red); }
/* The pad. */
.zensim-pad { display: grid; grid-template: repeat(3, 52px) / repeat(3, 72px); gap: 6px;
  justify-content: center; padding: 8px 0 10px; user-select: none; -webkit-user-select: none; }
.zensim-pad button { touch-action: none; flex-direction: column; gap: 0; font-size: 11px;
  border-radius: 10px; padding: 0; }
.zensim-pad svg { width: 22px; height: 22px; }
.zensim-pad .is-forward { grid-area: 1 / 2; } .zensim-pad .is-left { grid-area: 2 / 1; }
.zensim-pad .is-stop { grid-area: 2 / 2; } .zensim-pad .is-right { grid-area: 2 / 3; }
.zensim-pad .is-back { grid-area: 3 / 2; }
.zensim-pad .is-held { background: var(--zensim-on); }
.zensim-pad .is-stop, .zensim-pad .is-stop:hover { background: #b3261e; color: #fff;
  border-color: #b3261e; font-weight: 600; }
/* The legend of a chart says what its lines are and their newest values. */
.zensim-legend { display: grid; grid-template-columns: 1fr auto; gap: 2px 8px; margin: 0;
  padding: 0 .7em .5em; font-size: 12px; overflow-wrap: anywhere; }
.zensim-legend i { display: inline-block; width: 18px; margin-right: 6px; vertical-align: middle; }
.zensim-legend dd { margin: 0; font-weight: 600; font-variant-numeric: tabular-nums; }
/* One letter spacing, one radius; numbers at the ends of sliders would lie over their thumbs. */
label, .mantine-Text-root, input, [class*=mantine] { letter-spacing: normal !important; }
.mantine-Slider-markLabel { display: none; }
/* The scroll bar of the panel covers nothing. */
.mantine-ScrollArea-scrollbar[data-orientation=vertical] { width: 6px !important;
  padding: 0 1px !important; }
/* Six tabs fit one row of a panel 320 pixels wide; the active tab is as wide as before. */
[data-dock-strip] > [data-dock-tab] { padding: 0 .6em !important; font-weight: 600 !important; }
.zensim-models { display: grid; grid-template-columns: repeat(4, 1fr); gap: 4px;
  padding: 0 .7em .4em; }
.zensim-models button { min-width: 44px; min-height: 44px; padding: 2px; cursor: pointer;
  border: 2px solid transparent; border-radius: 6px; background: none; color: inherit;
  font: 10px/1.15 var(--mantine-font-family); overflow-wrap: anywhere; }
.zensim-models img { display: block; width: 100%; border-radius: 4px; margin-bottom: 2px; }
.zensim-models button:focus-visible { outline: 3px solid #4a90e2; }
.zensim-fold:focus-visible { outline: 3px solid #4a90e2; }
/* A list that begins below the window would lengthen the document, and scroll the panel back. */
.mantine-Popover-dropdown { position: fixed !important; }
/* Targets of fingers: 44 pixels; viser sets smaller ones in the elements. */
@media (max-width: 640px) {
  /* The sheet is as wide as the phone; viser makes it 20 em wide. */
  .mantine-Paper-root[style*="position: fixed"][style*="bottom: 0"] { width: 100vw !important;
    max-height: 48% !important; border-radius: 12px 12px 0 0; }
  .mantine-Paper-root[style*="position: fixed"][style*="bottom: 0"] [style*="width: 20em"] {
    width: 100% !important; }
  .mantine-Tabs-list { flex-wrap: nowrap !important; padding-inline-end: 10px; }
  .mantine-Tabs-tab { flex: 1 1 auto; padding: 0 4px !important; }
  [data-zensim-part] :is(button, input) { min-height: 44px; }
  .zensim-rows, .zensim-rows.is-short { max-height: 40vh; }
  /* All of the pad is in the sheet: Back beside the turns, Stop beside Forward. */
  .zensim-pad { grid-template-rows: repeat(2, 52px); padding-top: 0; }
  .zensim-pad .is-stop { grid-area: 1 / 3; } .zensim-pad .is-back { grid-area: 2 / 2; }
  .mantine-Button-root, .mantine-ActionIcon-root, .mantine-Input-input, .mantine-Tabs-tab,
  .mantine-Checkbox-inner, .mantine-Checkbox-input {
    min-width: 44px !important; min-height: 44px !important; }
  .mantine-NumberInput-controls { display: none !important; }
  .mantine-NumberInput-root { min-width: 44px; }
  .mantine-NumberInput-input { padding-right: .5em !important; }
  .mantine-Checkbox-input, .mantine-Checkbox-input:checked { border: solid transparent !important;
    border-width: 12px 4px !important; border-radius: 14px / 22px !important;
    background-clip: padding-box !important; }
  .mantine-Slider-root { padding: 14px 22px 10px !important; width: 0; min-width: 0; }
  .mantine-Slider-thumb { width: 44px !important; height: 44px !important; border: 0 !important;
    background: radial-gradient(circle, var(--mantine-primary-color-filled) 8px,
      transparent 9px) !important; }
  .zensim-fold { min-height: 44px; display: flex; align-items: center; min-width: 44px; }
  .zensim-folder { padding-top: 48px; }
  [role="button"][aria-label$="panel area"] { min-height: 44px; margin-block: -11px;
    display: flex; align-items: center; }
}
"""

SCRIPT: Final = """
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
add(help, "button", {type: "button", "aria-label": "Close help"}, "\\u00d7")
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
"""
