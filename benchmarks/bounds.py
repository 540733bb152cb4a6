"""Is any complete episode shorter than the bound that holds for every robot?

    python benchmarks/bounds.py --episodes 1000

Random small worlds of three kinds, starts, rules, scanners and strategies without noise; prints how many complete
episodes were compared with `low_any_m`, how many were shorter (none may be), and how tight the bounds are.
"""

import argparse
import sys

import numpy as np
import pandas as pd

import jexplore as jx

KINDS = ("rooms:width_m={w},height_m={h}", "cave:width_m={w},height_m={h}", "maze:width_m={w},height_m={h}")
STRATEGIES = ("closest", "closest+recheck", "random", "small-first+recheck", "utility+recheck")
STARTS = 4  # in each world


def some(draw, number):
    """Compare episodes in one random world with the bounds of their starts."""
    kind = KINDS[number % len(KINDS)].format(w=round(draw.uniform(6, 8), 1), h=round(draw.uniform(6, 8), 1))
    name, _, rest = kind.partition(":")
    lidar = jx.Lidar(n_beams=61, range_m=float(draw.choice([1.0, 1.5, 2.5])))
    names = ["closest", *draw.choice(STRATEGIES[1:], 1).tolist()]
    world = f"{name}#{int(draw.integers(10**6))}:{rest}"
    rules = jx.Rules(
        near_m=float(draw.choice([0.3, 0.5, 1.0])),
        scan_every_m=float(draw.choice([0.0, 0.5])),
        arrival_m=float(draw.choice([0.0, 0.5])),
        look_around=bool(draw.integers(2)),
        p_free=float(draw.choice([0.25, 0.5])),
    )
    compared = jx.compare(world, names, episodes=STARTS, seed=number, lidar=lidar, rules=rules)
    found = jx.bound(world, starts=STARTS, seed=number, lidar=lidar, rules=rules, max_floods=1500)
    return found.beside(compared), found.table


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    draw, tables, bounds, done, number = np.random.default_rng(args.seed), [], [], 0, 0
    while done < args.episodes:
        table, own = some(draw, number)
        tables.append(table)
        bounds.append(own)
        number += 1
        done += int(table["path_over_low_any"].notna().sum())
        print(f"\r{done} episodes", end="", file=sys.stderr, flush=True)
    table, own = pd.concat(tables), pd.concat(bounds)
    low = table["path_over_low_any"].dropna()
    tight = (own["low_any_m"] / own["high_m"])[own["high_m"] > 0]
    print(f"\n{len(low)} complete episodes in {number} worlds, {len(own)} starts")
    print(f"shorter than low_any_m: {int((low < 1).sum())}; shorter than high_m: {(table['path_over_high'] < 1).sum()}")
    print(f"path / low_any_m: least {low.min():.3f}, mean {low.mean():.3f}")
    print(f"low_any_m / high_m: mean {tight.mean():.3f}, least {tight.min():.3f}; zero in {int((tight == 0).sum())}")
    print(f"OPTIMAL: {int((own['status'] == 'OPTIMAL').sum())} of {len(own)} starts")
    return 1 if (low < 1 - 1e-9).any() else 0


if __name__ == "__main__":
    sys.exit(main())
