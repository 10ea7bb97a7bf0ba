"""Placeholder until the packet decoders of the 'files' part are merged."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from heliograph.io.registry import PacketContext, PacketDecoder

__all__ = ["PACKET_DECODERS"]

PACKET_DECODERS: Mapping[str, Callable[[PacketContext], PacketDecoder]] = {}
