// Driving by keys and gamepad.
(() => {
  "use strict";
  const PERIOD_MS = 50, STOPS = 3, DEADZONE = 0.15;
  const AXES = {
    KeyW: [1, 0, 0], ArrowUp: [1, 0, 0], KeyS: [-1, 0, 0], ArrowDown: [-1, 0, 0],
    KeyA: [0, 0, 1], ArrowLeft: [0, 0, 1], KeyD: [0, 0, -1], ArrowRight: [0, 0, -1],
    KeyQ: [0, 1, 0], KeyE: [0, -1, 0],
  };
  const held = new Set();
  let isOn = false, stopsLeft = 0;
  // Called by the server of the page: whether the selected robot can be driven.
  window.zensimDrives = (value) => { isOn = value; if (!value) held.clear(); };

  // Buttons of the pad, which are held as keys are.
  window.zensimHold = (code, isDown) => {
    if (!isDown) { if (held.delete(code)) repeat(); return; }
    if (isOn && !held.has(code)) { held.add(code); repeat(); }
  };
  window.zensimStop = () => stop();

  // Called by the server of the page: whether the simulation server is gone.
  window.zensimGreys = (value) => {
    const canvas = document.querySelector("canvas");
    if (canvas) canvas.style.filter = value ? "grayscale(1) brightness(.6)" : "";
  };

  function send(message) {
    const page = window.__viserMutable;
    if (page && page.sendMessage) page.sendMessage(message);
  }

  const FIELDS = "input:not([type=checkbox], [type=radio], [type=range], [type=button])," +
    "textarea, select, [role=dialog], [role=listbox], [role=menu]";
  const MOVED_BY_ARROWS = "[role=slider], [role=tab], input[type=radio], input[type=range]";

  function isTaken(target, code) {  // whether the control that has the focus uses this key
    if (!(target instanceof HTMLElement)) return false;
    return target.isContentEditable || target.closest(FIELDS) ||
      (code.startsWith("Arrow") && target.closest(MOVED_BY_ARROWS));
  }

  function limit(value) { return Math.max(-1, Math.min(1, value)); }

  function bend(value) { return Math.abs(value) < DEADZONE ? 0 : limit(value); }

  function readPads() {
    const sum = [0, 0, 0];
    if (!document.hasFocus()) return sum;
    for (const pad of navigator.getGamepads ? navigator.getGamepads() : []) {
      if (!pad || !pad.connected) continue;
      const [sideways, ahead, turn] = pad.axes;
      sum[0] -= bend(ahead || 0);
      sum[1] -= bend(sideways || 0);
      sum[2] -= bend(turn || 0);
    }
    return sum;
  }

  function repeat() {
    if (!isOn && !stopsLeft) return;
    const sum = isOn ? readPads() : [0, 0, 0];
    for (const code of held) AXES[code].forEach((value, axis) => { sum[axis] += value; });
    const [forward, left, turn] = sum.map(limit);
    if (forward || left || turn) stopsLeft = STOPS;
    else if (stopsLeft) stopsLeft -= 1;
    else return;
    send({type: "ZensimDrive", forward, left, turn});
  }

  function stop() {
    held.clear();
    if (isOn) stopsLeft = STOPS;
    repeat();
  }

  function leave() {
    const isDriven = held.size || stopsLeft;
    held.clear();
    stopsLeft = 0;
    if (isDriven) send({type: "ZensimLeave"});
  }

  addEventListener("keydown", (event) => {
    const isPlain = !event.ctrlKey && !event.metaKey && !event.altKey;
    if (!isOn || !isPlain || isTaken(event.target, event.code)) return;
    // Letters and arrows with shift are commands, as Shift+D; space stops with it, too.
    if (event.code !== "Space" && (event.shiftKey || !(event.code in AXES))) return;
    event.preventDefault();
    event.stopImmediatePropagation();  // else viser moves the camera, and buttons are pressed
    if (event.code === "Space") {
      // Else a button or checkbox that has the focus is used when the key is released.
      if (event.target instanceof HTMLElement) event.target.blur();
      stop();
    } else if (!held.has(event.code)) { held.add(event.code); repeat(); }
  }, true);
  addEventListener("keyup", (event) => {
    if (!held.delete(event.code)) return;
    event.stopImmediatePropagation();
    repeat();
  }, true);
  addEventListener("blur", leave);
  addEventListener("pagehide", leave);
  document.addEventListener("visibilitychange", () => { if (document.hidden) leave(); });
  setInterval(repeat, PERIOD_MS);
})();
