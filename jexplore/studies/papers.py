"""Papers whose tables can be reproduced: their figures, as data.

To add a paper: write its record, and add it to `PAPERS`.
"""

from typing import NamedTuple


class PaperEnvironment(NamedTuple):
    """An environment of a paper."""

    where: str  # its table and figure
    file: str  # its map, in a folder of maps
    scale: str  # what follows the map's name: its size
    counterpart: str  # the built-in world that is most like it
    paths: dict[str, tuple[float, float]]  # strategy -> mean and standard deviation of the path length, metres


class Paper(NamedTuple):
    """Reported results of a paper."""

    title: str
    runs: int  # the paper's, of each strategy in each environment
    reference: str  # the strategy that ratios are taken to
    environments: dict[str, PaperEnvironment]
    claimed: tuple[frozenset[str], ...]  # pairs of strategies that its text says an order of
    remark: str  # what it leaves open


RANDOM, CLOSEST, RECHECK = "random", "closest", "closest+recheck"
SEGMENT = "closest+recheck+segment"
DT100, DT500 = "decision-theoretic:samples=100", "decision-theoretic:samples=500"
HOLZ_STRATEGIES = (RANDOM, CLOSEST, RECHECK, SEGMENT, DT100, DT500)
CLAIMED = (RECHECK, CLOSEST), (RANDOM, CLOSEST), (DT500, CLOSEST), (DT500, RANDOM), (SEGMENT, RECHECK), (DT500, DT100)

HOLZ2010 = Paper(
    title="Holz, Basilico, Amigoni, Behnke 2010: Evaluating the Efficiency of Frontier-based Exploration Strategies",
    runs=10,
    reference=CLOSEST,
    environments={
        name: PaperEnvironment(*where, {strategy: path for strategy, path in zip(HOLZ_STRATEGIES, paths) if path})
        for name, where, paths in (
            (
                "Cave",
                ("Table 1, Figure 8a", "stage/cave_filled.png", "@16x16", "cave"),
                ((102.84, 34.50), (73.71, 1.00), (70.45, 0.97), (72.89, 5.77), (100.01, 17.64), (98.27, 11.76)),
            ),
            (
                "AVZ",
                ("Table 2, Figure 8b", "avz/avz5floor_open.yaml", "", "office"),
                ((601.51, 141.93), (382.07, 3.99), (361.88, 3.01), (359.77, 12.91), None, (447.68, 32.78)),
            ),
            (
                "Hospital",
                ("Table 3, Figure 8c", "stage/hospital_section.png", "@49.3x20.1", "hospital"),
                ((669.17, 186.41), (281.07, 3.82), (253.09, 3.12), (221.37, 19.97), None, (312.68, 38.11)),
            ),
        )
    },
    claimed=tuple(map(frozenset, CLAIMED)),
    remark="The paper does not say where its runs start, nor how far its scanner sees. Here every episode has a start "
    "of its own, drawn at random, so that standard deviations are those between starts as well.",
)
PAPERS = {"holz2010": HOLZ2010}
