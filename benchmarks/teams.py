"""Teams of random robots in random worlds, by the engine and by the oracle of the tests: is everything measured equal?

    python benchmarks/teams.py --cases 1000
    python benchmarks/teams.py --first 137 --cases 1 --coordination minpos --robots 3
    python benchmarks/teams.py --cost --robots 1 2 4 --coordination independent
    python benchmarks/teams.py --study runs/teams --worlds 40

Prints, for each coordination and size, how many cases were equal, how robots ended and how often they waited, and a
line for every case that was not equal; exit status 1 if there was any. With --cost the processor time of a turn of one
robot, in rooms of 10 x 8 m, to that in the smallest team.

With --study teams explore worlds of five kinds, 20 x 20 m (hospitals 32 x 20 m) in cells of 0.2 m, from one start
each, together and apart: all coordinations, and `learned` or `small-first` as each robot's strategy, with 1, 2, 4 and 8
robots, and two coordinations of four robots with every contact (`PARTS`). Worlds that are in the folder are not
computed again. Prints ratios of the times until all is known; intervals are over worlds.
"""

import argparse
import itertools
import math
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

import jexplore as jx
from jexplore.bench.tables import markdown
from jexplore.exploration.batch import Job, run_jobs
from jexplore.exploration.team.team import Team, read_coordination
from jexplore.policies import strategy
from jexplore.rules import Lidar, Rules
from jexplore.studies.statistics.over_worlds import ratio_over_worlds
from jexplore.worlds.starts import draw_starts

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from ref import team

KINDS = "cave", "office", "hospital", "maze", "rooms"
JOINT = "independent", "greedy", "hungarian", "minpos", "voronoi", "segments"
ALONE = {
    name: f"{name}+recheck" for name in ("learned", "small-first")
}  # strategies of each robot, without coordination
ALL, TWO, STARTS = (*JOINT, *ALONE), ("independent", "minpos"), ("together", "apart")
PARTS = [  # sizes, coordinations, contact, starts
    *(([1, 4], JOINT, "all", starts) for starts in STARTS),
    *(([4], TWO, contact, "together") for contact in ("none", "range:5", "range:10", "line-of-sight")),
    *(([2, 8], ("independent", "greedy", "minpos"), "all", starts) for starts in STARTS),
    *(([2, 8], ("hungarian", "voronoi", "segments"), "all", starts) for starts in STARTS),
    *(([1, 2, 4, 8], (name,), "all", starts) for name in ("small-first", "learned") for starts in STARTS),
]


def study(folder, worlds):
    """Run what the folder lacks, and return all episodes."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for (sizes, names, contact, starts), kind in itertools.product(PARTS, KINDS):
        told = *map(str, sizes), contact.replace(":", ""), starts
        path = folder / f"{kind}-{names[-1]}-{'-'.join(told)}.parquet"
        width_m = 32 if kind == "hospital" else 20  # the least of a hospital
        made = [pd.read_parquet(path)] if path.exists() else []
        done = {world for table in made for world in table["world"]}
        buildings = [f"{kind}#{number}:width_m={width_m},height_m=20" for number in range(worlds)]
        if buildings := [world for world in buildings if world not in done]:
            own = names[0] if names[0] in ALONE else None
            joint = [] if own else list(names)
            how = {"robots": sizes, "coordination": joint or "independent", "contact": contact, "team_starts": starts}
            began, strategy = time.monotonic(), ALONE.get(own, "closest+recheck")
            found = jx.compare(buildings, strategy, episodes=1, cell_m=0.2, workers=1, progress=False, **how)
            more = {"kind": kind, "starts": starts, **({"coordination": own} if own else {})}
            made.append(found.episodes.assign(**more))
            pd.concat(made, ignore_index=True).to_parquet(path)
            print(f"{path.stem}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
        parts += made
    return pd.concat(parts, ignore_index=True)


def ratio_row(episodes, ours, theirs):
    """Return a row of ratios of the time until all is known, by kind and over all: of worlds completed by both."""
    ours, theirs = (
        episodes.loc[
            (episodes[list(who)] == pd.Series(who)).all(axis=1) & (episodes["outcome"] == "COMPLETE")
        ].set_index("world")["path_m_at_100"]
        for who in (ours, theirs)
    )
    logs = np.log(ours / theirs).dropna()
    cells = []
    for kind in (*KINDS, None):
        own = logs[[kind is None or world.startswith(kind) for world in logs.index]]
        found = ratio_over_worlds(own, own.index)
        interval = f" [{found.low:.3f}, {found.high:.3f}]" if math.isfinite(found.low) else ""
        cells.append(f"{found.ratio:.3f}{interval}")
    return [*cells, str(len(logs))]


def team_of(robots, coordination="independent", contact="all", starts="together"):
    """Return the columns that tell a team of the study."""
    coordination = coordination if robots > 1 else "independent"
    return {"robots": robots, "coordination": coordination, "contact": contact, "starts": starts}


def study_tables(episodes):
    """Return the tables of a study, as Markdown."""
    teams = [(name, n) for n in (4, 2, 8) for name in ALL]
    tables, contacts = {}, ("range:10", "range:5", "line-of-sight", "none")
    for starts in ("together", "apart"):
        own = {(name, n): team_of(n, name, starts=starts) for name, n in teams}
        for other in ("independent", "greedy"):
            tables[f"to {other}, {starts}"] = {f"{name}, {n}": (who, own[other, n]) for (name, n), who in own.items()}
        alone = team_of(1, starts=starts)
        tables[f"speed-up, {starts}"] = {f"{name}, {n}": (alone, who) for (name, n), who in own.items()}
    tables["apart to together"] = {f"{name}, {n}": (who, team_of(n, name)) for (name, n), who in own.items()}
    tables["contact to all"] = {
        f"{name}, {contact}": (team_of(4, name, contact), team_of(4, name)) for name in TWO for contact in contacts
    }
    alone = team_of(1)
    others = {f"{name}, 1": {**alone, "coordination": name} for name in ALONE} | {"4, none": team_of(4, contact="none")}
    tables["to one robot, closest+recheck"] = {label: (who, alone) for label, who in others.items()}
    told = []
    for title, pairs in tables.items():
        rows = [[label, *ratio_row(episodes, *pair)] for label, pair in pairs.items() if pair[0] != pair[1]]
        told.append(f"{title}\n\n{markdown(['team', *KINDS, 'all', 'worlds'], rows)}")
    keys = ["starts", "robots", "contact", "coordination"]
    measures = ["path_m_at_90", "path_m_at_100", "path_sum_m", "overlap", "share_sd", "waits", "connected", "complete"]
    means = episodes.assign(complete=episodes["outcome"] == "COMPLETE").groupby(keys, sort=False)[measures].mean()
    rows = means.round(2).reset_index().astype(str).to_numpy().tolist()
    return "\n\n".join([*told, f"means\n\n{markdown([*keys, *measures], rows)}"])


def cost(coordinations, sizes):
    """Return a table of processor time; a turn is a step, a wait, a plan or a scan without a step."""
    world, rules = jx.load_world("rooms:width_m=10,height_m=8"), Rules()
    starts, rows, alone = draw_starts(world, 0, 4, rules.clearance_m), [], {}
    for coordination, n in itertools.product(coordinations, sorted(sizes)):
        job = Job(world, strategy("closest"), starts, team=Team(n, read_coordination(coordination)))
        run_jobs([job], Lidar(), rules, workers=1)  # compiles
        began = time.process_time()
        result = run_jobs([job], Lidar(), rules, workers=1).outcomes[0].result
        spent, counts = time.process_time() - began, result.metrics
        turns = int((counts.straight + counts.diagonal + counts.waits).sum() + result.plans.sum())
        us = 1e6 * spent / turns
        alone.setdefault(coordination, us)
        rows.append([coordination, str(n), str(turns), f"{us:.0f}", f"{us / alone[coordination]:.2f}"])
    return markdown(["coordination", "robots", "turns", "us a turn", "to the first"], rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000, help="number of cases, of all programs together")
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each program")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", type=int, nargs="+", default=[2, 3, 5])
    parser.add_argument("--coordination", nargs="+", default=["independent", "minpos", "voronoi"])
    parser.add_argument("--mixed", action="store_true", help="robots that differ, most with a rendezvous")
    parser.add_argument("--cost", action="store_true", help="measure the time of a turn instead")
    parser.add_argument("--study", type=Path, metavar="DIR", help="run the study of teams into this folder instead")
    parser.add_argument("--worlds", type=int, default=40, help="number of worlds of each kind, with --study")
    given = parser.parse_args()
    if given.study:
        print(study_tables(study(given.study, given.worlds)))
        return 0
    if given.cost:
        print(cost(given.coordination, given.robots))
        return 0
    kinds = list(itertools.product(given.coordination, given.robots))
    rows, unequal = [], 0
    for coordination, n in kinds:
        ends, waits, equal, of = Counter(), 0, 0, -(-given.cases // len(kinds))
        for number in range(given.first, given.first + of):
            case = team.draw_case(given.seed, number, coordination, n)
            told, robots = team.differences(team.mixed(case, number) if given.mixed else case)
            ends.update(robot.ended for robot in robots)
            waits += sum(robot.waits for robot in robots)
            equal += not told
            for text in told[:3]:
                print(f"{coordination}, {n} robots, case {number}: {text[:200]}", flush=True)
        unequal += of - equal
        told = ", ".join(f"{name} {count}" for name, count in sorted(ends.items()))
        rows.append([coordination, str(n), f"{equal} of {of}", str(waits), told])
    print(markdown(["coordination", "robots", "equal", "waits", "ends of robots"], rows))
    return int(unequal > 0)


if __name__ == "__main__":
    sys.exit(main())
