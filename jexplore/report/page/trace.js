// The operator's page: one run of a robot on tracks, and the map that it makes.
const data = JSON.parse($("data").textContent);
const run = Object.fromEntries(Object.entries(data.arrays).map(([name, packed]) => [name, unpack(packed)]));
const frames = run.time_s.length, beams = run.angles_rad.length;
const nodes = data.nodes, links = data.links;
const nodeIndex = new Map(nodes.map((node, index) => [node.id, index]));
const firstFrame = (counts, index) => { const at = counts.findIndex((count) => count > index); return at < 0 ? frames : at; };
const madeAt = nodes.map((_, index) => firstFrame(run.n_nodes, index));
const triangleStart = new Int32Array(frames + 1);
for (let i = 0; i < frames; i++) triangleStart[i + 1] = triangleStart[i] + run.n_triangles[i];
const beamCos = run.angles_rad.map(Math.cos), beamSin = run.angles_rad.map(Math.sin);
const estimateX = run.estimate.filter((_, i) => i % 3 === 0), estimateY = run.estimate.filter((_, i) => i % 3 === 1);
const pose = (i) => [run.pose[3 * i], run.pose[3 * i + 1], run.pose[3 * i + 2]];
const estimate = (i) => [run.estimate[3 * i], run.estimate[3 * i + 1], run.estimate[3 * i + 2]];
let drifts = false;
for (let i = 0; i < frames && !drifts; i++) drifts = Math.hypot(run.pose[3 * i] - run.estimate[3 * i], run.pose[3 * i + 1] - run.estimate[3 * i + 1]) > 0.02;
const modeRuns = [];  // [first frame, frame after the last, mode]
for (let i = 0; i < frames; i++) {
  const last = modeRuns[modeRuns.length - 1];
  if (last && last[2] === run.mode[i]) last[1] = i + 1; else modeRuns.push([i, i + 1, run.mode[i]]);
}

// ---- words and colours
const modeColour = (mode) => PALETTE[mode % PALETTE.length];
const onColour = (colour) => {
  const [r, g, b] = [1, 3, 5].map((at) => (parseInt(colour.slice(at, at + 2), 16) / 255) ** 2.2);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.18 ? "#000000" : "#ffffff";
};

// ---- state
const LAYERS = [
  {name: "building", text: "Building", colour: "wall", title: "The true walls, which the robot does not know"},
  {name: "scan", text: "Range data", colour: "scan", title: "The scan of this frame, where odometry places it"},
  {name: "triangles", text: "Triangles", colour: "chosen", title: "Surviving triangles of this frame; the chosen one solid, with its circumcircle and centre"},
  {name: "target", text: "Target", colour: "target", title: "The point that the robot steers to"},
  {name: "trajectory", text: "Trajectory", colour: "modes", title: "Where odometry has been, coloured by run mode"},
  {name: "truth", text: "True trajectory", colour: "dash", title: "Where the robot really was, and is"},
  {name: "map", text: "Map so far", colour: "band", title: "Nodes by type; links as bands; un-searched links dashed, with a question mark"},
  {name: "robot", text: "Robot", colour: "ink", title: "Outline of the robot, where odometry places it"},
  {name: "align", text: "Fit building to odometry", title: "Shift and turn the building so that it fits the robot at this moment"},
].map((layer) => drifts || layer.name !== "truth" && layer.name !== "align" ? layer : {...layer, off: true, title: "Odometry does not drift in this run"});
const shown = Object.fromEntries(LAYERS.map(({name, off}) => [name, name !== "align" && !off]));
let picked = -1;
const modeName = (i) => data.mode_names[run.mode[i]];
const state = () => ({
  frame: time.frame, frames, time_s: run.time_s[time.frame], playing: time.playing, speed: time.speed, mode: modeName(time.frame),
  nodes: run.n_nodes[time.frame], links: run.n_links[time.frame], picked: picked < 0 ? null : nodes[picked].id,
  view: view.kind, centre: [view.x, view.y], scale: view.scale, layers: {...shown}, drifts,
});
const time = makeTimeline({
  show,
  isOther: (event) => event.target.closest?.(".table") && event.key.startsWith("Arrow"),
  more: {
    f: () => plane.look("follow"), ...makeZoom((kind) => plane.look(kind), (factor) => plane.zoom(factor)),
    Escape: () => { picked = -1; time.showAll(); },
  },
});

// ---- geometry
function placed([x, y, heading], u, v) {
  const cos = Math.cos(heading), sin = Math.sin(heading);
  return [x + cos * u - sin * v, y + sin * u + cos * v];
}
function circumcircle([[ax, ay], [bx, by], [cx, cy]]) {
  const d = 2 * (ax * (by - cy) + bx * (cy - ay) + cx * (ay - by));
  if (Math.abs(d) < 1e-9) return null;
  const a = ax * ax + ay * ay, b = bx * bx + by * by, c = cx * cx + cy * cy;
  const x = (a * (by - cy) + b * (cy - ay) + c * (ay - by)) / d, y = (a * (cx - bx) + b * (ax - cx) + c * (bx - ax)) / d;
  return [x, y, Math.hypot(ax - x, ay - y)];
}
const bounds = (() => {
  let x0 = Infinity, y0 = Infinity, x1 = -Infinity, y1 = -Infinity;
  const add = (x, y) => { x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y); };
  for (let i = 0; i < frames; i++) { add(run.pose[3 * i], run.pose[3 * i + 1]); add(run.estimate[3 * i], run.estimate[3 * i + 1]); }
  for (let i = 0; i < run.walls_m.length; i += 2) add(run.walls_m[i], run.walls_m[i + 1]);
  for (const node of nodes) add(node.x_m, node.y_m);
  if (data.goal_m) add(...data.goal_m);
  return [x0 - 0.5, y0 - 0.5, x1 + 0.5, y1 + 0.5];
})();

// ---- the map view
const view = {kind: "follow", x: 0, y: 0, scale: 0};
const plane = makePlane($("view"), {
  view, bounds, centre: () => estimate(time.frame), changed: () => showSoon(), below: 40,
  clicked(x, y) {
    if (!shown.map) return;
    const near = nodes.slice(0, run.n_nodes[time.frame]).findIndex((node) => Math.hypot(sx(node.x_m) - x, sy(node.y_m) - y) < 14);
    if (near >= 0) pick(near, false); else if (picked >= 0) { picked = -1; time.showAll(); }
  },
});
const {pen, sx, sy, trace, path, stroke, fill, disc, label} = plane;
// From the true building to where the robot would place it now, or no change.
function moved() {
  if (!(shown.align && drifts)) return (x, y) => [x, y];
  const [tx, ty, th] = pose(time.frame), to = estimate(time.frame);
  const cos = Math.cos(th), sin = Math.sin(th);
  return (x, y) => placed(to, cos * (x - tx) + sin * (y - ty), -sin * (x - tx) + cos * (y - ty));
}
function drawBuilding() {
  const to = moved(), walls = run.walls_m;
  pen.beginPath();
  for (let i = 0; i < walls.length; i += 4) {
    const [x0, y0] = to(walls[i], walls[i + 1]), [x1, y1] = to(walls[i + 2], walls[i + 3]);
    pen.moveTo(sx(x0), sy(y0)); pen.lineTo(sx(x1), sy(y1));
  }
  pen.lineCap = "round"; stroke(ink.wall, Math.min(4, Math.max(1.5, view.scale * 0.05))); pen.lineCap = "butt";
  if (data.goal_m) {
    const [x, y] = to(...data.goal_m);
    pen.beginPath(); pen.moveTo(sx(x), sy(y)); pen.lineTo(sx(x), sy(y) - 22); stroke(ink.ink, 2);
    pen.beginPath(); pen.moveTo(sx(x), sy(y) - 22); pen.lineTo(sx(x) + 14, sy(y) - 17); pen.lineTo(sx(x), sy(y) - 12); pen.closePath(); fill(ink.free);
    label("goal", sx(x), sy(y) + 9, ink.ink, "center", 11);
  }
}
function drawScan() {
  const at = estimate(time.frame), points = [];
  for (let b = 0; b < beams; b++) {
    const range = run.ranges_m[time.frame * beams + b];
    points.push(Number.isFinite(range) ? placed(at, range * beamCos[b], range * beamSin[b]) : null);
  }
  pen.beginPath();
  for (let b = 0; b < beams; b++) {
    if (!points[b] || b && points[b - 1]) continue;
    pen.moveTo(sx(at[0]), sy(at[1]));
    for (let c = b; c < beams && points[c]; c++) pen.lineTo(sx(points[c][0]), sy(points[c][1]));
    pen.closePath();
  }
  fill(ink.scan, 0.1);
  pen.fillStyle = ink.scan;
  for (const point of points) if (point) pen.fillRect(sx(point[0]) - 1.5, sy(point[1]) - 1.5, 3, 3);
}
function drawTriangles() {
  const at = estimate(time.frame), flat = run.triangles_m, chosen = run.chosen[time.frame];
  const corners = (t) => [0, 1, 2].map((k) => placed(at, flat[6 * t + 2 * k], flat[6 * t + 2 * k + 1]));
  for (let t = triangleStart[time.frame]; t < triangleStart[time.frame + 1]; t++) {
    if (t - triangleStart[time.frame] === chosen) continue;
    trace(corners(t), true); fill(ink.chosen, 0.08); stroke(ink.chosen, 1.2, [5, 3]);
  }
  if (chosen < 0) return;
  const best = corners(triangleStart[time.frame] + chosen), circle = circumcircle(best);
  trace(best, true); fill(ink.chosen, 0.2); stroke(ink.chosen, 2.6);
  if (!circle) return;
  disc(circle[0], circle[1], circle[2] * view.scale); stroke(ink.chosen, 1.5, [2, 3]);
  disc(circle[0], circle[1], 4); fill(ink.chosen); stroke(ink.floor, 1);
}
function drawTrajectory() {
  path(estimateX, estimateY, 0, time.frame + 1); pen.lineJoin = "round"; stroke(ink.floor, 5);
  for (const [from, to, mode] of modeRuns) {
    if (from > time.frame) break;
    path(estimateX, estimateY, from, Math.min(to + 1, time.frame + 1)); stroke(modeColour(mode), 3);
  }
}
function drawTruth() {
  const to = moved(), points = [];
  let lastX = NaN, lastY = NaN;
  for (let i = 0; i <= time.frame; i++) {
    const point = to(run.pose[3 * i], run.pose[3 * i + 1]), x = sx(point[0]), y = sy(point[1]);
    if (i && i < time.frame && Math.abs(x - lastX) + Math.abs(y - lastY) < 2) continue;
    points.push(point); lastX = x; lastY = y;
  }
  trace(points); stroke(ink.soft, 1.6, [5, 4]);
  const [x, y, heading] = pose(time.frame), [length, breadth] = data.robot_m;
  trace([[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([u, v]) => to(...placed([x, y, heading], u * length / 2, v * breadth / 2))), true);
  stroke(ink.soft, 1.4, [3, 3]);
}
const searched = (k) => run.link_searched_frame[k] <= time.frame && nodeIndex.has(links[k].end) && nodeIndex.get(links[k].end) < run.n_nodes[time.frame];
function drawStubs() {
  for (let k = 0; k < run.n_links[time.frame]; k++) {
    const start = nodes[nodeIndex.get(links[k].start)];
    if (searched(k) || nodeIndex.get(start.id) >= run.n_nodes[time.frame]) continue;
    drawStub(plane, start, ahead(start, links[k].start_bearing_deg, 1.1));
  }
}
function drawLinks() {
  for (let k = 0; k < run.n_links[time.frame]; k++) {
    const link = links[k], from = nodeIndex.get(link.start);
    if (from >= run.n_nodes[time.frame] || !searched(k)) continue;
    traceCurve(plane, curveOf(link, nodes[from], nodes[nodeIndex.get(link.end)]));
    pen.globalAlpha = 0.4; stroke(ink.band, 10); pen.globalAlpha = 1;
  }
}
function drawNodes() {
  nodes.slice(0, run.n_nodes[time.frame]).forEach((node, index) => {
    drawNodeMark(plane, node, index === picked, true, () => fill(ink.card));
  });
}
function drawRobot() {
  const at = estimate(time.frame), [length, breadth] = data.robot_m;
  trace([[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([u, v]) => placed(at, u * length / 2, v * breadth / 2)), true);
  fill(modeColour(run.mode[time.frame]), 0.55); stroke(ink.ink, 2);
  trace([[0.42, 0], [0.1, 0.6], [0.1, -0.6]].map(([u, v]) => placed(at, u * length, v * breadth / 2)), true); fill(ink.ink);
}
function drawTarget() {
  const x = run.target_m[2 * time.frame], y = run.target_m[2 * time.frame + 1];
  if (!Number.isFinite(x + y)) return;
  const at = estimate(time.frame);
  trace([[at[0], at[1]], [x, y]]); stroke(ink.target, 1.5, [2, 4]);
  plane.drawTarget(x, y);
}
function drawMap() {
  plane.begin();
  plane.drawGrid();
  if (shown.scan) drawScan();
  if (shown.building) drawBuilding();
  if (shown.map) drawLinks();
  if (shown.truth) drawTruth();
  if (shown.trajectory) drawTrajectory();
  if (shown.triangles) drawTriangles();
  if (shown.map) { drawStubs(); drawNodes(); }
  if (shown.robot) drawRobot();
  if (shown.target) drawTarget();
  plane.drawBar();
}

// ---- strips
const drawRuns = makeStrip($("runs"), time, (c, w, h, along) => {
  for (const [from, to, mode] of modeRuns) {
    const x = along(from);
    c.fillStyle = modeColour(mode); c.fillRect(x, 0, Math.max(along(Math.min(to, frames - 1)) - x, 1), 16);
  }
  c.font = "600 11px system-ui, sans-serif"; c.textBaseline = "top"; c.textAlign = "center";
  let free = -Infinity;
  nodes.forEach((node, index) => {
    if (madeAt[index] >= frames) return;
    const x = along(madeAt[index]), half = c.measureText(String(node.id)).width / 2, at = Math.max(x, half);
    c.fillStyle = ink.card; c.fillRect(x - 2, 0, 4, 16);
    c.fillStyle = ink.ink; c.fillRect(x - 1, 0, 2, 20);
    if (at - half > free) { c.fillText(String(node.id), at, 22); free = at + half + 3; }
  });
}, {tall: 20});
const steepest = (() => {
  let most = 10;
  for (const values of [run.pitch_deg, run.roll_deg]) for (const value of values) if (Number.isFinite(value)) most = Math.max(most, Math.abs(value));
  return Math.ceil(most / 5) * 5;
})();
const drawTilt = makeStrip($("tilt"), time, (c, w, h, along) => {
  const y = (value) => h / 2 - value / steepest * (h / 2 - 7);
  c.font = "10.5px system-ui, sans-serif"; c.textAlign = "right"; c.textBaseline = "middle";
  for (const value of [steepest, 0, -steepest]) {
    c.fillStyle = ink.line; c.fillRect(30, y(value), w - 34, 1);
    c.fillStyle = ink.soft; c.fillText(`${value < 0 ? "\u2212" : ""}${Math.abs(value)}\u00b0`, 26, y(value));
  }
  [["roll_deg", "#e69f00", [4, 3]], ["pitch_deg", PALETTE[0], []]].forEach(([name, colour, dash]) => {
    c.beginPath();
    let on = false;
    run[name].forEach((value, i) => {
      if (!Number.isFinite(value)) { on = false; return; }
      c[on ? "lineTo" : "moveTo"](along(i), y(value)); on = true;
    });
    c.strokeStyle = colour; c.lineWidth = 1.8; c.lineJoin = "round"; c.setLineDash(dash); c.stroke(); c.setLineDash([]);
  });
}, {left: 30, right: 4});

// ---- the side panel
const READOUTS = {
  time: ["Time", "Since the start of the run"], speed: ["Speed", "By odometry, over the last half second"], left: ["Left L_l", "Distance to the wall on the left"],
  right: ["Right L_r", "Distance to the wall on the right"], votes: ["Votes", "Votes for the node that is being approached"], drift: ["Drift", "From the true position to the odometry's"],
};
for (const [id, [text, title]] of Object.entries(READOUTS)) {
  const row = add($("readouts"), "div", "", title);
  add(row, "dt", text); add(row, "dd").id = `now-${id}`;
}
function speedNow() {
  let from = time.frame;
  while (from > 0 && run.time_s[time.frame] - run.time_s[from - 1] <= 0.5 + 1e-9) from--;
  if (from === time.frame) from = Math.max(0, time.frame - 1);
  if (from === time.frame) return NaN;
  let path_m = 0;
  for (let i = from; i < time.frame; i++) path_m += Math.hypot(run.estimate[3 * i + 3] - run.estimate[3 * i], run.estimate[3 * i + 4] - run.estimate[3 * i + 1]);
  return path_m / (run.time_s[time.frame] - run.time_s[from]);
}
function bearings(node) {
  const found = [];
  for (let k = 0; k < run.n_links[time.frame]; k++) {
    if (links[k].start === node.id) found.push(links[k].start_bearing_deg);
    if (links[k].end === node.id && searched(k) && links[k].end_bearing_deg !== null) found.push(links[k].end_bearing_deg);
  }
  return found.map((degrees) => ((degrees % 360) + 360) % 360).sort((a, b) => a - b);
}
let tablesKey = "", rowsBefore = 0;
function fillTables() {
  let done = 0;
  for (let k = 0; k < run.n_links[time.frame]; k++) done += searched(k);
  const now = [run.n_nodes[time.frame], run.n_links[time.frame], done, picked].join();
  if (now === tablesKey) return;
  tablesKey = now;
  $("nodecount").textContent = `Nodes: ${run.n_nodes[time.frame]}`;
  $("linkcount").textContent = `Links: ${run.n_links[time.frame]}, of them ${run.n_links[time.frame] - done} un-searched`;
  const body = $("nodes").tBodies[0], focused = document.activeElement && document.activeElement.dataset.node;
  body.replaceChildren();
  nodes.slice(0, run.n_nodes[time.frame]).forEach((node, index) => {
    const row = add(body, "tr"), found = bearings(node);
    const gaps = found.map((degrees, i) => Math.round((((i + 1 < found.length ? found[i + 1] : found[0]) - degrees) % 360 + 360) % 360 || 360));
    row.title = `x ${number(node.x_m, 2, " m")}, y ${number(node.y_m, 2, " m")}` + (gaps.length ? `; angles between links ${gaps.map((gap) => `${gap}\u00b0`).join(", ")}` : "");
    row.classList.toggle("pick", index === picked);
    const button = add(add(row, "td"), "button", `${GLYPH[node.type] || "\u25cb"} ${node.id}`, "Pick the node and go to the frame that made it");
    button.dataset.node = index;
    button.setAttribute("aria-pressed", String(index === picked));
    add(row, "td", words(node.type)); add(row, "td", String(found.length)); add(row, "td", `${run.time_s[madeAt[index]].toFixed(1)} s`); add(row, "td", nodeNotes(node));
    row.addEventListener("click", () => pick(index, true));
    if (focused === String(index)) button.focus({preventScroll: true});
  });
  const list = $("links").tBodies[0];
  list.replaceChildren();
  for (let k = 0; k < run.n_links[time.frame]; k++) {
    const link = links[k], row = add(list, "tr"), known = searched(k), notes = [];
    add(row, "td", String(link.id)).style.fontWeight = 600;
    add(row, "td", `${link.start} \u2192 ${known ? link.end : "?"}`);
    add(row, "td", known ? number(link.length_m, 1, " m") : "\u2013"); add(row, "td", known ? number(link.min_width_m, 2, " m") : "\u2013");
    if (!known) notes.push("un-searched");
    if (!known && link.opening_m !== null) notes.push(`opening ${number(link.opening_m, 1, " m")}`);
    if (known && link.posture_deg !== null) notes.push(`tilt ${number(link.posture_deg, 1, "\u00b0")}`);
    if (known && link.max_step_m) notes.push(`step ${number(link.max_step_m, 2, " m")}`);
    const last = add(row, "td", [...notes, ...(known ? extras(link) : [])].join(", "));
    if (!known) last.className = "none";
  }
  const rows = run.n_nodes[time.frame] + run.n_links[time.frame];
  if (rows > rowsBefore && picked < 0) for (const table of [body, list]) { const pane = table.closest(".table"); pane.scrollTop = pane.scrollHeight; }
  rowsBefore = rows;
}
let spokenMode = "";
function fillPanel() {
  const i = time.frame, mode = words(modeName(i)), colour = modeColour(run.mode[i]);
  $("mode").textContent = mode;
  $("mode").style.background = colour;
  $("mode").style.color = onColour(colour);
  const values = {
    time: number(run.time_s[i], 2, " s"), speed: number(speedNow(), 2, " m/s"),
    left: number(run.left_m[i], 2, " m"), right: number(run.right_m[i], 2, " m"), votes: String(run.votes[i]),
    drift: number(Math.hypot(run.pose[3 * i] - run.estimate[3 * i], run.pose[3 * i + 1] - run.estimate[3 * i + 1]), 2, " m"),
  };
  for (const [name, text] of Object.entries(values)) $(`now-${name}`).textContent = text;
  $("pitch").textContent = number(run.pitch_deg[i], 1, "\u00b0");
  $("roll").textContent = number(run.roll_deg[i], 1, "\u00b0");
  $("clock").textContent = `${run.time_s[i].toFixed(1)} of ${run.time_s[frames - 1].toFixed(1)} s, frame ${i} of ${frames - 1}`;
  $("seek").setAttribute("aria-valuetext", `${run.time_s[i].toFixed(1)} seconds, ${mode}`);
  if (!time.playing && mode !== spokenMode) $("spoken").textContent = spokenMode = mode;
  for (const kind of ["follow", "whole"]) $(kind).setAttribute("aria-pressed", String(view.kind === kind));
}
function show() {
  drawMap(); drawRuns(); drawTilt(); fillPanel(); fillTables();
  document.body.dataset.state = JSON.stringify(state());  // for tests that read the page from outside
}
const showSoon = soon(show);

// ---- control
function pick(index, go) {
  picked = index;
  time.pause();
  if (go) time.seek(Math.min(madeAt[index], frames - 1)); else time.showAll();
}
$("follow").addEventListener("click", () => plane.look("follow"));
const dressLayers = makeLayers(LAYERS, shown, showSoon, {
  dash: () => ({borderTop: `2px dashed ${ink.soft}`, height: "0"}), wall: () => ({borderTop: `3px solid ${ink.wall}`, height: "0"}),
  modes: () => ({background: `linear-gradient(90deg, ${PALETTE[0]} 34%, ${PALETTE[1]} 34% 67%, ${PALETTE[2]} 67%)`, height: "4px"}),
});
new ResizeObserver(showSoon).observe($("plane"));
window.addEventListener("resize", showSoon);

$("about").textContent = `${run.time_s[frames - 1].toFixed(0)} s, ${nodes.length} nodes, ${links.length} links`;
themes(() => {
  dressLayers();
  $("modekey").replaceChildren();
  for (const mode of [...new Set(run.mode)].sort((a, b) => a - b)) {
    const item = add($("modekey"), "span");
    add(item, "i").style.background = modeColour(mode);
    item.append(words(data.mode_names[mode]));
  }
  showSoon();
});
window.replay = {frames, seek: time.seek, play: time.play, pause: time.pause, state, setSpeed: time.setSpeed};
time.setTimes(run.time_s);
time.fromHash();
