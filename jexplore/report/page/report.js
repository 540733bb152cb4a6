// The report: replays of episodes, side by side.
const data = JSON.parse($("data").textContent);
const {replays} = data, worlds = data.worlds.map(readWorld);
const LAYERS = [
  {name: "map", text: "Known map", colour: "wall", title: "What the robot knows: free and occupied cells; unknown ones are grey"},
  {name: "truth", text: "True walls", colour: "truth", title: "The world's walls, which the robot does not know"},
  {name: "rooms", text: "True rooms", colour: "rooms", title: "The world's rooms, which the robot does not know", off: !worlds.some((world) => world.hasRooms)},
  {name: "own", text: "Own room", colour: "own", title: "What the strategy takes for the room that the robot is in, and explores first", off: !replays.some((replay) => replay.has_own_room)},
  {name: "frontier", text: "Frontier", colour: "frontier", title: "Frontier cells that can be reached"},
  {name: "path", text: "Path", colour: "path", title: "Where the robot has been, in its strategy's colour"},
  {name: "ahead", text: "Way ahead", colour: "ahead", title: "Where it goes before it chooses anew"},
  {name: "target", text: "Target", colour: "target", title: "What it goes to"},
  {name: "robot", text: "Robot", colour: "robot", title: "The robot"},
];
const shown = Object.fromEntries(LAYERS.map(({name, off}) => [name, !off && name !== "rooms"]));
const nameOf = new Set(replays.map(({which}) => which)).size > 1 ? ({strategy, which}) => `${strategy}, ${which}` : ({strategy}) => strategy;
const names = [...new Set(replays.map(nameOf))];
const colourOf = (replay) => PALETTE[names.indexOf(nameOf(replay)) % PALETTE.length];
const dashOf = (replay) => names.indexOf(nameOf(replay)) < PALETTE.length ? [] : [6, 4];
const episodes = [...new Set(replays.map(({episode}) => episode))];
let measure = "metres", world = -1, episode = episodes[0], large = -1;  // world: -1 for all; large: number of the replay that is enlarged
const time = replays.length ? makeTimeline({show, keys: $("replays"), more: {
  ...makeZoom(look, zoom), Escape: () => enlarge(-1),
}}) : null;

// ---- data
function sheet([height, width]) {  // a picture of cells, row 0 first
  const picture = document.createElement("canvas");
  Object.assign(picture, {width, height});
  const context = picture.getContext("2d"), image = context.createImageData(width, height);
  return {picture, pixels: new Uint32Array(image.data.buffer), put: () => context.putImageData(image, 0, 0)};
}
function readWorld({name, shape, cell_m, truth, rooms}) {
  const codesOf = (packed) => {
    const codes = new Uint8Array(shape[0] * shape[1]), bytes = bytesOf(packed);
    eachRun(bytes, 0, bytes.length, (from, to, code) => codes.fill(code, from, to));
    return codes;
  };
  return {
    name, shape, cell_m, truth: {codes: codesOf(truth), ...sheet(shape)}, hasRooms: rooms !== null,
    rooms: rooms === null ? new Uint8Array(shape[0] * shape[1]) : codesOf(rooms),
    view: {kind: "whole", x: 0, y: 0, scale: 0}, bounds: [0, 0, shape[1] * cell_m, shape[0] * cell_m],
  };
}
function readWay(robot, cell_m) {  // of one robot
  const moves = bytesOf(robot.moves), n = moves.length;
  const [steps, heading, target] = ["steps", "heading_deg", "target"].map((name) => unpack(robot[name]));
  const x = new Float64Array(n + 1), y = new Float64Array(n + 1), metres = new Float64Array(n + 1);
  let [row, col] = robot.start;
  for (let i = 0; i <= n; i++) {
    if (i) {
      const up = Math.floor(moves[i - 1] / 3) - 1, right = moves[i - 1] % 3 - 1;
      row += up; col += right;
      metres[i] = metres[i - 1] + (up && right ? Math.SQRT2 : 1) * cell_m;
    }
    x[i] = (col + 0.5) * cell_m; y[i] = (row + 0.5) * cell_m;
  }
  return {x, y, metres, n, steps, heading, target};
}
function readReplay(replay) {
  const own = worlds[replay.world], {cell_m} = own, way = readWay(replay, cell_m), {metres, steps} = way;
  const [until, known, sizes] = ["until", "known_m2", "sizes"].map((name) => unpack(replay[name]));
  const clock = replay.clock_m && unpack(replay.clock_m);  // of a team
  const offsets = new Float64Array(sizes.length + 1);
  sizes.forEach((size, i) => { offsets[i + 1] = offsets[i] + size; });
  return {
    ...replay, own, ...way, until, known, offsets, bytes: bytesOf(replay.changes), clock,
    others: replay.others.map((other) => readWay(other, cell_m)),
    at: {metres: clock ?? steps.map((step) => metres[step]), steps: clock ? clock.map((at) => Math.round(at / cell_m)) : steps}, codes: new Uint8Array(own.shape[0] * own.shape[1]), ...sheet(own.shape),
    frame: -1, fresh: false,
  };
}
// The map of a frame: what changed since the one before; to go back is to begin anew, which is as fast.
function turnTo(replay, frame) {
  const {codes, bytes, offsets} = replay;
  if (frame < replay.frame) { codes.fill(0); paint(replay); replay.frame = -1; replay.fresh = true; }
  while (replay.frame < frame) {
    replay.frame++;
    eachRun(bytes, offsets[replay.frame], offsets[replay.frame + 1], (from, to, code) => {
      codes.fill(code, from, to); paint(replay, from, to); replay.fresh = true;
    });
  }
  if (replay.fresh) { replay.put(); replay.fresh = false; }
}
const tiles = replays.map(readReplay);
function frameAt(replay, position) {  // the last frame that is not beyond it
  const at = replay.at[measure];
  let low = 0, high = at.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (at[middle] <= position + 1e-9) low = middle; else high = middle - 1;
  }
  return low;
}

// ---- colours of cells, 0xAABBGGRR as a picture's bytes lie in memory
function rgba(colour, alpha = 1) {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return ((Math.round(255 * alpha) << 24) | (b << 16) | (g << 8) | r) >>> 0;
}
function mixed(colour, other, share) {
  const part = (at) => Math.round(parseInt(colour.slice(at, at + 2), 16) * (1 - share) + parseInt(other.slice(at, at + 2), 16) * share);
  return `#${[1, 3, 5].map((at) => part(at).toString(16).padStart(2, "0")).join("")}`;
}
const stripes = (list) => `linear-gradient(90deg, ${list.map((colour, i) => `${colour} ${100 * i / list.length}% ${100 * (i + 1) / list.length}%`).join(", ")})`;
const colours = new Uint32Array(256);  // of a cell's code + 16 * its room's
function paint({own, codes, pixels}, from = 0, to = codes.length) {
  for (let i = from; i < to; i++) pixels[i] = colours[codes[i] | own.rooms[i] << 4];
}
function paintAll() {
  const states = [ink.unknown, ink.floor, ink.wall, ink.wall];
  for (let code = 0; code < 256; code++) {
    let colour = shown.map ? states[code & 3] : ink.floor;
    if (shown.rooms && code > 15) colour = mixed(colour, PALETTE[(code >> 4) % 7], 0.3);
    if (shown.own && code & 8) colour = mixed(colour, ink.own, 0.45);
    colours[code] = rgba(shown.frontier && code & 4 ? ink.frontier : colour);
  }
  for (const replay of tiles) { paint(replay); replay.fresh = true; }
  const wall = rgba(ink.wall, 0.42);
  for (const {truth} of worlds) { truth.codes.forEach((code, i) => { truth.pixels[i] = code ? wall : 0; }); truth.put(); }
}

// ---- tiles
function buildTile(replay, number) {
  const figure = add($("tiles"), "figure"), caption = add(figure, "figcaption"), name = add(caption, "div");
  name.className = "name";
  const key = add(name, "i");
  key.setAttribute("aria-hidden", "true");
  const title = add(name, "span", "", `${replay.which}, episode ${replay.episode}`);
  const button = add(name, "button", "Enlarge");
  button.addEventListener("click", () => enlarge(large === number ? -1 : number));
  const now = add(caption, "div"), canvas = add(figure, "canvas", "", title.title);
  now.className = "now";
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${replay.strategy} in ${replay.own.name}, ${title.title}: the map so far and the way driven`);
  canvas.style.aspectRatio = `${replay.own.shape[1]} / ${replay.own.shape[0]}`;
  canvas.addEventListener("pointerdown", () => canvas.focus({preventScroll: true}));
  const plane = makePlane(canvas, {view: replay.own.view, bounds: replay.own.bounds, changed: showSoon, mayZoom: (event) => event.ctrlKey || large === number});
  Object.assign(replay, {figure, key, title, now, canvas, button, plane, number});
}
function drawSheet({pen, sx, sy, view}, {picture}, cell_m) {
  pen.save();
  pen.translate(sx(0), sy(0)); pen.scale(view.scale * cell_m, -view.scale * cell_m);
  pen.imageSmoothingEnabled = view.scale * cell_m * (window.devicePixelRatio || 1) < 1; pen.imageSmoothingQuality = "high";
  pen.drawImage(picture, 0, 0);
  pen.restore();
}
function drawRobot({pen, sx, sy, view}, x, y, degrees) {
  const size = Math.min(14, Math.max(8, 0.3 * view.scale)), turn = degrees * Math.PI / 180;
  pen.save();
  pen.translate(sx(x), sy(y)); pen.rotate(-turn);
  pen.beginPath();
  for (const [u, v] of [[1, 0], [-0.6, 0.6], [-0.3, 0], [-0.6, -0.6]]) pen.lineTo(u * size, v * size);
  pen.closePath(); pen.lineJoin = "round";
  pen.strokeStyle = ink.floor; pen.lineWidth = 4; pen.stroke();
  pen.fillStyle = ink.robot; pen.fill(); pen.strokeStyle = ink.ink; pen.lineWidth = 1.4; pen.stroke();
  pen.restore();
}
function drawTile(replay, position) {
  const frame = frameAt(replay, position), {plane, own, x, y, clock} = replay, step = replay.steps[frame], until = replay.until[frame];
  const robots = [replay, ...replay.others];  // of a team, each in a colour of its own
  turnTo(replay, frame);
  plane.begin();
  drawSheet(plane, replay, own.cell_m);
  if (shown.truth) drawSheet(plane, own.truth, own.cell_m);
  plane.pen.lineJoin = "round";
  if (shown.path) robots.forEach((robot, i) => {
    const colour = clock ? PALETTE[i % PALETTE.length] : colourOf(replay), end = robot.steps[frame] + 1;
    plane.path(robot.x, robot.y, 0, end); plane.stroke(ink.floor, 4.5); plane.path(robot.x, robot.y, 0, end); plane.stroke(colour, 2.2);
    plane.disc(robot.x[0], robot.y[0], 4); plane.fill(ink.floor); plane.stroke(colour, 2);
  });
  if (shown.ahead && until > step) { plane.path(x, y, step, until + 1); plane.stroke(ink.floor, 4); plane.path(x, y, step, until + 1); plane.stroke(ink.way, 2, [4, 3]); }
  for (const {target} of robots) {
    const [row, col] = [target[2 * frame], target[2 * frame + 1]];
    if (shown.target && row >= 0) plane.drawTarget((col + 0.5) * own.cell_m, (row + 0.5) * own.cell_m);
  }
  if (shown.robot) for (const robot of robots) drawRobot(plane, robot.x[robot.steps[frame]], robot.y[robot.steps[frame]], robot.heading[frame]);
  plane.drawBar(Math.min(150, plane.width / 4));
  const done = frame === replay.steps.length - 1;
  const ways = clock ? [`${clock[frame].toFixed(1)} of ${clock.at(-1).toFixed(1)} m`, `${robots.length} robots`] : done ? [`${replay.metres[step].toFixed(1)} m`, `${step} steps`] : [`${replay.metres[step].toFixed(1)} of ${replay.metres[replay.n].toFixed(1)} m`, `step ${step} of ${replay.n}`];
  replay.now.textContent = [...ways, `${replay.known[frame].toFixed(1)} m\u00b2 known`, ...(done ? [words(replay.outcome).toLowerCase()] : [])].join(" \u00b7 ");
}
const isChosen = (replay) => replay.episode === episode && (world < 0 || replay.world === world);
const inSight = () => tiles.filter((replay) => isChosen(replay) && (large < 0 || replay.number === large));
const inWorld = () => tiles.filter(isChosen);

// ---- the timeline
const position = () => time.times[time.frame];
function retime() {  // by the frames of the longest
  const [first, ...others] = inWorld();
  if (!first) return time.setTimes([0]);  // no replay of this episode in this world
  const times = others.reduce((a, b) => b.at[measure].at(-1) > a.at[measure].at(-1) ? b : a, first).at[measure];
  return time.setTimes(times, times.at(-1) / 30 || 1);
}
const drawKnown = time && makeStrip($("known"), time, (c, w, h, along) => {
  const some = inWorld(), most = Math.max(...some.map((replay) => replay.known.at(-1)), 1e-9), y = (value) => h - 16 - value / most * (h - 24);
  c.font = "11px system-ui, sans-serif"; c.fillStyle = ink.soft; c.textBaseline = "bottom";
  c.fillStyle = ink.line; c.fillRect(PAD, y(0), w - 2 * PAD, 1); c.fillRect(PAD, y(most), w - 2 * PAD, 1);
  c.fillStyle = ink.soft; c.textAlign = "left"; c.fillText("0", PAD, h - 1);
  c.textAlign = "right"; c.fillText(measure === "metres" ? `${time.times.at(-1).toFixed(0)} m driven` : `${time.times.at(-1)} steps`, w - PAD, h - 1);
  c.textBaseline = "top"; c.textAlign = "left"; c.fillText(`${most.toFixed(0)} m\u00b2 known`, PAD + 2, y(most) + 2);
  for (const replay of some) {
    c.beginPath();
    for (let i = 0; i < time.frames; i++) c.lineTo(along(i), y(replay.known[frameAt(replay, time.times[i])]));
    c.strokeStyle = colourOf(replay); c.lineWidth = 1.8; c.lineJoin = "round"; c.setLineDash(dashOf(replay)); c.stroke(); c.setLineDash([]);
  }
});
const where = () => measure === "metres" ? `${position().toFixed(1)} of ${time.times.at(-1).toFixed(1)} m` : `step ${position()} of ${time.times.at(-1)}`;
let spoken = "";
function show() {
  for (const replay of inSight()) drawTile(replay, position());
  drawKnown([world, episode, measure].join());
  $("clock").textContent = where();
  $("seek").setAttribute("aria-valuetext", where());
  if (!time.playing && spoken !== where()) $("spoken").textContent = spoken = where();
  $("whole").setAttribute("aria-pressed", String(inSight().every((replay) => replay.own.view.kind === "whole")));
  document.body.dataset.state = JSON.stringify(state());  // for tests that read the page from outside
}
const showSoon = soon(show);
const state = () => ({
  frame: time.frame, frames: time.frames, position: position(), playing: time.playing, speed: time.speed, measure, world, episode, large, layers: {...shown},
  tiles: inSight().map((replay) => ({strategy: replay.strategy, world: replay.own.name, frame: replay.frame, step: replay.steps[replay.frame], view: {...replay.own.view}})),
});

// ---- control
function enlarge(number) {
  large = number;
  $("tiles").classList.toggle("large", large >= 0);
  arrange();
}
function arrange() {
  for (const replay of tiles) {
    const isLarge = replay.number === large;
    replay.title.textContent = world < 0 && worlds.length > 1 ? `${nameOf(replay)} in ${replay.own.name}` : nameOf(replay);
    replay.figure.hidden = !isChosen(replay);
    replay.figure.classList.toggle("large", isLarge);
    replay.button.setAttribute("aria-pressed", String(isLarge));
    replay.button.textContent = isLarge ? "Side by side" : "Enlarge";
    replay.canvas.style.maxHeight = isLarge ? "max(300px, 100vh - 340px)" : "";
  }
  showSoon();
}
function look() { for (const own of worlds) own.view.kind = "whole"; showSoon(); }
function zoom(factor) {  // once for each view, by the first tile that has it
  const seen = new Set();
  for (const {own, plane} of inSight()) if (!seen.has(own)) { seen.add(own); plane.zoom(factor); }
}
function start() {
  tiles.forEach(buildTile);
  add($("world"), "option", "all").value = -1;
  worlds.forEach((own, i) => { add($("world"), "option", own.name).value = i; });
  const many = worlds.length > 1 && names.length > 1;  // strategies side by side in one world; or one strategy in all
  world = many ? 0 : -1;
  $("world").value = world;
  $("worldbox").hidden = worlds.length < 2;
  for (const number of episodes) add($("episode"), "option", number).value = number;
  $("episodebox").hidden = episodes.length < 2;
  const choose = () => { world = Number($("world").value); episode = Number($("episode").value); large = -1; $("tiles").classList.remove("large"); arrange(); retime(); };
  for (const id of ["world", "episode"]) $(id).addEventListener("change", choose);
  $("measure").addEventListener("change", () => { measure = $("measure").value; retime(); });
  const changed = () => { paintAll(); showSoon(); };
  const dressLayers = makeLayers(LAYERS, shown, changed, {
    truth: () => ({background: mixed(ink.unknown, ink.wall, 0.42)}), path: () => ({background: stripes(names.slice(0, PALETTE.length).map((_, i) => PALETTE[i])), height: "4px"}),
    ahead: () => ({borderTop: `2px dashed ${ink.way}`, height: "0"}), wall: () => ({background: `linear-gradient(90deg, ${ink.unknown} 34%, ${ink.floor} 34% 67%, ${ink.wall} 67%)`, outline: `1px solid ${ink.line}`}),
    rooms: () => ({background: stripes([1, 2, 3].map((i) => `${PALETTE[i]}66`))}),
  });
  themes(() => {
    dressLayers(); paintAll();
    for (const replay of tiles) replay.key.style.background = colourOf(replay);
    showSoon();
  });
  new ResizeObserver(showSoon).observe($("tiles"));
  window.addEventListener("resize", showSoon);
  window.replay = {seek: time.seek, play: time.play, pause: time.pause, setSpeed: time.setSpeed, state, codes: (number) => [...tiles[number].codes]};
  arrange(); retime();
  if (time.fromHash()) $("replays").scrollIntoView();
}
if (replays.length) start(); else themes(() => {});
