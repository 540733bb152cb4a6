// What the pages that draw Behavioral Trace Maps share: marks of nodes, curves of links, words for their measures. It
// follows replay.js in the same scope.
const GLYPH = {terminal: "\u25a0", divergence: "\u25cf", free_space: "\u25c6", obstacle: "\u25b2"};
const plain = (value) => typeof value === "string" ? value : typeof value === "number" ? String(Number(value.toPrecision(3))) : Array.isArray(value) ? value.map(plain).join(" ") : JSON.stringify(value);
const extras = (item) => Object.entries(item.attributes).map(([name, value]) => `${words(name)}: ${plain(value)}`);
function nodeNotes(node) {
  const notes = [];
  if (node.obstacle) notes.push(node.obstacle);
  if (node.inclination_deg !== null) notes.push(number(node.inclination_deg, 1, "\u00b0"));
  if (node.step_m !== null) notes.push(`step ${number(node.step_m, 2, " m")}`);
  if (node.posture_deg !== null) notes.push(`tilt ${number(node.posture_deg, 1, "\u00b0")}`);
  return [...notes, ...extras(node)].join(", ");
}
const ahead = (node, degrees, metres) => [node.x_m + metres * Math.cos(degrees * Math.PI / 180), node.y_m + metres * Math.sin(degrees * Math.PI / 180)];
// A searched link as a cubic curve that leaves both nodes by its bearings: four points, metres.
function curveOf(link, start, end) {
  const chord = Math.hypot(end.x_m - start.x_m, end.y_m - start.y_m);
  const reach = Math.max(0.35 * chord, link.start === link.end ? (link.length_m || 4.5) / 3 : 0);
  const back = link.end_bearing_deg === null ? Math.atan2(start.y_m - end.y_m, start.x_m - end.x_m) * 180 / Math.PI : link.end_bearing_deg;
  return [[start.x_m, start.y_m], ahead(start, link.start_bearing_deg, reach), ahead(end, back, reach), [end.x_m, end.y_m]];
}
function traceCurve({pen, sx, sy}, [from, a, b, to]) {
  pen.beginPath(); pen.moveTo(sx(from[0]), sy(from[1]));
  pen.bezierCurveTo(sx(a[0]), sy(a[1]), sx(b[0]), sy(b[1]), sx(to[0]), sy(to[1]));
}
// The tip of an un-searched link, a ring with a question mark at the end of a dashed line.
function drawStub({trace, stroke, fill, disc, label, sx, sy}, start, tip, colour = ink.ink) {
  const line = [[start.x_m, start.y_m], tip];
  trace(line); stroke(ink.floor, 5); trace(line); stroke(colour, 2.2, [5, 4]);
  disc(...tip, 8); fill(ink.floor); stroke(colour, 1.6);
  label("?", sx(tip[0]), sy(tip[1]) + 0.5, ink.ink, "center", 11);
}
function drawNodeMark({pen, sx, sy, disc, stroke, label}, node, isPicked, hasId, paint) {  // paint(x, y) fills the mark
  const x = sx(node.x_m), y = sy(node.y_m);
  traceMark(pen, node.type, x, y); paint(x, y);
  traceMark(pen, node.type, x, y); pen.lineJoin = "round"; stroke(ink.ink, 2.2);
  if (isPicked) { disc(node.x_m, node.y_m, 16); stroke(ink.focus, 3); }
  if (hasId) label(String(node.id), x + 12, y - 13, ink.ink, "left", 13);
}
const MARK = 7;  // half a square, pixels
function traceMark(pen, type, x, y) {
  pen.beginPath();
  if (type === "terminal") pen.rect(x - MARK, y - MARK, 2 * MARK, 2 * MARK);
  else if (type === "free_space") [[0, -9], [9, 0], [0, 9], [-9, 0]].forEach(([u, v]) => pen.lineTo(x + u, y + v));
  else if (type === "obstacle") [[0, -9], [9, 7], [-9, 7]].forEach(([u, v]) => pen.lineTo(x + u, y + v));
  else pen.arc(x, y, MARK + 0.5, 0, 2 * Math.PI);
  pen.closePath();
}
