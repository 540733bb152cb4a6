"""How often the 95 % interval of a paired ratio covers the ratio, by the number of pairs; beside a bootstrap's.

    python benchmarks/coverage.py [--world cave] [--episodes 1000] [--repetitions 2000] [--seed 0]

The pairs are drawn, with replacement, from a large comparison, whose own ratio of means is the truth:

- *strategies*: `closest+recheck` and `closest` from the same starts of the world;
- *half identical*, *70 %*, *90 % identical*: the same, with so many of the pairs made equal, as strategies often drive
  the very same path;
- *skewed*: the reference times a log-normal factor of standard deviation 0.6.

A sample without an interval (pairs that are all equal) counts as not covered; how many had none stands in brackets.
"""

import argparse

import numpy as np
from scipy import stats as scipy_stats

import jexplore as jx
from jexplore.bench.tables import markdown
from jexplore.studies.stats import paired_ratio

PAIRS = (5, 10, 20, 50, 100)


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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", default="cave")
    parser.add_argument("--episodes", type=int, default=1000, help="of each strategy: the population")
    parser.add_argument("--repetitions", type=int, default=2000, help="samples; the bootstrap makes a tenth of them")
    parser.add_argument("--seed", type=int, default=0, help="of the samples, and of the starts")
    given = parser.parse_args()
    found = jx.compare(given.world, ["closest", "closest+recheck"], episodes=given.episodes, seed=given.seed)
    paths = found.episodes.pivot(index="episode", columns="strategy", values="path_m")
    rng = np.random.default_rng(given.seed)
    rows = []
    pairs = populations(paths["closest+recheck"].to_numpy(), paths["closest"].to_numpy(), rng)
    for name, (values, reference) in pairs.items():
        for label, interval, share in (("t", ours, 1.0), ("BCa bootstrap", bootstrap, 0.1)):
            repetitions = max(1, round(share * given.repetitions))
            cells = [coverage(interval, values, reference, n, repetitions, rng) for n in PAIRS]
            texts = [f"{100 * hit:.1f}" + (f" ({100 * none:.1f})" if none else "") for hit, none in cells]
            rows.append([name, f"{values.mean() / reference.mean():.3f}", label, str(repetitions), *texts])
    print(markdown(["pairs", "true ratio", "interval", "samples", *(f"n = {n}" for n in PAIRS)], rows))
    print(f"{given.world}, {len(paths)} pairs; per cent of the samples whose 95 % interval covers the true ratio.")


if __name__ == "__main__":
    main()
