"""Vary every number of the trace robot, one at a time, at half and at double, as leaves of one compiled program.

    python benchmarks/ablation.py --out DIR [--worlds WORLD...] [--runs 8] [--seed 100] [--only NAME...]
    python benchmarks/ablation.py --out DIR --off [NAME+NAME...]      # without the rules that numbers steer
    python benchmarks/ablation.py --out DIR --summary

Every run of a changed robot has the noise and the start of one as it is. Rows are written as runs end, and what was
broken off goes on. The summary is Markdown: for each number, at half and at double, the share of runs whose path and
map stay the same, and by how much the share of good runs (on a course the true map, in a building EXHAUSTED) and of
junctions reached changes, in per cent, with the 95 % t interval of the paired differences.
"""

import argparse
import dataclasses
import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from jexplore.driving.params.groups import default_numbers
from jexplore.driving.settings import WHOLE, Noise
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.studies.traces import tracing
from jexplore.studies.traces.job import prepare_trace

WORLDS = ("course#101", "course#102", "course#103", "course#104", "office", "hospital")
FACTORS = (0.5, 2.0)
NEVER, ALWAYS = 0.0, 1e4
OFF = {
    "sensing.agree_deviations": ALWAYS, "sensing.plane_rad": ALWAYS, "sensing.tilt_rad": ALWAYS,
    "sensing.every_rad": ALWAYS, "ground.tip_share": NEVER, "ground.level_rad": ALWAYS,
    "ground.noise_shares.1": NEVER, "ground.passed_m": NEVER, "ground.stairs_rise_m": ALWAYS, "ground.face_m": NEVER,
    "places.recess_widths": NEVER, "places.graze_rad": NEVER, "places.ahead_radii": -ALWAYS, "places.alike_m": 1e-6,
    "places.in_line_rad": NEVER, "graph.shift_m": NEVER, "graph.led_node_m": NEVER, "graph.turn_share": NEVER,
    "graph.shift_share": NEVER, "graph.match_drift.1": ALWAYS, "graph.match_drift.0": NEVER,
    "graph.search_every_steps": 1, "motion.replaceable_votes": 0, "motion.survey_m": ALWAYS,
    "motion.stray_steps": 100000, "motion.stuck_steps": 100000, "motion.latch_steps": 100000,
    "motion.taken_rad": ALWAYS,
}  # fmt: skip
"""Number -> its value at which the rule that it steers does nothing, or does without a number of its own."""
PART = 40  # changes whose runs are written together


def numbers_of(plan):
    """Return the robot's numbers that are not 0: `{name: default}`."""
    own = {field.name: getattr(plan.tuning, field.name) for field in dataclasses.fields(plan.tuning)}
    return {name: v for name, v in {**own, **default_numbers()}.items() if v}


def changed(value, factor):
    """Return a number times a factor; whole ones stay whole and are 1 at least."""
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def changes_of(own, only, off):
    """Return the changes to make: `[(name, factor, {name: value})]`; the first changes nothing; factor NaN: off."""
    if off is None:
        varied = [(name, f, {name: changed(own[name], f)}) for name in only or own for f in FACTORS]
    else:
        varied = [(some, np.nan, {name: OFF[name] for name in some.split("+")}) for some in off or OFF]
    return [("", 1.0, {}), *varied]


def varied(world, options):
    """Return a plan with a setting for every change, and the changes."""
    runs = "runs" if world.startswith("course") else "starts"
    plan = prepare_trace(
        world, noise=Noise(range_m=0.01), seed=options.seed, perception="triangles", **{runs: options.runs}
    )
    own = numbers_of(plan)
    changes = changes_of(own, options.only, options.off)
    swept = {name: np.full(len(changes), value, float) for name, value in own.items()}
    for i, (_, _, values) in enumerate(changes):
        for name, value in values.items():
            swept[name][i] = min(value, WHOLE.get(name, np.inf))
    return dataclasses.replace(plan, swept=swept, settings=len(changes)), changes


def make(world, options):
    """Make the runs of a world that are not there yet, `PART` changes after the other, the first run of all first."""
    plan, changes = varied(world, options)
    name, firsts = world.replace(":", "_"), range(0, plan.settings, PART)
    paths = [(options.out / f"{name}-{k}-{first}.parquet", k, first) for k in range(options.runs) for first in firsts]
    paths = [part for part in paths if not part[0].exists()]
    own = [np.arange(first, min(first + PART, plan.settings)) for *_, first in paths]
    if not own:
        return
    ends = np.cumsum([len(part) for part in own])

    def put(i, result, _):
        path, run, _ = paths[i]
        table = tracing.trace_table(plan, result, own[i], np.full(len(own[i]), run, np.int32), {})[0]
        good = table["true"].astype(float) if plan.world.course else (table["outcome"] == "EXHAUSTED").astype(float)
        names, factors = zip(*(changes[k][:2] for k in own[i]))
        junctions = table["junctions_reached"] / table["junctions"].clip(lower=1)
        kept = table[["world", "run", "outcome", "steps", "path_m", "code", "mistaken", "false_divergences"]]
        kept.assign(name=names, factor=factors, good=good, junctions=junctions).to_parquet(path)
        print(path.name, flush=True)

    which = np.concatenate([np.full(len(part), run, np.int32) for part, (_, run, _) in zip(own, paths)])
    blocks = [(int(end) - len(part), len(part)) for end, part in zip(ends, own)]
    plan.run(np.concatenate(own), which, blocks=blocks, on_block=put, workers=options.workers)


def summary(out):
    """Print the changes of every number, the largest first."""
    table = pd.concat(pd.read_parquet(path) for path in sorted(out.glob("*.parquet")))
    plain = table[table["name"] == ""].set_index(["world", "run"])
    rows = []
    for (name, factor), some in table[table["name"] != ""].groupby(["name", "factor"], dropna=False):
        some = some.set_index(["world", "run"])
        base = plain.loc[some.index]
        same = ((some["path_m"] == base["path_m"]) & (some["code"] == base["code"])).mean()
        row = {"name": name, "factor": factor, "runs": len(some), "same": same}
        for measure in ("good", "junctions"):
            off = 100 * (some[measure] - base[measure]).to_numpy(float)
            half = stats.t.ppf(0.975, len(off) - 1) * off.std(ddof=1) / np.sqrt(len(off)) if len(off) > 1 else np.nan
            row |= {measure: off.mean(), f"{measure}_half": half}
        rows.append(row)
    found = pd.DataFrame(rows)
    found["moved"] = [any(abs(row[m]) > row[f"{m}_half"] for m in ("good", "junctions")) for _, row in found.iterrows()]
    counts = plain.groupby("world").size()
    print(f"As it is: good {100 * plain['good'].mean():.1f} %, junctions {100 * plain['junctions'].mean():.1f} %; "
          + ", ".join(f"{world} {n}" for world, n in counts.items()))  # fmt: skip
    print("\n| number | factor | equal % | good | junctions | moves |\n| --- | --- | --- | --- | --- | --- |")
    order = found.groupby("name")["same"].transform("min")
    for _, row in found.assign(order=order).sort_values(["order", "name", "factor"]).iterrows():
        factor = "off" if np.isnan(row["factor"]) else row["factor"]
        cells = (f"{row[m]:+.1f} ± {row[f'{m}_half']:.1f}" for m in ("good", "junctions"))
        print("|", row["name"], "|", factor, "|", f"{100 * row['same']:.0f} |", " | ".join(cells), "|",
              "yes |" if row["moved"] else "no |")  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows")
    parser.add_argument("--worlds", nargs="+", default=WORLDS)
    parser.add_argument("--runs", type=int, default=8, help="of every change and world")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--only", nargs="+", help="names of numbers; by default all")
    parser.add_argument("--off", nargs="*", help="rules of OFF to do without, a+b at once; by default each alone")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--summary", action="store_true", help="make no run")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if not options.summary:
        start_backend(options.workers)
        use_compilation_cache()
        for world in options.worlds:
            make(world, options)
    summary(options.out)


if __name__ == "__main__":
    main()
