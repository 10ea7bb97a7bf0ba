"""Ways to spoil files that a program wrote for itself: accounts, nested text, keyframes with their journal."""

from __future__ import annotations

import json
import random
import zlib
from pathlib import Path

from tests.fuzz.containers import in_shapes
from tests.fuzz.mutations import TOKENS, change, in_archive, in_text

__all__ = ["in_json", "in_keyframe", "in_nest"]


def in_json(data: bytes, rng: random.Random) -> bytes:
    """Put something else for values of a tree, drop some, or nest it beyond any parser."""
    if rng.random() < 0.2:
        return in_text(data, rng)
    tree = json.loads(data)
    for _ in range(rng.choice([1, 1, 2, 5])):
        kind = rng.randrange(5)
        if kind == 0 and isinstance(tree, dict) and tree:
            del tree[rng.choice(sorted(tree))]
        elif kind == 1 and isinstance(tree, dict) and tree:
            tree[rng.choice(sorted(tree))] = rng.choice(
                [*TOKENS, None, [], {}, [1], {"a": {"b": 1}}, 1e400, -1, 10**30]
            )
        else:
            tree = change(tree, rng)
    text = json.dumps(tree)
    if rng.random() < 0.05:
        text = text[:-1] + ', "x": ' + "[" * 100_000 + "]" * 100_000 + "}"
    return text.encode()


def in_nest(data: bytes, rng: random.Random) -> bytes:
    """Put a nest, an endless name or a chain of aliases behind a key of a TOML or YAML file."""
    yaml = b": " in data
    aliases = "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9 if k else ['x'] * 9)}]\n" for k in range(9))
    deep = rng.choice([50, 500, 5_000, 100_000])
    found = [
        "x: " + "[" * deep + "]" * deep,
        "x: " + "{a: " * deep + "}" * deep,
        "".join(" " * k + "a:\n" for k in range(min(deep, 3000))),
        "- " * deep,
        aliases,
        "x: &x [*x]",
        "<<: &a {<<: *a}",
        "? " * deep,
        "!!python/object/apply:os.system [id]",
        "x: !!binary ////",
        "%YAML 9.9\n---",
        "x: " + "9" * 5000,
        "x: 0x" + "f" * 5000,
        "x: 1:" + "59:" * 2000 + "59",
        "x: 9999-99-99",
        "---\n" * deep,
        "x: |" + "9" * 400,
    ] if yaml else [
        "x = " + "[" * deep + "]" * deep,
        "x = " + "{a = " * deep + "1" + "}" * deep,
        ".".join(["a"] * deep) + " = 1",
        "[" + ".".join(["a"] * deep) + "]",
        "x = " + "9" * 5000,
        "x = 0x" + "f" * 5000,
        "x = 9999-99-99",
        "x = 1e" + "9" * 300,
        "[[a]]\n" * deep,
        "\"\" = 1",
        "x = \"\\U00110000\"",
    ]  # fmt: skip
    lines = data.split(b"\n")
    lines.insert(rng.choice([0, len(lines), rng.randrange(len(lines))]), rng.choice(found).encode())
    if rng.random() < 0.2:
        return in_text(b"\n".join(lines), rng)
    return b"\n".join(lines)


def in_keyframe(folder: Path, rng: random.Random) -> None:
    """Spoil a keyframe's file and make the journal's line fit it."""
    keyframes = folder / "keyframes"
    file = rng.choice(sorted(keyframes.glob("*.npz")))
    file.write_bytes(rng.choice([in_archive, in_shapes])(file.read_bytes(), rng))
    content, journal = file.read_bytes(), keyframes / "journal.jsonl"
    lines = journal.read_text().splitlines()
    for k, line in enumerate(lines[1:], 1):
        entry = json.loads(line)
        if entry["file"] == file.name:
            lines[k] = json.dumps({**entry, "size": len(content), "crc32": zlib.crc32(content)})
    journal.write_text("\n".join(lines) + "\n")
