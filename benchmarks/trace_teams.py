"""Measure teams of trace robots: how soon they have been everywhere, and how well their maps merge.

    python benchmarks/trace_teams.py [--worlds rooms office] [--teams 5] [--robots 4] [--contacts all range:8 range:4]

Team i has seed i, 1 cm of range noise, and starts apart. Of one team of four also its first one and two robots count.
Limits of merging are those of `jexplore merge-maps`, and those of teams.
"""

import argparse

import pandas as pd

from jexplore.driving.settings import Noise
from jexplore.report.tables import aligned_table, number_text
from jexplore.studies.traces.teams.team import merge_team, trace_team
from jexplore.tracemap.merging.limits import Limits, TeamLimits

LIMITS = {"merge-maps": Limits(), "teams": TeamLimits()}
MEANS = {
    "steps_reached_90": 0, "steps_mapped_90": 0, "junctions": 0, "reached": 1, "one": 1, "all": 1, "merged": 1,
    "apart": 2, "doubled": 2, "wrong": 2,
}  # fmt: skip
"""Columns of `team_row` of which means are told -> decimals."""
OUTCOMES = "MERGED", "NOT_ENOUGH_IN_COMMON", "AMBIGUOUS"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", default=["rooms", "office"])
    parser.add_argument("--teams", type=int, default=5)
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--contacts", nargs="+", default=["all", "range:8", "range:4"])
    given = parser.parse_args()
    runs = ((world, seed) for world in given.worlds for seed in range(given.teams))
    print(report(((world, seed, *_run(world, seed, given.robots)) for world, seed in runs), given.contacts))


def _run(world, seed, robots):
    ran = trace_team(world, robots=robots, contact="none", seed=seed, noise=Noise(range_m=0.01))
    print(f"{world}, team {seed}: {ran.table['steps'].iloc[-1]} steps", flush=True)
    return ran.plan, ran.logs


def report(runs, contacts):
    """Tabulate runs, `(world, team, plan, logs)` each, by size of team and by contact."""
    tables, attempts = [], []
    for world, team, plan, logs in runs:
        for contact in contacts:
            for name, limits in LIMITS.items():
                found, own = merge_team(plan, logs, contact, limits), {"contact": contact, "limits": name}
                tables.append(found.table.assign(world=world, team=team, **own))
                attempts.append(found.contacts.assign(world=world, team=team, **own))
    table = pd.concat(tables)
    return "\n\n".join([_sizes(table[table["contact"] == contacts[0]]), _attempts(pd.concat(attempts), table)])


def _sizes(table):
    """Tabulate teams by size."""
    rows = []
    for (world, limits, robots), own in table.groupby(["world", "limits", "robots"], sort=False):
        alone = table[(table["world"] == world) & (table["robots"] == 1)]["steps_reached_90"]
        speed = alone.mean() / own["steps_reached_90"].mean()
        values = [number_text(own[name].mean(), decimals) for name, decimals in MEANS.items()]
        rows.append([world, limits, str(robots), values[0], number_text(speed, 2), *values[1:]])
    first, *others = MEANS
    return aligned_table(["world", "limits", "robots", first, "speed-up", *others], rows, left=("world", "limits"))


def _attempts(attempts, table):
    """Tabulate attempts of two robots in contact, the step at which a pair merged first, and the maps of the end."""
    rows, key = [], ["world", "contact", "limits"]
    for names, own in attempts.groupby(key, sort=False):
        merged = own[own["outcome"] == "MERGED"]
        first = merged.groupby(["team", "one", "other"])["step"].min()
        pairs = len(own.groupby(["team", "one", "other"]))
        counts, wrong = own["outcome"].value_counts(), (merged["wrong"] > 0).sum()
        told = *(counts.get(name, 0) for name in OUTCOMES), wrong, f"{len(first)} of {pairs}"
        teams = table[(table[key] == names).all(axis=1) & (table["robots"] == table["robots"].max())]
        whole = f"{(teams['apart'] == 0).sum()} of {len(teams)}"
        rows.append([*names, *map(str, told), number_text(first.median(), 0), whole])
    head = [
        *key,
        "merged",
        "not enough",
        "ambiguous",
        "with a wrong match",
        "pairs",
        "first at step",
        "one map",
    ]
    return aligned_table(head, rows, left=key)


if __name__ == "__main__":
    main()
