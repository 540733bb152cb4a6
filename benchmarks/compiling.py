"""Measure the cost of compiling: a command with an empty cache of compiled programs, and again with a full one.

    python benchmarks/compiling.py                                       # the default comparison
    python benchmarks/compiling.py --worlds cave --strategies closest+recheck
    python benchmarks/compiling.py --league --episodes 1

The options are those of `jexplore compare`. Prints processor and clock seconds of both runs and their difference.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time

from jexplore.bench.tables import markdown


def timed(arguments, cache, out):
    """Processor and clock seconds of a comparison."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "XDG_CACHE_HOME": cache, "JAX_COMPILATION_CACHE_DIR": os.path.join(cache, "jexplore")}
    command = [sys.executable, "-m", "jexplore", "compare", *arguments, "--out", out, "--overwrite"]
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, time.perf_counter() - began


def main(arguments):
    with tempfile.TemporaryDirectory() as folder:
        os.mkdir(os.path.join(folder, "jexplore"))
        runs = {name: timed(arguments, folder, os.path.join(folder, "run")) for name in ("empty", "warm")}
    runs["difference"] = tuple(a - b for a, b in zip(runs["empty"], runs["warm"]))
    print(markdown(["cache", "processor s", "clock s"], [[name, *took] for name, took in runs.items()]))


if __name__ == "__main__":
    main(sys.argv[1:])
