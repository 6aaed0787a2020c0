"""Digests: as documented, recomputed by an independent script, and changed by any bit."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from hashlib import blake2b
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import example, given, settings
from support import recompute_digest
from support.hierarchies import random_hierarchy
from support.strategies import hierarchies

from hierax.runtime.core.digest import NO_DIGEST, encode_state, epoch_digest, formal_digest, node_digest
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, ActiveNode, update
from hierax.schemas.roster import Reference, Roster, RosterEdge
from hierax.schemas.values import encode_value

SCRIPT = Path(recompute_digest.__file__)
EPOCHS = 3
SEED = 1


def roster_of(hierarchy: Hierarchy) -> Roster:
    nodes = {name: Reference("support.hierarchies:MixingNode", {"name": name}) for name in hierarchy.nodes}
    gain = Reference("support.hierarchies:Mix", {"gain": np.arange(3.0)})
    edges = tuple(RosterEdge(edge.lower, edge.upper, sense=gain) for edge in hierarchy.edges)
    return Roster(hierarchy.world, nodes, edges)


def written(folder: Path, hierarchy: Hierarchy) -> bytes:
    """Write what a run writes; gives the formal core's last digest."""
    roster = roster_of(hierarchy)
    (folder / "states").mkdir()
    (folder / "roster.msgpack").write_bytes(encode_value(roster.content()))
    active, digest = ActiveHierarchy.initial(hierarchy), NO_DIGEST
    for epoch in range(1, EPOCHS + 1):
        active = update(active)
        digest = formal_digest(active, digest, roster.content_hash())
        append(folder / "digests.msgpack", [epoch, digest])
        nodes: dict[str, bytes] = {}
        for name in reversed(hierarchy.order):
            state = active.states[name]
            encoded = encode_state(state.belief, state.policy, state.actions)
            nodes[name] = node_digest(encoded, [nodes[upper] for upper in hierarchy.above(name)])
            append(folder / "states" / f"{name}.msgpack", [epoch, 0, encoded, nodes[name]])
    return digest


def append(path: Path, value: Any) -> None:
    with path.open("ab") as file:
        file.write(msgpack.packb(value))


def rewritten(path: Path, change: Callable[[list[Any]], Any]) -> None:
    """Change the records of a file."""
    records = list(recompute_digest.stream(path))
    change(records)
    path.write_bytes(b"".join(msgpack.packb(record) for record in records))


def last_record(content: bytes) -> Any:
    """The last record of a file's content."""
    unpacker = msgpack.Unpacker()
    unpacker.feed(content)
    return list(unpacker)[-1]


def script(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-I", str(SCRIPT), str(folder)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_the_digests_are_the_documented_ones() -> None:
    parents = [bytes([1]) * 32, bytes([2]) * 32]
    assert node_digest(b"state", parents) == blake2b(b"state" + parents[0] + parents[1], digest_size=32).digest()
    chained = bytes(32) + struct.pack("<Q", 258) + parents[0] + parents[1]
    assert epoch_digest(NO_DIGEST, 258, *parents) == blake2b(chained, digest_size=32).digest()
    assert encode_state({"a": 1}, "p", (2,)) == b"\x93\x81\xa1a\x01\xa1p\x91\x02"


def test_a_digest_once_taken_stays_what_it_is() -> None:
    state = encode_state({"pose": np.eye(3), "lost": False}, "follow", (0.5, "grip"))
    digest = epoch_digest(NO_DIGEST, 1, bytes(32), node_digest(state, [bytes([7]) * 32]))
    assert digest.hex() == "92ec07a6b754b0b29599e9038c548db3563d535ccf8456b29c7a794393d03c90"


@settings(max_examples=30)
@given(hierarchies())
@example(random_hierarchy(seed=47780, nodes=7))  # within one of its digests something looks like an entry
def test_the_independent_script_recomputes_the_formal_cores_digest(
    tmp_path_factory: pytest.TempPathFactory, hierarchy: Hierarchy
) -> None:
    folder = tmp_path_factory.mktemp("run")
    digest = written(folder, hierarchy)
    assert recompute_digest.recompute(folder) == digest


def test_the_script_runs_by_itself(tmp_path: Path) -> None:
    digest = written(tmp_path, random_hierarchy(SEED, nodes=5))
    done = script(tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, digest.hex() + "\n", "")
    assert "hierax" not in SCRIPT.read_text().replace("Imports nothing of hierax", "")


def test_only_the_last_entry_of_an_epoch_counts(tmp_path: Path) -> None:
    hierarchy = random_hierarchy(SEED, nodes=5)
    digest = written(tmp_path, hierarchy)
    path = tmp_path / "states" / f"{hierarchy.world}.msgpack"
    rewritten(path, lambda records: records.insert(1, [2, 7, b"\xc0", bytes(32)]))
    assert recompute_digest.recompute(tmp_path) == digest
    rewritten(path, lambda records: records.append([2, 0, b"\xc0", bytes(32)]))
    with pytest.raises(recompute_digest.MismatchError, match=f"^node {hierarchy.world}, epoch 2: the digest is"):
        recompute_digest.recompute(tmp_path)


def test_an_epoch_may_be_committed_several_times(tmp_path: Path) -> None:
    digest = written(tmp_path, random_hierarchy(SEED, nodes=5))
    path = tmp_path / "digests.msgpack"
    rewritten(path, lambda records: records.insert(1, [2, bytes(32)]))
    rewritten(path, lambda records: records.append(records[2]))
    assert recompute_digest.recompute(tmp_path) == digest
    rewritten(path, lambda records: records.append([2, bytes(32)]))
    with pytest.raises(recompute_digest.MismatchError, match=r"^epoch 2: the digest is .*, but 0000"):
        recompute_digest.recompute(tmp_path)


@pytest.mark.parametrize("state_bytes", [0, 1, 255, 256, 70_000])
def test_a_half_entry_is_passed_over_wherever_it_is_cut(tmp_path: Path, state_bytes: int) -> None:
    """At a file's end, and with the entries of the next process behind it."""
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    path = tmp_path / "states.msgpack"

    def packed(epoch: int) -> bytes:
        return msgpack.packb([epoch, 0, rng.bytes(state_bytes), rng.bytes(32)])

    first, half, *behind = (packed(epoch) for epoch in (300, 301, 301, 302))
    cuts = sorted({*range(1, min(len(half), 60)), *range(max(1, len(half) - 60), len(half))})
    for cut in cuts:
        path.write_bytes(first + half[:cut])
        assert list(recompute_digest.stream(path)) == [msgpack.unpackb(first)], cut
        path.write_bytes(first + half[:cut] + b"".join(behind))
        assert list(recompute_digest.stream(path)) == [msgpack.unpackb(entry) for entry in (first, *behind)], cut
        path.write_bytes(half[:cut] + b"".join(behind))
        assert list(recompute_digest.stream(path)) == [msgpack.unpackb(entry) for entry in behind], cut


@pytest.mark.parametrize("cut", [1, 2, 3, 20, 35])
def test_half_digests_are_passed_over(tmp_path: Path, cut: int) -> None:
    digest = written(tmp_path, random_hierarchy(SEED, nodes=5))
    path = tmp_path / "digests.msgpack"
    whole = path.read_bytes()
    size = len(whole) // EPOCHS
    path.write_bytes(whole + whole[:cut])
    assert recompute_digest.recompute(tmp_path) == digest
    path.write_bytes(whole[: size + cut] + whole[size:])
    assert recompute_digest.recompute(tmp_path) == digest


def test_an_epoch_of_which_only_a_half_entry_is_left_is_named(tmp_path: Path) -> None:
    hierarchy = random_hierarchy(SEED, nodes=5)
    digest = written(tmp_path, hierarchy)
    top = hierarchy.order[-1]
    path = tmp_path / "states" / f"{top}.msgpack"
    whole = path.read_bytes()
    for half in (whole[:-1], whole[:-33], whole[:-40]):
        path.write_bytes(half)
        with pytest.raises(recompute_digest.MismatchError, match=f"^node {top}: no state of epoch {EPOCHS} is written"):
            recompute_digest.recompute(tmp_path)
        path.write_bytes(half + msgpack.packb(last_record(whole)))
        assert recompute_digest.recompute(tmp_path) == digest


def test_a_file_of_something_else_is_named(tmp_path: Path) -> None:
    written(tmp_path, random_hierarchy(SEED, nodes=5))
    (tmp_path / "digests.msgpack").write_bytes(b"epochs")
    done = script(tmp_path)
    assert (done.returncode, done.stderr) == (1, "digests.msgpack: begins with no entry\n")


def test_the_script_says_which_node_and_epoch_differ(tmp_path: Path) -> None:
    hierarchy = random_hierarchy(SEED, nodes=5)
    written(tmp_path, hierarchy)
    top = hierarchy.order[-1]

    def flip(records: list[Any]) -> None:
        epoch, attempt, state, digest = records[1]
        records[1] = [epoch, attempt, state[:-1] + bytes([state[-1] ^ 1]), digest]

    rewritten(tmp_path / "states" / f"{top}.msgpack", flip)
    done = script(tmp_path)
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith(f"node {top}, epoch 2: the digest is ")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda records: records[2].__setitem__(1, bytes(32)), "epoch 3: the digest is .*, but 0000"),
        (lambda records: records.pop(1), "digests.msgpack: no digest of epoch 2 is written"),
        (lambda records: records.append([4, bytes(32)]), "no state of epoch 4 is written"),
    ],
)
def test_the_script_finds_a_wrong_chain(tmp_path: Path, change: Callable[[list[Any]], Any], reason: str) -> None:
    written(tmp_path, random_hierarchy(SEED, nodes=5))
    rewritten(tmp_path / "digests.msgpack", change)
    with pytest.raises(recompute_digest.MismatchError, match=reason):
        recompute_digest.recompute(tmp_path)


def test_another_roster_is_another_run(tmp_path: Path) -> None:
    hierarchy = random_hierarchy(SEED, nodes=5)
    written(tmp_path, hierarchy)
    roster = roster_of(hierarchy)
    other = replace(roster, nodes={**roster.nodes, hierarchy.world: Reference("package.module:Other")})
    (tmp_path / "roster.msgpack").write_bytes(encode_value(other.content()))
    with pytest.raises(recompute_digest.MismatchError, match=r"^epoch 1: the digest is"):
        recompute_digest.recompute(tmp_path)


def test_any_flipped_bit_of_any_belief_changes_the_digest() -> None:
    hierarchy = random_hierarchy(SEED, nodes=4)
    active = update(ActiveHierarchy.initial(hierarchy))
    seen = {formal_digest(active, NO_DIGEST, bytes(32))}
    flips = 0
    for name, state in active.states.items():
        level = state.belief["level"]
        for bit in range(level.nbytes * 8):
            bits = bytearray(level.tobytes())
            bits[bit // 8] ^= 1 << (bit % 8)
            belief = {**state.belief, "level": np.frombuffer(bytes(bits))}
            other = active.with_state(name, state._replace(belief=belief))
            seen.add(formal_digest(other, NO_DIGEST, bytes(32)))
            flips += 1
    assert flips == 4 * 3 * 64
    assert len(seen) == flips + 1


@pytest.mark.parametrize("field", ["policy", "actions", "epoch", "previous", "roster"])
def test_all_else_changes_it_too(field: str) -> None:
    hierarchy = random_hierarchy(SEED, nodes=4)
    active = update(ActiveHierarchy.initial(hierarchy))
    top = hierarchy.order[-1]
    state: ActiveNode = active.states[top]
    others = {
        "policy": (active.with_state(top, state._replace(policy="other")), NO_DIGEST, bytes(32)),
        "actions": (active.with_state(top, state._replace(actions=("other",))), NO_DIGEST, bytes(32)),
        "epoch": (replace(active, epoch=2), NO_DIGEST, bytes(32)),
        "previous": (active, bytes([1]) * 32, bytes(32)),
        "roster": (active, NO_DIGEST, bytes([1]) * 32),
    }
    assert formal_digest(*others[field]) != formal_digest(active, NO_DIGEST, bytes(32))
