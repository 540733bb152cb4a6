"""Does a run survive being killed, and what does keeping its units cost?

    python benchmarks/survive.py --episodes 50000 --kills 20
    python benchmarks/survive.py --cost

Starts `jexplore compare` with `--resume` again and again and kills it (SIGKILL) at random moments, until it has been
killed so often; then lets it finish, and looks whether every unit is there exactly once, none made twice.
"""

import argparse
import collections
import contextlib
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from jexplore.engine.backend import use_compilation_cache
from jexplore.exploration import batch
from jexplore.report.folders import claimed
from jexplore.report.ledger import open_ledger
from jexplore.rules import Lidar, Rules
from jexplore.studies.checks import prepare_jobs
from jexplore.studies.comparison import compare
from jexplore.studies.results import units

WORLD, STRATEGIES = "rooms:width_m=6.4,height_m=6.4", ["closest", "closest+recheck"]  # 64 x 64 cells


def shards(folder):
    """Unit files, and when each was written."""
    found = {}
    for path in (folder / ".unfinished").glob("*.parquet"):
        with contextlib.suppress(FileNotFoundError):  # the run has just been finished
            found[path.name] = path.stat().st_mtime_ns
    return found


def killed(folder, episodes, kills, seed):
    """Kills a run so often and lets it finish: `(times that each unit was written, seconds, kills)`."""
    draw, written, began, done = random.Random(seed), collections.Counter(), time.monotonic(), 0
    command = [sys.executable, "-m", "jexplore", "compare", "--worlds", WORLD, "--strategies", *STRATEGIES]
    command += ["--episodes", str(episodes), "--out", str(folder), "--resume", "--no-report"]
    seen = {}
    while True:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        moment = time.monotonic() + (draw.uniform(0, 25) if done < kills else 3600)
        while process.poll() is None and time.monotonic() < moment:
            for name, when in shards(folder).items():
                if seen.get(name) != when:
                    seen[name] = when
                    written[name] += 1
            time.sleep(0.05)
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            process.communicate()
            done += 1
            for name, when in shards(folder).items():
                if seen.get(name) != when:
                    seen[name] = when
                    written[name] += 1
            print(f"killed {done}: {len(seen)} units", flush=True)
            continue
        assert process.returncode == 0, process.communicate()[1]
        process.communicate()
        return written, time.monotonic() - began, done


def survive(args):
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "run"
        written, seconds, kills = killed(folder, args.episodes, args.kills, args.seed)
        table = pd.read_parquet(folder / "episodes.parquet")
        record = json.loads((folder / "run.json").read_text())
        left = sorted(path.name for path in folder.iterdir())
    pairs = table.groupby("strategy")["episode"].agg(list)
    whole = all(own == list(range(args.episodes)) for own in pairs) and list(pairs.index) == sorted(STRATEGIES)
    few = compare(WORLD, STRATEGIES, episodes=200).to_pandas()
    same = table[table["episode"] < 200].reset_index(drop=True).equals(few)
    print(f"{len(table):,} episodes, {record['units']} units, {kills} kills, {seconds:.0f} s in all")
    print(f"every episode exactly once: {whole}; the first 200 as in an undisturbed run: {same}")
    twice = [name for name, n in written.items() if n > 1]
    print(f"units written more than once: {len(twice)}; files left: {', '.join(left)}")
    return 0 if whole and same and not twice else 1


def cost(args):
    """Processor time of a run whose units are kept, over that of the same episodes without."""
    use_compilation_cache()
    how = {"episodes": args.episodes, "seed": 0, "cell_m": 0.1, "start": "random", "lidar": Lidar(), "rules": Rules()}
    jobs = prepare_jobs(WORLD, STRATEGIES, **how)
    ratios, written = [], []
    for turn in range(args.repeat + 1):  # the first turn compiles
        seconds = {}
        for kind in ("plain", "kept")[:: 1 if turn % 2 else -1]:
            with tempfile.TemporaryDirectory() as temporary, claimed(Path(temporary) / "run") as run:
                ledger = open_ledger(run, {}, len(units.cut_jobs(jobs)))
                clock, began = time.process_time(), time.perf_counter()
                if kind == "plain":
                    batch.run_jobs(jobs, Lidar(), Rules(), workers=1)
                else:
                    units.run_units(jobs, units.cut_jobs(jobs), ledger=ledger, workers=1)
                seconds[kind] = time.process_time() - clock, time.perf_counter() - began
        if turn:
            ratios.append(seconds["kept"][0] / seconds["plain"][0] - 1)
            written.append(seconds["kept"][1] / seconds["plain"][1] - 1)
    n_units = len(units.cut_jobs(jobs))
    print(f"{len(jobs)} jobs of {args.episodes} episodes, {n_units} units, one core, {args.repeat} turns:")
    for what, found in (("processor time", ratios), ("the clock", written)):
        print(
            f"keeping costs {100 * np.median(found):.1f} % by {what} ({100 * min(found):.1f} to {100 * max(found):.1f})"
        )
    return 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=50_000, help="of each of two strategies")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cost", action="store_true")
    parser.add_argument("--repeat", type=int, default=5)
    args = parser.parse_args()
    return cost(args) if args.cost else survive(args)


if __name__ == "__main__":
    sys.exit(main())
