"""Runs that write Behavioral Trace Maps, and the maps themselves, as tables of text."""

import collections
from typing import Any

from jexplore.report.tables import aligned_table
from jexplore.tracemap.passable import link_name
from jexplore.tracemap.record import NOWHERE, BtmMap
from jexplore.tracemap.route import Route

NOTED = {
    "contacts": "steps refused because of a wall",
    "refused": "steps refused because of the ground",
    "interventions": "interventions of the operator",
    "mistaken": "places taken for a node that truly lies elsewhere",
    "overflow": "warning: nodes and links that did not fit",
    "scan_overflow": "ends of walls beyond 16 in one scan, no fault; with a local map points without room, a fault",
}
LEFT = ("angles deg", "type", "obstacle", "status")  # columns of text


def share(hits: int, n: int) -> str:
    """Format a share with its 95 % Wilson interval: `"99.2 % [98.4, 99.6]"`."""
    from scipy.stats import binomtest

    low, high = binomtest(hits, n).proportion_ci(method="wilson")
    return f"{100 * hits / n:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


def summary(traced: Any, most: int = 10) -> list[str]:
    """Return the summary that the command prints of many runs: lines of text."""
    table, lines = traced.table, []
    if not len(table):
        return ["no run was finished"]
    outcomes = collections.Counter(table["outcome"])
    lines.append("outcomes: " + ", ".join(f"{name} {count}" for name, count in outcomes.most_common()))
    alike = collections.Counter(table["code"]).most_common(1)[0][1]
    if len(table) > 1:
        lines.append(f"exactly the same map: {share(alike, len(table))} of {len(table)} runs")
    known = table["true"].dropna()
    if len(known) and len(table) > 1:
        of = "" if len(known) == len(table) else f" of {len(known)} runs that began on a link"
        lines.append(f"that of the true topology: {share(int(known.sum()), len(known))}{of}")
    elif len(known):
        lines.append(f"the true topology: {'yes' if known.iloc[0] else 'no'}")
    for name, what in NOTED.items():
        if table[name].sum():
            lines.append(f"{what}: {table[name].sum()} in {(table[name] > 0).sum()} of the runs")
    if traced.plan.settings > 1:
        lines += ["", *_settings_table(traced, most)]
    return lines


def _settings_table(traced, most):
    """Tabulate the settings of a sweep, the best first."""
    groups = [rows for _, rows in traced.table.groupby("setting")]
    has_truth = all(rows["true"].count() for rows in groups)

    def hits_of(rows):  # without a truth, alike is all that can be said
        known = rows["true"].dropna()
        return (int(known.sum()), len(known)) if has_truth else (int(rows["code"].value_counts().iloc[0]), len(rows))

    groups.sort(key=lambda rows: -hits_of(rows)[0] / hits_of(rows)[1])
    lines = []
    for rows in groups[:most]:
        values = [f"{rows[name].iloc[0]:.4g}" for name in traced.plan.swept]
        lines.append([*values, str(len(rows)), share(*hits_of(rows)), f"{rows['nodes'].mean():.1f}"])
    head = [*traced.plan.swept, "runs", "true map" if has_truth else "alike", "nodes"]
    text = aligned_table(head, lines, left=LEFT)
    more = [f"(the best {most} of {len(groups)} settings)"] if len(groups) > most else []
    return [text, *more]


def _cells(item, **digits):
    """Return the texts of measures by their numbers of digits."""
    values = [(getattr(item, name), n) for name, n in digits.items()]
    return ["–" if value is None else f"{value:.{n}f}" for value, n in values]


def map_tables(found: BtmMap) -> str:
    """Format the node and link tables of a map as Markdown (Mano et al., Tables I and II)."""
    head = ["node", "x m", "y m", "links", "angles deg", "type", "obstacle", "inclination deg", "step m", "posture deg"]
    lines = []
    for node in found.nodes:
        angles = found.angles_deg(node.id)
        cells = [str(node.id), *_cells(node, x_m=2, y_m=2), str(len(angles)), " ".join(f"{a:.0f}" for a in angles)]
        cells += [node.type, node.obstacle or "–", *_cells(node, inclination_deg=1, step_m=3, posture_deg=1)]
        lines.append([cell or "–" for cell in cells])
    nodes = aligned_table(head, lines, left=LEFT)
    head = ["link", "from", "to", "status", "length m", "min width m", "step m", "posture deg", "roll deg"]
    head += ["bearing deg", "opening m"]
    lines = []
    for link in found.links:
        cells = [str(link.id), str(link.start), "–" if link.end < 0 else str(link.end), link.status]
        cells += _cells(link, length_m=2, min_width_m=2, max_step_m=3, posture_deg=1, max_roll_deg=1)
        lines.append([*cells, str(round(link.start_bearing_deg) % 360), *_cells(link, opening_m=2)])
    return nodes + "\n" + aligned_table(head, lines, left=LEFT)


def route_table(route: Route) -> str:
    """Format a found route as Markdown: a row a link, an un-searched one last, and a line of the whole.

    `way` 2 of 3 is the second link counter-clockwise from the one by which one came, of the three others; `turn` the
    angle between them: 180 degrees is straight on, less to the right.
    """
    head = ["step", "link", "from", "to", "length m", "way", "turn deg", "bearing deg", "width m", "step m"]
    head += ["posture deg", "roll deg"]
    steps, lines = [*route.steps, *([] if route.onward is None else [route.onward])], []
    for number, step in enumerate(steps, 1):
        way = "–" if step.way is None else f"{step.way} of {step.ways}"
        ends = [str(step.start), "–" if step.end == NOWHERE else str(step.end)]
        cells = [str(number), str(step.link), *ends, *_cells(step, length_m=2), way, *_cells(step, turn_deg=0)]
        cells.append(str(round(step.bearing_deg) % 360))
        lines.append(cells + _cells(step, width_m=2, step_m=3, posture_deg=1, roll_deg=1))
    count = f"{len(route.links)} link" + "s" * (len(route.links) != 1)
    told = [f"{route.length_m:.2f} m over {count}"]
    for name, field, which, unit, digits in (
        ("narrowest", "width_m", min, "m", 2),
        ("highest step", "step_m", max, "m", 3),
        ("steepest", "posture_deg", max, "deg", 1),
        ("largest roll", "roll_deg", max, "deg", 1),
    ):
        values = [value for step in steps if (value := getattr(step, field)) is not None]
        told += [f"{name} {which(values):.{digits}f} {unit}"] if values else []
    table = aligned_table(head, lines, left=("way",)) + "\n" if lines else ""
    goal, last = f"node {route.end}", route.onward
    if last is not None:
        goal = f"un-searched link {last.link} of {goal}, bearing {last.bearing_deg:.0f} deg"
    return f"{table}{route.robot}, node {route.start} to {goal}: {', '.join(told)}"


def refused_lines(btm: BtmMap, route: Route) -> list[str]:
    """List the parts of a map that a robot may not use, and why: a line a link, then one for every impassable node."""
    links = {link.id: link for link in btm.links}
    lines = [f"{link_name(links[own])}: {', '.join(why)}" for own, why in route.refused]
    return [*lines, *(f"node {own}, to pass: {', '.join(why)}" for own, why in route.barriers)]
