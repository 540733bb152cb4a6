"""Runs that write Behavioral Trace Maps, and the maps themselves, as tables of text."""

import collections
from typing import Any

from jexplore.report.tables import aligned_table
from jexplore.tracemap.record import BtmMap

NOTED = {
    "contacts": "steps refused because of a wall",
    "refused": "steps refused because of the ground",
    "interventions": "interventions of the operator",
    "overflow": "warning: nodes and links that did not fit",
    "scan_overflow": "warning: ends of walls that did not fit into a scan's points",
}
LEFT = ("angles deg", "type", "obstacle", "status")  # columns of text


def share(hits: int, n: int) -> str:
    """`"99.2 % [98.4, 99.6]"`: a share with its 95 % Wilson interval."""
    from scipy.stats import binomtest

    low, high = binomtest(hits, n).proportion_ci(method="wilson")
    return f"{100 * hits / n:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


def summary(traced: Any, most: int = 10) -> list[str]:
    """What the command prints of many runs: lines of text."""
    table, lines = traced.table, []
    if not len(table):
        return ["no run was finished"]
    outcomes = collections.Counter(table["outcome"])
    lines.append("outcomes: " + ", ".join(f"{name} {count}" for name, count in outcomes.most_common()))
    alike = collections.Counter(table["code"]).most_common(1)[0][1]
    if len(table) > 1:
        lines.append(f"exactly the same map: {share(alike, len(table))} of {len(table)} runs")
    if traced.truth is not None and len(table) > 1:
        lines.append(f"that of the true topology: {share(int(table['true'].sum()), len(table))}")
    elif traced.truth is not None:
        lines.append(f"the true topology: {'yes' if table['true'][0] else 'no'}")
    for name, what in NOTED.items():
        if table[name].sum():
            lines.append(f"{what}: {table[name].sum()} in {(table[name] > 0).sum()} of the runs")
    if table["run"].iloc[0] == 0 and table["helped_at"].iloc[0]:
        lines.append(f"the operator helped run 0 at {table['helped_at'].iloc[0]}")
    if traced.plan.settings > 1:
        lines += ["", *_settings_table(traced, most)]
    return lines


def _settings_table(traced, most):
    """The settings of a sweep, the best first."""
    groups = [rows for _, rows in traced.table.groupby("setting")]
    right = "true" if traced.truth is not None else "code"
    if traced.truth is None:  # without a truth, alike is all that can be said
        groups.sort(key=lambda rows: -rows["code"].value_counts().iloc[0] / len(rows))
    else:
        groups.sort(key=lambda rows: -rows["true"].mean())
    lines = []
    for rows in groups[:most]:
        hits = int(rows["true"].sum()) if right == "true" else int(rows["code"].value_counts().iloc[0])
        values = [f"{rows[name].iloc[0]:.4g}" for name in traced.plan.swept]
        lines.append([*values, str(len(rows)), share(hits, len(rows)), f"{rows['nodes'].mean():.1f}"])
    head = [*traced.plan.swept, "runs", "true map" if right == "true" else "alike", "nodes"]
    text = aligned_table(head, lines, left=LEFT)
    more = [f"(the best {most} of {len(groups)} settings)"] if len(groups) > most else []
    return [text, *more]


def _cell(value, digits):
    if value is None:
        return "–"
    return f"{value:.{digits}f}" if isinstance(value, float) else str(value)


def tables(found: BtmMap) -> str:
    """The node and link tables of a map as Markdown (Mano et al., Tables I and II)."""
    head = ["node", "x m", "y m", "links", "angles deg", "type", "obstacle", "inclination deg", "step m", "posture deg"]
    lines = []
    for node in found.nodes:
        angles = found.angles_deg(node.id)
        cells = [str(node.id), _cell(node.x_m, 2), _cell(node.y_m, 2), str(len(angles))]
        cells += [" ".join(f"{a:.0f}" for a in angles) or "–", node.type, _cell(node.obstacle, 0)]
        cells += [_cell(node.inclination_deg, 1), _cell(node.step_m, 3), _cell(node.posture_deg, 1)]
        lines.append(cells)
    nodes = aligned_table(head, lines, left=LEFT)
    head = ["link", "from", "to", "status", "length m", "min width m", "step m", "posture deg", "roll deg"]
    head += ["bearing deg", "opening m"]
    lines = []
    for link in found.links:
        cells = [str(link.id), str(link.start), "–" if link.end < 0 else str(link.end), link.status]
        cells += [_cell(link.length_m, 2), _cell(link.min_width_m, 2), _cell(link.max_step_m, 3)]
        cells += [_cell(link.posture_deg, 1), _cell(link.max_roll_deg, 1)]
        cells += [_cell(link.start_bearing_deg, 0), _cell(link.opening_m, 2)]
        lines.append(cells)
    return nodes + "\n" + aligned_table(head, lines, left=LEFT)
