// What a robot may use of a map, and its shortest way: the rules of tracemap/passable.py and studies/traces/routes.py once
// more. Nothing here knows the page.
//
// A map: nodes, links (in the order of their ids), ends (Map of node -> its ends of links), and byNode, byLink: Map of id ->
// item. Measures that are not known are null. Of a link step_m and inclination_deg are those that count, length_mm is whole, metres its length, called its name in
// a sentence, unknown and doubts texts, blocks by whom it could not be passed: words, and width_m, max_step_m, max_slope_deg of
// the robot that could not, null if not known; of a node unknown. A robot: name, width_m, max_step_m, max_slope_deg.
const NOWHERE = -1, SLACK = 1e-6, SAME_DEG = 1e-6;

function makeMap({nodes, links}) {
  links = [...links].sort((a, b) => a.id - b.id);
  const ends = new Map(nodes.map((node) => [node.id, []]));  // of links at a node: [link, whether its first end, bearing]
  for (const link of links) {
    ends.get(link.start).push([link, true, link.start_bearing_deg]);
    if (link.end !== NOWHERE) ends.get(link.end).push([link, false, link.end_bearing_deg]);
  }
  return {nodes, links, ends, byNode: new Map(nodes.map((node) => [node.id, node])), byLink: new Map(links.map((link) => [link.id, link]))};
}

// ---- numbers in sentences, to the same digits as Python's "g": halves go to the even digit
function general(value, digits) {
  if (value === 0) return "0";
  const [head, tail] = Math.abs(value).toExponential(60).split("e"), all = head.replace(".", "");
  const isTie = /^50*$/.test(all.slice(digits)) && Number(all[digits - 1]) % 2 === 0;
  const [mantissa, power] = isTie ? [all.slice(0, digits), tail] : Math.abs(value).toExponential(digits - 1).split("e");
  const figures = mantissa.replace(".", "").replace(/0+$/, "") || "0", exponent = Number(power), sign = value < 0 ? "-" : "";
  if (exponent < -4 || exponent >= digits) {
    const tens = String(Math.abs(exponent)).padStart(2, "0");
    return `${sign}${figures[0]}${figures.length > 1 ? `.${figures.slice(1)}` : ""}e${exponent < 0 ? "-" : "+"}${tens}`;
  }
  if (exponent < 0) return `${sign}0.${"0".repeat(-exponent - 1)}${figures}`;
  const whole = figures.slice(0, exponent + 1).padEnd(exponent + 1, "0"), part = figures.slice(exponent + 1);
  return `${sign}${whole}${part && `.${part}`}`;
}
function told(value, limit, sign, unit) {  // with as many digits as it takes to tell them apart, three or more
  for (let digits = 3; ; digits++) {
    const [left, right] = [general(value, digits), general(limit, digits)];
    if (left !== right || digits === 17) return `${left} ${unit} ${sign} ${right} ${unit}`;
  }
}

// ---- refusals: all reasons, none if it may
const above = (name, value, limit, unit) => value === null || value <= limit * (1 + SLACK) ? null : `${name} ${told(value, limit, ">", unit)}`;
const below = (name, value, limit) => value === null || value >= limit * (1 - SLACK) ? null : `${name} ${told(value, limit, "<", "m")}`;
const reasons = (found) => [...new Set(found.filter((reason) => reason !== null))];
function hindrances(node, robot) {
  return reasons([above("step", node.step_m, robot.max_step_m, "m"), above("inclination", node.inclination_deg, robot.max_slope_deg, "deg")]);
}
function holdsFor(block, robot) {  // all but those that are narrower or climb more than the one that could not pass
  if (block.width_m === null) return true;
  const climbsMore = (name) => robot[name] > block[name] * (1 + SLACK);
  return !(robot.width_m < block.width_m * (1 - SLACK) || climbsMore("max_step_m") || climbsMore("max_slope_deg"));
}
function refusals(link, map, robot) {
  const steep = robot.max_slope_deg;
  return reasons([
    below("width", link.min_width_m, robot.width_m), below("opening", link.opening_m, robot.width_m),
    above("step", link.step_m, robot.max_step_m, "m"), above("inclination", link.inclination_deg, steep, "deg"),
    above("roll", link.max_roll_deg, steep, "deg"), ...link.blocks.filter((block) => holdsFor(block, robot)).map((block) => block.words),
    ...(link.end === NOWHERE ? hindrances(map.byNode.get(link.start), robot) : []),
  ]);
}
// What a robot may use: {robot, refused, barriers}, Maps of id -> reasons.
function useOf(map, robot, knownOnly) {
  const refused = new Map(), barriers = new Map();
  for (const link of map.links) {
    const missing = link.end === NOWHERE ? map.byNode.get(link.start).unknown : link.unknown;
    const all = reasons([...refusals(link, map, robot), ...(knownOnly ? missing : [])]);
    if (all.length) refused.set(link.id, all);
  }
  for (const node of [...map.nodes].sort((a, b) => a.id - b.id)) {
    const all = [...hindrances(node, robot), ...(knownOnly ? node.unknown : [])];
    if (all.length) barriers.set(node.id, all);
  }
  return {robot, refused, barriers};
}

// ---- the shortest way, in whole millimetres; of equal ones that of the fewest links, then of the lowest ids in order
const otherEnd = (link, node) => link.start === node ? link.end : link.start;
function shortest(map, use, targets) {
  const left = new Map(map.nodes.map((node) => [node.id, [Infinity, Infinity]])), heap = [];  // of [mm, hops, node]
  const isLess = ([mm, hops], [others, more]) => mm < others || mm === others && hops < more;
  const put = (way) => {
    let at = heap.push(way) - 1;
    for (let up; at && isLess(way, heap[up = (at - 1) >> 1]); at = up) heap[at] = heap[up];
    heap[at] = way;
  };
  const take = () => {
    const top = heap[0], last = heap.pop();
    for (let at = 0, next; heap.length; at = next) {
      next = 2 * at + 1;
      if (next + 1 < heap.length && isLess(heap[next + 1], heap[next])) next++;
      if (next >= heap.length || !isLess(heap[next], last)) { heap[at] = last; break; }
      heap[at] = heap[next];
    }
    return top;
  };
  const usable = map.links.filter((link) => link.end !== NOWHERE && !use.refused.has(link.id));
  const around = new Map(map.nodes.map((node) => [node.id, []]));
  for (const link of usable) for (const end of new Set([link.start, link.end])) around.get(end).push(link);
  const ends = (node) => use.barriers.has(node) && !targets.has(node);  // a way may begin there, not lead on
  for (const target of targets) { left.set(target, [0, 0]); put([0, 0, target]); }
  while (heap.length) {
    const [mm, hops, here] = take();
    if (isLess(left.get(here), [mm, hops]) || ends(here)) continue;
    for (const link of around.get(here)) {
      const there = otherEnd(link, here), way = [mm + link.length_mm, hops + 1];
      if (isLess(way, left.get(there))) { left.set(there, way); put([...way, there]); }
    }
  }
  const first = (node) => {  // the link by which the best way leaves a node
    const [mm, hops] = left.get(node);
    return around.get(node).find((link) => {
      const beyond = otherEnd(link, node), [rest, more] = left.get(beyond);
      return !ends(beyond) && rest + link.length_mm === mm && more + 1 === hops;
    });
  };
  return {isReached: (node) => left.get(node)[0] < Infinity, next: (node) => targets.has(node) ? null : first(node)};
}
// Which way out of a node a link is, of how many, and its angle; `leaves`, `came`: [link, whether by its first end].
function counted(map, node, leaves, came) {
  const ends = map.ends.get(node);
  const isSame = (a, b) => a[0].id === b[0].id && a[1] === b[1];
  if (!came) return {way: null, ways: ends.length, turn_deg: null};
  const back = ends.find((end) => isSame(end, came))[2], others = ends.filter((end) => !isSame(end, came));
  if (isSame(leaves, came)) return {way: others.length + 1, ways: others.length, turn_deg: 360};
  const angle = (end) => { const turned = modulo(end[2] - back); return turned <= SAME_DEG ? 360 : turned; };
  others.sort((a, b) => angle(a) - angle(b) || a[0].id - b[0].id || Number(b[1]) - Number(a[1]));
  const at = others.findIndex((end) => isSame(end, leaves));
  return {way: at + 1, ways: others.length, turn_deg: angle(others[at])};
}
const modulo = (degrees) => ((degrees % 360) + 360) % 360;
function stepsAlong(map, nodes, links) {
  let came = null;
  return links.map((link, i) => {
    const forward = link.start === nodes[i], leaves = [link, forward];
    const bearing_deg = modulo(forward ? link.start_bearing_deg : link.end_bearing_deg);
    const step = {link: link.id, start: nodes[i], end: nodes[i + 1], bearing_deg, ...counted(map, nodes[i], leaves, came)};
    came = [link, !forward];
    return step;
  });
}

// ---- a route from node to node, or to the nearest un-searched link where `end` is null
function routeOf(map, use, start, end) {
  const stubs = map.links.filter((link) => link.end === NOWHERE && !use.refused.has(link.id));
  const ways = shortest(map, use, new Set(end === null ? stubs.map((link) => link.start) : [end]));
  const refused = [...use.refused].filter(([id]) => end === null || map.byLink.get(id).end !== NOWHERE), barriers = [...use.barriers];
  const about = {start, refused, barriers};
  if (!ways.isReached(start)) return {...about, found: false, end, nodes: [], links: [], steps: [], onward: null, unknown: [], trouble: troubleOf(map, use, start, end)};
  const nodes = [start], links = [];
  for (let link = ways.next(start); link; link = ways.next(nodes[nodes.length - 1])) {
    nodes.push(otherEnd(link, nodes[nodes.length - 1]));
    links.push(link);
  }
  const last = nodes[nodes.length - 1], stub = end === null ? stubs.find((link) => link.start === last) : null;
  const steps = stepsAlong(map, stub ? [...nodes, NOWHERE] : nodes, stub ? [...links, stub] : links), onward = stub ? steps.pop() : null;
  const passed = stub ? nodes.slice(1) : nodes.slice(1, -1), unknown = [];
  for (const link of stub ? [...links, stub] : links) if (link.doubts.length) unknown.push(`${link.called}: ${link.doubts.join(", ")}`);
  for (const node of passed) if (map.byNode.get(node).unknown.length) unknown.push(`node ${node}: ${map.byNode.get(node).unknown.join(", ")}`);
  const length_m = links.reduce((sum, link) => sum + link.metres, 0);
  return {...about, found: true, end: last, nodes, links: links.map((link) => link.id), steps, onward, length_m, unknown, trouble: ""};
}
function troubleOf(map, use, start, end) {
  const around = new Map(map.nodes.map((node) => [node.id, []])), known = new Set([start]);
  for (const link of map.links) if (link.end !== NOWHERE) { around.get(link.start).push(link.end); around.get(link.end).push(link.start); }
  for (const here of known) for (const there of around.get(here)) known.add(there);  // a set goes on with what is added
  const name = use.robot.name, stubs = map.links.filter((link) => link.end === NOWHERE);
  if (end !== null) return known.has(end) ? `${name} cannot get from node ${start} to node ${end}` : `nodes ${start} and ${end} lie in parts of the map that no link joins`;
  if (!stubs.length) return "the map has no un-searched link";
  if (!stubs.some((link) => known.has(link.start))) return `node ${start} and the un-searched links lie in parts of the map that no link joins`;
  return `${name} can get from node ${start} to no un-searched link`;
}
