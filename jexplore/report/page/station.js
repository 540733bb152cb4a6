// The station's page: maps of several robots, what they say, and routes over them.
const data = JSON.parse($("data").textContent);
const OWN = "own", UNSEARCHED = "unsearched";
const panels = data.panels.map((panel, index) => ({...panel, ...makeMap(panel), index, view: {kind: "whole", x: 0, y: 0, scale: 0}}));
let current = panels[0], picked = null, from = null, to = null, route = null, use = null;  // picked: {kind, id}
const hidden = new Set();  // writers that are not shown
const LAYERS = [
  {name: "ids", text: "Node ids"}, {name: "linkids", text: "Link ids"},
  {name: "stubs", text: "Un-searched ways", title: "Openings that nobody has followed, where they point to"},
  {name: "refused", text: "Refused", title: "What the chosen robot may not use, crossed"},
  {name: "radio", text: "Radio", title: "Quality of the radio where the maps say it"},
  {name: "notes", text: "Victims, help", title: "Victims, and where the operator had to help"},
];
const shown = Object.fromEntries(LAYERS.map(({name}) => [name, name !== "linkids"]));

// ---- words
const isSaid = (value) => value !== undefined && value !== null && value !== false && value !== 0 && value !== "";
const says = (item, name) => isSaid(item.attributes[name]) ? "yes" : (item.conflicts[name] ?? []).some((one) => isSaid(one.value)) ? "perhaps" : "no";
const text = (value) => typeof value === "string" ? value : typeof value === "number" ? String(Number(value.toPrecision(4))) : value === true ? "yes" : value === false ? "no" : JSON.stringify(value);
const disputed = (told) => told.map((one) => `${text(one.value)} (${one.from.join(", ")})`).join(" or ");
const writersOf = (item) => Object.keys(item.from);
const writtenBy = (item, kind) => Object.entries(item.from).map(([name, id]) => `${name} (${kind} ${text(id)})`).join(", ");
const colourOf = (writer) => { const at = data.writers.indexOf(writer); return at < 0 ? ink.band : PALETTE[at % PALETTE.length]; };
const isShown = (item) => writersOf(item).some((writer) => !hidden.has(writer));
const plural = (n, one, many = `${one}s`) => `${n} ${n === 1 ? one : many}`;
const degrees = (value) => value === null ? "\u2013" : `${Math.round(modulo(value)) % 360}\u00b0`;
const placeOf = (node) => `${number(node.x_m, 1, "")}, ${number(node.y_m, 1, " m")}`;
const nodeWords = (node) => `${GLYPH[node.type] ?? ""} ${node.id}`;
// The radio's quality in bars, from the strength in dBm; null where there is no number.
const RADIO = [[-60, "free"], [-70, "way"], [-80, "robot"], [-Infinity, "chosen"]];
function radioOf(item) {
  const dbm = item.attributes.radio_dbm;
  if (typeof dbm !== "number") return null;
  const at = RADIO.findIndex(([least]) => dbm >= least);
  return {dbm, bars: 4 - at, colour: RADIO[at][1]};
}

// ---- robots and routes
const limits = {width_m: [0, 10, "width", "m"], max_step_m: [0, 1, "step", "m"], max_slope_deg: [0, 60, "slope", "degrees"]};
function ownRobot() {  // the one that is typed in, or what is wrong with it
  const read = (id) => $(id).value.trim() === "" ? NaN : Number($(id).value);
  const robot = {name: "own robot", width_m: read("own-width"), max_step_m: read("own-step"), max_slope_deg: read("own-slope")};
  for (const [key, [low, high, name, unit]] of Object.entries(limits)) {
    const value = robot[key], isWrong = !(value >= low && value <= high) || key === "width_m" && value === 0;
    if (isWrong) return {wrong: `expected ${name} ${key === "width_m" ? "above" : "from"} ${low} to ${high} ${unit}, got ${Number.isNaN(value) ? "no number" : value}`};
  }
  return {robot};
}
function findUse() {
  const at = $("robot").value, given = at === OWN ? ownRobot() : {robot: data.robots[at]};
  use = given.wrong ? {...given, refused: new Map(), barriers: new Map()} : useOf(current, given.robot, $("known").checked);
}
function findRoute() {
  findUse();
  route = from === null || to === null || use.wrong ? null : routeOf(current, use, from, to === UNSEARCHED ? null : to);
}
const refusedOf = (link) => use.refused.get(link.id) ?? [];

// ---- the plane of a map
const STUB_PX = 34;
const tipOf = ({plane}, link, start) => ahead(start, link.start_bearing_deg, Math.max(1.1, STUB_PX / plane.view.scale));
const onCurve = ([p, a, b, q], t) => [0, 1].map((i) => (1 - t) ** 3 * p[i] + 3 * (1 - t) ** 2 * t * a[i] + 3 * (1 - t) * t * t * b[i] + t ** 3 * q[i]);
function shapeOf(panel, link) {  // points in metres along a link, and its middle
  const start = panel.byNode.get(link.start);
  if (link.end === NOWHERE) {
    const tip = tipOf(panel, link, start);
    return {tip, middle: tip, points: [[start.x_m, start.y_m], tip]};
  }
  const curve = curveOf(link, start, panel.byNode.get(link.end));
  return {curve, middle: onCurve(curve, 0.5), points: Array.from({length: 25}, (_, i) => onCurve(curve, i / 24))};
}
function boundsOf({nodes}) {
  if (!nodes.length) return [-5, -5, 5, 5];
  const xs = nodes.map((node) => node.x_m), ys = nodes.map((node) => node.y_m), least = (many) => many.reduce((a, b) => Math.min(a, b)), most = (many) => many.reduce((a, b) => Math.max(a, b));
  const edge = 2 + 0.06 * Math.max(most(xs) - least(xs), most(ys) - least(ys));
  return [least(xs) - edge, least(ys) - edge, most(xs) + edge, most(ys) + edge];
}
function away(x, y, ax, ay, bx, by) {  // of a point from a piece of a line
  const square = (bx - ax) ** 2 + (by - ay) ** 2, t = square ? Math.max(0, Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / square)) : 0;
  return Math.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay));
}
function hit(panel, x, y) {  // what lies under a pixel: {kind, id}, or null
  const {sx, sy} = panel.plane;
  const near = panel.nodes.filter(isShown).map((node) => [Math.hypot(sx(node.x_m) - x, sy(node.y_m) - y), node]).filter(([px]) => px < 14);
  if (near.length) return {kind: "node", id: near.reduce((a, b) => b[0] < a[0] ? b : a)[1].id};
  let best = null, least = 9;
  for (const link of panel.links.filter(isShown)) {
    if (link.end === NOWHERE && !shown.stubs) continue;
    const {points, tip} = shapeOf(panel, link), px = points.map(([u, v]) => [sx(u), sy(v)]);
    let distance = tip ? Math.max(0, Math.hypot(sx(tip[0]) - x, sy(tip[1]) - y) - 6) : Infinity;
    for (let i = 1; i < px.length; i++) distance = Math.min(distance, away(x, y, ...px[i - 1], ...px[i]));
    if (distance < least) [best, least] = [{kind: "link", id: link.id}, distance];
  }
  return best;
}
const itemOf = (panel, {kind, id}) => (kind === "node" ? panel.byNode : panel.byLink).get(id);

// ---- drawing
function strokeWritten({pen, stroke}, writers, thickness) {  // in the colours of all, in turns
  const seen = writers.filter((writer) => !hidden.has(writer)), length = 9;
  seen.forEach((writer, i) => {
    pen.lineDashOffset = -i * length;
    stroke(colourOf(writer), thickness, seen.length > 1 ? [length, length * (seen.length - 1)] : []);
  });
  pen.lineDashOffset = 0;
}
function drawCross({pen, stroke}, x, y, isBlocked) {
  const size = isBlocked ? 5 : 6, cross = () => { pen.beginPath(); pen.moveTo(x - size, y - size); pen.lineTo(x + size, y + size); pen.moveTo(x - size, y + size); pen.lineTo(x + size, y - size); };
  if (isBlocked) { pen.beginPath(); pen.arc(x, y, 9, 0, 2 * Math.PI); pen.fillStyle = ink.floor; pen.fill(); stroke(ink.chosen, 2.4); } else { cross(); stroke(ink.floor, 6); }
  cross(); stroke(ink.chosen, 2.8);
}
function drawBadge({pen}, x, y, letter, colour, isSure = true) {
  pen.beginPath(); pen.arc(x, y, 8, 0, 2 * Math.PI); pen.fillStyle = isSure ? colour : ink.floor; pen.fill();
  pen.lineWidth = 2; pen.strokeStyle = isSure ? ink.floor : colour; pen.stroke();
  pen.font = "700 11px system-ui, sans-serif"; pen.textAlign = "center"; pen.textBaseline = "middle";
  pen.fillStyle = isSure ? "#ffffff" : ink.ink; pen.fillText(isSure ? letter : `${letter}?`, x, y + 0.5);
}
const VICTIM = "#b0204a", HELP = "#6b5b00";
function drawBars({pen}, x, y, {bars, colour}) {
  for (let k = 0; k < 4; k++) { pen.fillStyle = k < bars ? ink[colour] : ink.line; pen.fillRect(x + 4 * k, y - 3 - 3 * k, 3, 3 + 3 * k); }
}
function drawNotes(plane, item, x, y) {
  const victim = says(item, "victim"), help = says(item, "intervention"), radio = radioOf(item);
  if (shown.radio && radio) drawBars(plane, x + 12, y + 19, radio);
  if (shown.notes && victim !== "no") drawBadge(plane, x - 15, y - 13, "V", VICTIM, victim === "yes");
  if (shown.notes && help !== "no") drawBadge(plane, x - 15, y + 13, "H", HELP, help === "yes");
}
function drawLink(panel, link) {
  const {plane} = panel, {pen, stroke, sx, sy, disc} = plane, {curve, middle} = shapeOf(panel, link), start = panel.byNode.get(link.start);
  const radio = radioOf(link), isPicked = panel === current && picked?.kind === "link" && picked.id === link.id;
  const line = () => curve ? traceCurve(plane, curve) : plane.trace([[start.x_m, start.y_m], middle]);
  if (!curve && !shown.stubs) return;
  if (shown.radio && radio) { line(); pen.globalAlpha = 0.25; stroke(ink[radio.colour], 18); pen.globalAlpha = 1; }
  if (isPicked) { line(); stroke(ink.focus, 10); }
  if (curve) {
    line(); stroke(ink.floor, 7); line(); strokeWritten(plane, writersOf(link), 4);
  } else drawStub(plane, start, middle, colourOf(writersOf(link).find((writer) => !hidden.has(writer))));
  if (isPicked && !curve) { disc(...middle, 11); stroke(ink.focus, 3); }
  const [x, y] = [sx(middle[0]), sy(middle[1])];
  if (link.blocked || panel === current && shown.refused && refusedOf(link).length) drawCross(plane, x, y, link.blocked);
  drawNotes(plane, link, x, y);
  if (shown.linkids) plane.label(String(link.id), x + 10, y + 12, ink.soft, "left", 11);
}
function drawNode(panel, node) {
  const {plane} = panel, {pen, sx, sy, disc, fill, stroke} = plane, x = sx(node.x_m), y = sy(node.y_m), radio = radioOf(node);
  if (shown.radio && radio) { disc(node.x_m, node.y_m, 24); fill(ink[radio.colour], 0.22); stroke(ink[radio.colour], 1); }
  const seen = writersOf(node).filter((writer) => !hidden.has(writer));
  drawNodeMark(plane, node, panel === current && picked?.kind === "node" && picked.id === node.id, shown.ids, () => {
    pen.save(); pen.clip();
    seen.forEach((writer, i) => { pen.fillStyle = colourOf(writer); pen.fillRect(x - 10 + 20 * i / seen.length, y - 10, 20 / seen.length + 0.5, 20); });
    pen.restore();
  });
  if (panel === current && shown.refused && use.barriers.has(node.id)) { disc(node.x_m, node.y_m, 13); stroke(ink.chosen, 2.2, [4, 3]); }
  drawNotes(plane, node, x, y);
}
function drawRoute(panel) {
  const {plane} = panel, {pen, stroke, sx, sy, fill} = plane;
  const steps = route?.found ? [...route.steps, ...(route.onward ? [route.onward] : [])] : [];
  for (const step of steps) {
    const link = panel.byLink.get(step.link), {curve, points} = shapeOf(panel, link);
    curve ? traceCurve(plane, curve) : plane.trace(points);
    pen.lineCap = "round"; pen.globalAlpha = 0.45; stroke(ink.focus, 15); pen.globalAlpha = 1; pen.lineCap = "butt";
  }
  return () => {  // arrows lie above the links, flags above all
    for (const step of steps) {
      const link = panel.byLink.get(step.link), {points} = shapeOf(panel, link), isBack = link.end !== NOWHERE && link.start !== step.start;
      const [a, b] = points.length > 2 ? [points[15], points[17]] : points, [c, d] = isBack ? [points[9], points[7]] : [a, b];
      const angle = Math.atan2(sy(d[1]) - sy(c[1]), sx(d[0]) - sx(c[0])), x = (sx(c[0]) + sx(d[0])) / 2, y = (sy(c[1]) + sy(d[1])) / 2;
      pen.beginPath();
      [[9, 0], [-6, 7], [-6, -7]].forEach(([u, v]) => pen.lineTo(x + u * Math.cos(angle) - v * Math.sin(angle), y + u * Math.sin(angle) + v * Math.cos(angle)));
      pen.closePath(); fill(ink.focus); stroke(ink.floor, 1.5);
    }
    for (const [id, word] of [[from, "from"], [to, "to"]]) {
      const node = panel.byNode.get(id);
      if (node) { plane.disc(node.x_m, node.y_m, 20); stroke(ink.focus, 2.5); plane.label(word, sx(node.x_m), sy(node.y_m) + 29, ink.focus, "center", 12); }
    }
  };
}
function drawPanel(panel) {
  const {plane} = panel;
  plane.begin(); plane.drawGrid();
  const finish = panel === current ? drawRoute(panel) : () => {};
  for (const link of panel.links) if (isShown(link)) drawLink(panel, link);
  for (const node of panel.nodes) if (isShown(node)) drawNode(panel, node);
  finish(); plane.drawBar();
  if (!panel.nodes.length) plane.label("The map has no node", plane.width / 2, plane.height / 2, ink.soft, "center", 14);
}
