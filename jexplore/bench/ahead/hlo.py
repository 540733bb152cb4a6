"""Optimised HLO as text: what its loops are called, and what its instructions read and write."""

import math
import re
from typing import NamedTuple

_COMPUTATION = re.compile(r"^(?:ENTRY )?%([\w.-]+) \(.*\{$")
_INSTRUCTION = re.compile(r"^  (ROOT )?%([\w.-]+) = (\(.*?\)|\S+) ([a-z][\w-]*)\((.*)$")
_ARRAY = re.compile(r"([a-z]+\d*)\[([\d,]*)\]")
_TRIPS = re.compile(r'"known_trip_count":\{"n":"(\d+)"\}')
_BITS = re.compile(r"\d+")
_PLUMBING = re.compile(r"^(jit\(.*|while|body|cond|branch_\d+_fun|closed_call|)$")
_PARTS = ("gather", "dynamic-slice", "slice")  # read as much of their first operand as they return
_UPDATES = {"scatter": 2, "dynamic-update-slice": 1}  # write into their first operand: where the new values stand


class Instruction(NamedTuple):
    """One line of a computation."""

    shape: str  # as written
    op: str
    operands: list[str]
    rest: str  # what follows the operands
    is_root: bool


class Traffic(NamedTuple):
    """What an instruction moves, all lanes together."""

    n_bytes: int  # read and written
    atomics: int  # elements that are added or set one by one, because several may meet in a cell


def arrays_of(shape: str) -> list[tuple[str, tuple[int, ...]]]:
    """Element types and sizes of the arrays of a shape, a tuple's all: `s32[4,2]{1,0}` is `[("s32", (4, 2))]`."""
    return [(kind, tuple(int(n) for n in dims.split(",") if n)) for kind, dims in _ARRAY.findall(shape)]


def bytes_of(shape: str) -> int:
    """Bytes of the arrays of a shape. Types without a number (`pred`, `token`) take one byte an element."""
    total = 0
    for kind, dims in arrays_of(shape):
        bits = _BITS.search(kind)
        total += math.prod(dims) * (int(bits[0]) // 8 if bits else 1)
    return total


def scope_of(op_name: str) -> str:
    """The named scopes of an instruction: `jit(f)/while/body/decide/while/body/vmap(wave)/while` is `decide/wave`."""
    parts = (re.sub(r"^(?:vmap\()+|\)+$", "", part) if part.startswith("vmap(") else part
             for part in op_name.split("/")[:-1])  # fmt: skip
    return "/".join(part for part in parts if not _PLUMBING.match(part) and not part.startswith("jit("))


class Module:
    """The text of a module, taken apart."""

    def __init__(self, text: str) -> None:
        """`text`: of a scheduled module, as `compiled.as_text()` returns it."""
        self.computations: dict[str, dict[str, Instruction]] = {}
        self.loops: dict[str, tuple[int | None, str]] = {}  # name -> turns, None if not known; scope
        self.place: dict[str, str] = {}  # instruction that is launched -> computation
        own = {}
        for line in text.splitlines():
            if found := _COMPUTATION.match(line):
                own = self.computations.setdefault(found[1], {})
            elif found := _INSTRUCTION.match(line):
                inside, _, rest = found[5].partition(")")
                own[found[2]] = Instruction(found[3], found[4], re.findall(r"%([\w.-]+)", inside), rest, bool(found[1]))
        for place, instructions in self.computations.items():
            for name, one in instructions.items():
                if one.op == "while":
                    trips, scope = _TRIPS.search(one.rest), re.search(r'op_name="([^"]*)"', one.rest)
                    self.loops[name] = int(trips[1]) if trips else None, scope_of(scope[1]) if scope else ""
                if one.op not in ("parameter", "constant"):
                    self.place[name] = place

    def _find(self, name):
        return self.computations[self.place[name]].get(name) if name in self.place else None

    def has_axis(self, name: str, n: int) -> bool:
        """Whether an instruction returns an array whose leading axis is n."""
        one = self._find(name)
        return one is not None and any(dims[:1] == (n,) for _, dims in arrays_of(one.shape))

    def traffic(self, name: str) -> Traffic:
        """What an instruction moves: an estimate. Of what it only takes parts of, or writes parts into, only those."""
        one = self._find(name)
        if one is None:
            return Traffic(0, 0)
        called = re.search(r"calls=%([\w.-]+)", one.rest)
        if called is None:
            inputs = [self.computations[self.place[name]][other].shape for other in one.operands]
            return Traffic(sum(map(bytes_of, [one.shape, *inputs])), 0)
        return self._fused(self.computations[called[1]])

    def _fused(self, body):
        total, atomics, written = 0, 0, set()
        users = {}
        for name, one in body.items():
            for i, other in enumerate(one.operands):
                users.setdefault(other, []).append((name, i))
        for name, one in body.items():
            if one.op == "parameter":
                total += min(bytes_of(one.shape), self._read(body, users, name))
            if one.op in _UPDATES:
                new = body[one.operands[_UPDATES[one.op]]].shape
                total += 2 * bytes_of(new)
                written.add(name)
                if one.op == "scatter" and "unique_indices=true" not in one.rest:
                    atomics += sum(math.prod(dims) for _, dims in arrays_of(new))
        roots = [name for name, one in body.items() if one.is_root]
        for root in roots:
            ends = body[root].operands if body[root].op == "tuple" else [root]
            total += sum(bytes_of(body[end].shape) for end in ends if self._source(body, end) not in written)
        return Traffic(total, atomics)

    def _source(self, body, name):
        while body[name].op in ("bitcast", "copy", "reshape") and body[name].operands:
            name = body[name].operands[0]
        return name

    def _read(self, body, users, name):
        """Bytes that are read of a value, by all its users; of a part that is taken, only what is read of that."""
        total = 0 if users.get(name) else bytes_of(body[name].shape)  # it is returned
        for user, i in users.get(name, []):
            op = body[user].op
            if op in ("bitcast", "reshape"):
                total += self._read(body, users, user)
            elif op in _PARTS and i == 0:
                total += min(bytes_of(body[user].shape), self._read(body, users, user))
            elif op not in _UPDATES or i > 0:
                total += bytes_of(body[name].shape)
        return total
