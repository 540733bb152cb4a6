"""Teams of robots of the command `jexplore trace`."""

import collections
from typing import Any

from jexplore.cli.options import fields_of
from jexplore.cli.output.console import Out, note_if_slow, working
from jexplore.report.tables import aligned_table, number_text


def trace_robots(out: Out, options: Any) -> int:
    """Run a team of trace robots, and write their maps, the merged ones, tables, a picture and the station's page.

    `options` are those of `jexplore trace`.
    """
    from jexplore.engine.backend import use_compilation_cache
    from jexplore.studies.traces.teams.clock import run_robots
    from jexplore.studies.traces.teams.team import merge_team, prepare_team, read_reach
    from jexplore.tracemap import json_form

    read_reach(options.contact)
    own = fields_of(options, "robot seed tuning start cell_m max_steps nodes links perception")
    starts = options.team_starts[0] if len(options.team_starts) == 1 else options.team_starts
    own |= {"noise": options.own_noise, "attributes": options.attribute}
    plan = prepare_team(options.world, options.robots, starts, **own)
    use_compilation_cache()
    with working(plan.runs, "robots") as on_progress:
        logs, costs = run_robots(plan, **fields_of(options, "engine lanes workers"), on_progress=on_progress)
    with note_if_slow("jexplore: merging maps"):
        found = merge_team(plan, logs, options.contact, options.limits, costs)
    files = {f"{name}.json": json_form.to_json(btm) for name, btm in {"btm": found.map, **found.maps}.items()}
    files |= {"station.html": found.page(), "teams.parquet": found.table, "contacts.parquet": found.contacts}
    record = out.record(
        groups=[
            {"robots": names, "outcome": merged.outcome.name, "apart": merged.left, "notes": merged.notes}
            for names, merged in found.groups.items()
        ],
        worlds=[plan.world],
        costs=costs,
    )
    return out.finish(record, files, summary(found), {"team.png": found.figure})


def summary(found: Any) -> str:
    """Return the text that the command prints: the table of teams, outcomes, and how often robots merged their maps."""
    from jexplore.driving.mission import RunOutcome

    lines = [aligned_table(list(found.table), _rows(found.table), left=("outcome",))]
    ends = collections.Counter(RunOutcome(int(log.result.outcome)).name for log in found.logs)
    lines.append("outcomes: " + ", ".join(f"{name} {count}" for name, count in ends.most_common()))
    wrong, outcomes = found.contacts["wrong"], found.contacts["outcome"].value_counts()
    counts = ", ".join(f"{name} {count}" for name, count in outcomes.items())
    merged = f", of them {int((wrong > 0).sum())} with a wrong match" if len(wrong) else ""
    lines.append(f"merges of two robots in contact: {counts or 'none'}{merged}")
    for names, group in found.groups.items():
        apart = f", without {', '.join(group.left)}" if group.left else ""
        lines.append(f"{', '.join(names)} in the end: {group.outcome.name}{apart}")
    return "\n".join(lines)


def _rows(table):
    for row in table.itertuples(index=False):
        yield [value if isinstance(value, str) else number_text(value, int(value % 1 > 0)) for value in row]
