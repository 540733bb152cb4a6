"""YAML by the core schema of version 1.2, as yaml-cpp and ROS 2 read it: 010 is 10, 4:30 and no are words.

PyYAML by itself follows version 1.1, where they are 8, 270 and false.

Source:
  YAML 1.2.2, section 10.3.2. Changed: no aliases; kept from version 1.1: the merge key <<.
"""

import re
from typing import Any

import yaml

_TAG = "tag:yaml.org,2002:"
_PLAIN = {
    "null": r"null|Null|NULL|~|",
    "bool": r"true|True|TRUE|false|False|FALSE",
    "int": r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+",
    "float": r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
    "merge": r"<<",
}
_RESOLVERS = {None: [(_TAG + kind, re.compile(f"(?:{words})$")) for kind, words in _PLAIN.items()]}


class Loader(yaml.SafeLoader):
    """Reads plain values. Refuses aliases, and keys that are there twice or are no plain values."""

    yaml_implicit_resolvers = _RESOLVERS

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):  # one may stand for a list of lists of lists that fills the memory
            what, mark = "aliases are not read: write out what it stands for", self.peek_event().start_mark
            raise yaml.MarkedYAMLError(None, None, what, mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key, _ in node.value:
            what = "" if isinstance(key.value, str) else "a key must be a plain value"
            what = what or (f"the key {key.value!r} is there twice" if key.value in seen else "")
            if what:
                raise yaml.MarkedYAMLError(None, None, what, key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_whole(self, node):
        text = self.construct_scalar(node)
        return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))


Loader.add_constructor(_TAG + "int", Loader.construct_whole)


class _Dumper(yaml.SafeDumper):
    yaml_implicit_resolvers = _RESOLVERS


def dump(value: Any) -> str:
    """Write plain values as text that `Loader` reads back as the same."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False)
