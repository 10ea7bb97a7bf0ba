"""A look into a pcap file without decoding it: which sizes of UDP datagram it holds, and how many."""

from __future__ import annotations

import mmap
import struct
from collections import Counter
from pathlib import Path
from typing import BinaryIO

from heliograph.guard.files import plain_file

__all__ = ["datagram_sizes", "is_cut", "is_pcap"]

_MAGICS = {b"\xd4\xc3\xb2\xa1": "<", b"\x4d\x3c\xb2\xa1": "<", b"\xa1\xb2\xc3\xd4": ">", b"\xa1\xb2\x3c\x4d": ">"}
_PCAPNG = b"\x0a\x0d\x0d\x0a"
_LINK_HEADER = {1: 14, 113: 16, 276: 20, 101: 0, 0: 4}  # Ethernet, Linux cooked v1 and v2, raw IP, loopback
_VLAN = (0x8100, 0x88A8)
_UDP = 17
_FILE_HEADER, _RECORD_HEADER = 24, 16
_MAX_COUNTED_PACKETS = 20_000


def is_pcap(path: Path) -> bool:
    """Tell whether the file begins as pcap or pcapng."""
    with plain_file(path).open("rb") as file:
        magic = file.read(4)
    return magic in _MAGICS or magic == _PCAPNG


def is_cut(path: Path) -> bool:
    """Tell whether a pcap file ends inside a packet; the vendors' readers stop there without a word."""
    with plain_file(path).open("rb") as file:
        order = _MAGICS.get(file.read(4))
        if order is None:
            return False
        length = struct.Struct(order + "I")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            at, end = _FILE_HEADER, len(data)
            while at + _RECORD_HEADER <= end:
                at += _RECORD_HEADER + length.unpack_from(data, at + 8)[0]
    return at != end


def datagram_sizes(path: Path) -> Counter[int]:
    """Count UDP datagrams by payload size.

    In a file with more than 20 000 packets, those are counted and scaled up to the file's size.
    A fragmented datagram counts once, by its full size. A pcapng file, or one of an unknown link type, gives no counts.
    """
    sizes: Counter[int] = Counter()
    with plain_file(path).open("rb") as file:
        head = file.read(_FILE_HEADER)
        order = _MAGICS.get(head[:4])
        if order is None or len(head) < _FILE_HEADER:
            return sizes
        link = _LINK_HEADER.get(struct.unpack_from(order + "I", head, 20)[0] & 0xFFFF)
        if link is None:
            return sizes
        for _ in range(_MAX_COUNTED_PACKETS):
            size = _next_datagram(file, order, link)
            if size is None:
                return sizes
            if size >= 0:
                sizes[size] += 1
        scale = path.stat().st_size / file.tell()
    return Counter({size: round(count * scale) for size, count in sizes.items()})


def _next_datagram(file: BinaryIO, order: str, link: int) -> int | None:
    """Return the UDP payload size of the next packet: -1 for any other packet, None at the end of the file."""
    record = file.read(_RECORD_HEADER)
    if len(record) < _RECORD_HEADER:
        return None
    captured = struct.unpack_from(order + "I", record, 8)[0]
    start = file.tell()
    data = file.read(min(captured, 128))
    file.seek(start + captured)
    return _payload_size(data, link)


def _payload_size(data: bytes, link: int) -> int:
    at = link
    while link == 14 and len(data) > at and int.from_bytes(data[at - 2 : at], "big") in _VLAN:
        at += 4
    if len(data) < at + 28:
        return -1
    if data[at] >> 4 == 6:
        return int.from_bytes(data[at + 44 : at + 46], "big") - 8 if data[at + 6] == _UDP else -1
    later_fragment = int.from_bytes(data[at + 6 : at + 8], "big") & 0x1FFF
    if data[at] >> 4 != 4 or data[at + 9] != _UDP or later_fragment:
        return -1
    at += (data[at] & 0xF) * 4
    return int.from_bytes(data[at + 4 : at + 6], "big") - 8 if len(data) >= at + 6 else -1
