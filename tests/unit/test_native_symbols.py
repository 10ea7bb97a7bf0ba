"""The native module keeps the names of its functions: without them a profile is a list of addresses."""

import struct
import sys
from pathlib import Path

import pytest

from heliograph import _core

SYMTAB = 2  # sh_type of a symbol table, which stripping takes away; that of exported names is 11


def _section_types(elf):
    """sh_type of each section header of a 64-bit little-endian ELF file."""
    (at,) = struct.unpack_from("<Q", elf, 40)
    size, count = struct.unpack_from("<HH", elf, 58)
    return {struct.unpack_from("<I", elf, at + k * size + 4)[0] for k in range(count)}


@pytest.mark.skipif(sys.platform != "linux", reason="reads the ELF file that Linux builds are")
def test_profilers_find_the_names_of_native_functions():
    elf = Path(_core.__file__).read_bytes()
    assert elf[:6] == b"\x7fELF\x02\x01"
    assert SYMTAB in _section_types(elf)
    assert b"heliograph8VoxelMap6insert" in elf  # as the linker spells VoxelMap::insert
