"""Check that two result folders hold equal results, bit by bit: `python benchmarks/same_results.py BEFORE AFTER`.

Compares every table (`*.parquet`) and every Behavioral Trace Map (`btm.json`) of the first folder with
that of the second. Columns that only the second has are told and do not count. Exit status 1 if anything differs.
"""

import json
import sys
from pathlib import Path

import pandas as pd

from jexplore.bench.tables import markdown


def compare_tables(before, after):
    """Describe the differences of two tables, as text; "equal" for none."""
    ours, theirs = pd.read_parquet(before), pd.read_parquet(after)
    if missing := [name for name in ours if name not in theirs]:
        return f"columns are missing: {', '.join(missing)}"
    if len(ours) != len(theirs):
        return f"{len(ours)} and {len(theirs)} rows"
    # `equals` takes two missing values for the same, and tells every other bit.
    other = [name for name in ours if not ours[name].equals(theirs[name])]
    return f"other values: {', '.join(other)}" if other else "equal"


def compare_folders(before, after):
    """Rows of `file`, `what was found`, `columns added`, for every file of the first folder that holds results."""
    rows = []
    for path in sorted(before.iterdir()):
        other = after / path.name
        if path.suffix != ".parquet" and path.name != "btm.json":
            continue
        if not other.is_file():
            rows.append([path.name, "is missing", ""])
        elif path.suffix == ".parquet":
            added = [name for name in pd.read_parquet(other) if name not in pd.read_parquet(path)]
            rows.append([path.name, compare_tables(path, other), ", ".join(added)])
        else:
            same = json.loads(path.read_text("utf-8")) == json.loads(other.read_text("utf-8"))
            rows.append([path.name, "equal" if same else "differs", ""])
    return rows


def main(arguments):
    if len(arguments) != 2 or not all(Path(folder).is_dir() for folder in arguments):
        print("expected two folders: python benchmarks/same_results.py BEFORE AFTER", file=sys.stderr)
        return 2
    rows = compare_folders(*map(Path, arguments))
    if not rows:
        print(f"{arguments[0]}: holds no results", file=sys.stderr)
        return 2
    print(markdown(["file", "results", "columns added"], rows))
    return int(any(row[1] != "equal" for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
