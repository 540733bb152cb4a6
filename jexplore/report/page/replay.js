// What the pages that replay something share: packed data, colours, the plane that maps are drawn on, layers, strips and
// the timeline. Each page's own script follows in the same scope.
const $ = (id) => document.getElementById(id);
function add(parent, tag, text = "", title = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (title) made.title = title;
  parent.append(made);
  return made;
}
const words = (name) => String(name).replace(/_/g, " ");
const number = (value, digits, unit, open = "open") =>
  value === null || value === undefined || Number.isNaN(value) ? "\u2013" : value === Infinity ? open : `${value.toFixed(digits).replace(/^-(0(\.0+)?)$/, "$1").replace("-", "\u2212")}${unit}`;

// ---- data
function bytesOf(base64) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}
// Whole multiples of a step, little-endian; the extremes stand for NaN and +infinity.
function unpack({type, step, base64}) {
  const {buffer} = bytesOf(base64), whole = type === "i2" ? new Int16Array(buffer) : new Int32Array(buffer);
  const low = type === "i2" ? -32768 : -2147483648, high = type === "i2" ? 32767 : 2147483647;
  return Float64Array.from(whole, (value) => value === low ? NaN : value === high ? Infinity : value * step);
}
// Calls put(first cell, cell after the last, code) for each run of changed cells in bytes[from..to).
function eachRun(bytes, from, to, put) {
  let at = 0, gap = 0, shift = 0;
  for (let i = from; i < to; i++) {
    gap |= (bytes[i] & 127) << shift; shift += 7;
    if (bytes[i] > 127) continue;
    const head = bytes[++i], first = at + gap;
    at = first + (head >> 4); gap = shift = 0;
    put(first, at, head & 15);
  }
}

// ---- colours: Okabe and Ito's, and those of the style
const PALETTE = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999"];
const INKS = ["page", "card", "floor", "ink", "soft", "line", "grid", "wall", "scan", "band", "chosen", "target", "pick", "focus", "free", "unknown", "frontier", "way", "robot", "own"];
const ink = {};
function themes(dress) {  // dress() is called for the first theme and after every change
  const root = document.documentElement;
  function set(theme) {
    root.dataset.theme = theme;
    PALETTE[0] = theme === "dark" ? "#2a8ed4" : "#0072b2";  // the true blue is dim on a dark floor
    $("theme").textContent = theme === "dark" ? "Light" : "Dark";
    const style = getComputedStyle(root);
    for (const name of INKS) ink[name] = style.getPropertyValue(`--${name}`).trim();
    dress();
  }
  $("theme").addEventListener("click", () => set(root.dataset.theme === "dark" ? "light" : "dark"));
  set(window.matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
}

// ---- drawing once for many changes
function soon(show) {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; show(); });
  };
}
function fit(target, context) {
  const ratio = window.devicePixelRatio || 1, box = target.getBoundingClientRect();
  const w = Math.max(1, Math.round(box.width * ratio)), h = Math.max(1, Math.round(box.height * ratio));
  if (target.width !== w || target.height !== h) { target.width = w; target.height = h; }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [Math.max(1, box.width), Math.max(1, box.height)];
}
function unitLength(widest) {
  const unit = 10 ** Math.floor(Math.log10(widest));
  return [5, 2, 1].map((step) => step * unit).find((length) => length <= widest * (1 + 1e-9));
}

// ---- the plane: metres on a canvas. Planes with one view move together.
// view: {kind: "follow" | "whole" | "free", x, y, scale}, scale 0 for not yet; bounds: [x0, y0, x1, y1];
// centre(): what is followed; changed(): the view is another; clicked(x, y), pixels; mayZoom(event): by this wheel;
// below: pixels kept free under the whole map.
function makePlane(canvas, {view, bounds, centre, changed, clicked = () => {}, mayZoom = () => true, below = 0}) {
  const pen = canvas.getContext("2d");
  const plane = {pen, view, width: 1, height: 1};
  const sx = (x) => plane.width / 2 + (x - view.x) * view.scale, sy = (y) => plane.height / 2 - (y - view.y) * view.scale;
  function begin() {
    [plane.width, plane.height] = fit(canvas, pen);
    const [x0, y0, x1, y1] = bounds;
    if (view.kind === "whole") {
      Object.assign(view, {x: (x0 + x1) / 2, y: (y0 + y1) / 2});
      view.scale = Math.min(plane.width / (x1 - x0), Math.max(plane.height - below, 20) / (y1 - y0));
    } else if (!view.scale) view.scale = Math.min(plane.width, plane.height) / 9;
    if (view.kind === "follow") [view.x, view.y] = centre();
    pen.fillStyle = ink.floor; pen.fillRect(0, 0, plane.width, plane.height);
  }
  function trace(points, close = false) {
    pen.beginPath();
    points.forEach(([x, y], i) => i ? pen.lineTo(sx(x), sy(y)) : pen.moveTo(sx(x), sy(y)));
    if (close) pen.closePath();
  }
  function path(xs, ys, from, to) {  // points nearer than a pixel to the last one are left out
    pen.beginPath();
    let lastX = NaN, lastY = NaN;
    for (let i = from; i < to; i++) {
      const x = sx(xs[i]), y = sy(ys[i]);
      if (i === from) pen.moveTo(x, y);
      else if (i === to - 1 || Math.abs(x - lastX) + Math.abs(y - lastY) > 1) pen.lineTo(x, y);
      else continue;
      lastX = x; lastY = y;
    }
  }
  function stroke(colour, thickness, dash = []) {
    pen.strokeStyle = colour; pen.lineWidth = thickness; pen.setLineDash(dash); pen.stroke(); pen.setLineDash([]);
  }
  function fill(colour, alpha = 1) { pen.globalAlpha = alpha; pen.fillStyle = colour; pen.fill(); pen.globalAlpha = 1; }
  function disc(x, y, pixels) { pen.beginPath(); pen.arc(sx(x), sy(y), pixels, 0, 2 * Math.PI); }
  function label(text, x, y, colour, align = "center", size = 12) {
    pen.font = `600 ${size}px system-ui, sans-serif`; pen.textAlign = align; pen.textBaseline = "middle";
    pen.lineWidth = 3; pen.lineJoin = "round"; pen.strokeStyle = ink.floor; pen.strokeText(text, x, y);
    pen.fillStyle = colour; pen.fillText(text, x, y);
  }
  function drawGrid() {
    const {width, height} = plane, unit = Math.max(1, unitLength(160 / view.scale));
    pen.beginPath();
    for (let k = Math.ceil((view.x - width / 2 / view.scale) / unit); sx(k * unit) < width; k++) { pen.moveTo(sx(k * unit), 0); pen.lineTo(sx(k * unit), height); }
    for (let k = Math.ceil((view.y - height / 2 / view.scale) / unit); sy(k * unit) > 0; k++) { pen.moveTo(0, sy(k * unit)); pen.lineTo(width, sy(k * unit)); }
    stroke(ink.grid, 1);
  }
  function drawTarget(x, y) {  // a ring with a cross
    disc(x, y, 8); stroke(ink.floor, 5); disc(x, y, 8); stroke(ink.target, 2.4);
    pen.beginPath();
    for (const [u, v] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { pen.moveTo(sx(x) + 3 * u, sy(y) + 3 * v); pen.lineTo(sx(x) + 12 * u, sy(y) + 12 * v); }
    stroke(ink.target, 2);
  }
  function drawBar(widest = 150) {
    const length = unitLength(widest / view.scale), bar = length * view.scale, x = 14, y = plane.height - 16;
    pen.beginPath(); pen.moveTo(x, y - 5); pen.lineTo(x, y); pen.lineTo(x + bar, y); pen.lineTo(x + bar, y - 5);
    stroke(ink.floor, 5); stroke(ink.ink, 2);
    label(`${+length.toPrecision(3)} m`, x + bar / 2, y - 11, ink.ink);
  }

  function look(kind) {
    if (view.kind === "whole" && kind === "follow") view.scale = 0;
    view.kind = kind; changed();
  }
  function zoom(factor, x = plane.width / 2, y = plane.height / 2) {
    const wx = view.x + (x - plane.width / 2) / view.scale, wy = view.y - (y - plane.height / 2) / view.scale;
    if (view.kind === "whole") view.kind = "free";
    view.scale = Math.min(1000, Math.max(1, view.scale * factor));
    if (view.kind === "free") { view.x = wx - (x - plane.width / 2) / view.scale; view.y = wy + (y - plane.height / 2) / view.scale; }
    changed();
  }
  canvas.addEventListener("wheel", (event) => {
    if (!mayZoom(event)) return;
    event.preventDefault();
    const box = canvas.getBoundingClientRect(), lines = event.deltaMode === 1 ? 30 : 1;
    zoom(Math.exp(-Math.max(-200, Math.min(200, event.deltaY * lines)) * 0.0018), event.clientX - box.left, event.clientY - box.top);
  }, {passive: false});
  let drag = null;
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    canvas.setPointerCapture(event.pointerId);
    drag = {x: event.clientX, y: event.clientY, far: false};
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!drag) return;
    const dx = event.clientX - drag.x, dy = event.clientY - drag.y;
    if (!drag.far && Math.hypot(dx, dy) < 4) return;
    Object.assign(drag, {x: event.clientX, y: event.clientY, far: true});
    view.kind = "free"; view.x -= dx / view.scale; view.y += dy / view.scale;
    changed();
  });
  canvas.addEventListener("pointerup", (event) => {
    const box = canvas.getBoundingClientRect();
    if (drag && !drag.far) clicked(event.clientX - box.left, event.clientY - box.top);
    drag = null;
  });
  canvas.addEventListener("pointercancel", () => { drag = null; });
  return Object.assign(plane, {sx, sy, begin, trace, path, stroke, fill, disc, label, drawGrid, drawTarget, drawBar, look, zoom});
}

// ---- buttons that move maps; returns the same for keys
function makeZoom(look, zoom) {
  const whole = () => look("whole"), closer = () => zoom(1.3), farther = () => zoom(1 / 1.3);
  for (const [id, action] of Object.entries({whole, closer, farther})) $(id).addEventListener("click", action);
  return {w: whole, "+": closer, "=": closer, "-": farther};
}

// ---- layers: boxes to switch them. Of each: name, text, colour (a name among the inks, or a style), title, off.
function makeLayers(list, shown, changed, styles = {}) {
  const swatches = [];
  for (const {name, text, colour = "", title = "", off = false} of list) {
    const row = add($("layers"), "label", "", title), box = add(row, "input"), swatch = add(row, "span");
    box.type = "checkbox"; box.checked = shown[name]; box.name = name; box.disabled = off;
    row.classList.toggle("off", off);
    swatch.className = "key"; swatch.hidden = !colour; swatch.setAttribute("aria-hidden", "true");
    swatches.push([swatch, colour]);
    row.append(text);
    box.addEventListener("change", () => { shown[name] = box.checked; changed(); });
  }
  return () => {  // dresses them in the present theme
    for (const [swatch, colour] of swatches) Object.assign(swatch.style, styles[colour]?.() ?? {background: ink[colour] || "none"});
  };
}

// ---- the timeline: frames at rising times, of which `rate` pass in a second; keys: where they are pressed
function makeTimeline({show, keys = document, more = {}, isOther = () => false}) {
  const time = {frame: 0, frames: 1, playing: false, speed: 1, times: [0], rate: 1};
  let clock = 0, before = 0;
  function seek(i) {
    time.frame = Math.min(time.frames - 1, Math.max(0, Math.round(Number(i)) || 0));
    clock = time.times[time.frame];
    showAll();
  }
  function setTimes(times, rate = 1) {  // stays at the same share of the whole
    const share = time.frames > 1 ? time.frame / (time.frames - 1) : 0;
    Object.assign(time, {times, rate, frames: times.length});
    $("seek").max = time.frames - 1;
    seek(share * (time.frames - 1));
  }
  function showAll() {
    $("seek").value = time.frame;
    $("play").textContent = time.playing ? "Pause" : "Play";
    show();
  }
  function tick(now) {
    if (!time.playing) return;
    clock += Math.min(0.25, Math.max(0, (now - before) / 1000)) * time.speed * time.rate;  // a hidden tab does not jump
    before = now;
    let next = time.frame;
    while (next < time.frames - 1 && time.times[next + 1] <= clock) next++;
    if (next === time.frames - 1) time.playing = false;
    if (next !== time.frame || !time.playing) { time.frame = next; showAll(); }
    if (time.playing) requestAnimationFrame(tick);
  }
  function play() {
    if (time.playing || time.frames < 2) return;
    time.playing = true;
    if (time.frame === time.frames - 1) time.frame = 0;
    clock = time.times[time.frame]; before = performance.now();
    showAll(); requestAnimationFrame(tick);
  }
  function pause() { if (time.playing) { time.playing = false; showAll(); } }
  const toggle = () => time.playing ? pause() : play();
  const go = (i) => { pause(); seek(i); };
  function later(by, whole) {  // by so many frames, or by so many seconds
    if (!whole) return go(time.frame + by);
    const wanted = time.times[time.frame] + by * time.rate;
    let i = time.frame;
    while (by > 0 ? i < time.frames - 1 && time.times[i] < wanted - 1e-9 : i > 0 && time.times[i] > wanted + 1e-9) i += by;
    return go(i);
  }
  const setSpeed = (value) => { time.speed = value; $("speed").value = String(value); };
  for (const [id, action] of Object.entries({
    first: () => go(0), last: () => go(time.frames - 1), back: () => later(-1), next: () => later(1), play: toggle,
  })) $(id).addEventListener("click", action);
  $("speed").addEventListener("change", () => setSpeed(Number($("speed").value)));
  $("seek").addEventListener("input", () => go($("seek").value));
  keys.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const tag = event.target.tagName, slider = event.target.type === "range";
    if (tag === "SELECT" || isOther(event)) return;
    if (event.key === " " && (tag === "BUTTON" || tag === "SUMMARY" || tag === "INPUT" && !slider)) return;
    const action = {
      " ": toggle, ArrowLeft: () => later(-1, event.shiftKey), ArrowRight: () => later(1, event.shiftKey),
      Home: () => go(0), End: () => go(time.frames - 1), ...more,
    }[event.key];
    if (action) { event.preventDefault(); action(); }
  });
  function fromHash() {  // #frame=12, or #t=0.5 for the middle; true if there was one
    const hash = new URLSearchParams(location.hash.slice(1)), frame = hash.get("frame"), share = hash.get("t");
    const at = /^\d+$/.test(frame ?? "") ? Number(frame) : /^(\d+\.?\d*|\.\d+)$/.test(share ?? "") ? Number(share) * (time.frames - 1) : NaN;
    if (!Number.isNaN(at)) go(at);
    return !Number.isNaN(at);
  }
  window.addEventListener("hashchange", fromHash);
  return Object.assign(time, {seek, setTimes, play, pause, go, setSpeed, fromHash, showAll});
}

// ---- strips along the timeline: painted once for a size and a theme, then copied under the cursor
const PAD = 8;  // half the slider's thumb
function makeStrip(target, time, paint, {left = PAD, right = PAD, tall = Infinity} = {}) {
  const context = target.getContext("2d"), kept = document.createElement("canvas");
  const along = (i, w) => left + (time.frames > 1 ? i / (time.frames - 1) : 0) * (w - left - right);
  let key = "";
  const go = (event) => {
    const box = target.getBoundingClientRect();
    time.go(Math.round((event.clientX - box.left - left) / (box.width - left - right) * (time.frames - 1)));
  };
  target.addEventListener("pointerdown", (event) => { target.setPointerCapture(event.pointerId); go(event); });
  target.addEventListener("pointermove", (event) => { if (event.buttons & 1) go(event); });
  return (content = "") => {  // draws it; painted anew for other content
    const [w, h] = fit(target, context), now = [target.width, target.height, document.documentElement.dataset.theme, content].join();
    if (now !== key) {
      key = now; kept.width = target.width; kept.height = target.height;
      const copy = kept.getContext("2d");
      copy.setTransform(context.getTransform());
      paint(copy, w, h, (i) => along(i, w));
    }
    context.save(); context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, target.width, target.height); context.drawImage(kept, 0, 0); context.restore();
    const x = along(time.frame, w);
    context.fillStyle = ink.card; context.fillRect(x - 3, 0, 6, Math.min(h, tall));
    context.fillStyle = ink.ink; context.fillRect(x - 1.5, 0, 3, Math.min(h, tall));
  };
}
