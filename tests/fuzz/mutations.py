"""Ways to spoil a file: by bytes, by words, by what stands in its containers. All draw from one `Random`."""

from __future__ import annotations

import io
import json
import random
import sqlite3
import struct
import zipfile
from pathlib import Path

__all__ = ["change", "in_archive", "in_database", "in_messages", "in_text", "in_tree", "of_bytes"]

WORDS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1_000_000, 100_000)
LONG_WORDS = (*WORDS, 2**63 - 1, 2**63, 2**64 - 1, 10**18, 2**62, 2**53)
COLUMNS = (
    *(("messages", name) for name in ("topic_id", "timestamp", "data")),
    *(("topics", name) for name in ("name", "type", "id", "serialization_format")),
)
TOKENS = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e30", "1e-320", "1e999999999", "9" * 25, "9" * 400, "-0", "1_000"),
    *("0", "-1", "1", "2147483647", "4294967296", "0x10", "\u0661", "", "x", "\x00", "\x1b[31m", "\u202e", "a" * 3000),
)


def of_bytes(data: bytes, rng: random.Random) -> bytes:
    """Flip, set, cut, double, move or blank something, once or a few times; the ends more often than the middle."""
    content = bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 4, 16])):
        if not content:
            return b""
        _spoil(content, rng)
    return bytes(content)


def _spoil(content: bytearray, rng: random.Random) -> None:
    size = len(content)
    edge = min(2000, size)
    at = rng.choice([rng.randrange(edge), size - 1 - rng.randrange(edge), rng.randrange(size), rng.randrange(size)])
    kind = rng.randrange(9)
    if kind <= 1:
        content[at] ^= 1 << rng.randrange(8)
    elif kind == 2:
        content[at] = rng.randrange(256)
    elif kind <= 4:
        word = struct.pack(rng.choice("<>") + "I", rng.choice(WORDS))
        content[at : at + 4] = word[: size - at]
    elif kind == 5:
        word = struct.pack(rng.choice("<>") + "Q", rng.choice(LONG_WORDS))
        content[at : at + 8] = word[: size - at]
    elif kind == 6:
        del content[at:]
    elif kind == 7:
        length = rng.choice([1, 4, 50, 1000])
        content[at:at] = content[at : at + length] * rng.choice([1, 1, 3])
    else:
        del content[at : at + rng.choice([1, 2, 4, 8, 100])]


def in_text(data: bytes, rng: random.Random) -> bytes:
    """Put something else for a word, drop or double a line, nest, or spoil bytes."""
    if rng.random() < 0.15:
        return of_bytes(data, rng)
    lines = data.split(b"\n")
    for _ in range(rng.choice([1, 1, 2, 5])):
        at = rng.randrange(len(lines))
        kind = rng.randrange(7)
        if kind <= 3:
            lines[at] = _word(lines[at], rng)
        elif kind == 4:
            lines.insert(at, lines[rng.randrange(len(lines))])
        elif kind == 5 and len(lines) > 1:
            del lines[at]
        else:
            lines[at] += rng.choice([b"[" * 5000, b"{" * 3000, b"\xff\xfe", b"\x00", b'"""', b"," * 500, b"- " * 3000])
    return b"\n".join(lines)


def _word(line: bytes, rng: random.Random) -> bytes:
    for separator in (b",", b" ", b"="):
        words = line.split(separator)
        if len(words) > 1:
            words[rng.randrange(len(words))] = rng.choice(TOKENS).encode()
            return separator.join(words)
    return rng.choice(TOKENS).encode()


def in_messages(data: bytes, rng: random.Random) -> bytes:
    """Spoil an MCAP file without chunks inside its messages: stamps, words and lengths, the records whole."""
    out, at, found = bytearray(data[:8]), 8, []
    records = []
    while at + 9 <= len(data):
        opcode, size = struct.unpack_from("<BQ", data, at)
        records.append((opcode, bytearray(data[at + 9 : at + 9 + size])))
        found += [len(records) - 1] if opcode == 0x05 else []
        at += 9 + size
        if opcode == 0x02:
            break
    kind = rng.randrange(6)
    first = rng.randrange(len(found))
    shift = rng.choice([-(2**31), 10, 3600, 100_000, 10**8, -5, 10**6]) if kind == 0 else 0
    for place in found[first:] if kind <= 1 else rng.sample(found, min(len(found), rng.choice([1, 1, 3, 40]))):
        body = records[place][1]
        if kind == 0:  # both clocks step: header stamps and times of reception
            seconds = struct.unpack_from("<i", body, 26)[0] + shift
            struct.pack_into("<i", body, 26, max(-(2**31), min(2**31 - 1, seconds)))
            received = struct.unpack_from("<Q", body, 6)[0] + shift * 10**9
            struct.pack_into("<Q", body, 6, max(0, min(2**63 - 1, received)))
        elif kind == 1:
            continue
        elif kind == 2:
            struct.pack_into("<II", body, 26, rng.choice(WORDS), rng.choice(WORDS))
        elif kind == 3:
            word = rng.randrange(22, max(23, min(len(body) - 4, 220)))
            struct.pack_into("<I", body, word, rng.choice(WORDS))
        else:
            body[22:] = of_bytes(bytes(body[22:]), rng)
    for opcode, body in records:
        out += struct.pack("<BQ", opcode, len(body)) + body
    return bytes(out) + data[:8]


def in_archive(data: bytes, rng: random.Random) -> bytes:
    """Spoil one member of a ZIP archive, and make the archive whole again."""
    if rng.random() < 0.2:
        return of_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {entry.filename: archive.read(entry) for entry in archive.infolist()}
    name = rng.choice(sorted(members))
    kind = rng.randrange(8)
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[name] = members[rng.choice(sorted(members))]
    elif b'{"' in members[name] and kind <= 6:
        members[name] = _json_member(members[name], rng)
    else:
        members[name] = (
            members[name][:128] + of_bytes(members[name][128:], rng) if kind <= 5 else of_bytes(members[name], rng)
        )
    out = io.BytesIO()
    packing = zipfile.ZIP_DEFLATED if rng.random() < 0.1 else zipfile.ZIP_STORED
    with zipfile.ZipFile(out, "w", packing) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return out.getvalue()


def _json_member(content: bytes, rng: random.Random) -> bytes:
    """Change a table of contents that lies in an archive as an array of bytes."""
    start = content.index(b"{", 64)
    try:
        tree = json.loads(content[start:])
    except ValueError:
        return of_bytes(content, rng)
    change(tree, rng)
    text = json.dumps(tree).encode()
    header = content[:start].replace(str(len(content) - start).encode(), str(len(text)).encode(), 1)
    return header[: len(content[:start])].ljust(start, b" ") + text


def change(tree: object, rng: random.Random) -> object:
    """Put something else for one value of a nested structure, and return it."""
    whole = tree
    values = (None, -1, 0, 1, 10**9, 2**63, 1e308, "", "x", [], {}, True, [[1]], "Vector(3)", 10**400)
    while isinstance(tree, (dict, list)) and tree:
        key = rng.choice(sorted(tree)) if isinstance(tree, dict) else rng.randrange(len(tree))
        if not isinstance(tree[key], (dict, list)) or not tree[key] or rng.random() < 0.2:
            tree[key] = rng.choice(values)
            break
        tree = tree[key]
    return whole


def in_tree(data: bytes, rng: random.Random) -> bytes:
    """Change words of the native tree in a saved smoother, and make its checksum right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {entry.filename: archive.read(entry) for entry in archive.infolist()}
    content = members["tree.npy"]
    start = content.index(b"\n") + 1
    tree = bytearray(content[start:-8])
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        at = 4 * rng.randrange(2, len(tree) // 4)
        word = rng.choice([*WORDS, 3, 4, 7, 16, 17, 100, 2**31 - 2, rng.randrange(2**32), rng.randrange(64)])
        struct.pack_into("<I", tree, at, word)
    members["tree.npy"] = content[:start] + bytes(tree) + struct.pack("<Q", _checksum(bytes(tree)))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for member, body in members.items():
            archive.writestr(member, body)
    return out.getvalue()


def _checksum(data: bytes) -> int:
    """FNV-1a, eight bytes at a time, as cpp/graph/tree/archive.cpp has it."""
    mask, prime, value = (1 << 64) - 1, 0x100000001B3, 0xCBF29CE484222325
    whole = len(data) // 8 * 8
    for (word,) in struct.iter_unpack("<Q", data[:whole]):
        value = ((value ^ word) * prime) & mask
        value ^= value >> 29
    for byte in data[whole:]:
        value = ((value ^ byte) * prime) & mask
    return value


def in_database(data: bytes, rng: random.Random, folder: Path) -> bytes:
    """Change a cell, a table or the bytes of an SQLite file."""
    if rng.random() < 0.4:
        return of_bytes(data, rng)
    path = folder / "spoiled.db3"
    path.write_bytes(data)
    db = sqlite3.connect(path)
    values = (None, -1, 0, 2**63 - 1, "x", b"\xff\xfe", 1e308, "\x1b[31m", -(2**63), b"", "sensor_msgs/msg/Imu")
    try:
        kind = rng.randrange(7)
        table, column = rng.choice(COLUMNS)
        if kind <= 2:
            row = rng.choice(db.execute(f"SELECT rowid FROM {table}").fetchall())[0]
            db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (rng.choice(values), row))
        elif kind == 3:
            db.execute(f"UPDATE {table} SET {column} = ?", (rng.choice(values),))
        elif kind == 4:
            db.execute("ALTER TABLE messages RENAME TO others")
            endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
            db.execute(
                f"CREATE VIEW messages AS {endless} SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n"
            )
        elif kind == 5:
            db.execute(f"DROP TABLE {table}")
        else:
            db.execute(f"DELETE FROM {table}")
        db.commit()
    except sqlite3.Error:
        pass
    finally:
        db.close()
    return path.read_bytes()
