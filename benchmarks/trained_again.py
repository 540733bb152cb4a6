"""Check a model's weights by its training: train again to its first check and compare the hashes.

    python benchmarks/trained_again.py [MODEL]

Without MODEL, the one that comes with the package. Takes as long as training took to its first check. Ends with status
1 if the weights are others.
"""

import json
import sys
import tempfile
from pathlib import Path

from jexplore.cli import main as jexplore
from jexplore.policies.learned.model import SHIPPED


def main(arguments):
    page = json.loads((Path(arguments[0]) if arguments else SHIPPED).with_suffix(".json").read_text(encoding="utf-8"))
    _, *command = page["command"]
    first = page["checks"][1]
    for option, value in (("--rounds", str(first["round"])), ("--out", None)):
        if option in command:
            at = command.index(option)
            del command[at : at + 2]
        command += [option, value] if value is not None else []
    command = [word for word in command if word not in ("--overwrite", "--resume")]
    with tempfile.TemporaryDirectory() as folder:
        status = jexplore.main([*command, "--out", folder + "/again"])
        if status:
            return status
        again = json.loads(Path(folder, "again", "model.json").read_text(encoding="utf-8"))["checks"][1]
    same = again["sha256"] == first["sha256"]
    print(f"round {first['round']}: {again['sha256']} is {'' if same else 'not '}the hash of the model's first check")
    return int(not same)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
