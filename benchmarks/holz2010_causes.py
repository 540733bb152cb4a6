"""Why an ordering of Holz et al. 2010 may not hold: its strategies under other maps, scales, cells, scanners and rules.

    python benchmarks/holz2010_causes.py [MAP@SCALE | WORLD] [EPISODES]

One row a setting, everything else as in `jexplore reproduce`: paired ratios of `closest+recheck` to `closest`, of
`+segment` to none (with the default and with the paper's literal minima), and of `decision-theoretic` to `closest`.
"""

import sys

from jexplore import Lidar, Rules, compare
from jexplore.bench.tables import markdown
from jexplore.report.tables import ratio_text
from jexplore.studies.statistics.paired import paired_ratio

CLOSEST, RECHECK = "closest", "closest+recheck"
SEGMENT, LITERAL, THEORETIC = "closest+recheck+segment", "closest+recheck+segment:prominence_m=0", "decision-theoretic"
PAIRS = ((RECHECK, CLOSEST), (SEGMENT, RECHECK), (LITERAL, RECHECK), (THEORETIC, CLOSEST))
SETTINGS = {
    "as reproduced": {},
    "cells of 0.2 m": {"cell_m": 0.2},
    "clearance 0.2 m": {"rules": Rules(clearance_m=0.2)},
    "clearance 0.4 m": {"rules": Rules(clearance_m=0.4)},
    "range 4 m": {"lidar": Lidar(range_m=4.0)},
    "range 30 m": {"lidar": Lidar(range_m=30.0)},
    "field of view 360 degrees": {"lidar": Lidar(n_beams=360, fov_deg=360)},
    "no look around on arrival": {"rules": Rules(look_around=False)},
    "a scan every 0.5 m": {"rules": Rules(scan_every_m=0.5)},
    "a scan every 1 m": {"rules": Rules(scan_every_m=1.0)},
    "a scan every 2 m": {"rules": Rules(scan_every_m=2.0)},
    "arrival within 0.5 m": {"rules": Rules(arrival_m=0.5)},
    "arrival within 1 m": {"rules": Rules(arrival_m=1.0)},
    "a scan every 1 m, arrival within 0.5 m": {"rules": Rules(scan_every_m=1.0, arrival_m=0.5)},
}
SCALES = {"hospital_section.png@49.3x20.1": "hospital_section.png@40x18"}


def main(arguments):
    world = arguments[0] if arguments else "hospital"
    episodes = int(arguments[1]) if len(arguments) > 1 else 20
    settings = {name: (world, more) for name, more in SETTINGS.items()}
    for name, other in SCALES.items():
        if world.endswith(name):
            settings["scale of Stage's own world file"] = (world.replace(name, other), {})
    rows = []
    for name, (where, more) in settings.items():
        table = compare(where, [CLOSEST, RECHECK, SEGMENT, LITERAL, THEORETIC], episodes=episodes, **more).to_pandas()
        paths = table.pivot(index="episode", columns="strategy", values="path_m")
        ratios = [paired_ratio(paths[a], paths[b]) for a, b in PAIRS]
        complete = (table["outcome"] == "COMPLETE").mean()
        rows.append([name, *(ratio_text(r.ratio, r.low, r.high) for r in ratios), f"{complete:.0%}"])
        print(f"{name}: done", file=sys.stderr, flush=True)
    print(f"{world}, {episodes} starts\n")
    print(markdown(["setting", *(f"{a} / {b}" for a, b in PAIRS), "COMPLETE"], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
