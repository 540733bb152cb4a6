"""Measure how often intervals cover, by the size of the sample; compared with a bootstrap's.

    python benchmarks/intervals.py [--world cave] [--episodes 1000] [--repetitions 2000] [--seed 0]
    python benchmarks/intervals.py --over worlds [--worlds 150] [--repetitions 1000]

Over pairs: the 95 % interval of a paired ratio. The pairs are drawn, with replacement, from a large comparison, whose
own ratio of means is the truth:

- *strategies*: `closest+recheck` and `closest` from the same starts of the world;
- *half identical*, *70 %*, *90 % identical*: the same, with this share of the pairs made equal, as strategies often
  drive identical paths;
- *skewed*: the reference times a log-normal factor of standard deviation 0.6.

A sample without an interval (pairs that are all equal) counts as not covered; how many had none stands in brackets.

Over worlds: the intervals of statistics over many worlds: n small ones, of three kinds or of one, are drawn, with
replacement, from many, whose own numbers are the truth.
"""

import argparse

import numpy as np
from scipy import stats as scipy_stats

import jexplore as jx
from jexplore.bench.tables import markdown
from jexplore.studies.statistics.over_worlds import share_over_worlds
from jexplore.studies.statistics.paired import paired_ratio

PAIRS = (5, 10, 20, 50, 100)
KINDS = {
    "cave": "cave#{}:width_m=6.4,height_m=6.4",
    "maze": "maze#{}:width_m=6,height_m=6",
    "rooms": "rooms#{}:width_m=9.6,height_m=9.6,room_m=2.5",
}
EPISODES = 4  # in each of the small worlds
WORLDS = (6, 12, 24, 48)


def populations(values, reference, rng):
    """`{name: (values, reference)}`, each `[N]` float."""
    n = len(values)
    factor = np.exp(rng.normal(0.0, 0.6, n))
    found = {"strategies": (values, reference)}
    for name, share in (("half identical", 0.5), ("70 % identical", 0.7), ("90 % identical", 0.9)):
        found[name] = np.where(rng.random(n) < share, reference, values), reference
    return found | {"skewed": (reference * factor, reference)}


def bootstrap(values, reference):
    """The BCa bootstrap interval of the ratio of means, as scipy has it."""
    if (values == reference).all():
        return np.nan, np.nan
    with np.errstate(all="ignore"):
        found = scipy_stats.bootstrap(
            (values, reference),
            lambda v, r, axis: v.mean(axis=axis) / r.mean(axis=axis),
            paired=True,
            vectorized=True,
            n_resamples=999,
            method="BCa",
            rng=np.random.default_rng(0),
        ).confidence_interval
    return found.low, found.high


def ours(values, reference):
    """The interval that jexplore prints."""
    found = paired_ratio(values, reference)
    return found.low, found.high


def coverage(interval, values, reference, n, repetitions, rng):
    """Shares of samples of n pairs whose interval covers, and that have none: `(covered, none)`."""
    truth, covered, none = values.mean() / reference.mean(), 0, 0
    for _ in range(repetitions):
        chosen = rng.integers(len(values), size=n)
        low, high = interval(values[chosen], reference[chosen])
        covered += bool(low <= truth <= high)
        none += bool(np.isnan(low))
    return covered / repetitions, none / repetitions


def paths_of(given):
    """Paths of `closest+recheck` and `closest` from the same starts of one world, each `[N]` metres."""
    found = jx.compare(given.world, ["closest", "closest+recheck"], episodes=given.episodes, seed=given.seed)
    paths = found.episodes.pivot(index="episode", columns="strategy", values="path_m")
    return paths["closest+recheck"].to_numpy(), paths["closest"].to_numpy()


def over_pairs(given):
    """The table of paired ratios."""
    rng, rows, paths = np.random.default_rng(given.seed), [], paths_of(given)
    for name, (values, reference) in populations(*paths, rng).items():
        for label, interval, share in (("t", ours, 1.0), ("BCa bootstrap", bootstrap, 0.1)):
            repetitions = max(1, round(share * given.repetitions))
            cells = [coverage(interval, values, reference, n, repetitions, rng) for n in PAIRS]
            texts = [f"{100 * hit:.1f}" + (f" ({100 * none:.1f})" if none else "") for hit, none in cells]
            rows.append([name, f"{values.mean() / reference.mean():.3f}", label, str(repetitions), *texts])
    print(markdown(["pairs", "true ratio", "interval", "samples", *(f"n = {n}" for n in PAIRS)], rows))
    print(f"{given.world}, {len(paths[0])} pairs; per cent of the samples whose 95 % interval covers the true ratio.")


def small_worlds(given):
    """`{strategy: paths [3 kinds, worlds, EPISODES]}` in small worlds."""
    strategies, kinds = ["closest", "closest+recheck", "random+recheck"], []
    for kind in KINDS.values():
        worlds = [kind.format(seed) for seed in range(given.worlds)]
        found = jx.compare(worlds, strategies, episodes=EPISODES, seed=given.seed).episodes
        kinds.append({name: rows["path_m"].to_numpy() for name, rows in found.groupby("strategy")})
    return {name: np.array([one[name].reshape(given.worlds, EPISODES) for one in kinds]) for name in strategies}


def estimates(values, reference):
    """`{what: estimate}`: functions of `(kinds, worlds)`, two of `[N]` numbers of worlds, to `(value, low, high)`."""
    with np.errstate(all="ignore"):
        ratios = np.where(values == reference, 1.0, values / reference)
    wins = {"shorter": (ratios < 1) + 0.5 * (ratios == 1), "at most 1.1 times": (ratios <= 1.1).astype(np.float64)}
    return {
        what: lambda at, own=own: share_over_worlds(own[at].mean(axis=-1), at[0].tolist())[:3]
        for what, own in wins.items()
    }


def resampled(estimate, at, rng, resamples=199):
    """The percentile bootstrap: worlds drawn again within their kinds."""
    kinds, worlds = at
    values = []
    for _ in range(resamples):
        again = np.concatenate([rng.choice(worlds[kinds == kind], (kinds == kind).sum()) for kind in np.unique(kinds)])
        values.append(estimate((np.sort(kinds), again))[0])
    return np.quantile(values, [0.025, 0.975])


def covered_over_worlds(estimate, chosen, n, given, rng):
    """Per cent of samples of n worlds of the chosen kinds whose interval covers, and of a bootstrap's, as text."""
    everywhere = np.repeat(chosen, given.worlds), np.tile(np.arange(given.worlds), len(chosen))
    truth, hits, none, boots = estimate(everywhere)[0], 0, 0, []
    for i in range(given.repetitions):
        kinds = np.repeat(chosen, n // len(chosen))
        at = kinds, rng.integers(given.worlds, size=len(kinds))
        _, low, high = estimate(at)
        hits += bool(low <= truth <= high)
        none += bool(np.isnan(low))
        if i % 20 == 0:
            low, high = resampled(estimate, at, rng)
            boots.append(low <= truth <= high)
    missing = f" ({100 * none / given.repetitions:.1f})" if none else ""
    return f"{100 * hits / given.repetitions:.1f}{missing}, {100 * np.mean(boots):.0f}"


def over_worlds(given):
    """Tabulate the statistics over many worlds."""
    paths, rng, rows = small_worlds(given), np.random.default_rng(given.seed), []
    for name, other in (("closest+recheck", "closest"), ("random+recheck", "closest+recheck")):
        for what, estimate in estimates(paths[name], paths[other]).items():
            for chosen in ([0, 1, 2], [0], [2]):
                cells = [covered_over_worlds(estimate, chosen, n, given, rng) for n in WORLDS]
                of = " ".join(list(KINDS)[kind] for kind in chosen)
                rows.append([f"{name} / {other}", what, of, *cells])
    print(markdown(["strategies", "estimate", "worlds", *(f"n = {n}" for n in WORLDS)], rows))
    print(
        f"{given.worlds} worlds of each kind, {EPISODES} episodes each; per cent of {given.repetitions} samples whose"
    )
    print("95 % interval covers (in brackets: without one), and, of a twentieth of them, a percentile bootstrap's.")


OVER = {"pairs": over_pairs, "worlds": over_worlds}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--over", choices=tuple(OVER), default="pairs", help="what is measured")
    parser.add_argument("--world", default="cave")
    parser.add_argument("--worlds", type=int, default=150, help="of each kind: the population over worlds")
    parser.add_argument("--episodes", type=int, default=1000, help="of each strategy: the population of pairs")
    parser.add_argument("--repetitions", type=int, default=2000, help="samples; the bootstrap makes some of them")
    parser.add_argument("--seed", type=int, default=0, help="of the samples, and of the starts")
    given = parser.parse_args()
    OVER[given.over](given)


if __name__ == "__main__":
    main()
