// The side of the station's page, and what its controls do; it follows station.js in the same scope.
// ---- the side: details, tables
function pickButton(parent, kind, item, title) {
  const button = add(parent, "button", kind === "node" ? nodeWords(item) : String(item.id), title);
  button.dataset.pick = `${kind}-${item.id}`;
  button.addEventListener("click", () => pick({kind, id: item.id}));
  return button;
}
function rowsOf(item, kind) {  // what is told of a node or link: pairs of words
  const rows = [], put = (name, value, digits, unit) => { if (value !== null && value !== undefined) rows.push([name, typeof value === "number" ? number(value, digits, unit) : value]); };
  if (kind === "node") {
    put("type", words(item.type)); put("at", placeOf(item)); put("obstacle", item.obstacle);
    put("links leave at", item.bearings_deg.map(degrees).join(", ") || "none"); put("angles between", item.angles_deg.map((gap) => `${Math.round(gap)}\u00b0`).join(", ") || null);
    put("inclination", item.inclination_deg, 1, "\u00b0"); put("step", item.step_m, 3, " m"); put("posture", item.posture_deg, 1, "\u00b0");
  } else {
    put("way", item.end === NOWHERE ? `from node ${item.start}, un-searched` : `nodes ${item.start} to ${item.end}, searched`);
    put("leaves at", degrees(item.start_bearing_deg) + (item.end_bearing_deg === null ? "" : `, at its end ${degrees(item.end_bearing_deg)}`));
    put("length", item.length_m, 2, " m"); put("narrowest", item.min_width_m, 2, " m"); put("opening", item.opening_m, 2, " m");
    put("highest step", item.step_m, 3, " m"); put("inclination", item.inclination_deg, 1, "\u00b0"); put("roll", item.max_roll_deg, 1, "\u00b0");
    put("unknown", item.unknown.map((missing) => missing.replace(" unknown", "")).join(", ") || null);
  }
  for (const [name, value] of Object.entries(item.attributes)) put(words(name), text(value));
  for (const [name, told] of Object.entries(item.conflicts)) put(`${words(name)}, disputed`, disputed(told));
  put("written by", writtenBy(item, kind));
  if (use.robot) {
    const why = kind === "node" ? use.barriers.get(item.id) ?? [] : refusedOf(item);
    put(`for ${use.robot.name}`, why.length ? `${kind === "node" ? "not to be passed" : "refused"}: ${why.join(", ")}` : kind === "node" ? "may be passed" : item.end === NOWHERE ? "may be followed" : "may be used");
  }
  return rows;
}
const headOf = (item, kind) => kind === "node" ? `Node ${nodeWords(item)}` : item.called[0].toUpperCase() + item.called.slice(1);
function fillPicked() {
  const box = $("picked");
  box.replaceChildren();
  const item = picked && itemOf(current, picked);
  if (!item) return void (add(box, "p", "Click a node or a way, or a number in the tables below.").className = "soft");
  add(box, "b", headOf(item, picked.kind));
  const list = add(box, "dl");
  for (const [name, value] of rowsOf(item, picked.kind)) { add(list, "dt", name); add(list, "dd", value); }
  if (picked.kind !== "node") return;
  const bar = add(box, "div"); bar.className = "zoom";
  add(bar, "button", "Route from here").addEventListener("click", () => setEnds(item.id, to));
  add(bar, "button", "Route to here").addEventListener("click", () => setEnds(from, item.id));
}
function lines(parent, title, found) {
  if (!found.length) return;
  if (title) add(parent, "h3", title);
  const list = add(parent, "ul");
  for (const line of found) add(list, "li", line);
}
function fillFound() {
  const box = $("found");
  box.replaceChildren();
  if (use.wrong) return void (add(box, "p", use.wrong).className = "no");
  const refused = [...use.refused].map(([id, why]) => `${current.byLink.get(id).called}: ${why.join(", ")}`);
  if (!route) {
    const n = use.refused.size, of = current.links.length;
    return void (add(box, "p", `${use.robot.name}: ${n ? `${n} of ${plural(of, "way")} refused` : `may use all of ${plural(of, "way")}`}${from === null ? "" : `. From node ${from}: choose where to.`}`).className = "soft");
  }
  if (!route.found) {
    add(box, "b", `no route: ${route.trouble}`).className = "no";
    lines(box, "Refused", [...route.refused.map(([id, why]) => `${current.byLink.get(id).called}: ${why.join(", ")}`), ...route.barriers.map(([id, why]) => `node ${id}, to pass: ${why.join(", ")}`)]);
    return;
  }
  const goal = route.onward ? `un-searched link ${route.onward.link} of node ${route.end}, bearing ${degrees(route.onward.bearing_deg)}` : `node ${route.end}`;
  add(box, "b", `${number(route.length_m, 2, " m")} over ${plural(route.links.length, "link")}, node ${route.start} to ${goal}`);
  const steps = [...route.steps, ...(route.onward ? [route.onward] : [])];
  if (steps.length) table(box, "The route", ["Link", "To", "Way", "Turn", "Bearing", "Length"], steps.map((step) => {
    const link = current.byLink.get(step.link);
    return [{kind: "link", item: link}, step.end === NOWHERE ? "?" : String(step.end), step.way === null ? "\u2013" : `${step.way} of ${step.ways}`, degrees(step.turn_deg).replace(/^0\u00b0$/, "360\u00b0"), degrees(step.bearing_deg), number(link.metres, 2, " m")];
  }));
  lines(box, "Not known", route.unknown);
  if (!refused.length) return;
  const rest = add(box, "details");
  add(rest, "summary", `Refused: ${refused.length}`); lines(rest, "", refused);
}
// A table; a cell is text, or {kind, item} for a button that picks it.
function table(parent, title, head, rows) {
  const box = add(parent, "div"), made = add(box, "table");
  box.className = "table"; box.tabIndex = 0; box.setAttribute("role", "region"); box.setAttribute("aria-label", title);
  const top = add(add(made, "thead"), "tr"), body = add(made, "tbody");
  for (const name of head) add(top, "th", name).scope = "col";
  for (const cells of rows) {
    const row = add(body, "tr");
    for (const cell of cells) if (typeof cell === "string") add(row, "td", cell).classList.toggle("long", cell.length > 16); else { pickButton(add(row, "td"), cell.kind, cell.item, `Show ${cell.kind} ${cell.item.id}`); row.dataset.pick ??= `${cell.kind}-${cell.item.id}`; }
  }
  return made;
}
const folded = new Map([["All nodes", true], ["All links", true]]);  // title -> whether it is
function foldable(title, count) {
  const box = add($("tables"), "details");
  box.open = !folded.get(title);
  box.addEventListener("toggle", () => folded.set(title, !box.open));
  add(box, "summary", `${title}: ${count}`);
  return box;
}
let tablesKey = "";
function fillTables() {
  const key = JSON.stringify([current.index, use.robot, [...use.refused], [...hidden]]);
  if (key === tablesKey) return;  // or they would lose where they are scrolled to
  tablesKey = key;
  const {nodes, links} = current, focused = document.activeElement?.closest?.("#tables") ? document.activeElement.dataset : {};
  const everything = [...nodes.map((item) => ({kind: "node", item})), ...links.map((item) => ({kind: "link", item}))];
  const by = (item) => writersOf(item).join(", ");
  $("tables").replaceChildren();
  fillWriters();
  const stubs = links.filter((link) => link.end === NOWHERE);
  table(foldable("Un-searched links", stubs.length), "Un-searched links", ["Link", "Node", "Bearing", "Opening", `For ${use.robot?.name ?? "the robot"}`, "By"], stubs.map((link) => [
    {kind: "link", item: link}, String(link.start), degrees(link.start_bearing_deg), number(link.opening_m, 2, " m"), refusedOf(link).join(", ") || "may be followed", by(link)]));
  const victims = everything.filter(({item}) => says(item, "victim") !== "no");
  table(foldable("Victims", victims.length), "Victims", ["Where", "At", "Says", "Place known to"], victims.map(({kind, item}) => [
    {kind, item}, kind === "node" ? placeOf(item) : item.called, item.conflicts.victim ? disputed(item.conflicts.victim) : text(item.attributes.victim), by(item)]));
  table(foldable("All nodes", nodes.length), "All nodes", ["Node", "Type", "x, y", "Links", "Notes", "By"], nodes.map((node) => [
    {kind: "node", item: node}, words(node.type), placeOf(node), String(node.bearings_deg.length), nodeNotes(node), by(node)]));
  table(foldable("All links", links.length), "All links", ["Link", "From, to", "Length", "Width", "Refused", "Notes", "By"], links.map((link) => [
    {kind: "link", item: link}, `${link.start} \u2192 ${link.end === NOWHERE ? "?" : link.end}`, number(link.length_m, 1, " m"), number(link.min_width_m ?? link.opening_m, 2, " m"), refusedOf(link).join(", "), extras(link).join(", "), by(link)]));
  const said = [...extras(current), ...Object.entries(current.conflicts).map(([name, told]) => `${words(name)}: ${disputed(told)}`)];
  if (said.length) lines(foldable("About the map", said.length), "", said);
  if (data.notes.length) lines(foldable("What the maps say differently", data.notes.length), "", data.notes);
  if (focused.pick || focused.writer) [...$("tables").querySelectorAll("button, input")].find((one) => focused.pick ? one.dataset.pick === focused.pick : one.dataset.writer === focused.writer)?.focus({preventScroll: true});
}
function fillWriters() {
  const everything = [...current.nodes, ...current.links];
  const made = table(foldable("Written by", plural(data.writers.length, "map")), "Who wrote what", ["Map", "Nodes", "Links", "Un-searched", "Alone"], data.writers.map((writer) => {
    const own = (items) => items.filter((item) => writersOf(item).includes(writer));
    return [writer, own(current.nodes).length, own(current.links).length, own(current.links.filter((link) => link.end === NOWHERE)).length, own(everything).filter((item) => writersOf(item).length === 1).length].map(String);
  }));
  [...made.tBodies[0].rows].forEach((row, i) => {
    const writer = data.writers[i], cell = row.cells[0], label = document.createElement("label"), box = add(label, "input"), swatch = add(label, "span");
    box.type = "checkbox"; box.checked = !hidden.has(writer); box.dataset.writer = String(i); box.title = "Show what it wrote";
    swatch.className = "swatch"; swatch.style.background = colourOf(writer);
    box.addEventListener("change", () => { box.checked ? hidden.delete(writer) : hidden.add(writer); showSoon(); });
    label.append(writer); cell.replaceChildren(label);
  });
}
function fillHead() {
  const {nodes, links} = current, count = (items, test) => items.filter(test).length, stubs = count(links, (link) => link.end === NOWHERE);
  const types = [...new Set(nodes.map((node) => node.type))].map((type) => `${count(nodes, (node) => node.type === type)} ${words(type)}`);
  const extra = [[count(links, (link) => link.blocked), "blocked", "blocked"], ...["victim", "intervention"].map((name) => [count([...nodes, ...links], (item) => says(item, name) !== "no"), name, `${name}s`])];
  $("about").textContent = [`${plural(nodes.length, "node")}${types.length ? ` (${types.join(", ")})` : ""}`, `${plural(links.length, "link")}: ${links.length - stubs} searched, ${stubs} un-searched`, ...extra.filter(([n]) => n).map(([n, one, many]) => plural(n, one, many))].join("; ");
  for (const [id, value] of [["from", from], ["to", to]]) $(id).value = value === null ? "" : String(value);
  $("own").hidden = $("robot").value !== OWN;
}
function markPicked() {
  for (const row of document.querySelectorAll("tr[data-pick]")) row.classList.toggle("pick", picked !== null && row.dataset.pick === `${picked.kind}-${picked.id}`);
}
const state = () => ({
  map: current.name, picked, from, to, robot: use.robot ?? null, wrong: use.wrong ?? null, known: $("known").checked, route,
  refused: [...use.refused], barriers: [...use.barriers], hidden: [...hidden], layers: {...shown}, view: {...current.view},
});
function show() {
  findRoute();
  fillHead(); fillFound(); fillPicked(); fillTables(); markPicked();
  draw();
}
function draw() {
  panels.forEach(drawPanel);
  document.body.dataset.state = JSON.stringify(state());  // for tests that read the page from outside
}
const showSoon = soon(show), drawSoon = soon(draw);

// ---- control
function pick(wanted) { picked = wanted; showSoon(); }
function setEnds(start, end) { [from, to] = [start, end]; showSoon(); }
function choose(panel) {  // the map that is shown large and asked about
  if (panel === current) return;
  [current, picked, from, to] = [panel, null, null, null];
  arrange(); showSoon();
}
function clicked(panel, x, y) {
  const found = hit(panel, x, y);
  choose(panel);
  picked = found;
  if (found?.kind === "node") [from, to] = from === null || to !== null ? [found.id, null] : [from, found.id];
  showSoon();
}
function hinted(panel, found) {
  if (!found) return "";
  const item = itemOf(panel, found), why = panel !== current || use.wrong ? [] : found.kind === "node" ? use.barriers.get(item.id) ?? [] : refusedOf(item);
  const told = why.length ? `\n${found.kind === "node" ? "not to be passed by" : "refused for"} ${use.robot.name}: ${why.join(", ")}` : "";
  return `${headOf(item, found.kind)}${found.kind === "node" ? `, ${words(item.type)}` : ""}${told}`;
}
function makePanel(panel) {
  const figure = document.createElement("figure"), box = add(figure, "div"), canvas = add(box, "canvas"), hint = add(box, "div"), caption = add(figure, "figcaption");
  box.className = "plane"; canvas.tabIndex = 0; canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `Drawing of the map ${panel.name}; all of it stands in the tables`);
  hint.className = "hint"; hint.hidden = true; hint.setAttribute("aria-hidden", "true");
  add(caption, "b", panel.name);
  const about = panel.maps.length > 1 ? `${panel.maps.join(", ")}. ${panel.note}` : panel.note;
  add(caption, "span", about, about);
  add(caption, "button", "Enlarge").addEventListener("click", () => choose(panel));
  panel.plane = makePlane(canvas, {
    view: panel.view, bounds: boundsOf(panel), centre: () => [0, 0], changed: () => drawSoon(), below: 34,
    clicked: (x, y) => clicked(panel, x, y), mayZoom: () => true,
  });
  canvas.addEventListener("pointermove", (event) => {
    const {left, top, width} = canvas.getBoundingClientRect(), x = event.clientX - left, y = event.clientY - top;
    hint.textContent = event.buttons ? "" : hinted(panel, hit(panel, x, y));
    hint.hidden = !hint.textContent;
    Object.assign(hint.style, {top: `${y + 16}px`, left: x < width / 2 ? `${x + 12}px` : "auto", right: x < width / 2 ? "auto" : `${width - x + 12}px`});
  });
  canvas.addEventListener("pointerleave", () => { hint.hidden = true; });
  panel.figure = figure;
}
function arrange() {
  $("large").replaceChildren(current.figure);
  $("apart").replaceChildren(...panels.filter((panel) => panel !== current).map((panel) => panel.figure));
  current.view.kind = "whole";
  $("which").value = String(current.index);
  for (const id of ["from", "to"]) {
    $(id).replaceChildren();
    add($(id), "option", "\u2013").value = "";
    if (id === "to") add($(id), "option", "nearest un-searched").value = UNSEARCHED;
    for (const node of [...current.nodes].sort((a, b) => a.id - b.id)) add($(id), "option", `${nodeWords(node)}, ${words(node.type)}`).value = String(node.id);
  }
}
function fillKey() {  // what marks mean, as they are drawn
  $("key").replaceChildren();
  const put = (words, paint) => {
    const item = add($("key"), "span"), canvas = add(item, "canvas"), pen = canvas.getContext("2d"), ratio = window.devicePixelRatio || 1;
    canvas.setAttribute("aria-hidden", "true"); canvas.width = canvas.height = 26 * ratio; pen.scale(ratio, ratio);
    const stroke = (colour, thickness) => { pen.strokeStyle = colour; pen.lineWidth = thickness; pen.stroke(); };
    paint({pen, stroke}); item.append(words);
  };
  for (const type of Object.keys(GLYPH)) put(words(type), ({pen, stroke}) => { traceMark(pen, type, 13, 13); pen.fillStyle = ink.card; pen.fill(); stroke(ink.ink, 2.2); });
  put("refused", (plane) => drawCross(plane, 13, 13, false)); put("blocked", (plane) => drawCross(plane, 13, 13, true));
  put("not to be passed", ({pen, stroke}) => { pen.beginPath(); pen.arc(13, 13, 10, 0, 2 * Math.PI); pen.setLineDash([4, 3]); stroke(ink.chosen, 2.2); });
  put("victim", (plane) => drawBadge(plane, 13, 13, "V", VICTIM)); put("operator helped", (plane) => drawBadge(plane, 13, 13, "H", HELP));
  put("radio: 4 bars from \u221260 dBm, 3 from \u221270, 2 from \u221280", (plane) => drawBars(plane, 5, 20, {bars: 4, colour: "free"}));
}
data.robots.forEach((robot, i) => { add($("robot"), "option", robot.name).value = String(i); });
add($("robot"), "option", "own measures").value = OWN;
const least = data.robots[0] ?? {width_m: 0.39, max_step_m: 0.1, max_slope_deg: 10};
[["own-width", "width_m"], ["own-step", "max_step_m"], ["own-slope", "max_slope_deg"]].forEach(([id, key]) => { $(id).value = String(least[key]); $(id).addEventListener("input", () => showSoon()); });
for (const panel of panels) { add($("which"), "option", panel.name).value = String(panel.index); makePanel(panel); }
$("whichbox").hidden = panels.length < 2;
$("which").addEventListener("change", () => choose(panels[Number($("which").value)]));
for (const id of ["robot", "known"]) $(id).addEventListener("change", () => showSoon());
const chosen = (id) => $(id).value === "" ? null : $(id).value === UNSEARCHED ? UNSEARCHED : Number($(id).value);
for (const id of ["from", "to"]) $(id).addEventListener("change", () => setEnds(chosen("from"), chosen("to")));
$("clear").addEventListener("click", () => setEnds(null, null));
const zoomKeys = makeZoom((kind) => current.plane.look(kind), (factor) => current.plane.zoom(factor));
const pan = (u, v) => { const {view} = current; view.kind = "free"; view.x += u * 60 / view.scale; view.y += v * 60 / view.scale; drawSoon(); };
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.("select, input:not([type=checkbox])")) return;
  const arrows = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[event.key];
  const action = arrows ? event.target.tagName === "CANVAS" && (() => pan(...arrows)) : {
    ...zoomKeys, Escape: () => { picked = null; setEnds(null, null); },
  }[event.key];
  if (action) { event.preventDefault(); action(); }
});
const dressLayers = makeLayers(LAYERS, shown, () => showSoon());
arrange();
findRoute();
const resized = new ResizeObserver(() => drawSoon());
for (const panel of panels) resized.observe(panel.plane.pen.canvas);
themes(() => { dressLayers(); fillKey(); tablesKey = ""; showSoon(); });
window.station = {
  state, setEnds, choose: (index) => choose(panels[index]),
  at: (kind, id) => {  // where a node or link is drawn, in pixels of the window
    const item = itemOf(current, {kind, id}), [x, y] = kind === "node" ? [item.x_m, item.y_m] : shapeOf(current, item).middle;
    const {left, top} = current.plane.pen.canvas.getBoundingClientRect();
    return [left + current.plane.sx(x), top + current.plane.sy(y)];
  },
};
