"""Loops: places propose, registration decides, the ledger remembers. What decides is a function of records."""

from heliograph.slam.loops.consistency import cycle_mahalanobis, maximum_clique
from heliograph.slam.loops.judge import agreements, judge, judge_together
from heliograph.slam.loops.ledger import Ledger, LedgerEntry
from heliograph.slam.loops.ledger_file import LOOP_COLUMNS, read_ledger, write_ledger
from heliograph.slam.loops.records import (
    REASONS,
    LoopDecision,
    LoopEvidence,
    LoopStart,
    RelativePose,
    Verdict,
)
from heliograph.slam.loops.search import rank_places, within_reach
from heliograph.slam.loops.submaps import LocalMaps, Submaps, local_map
from heliograph.slam.loops.tangent import diagonal, gate_of
from heliograph.slam.loops.verify import finished, loop_align_config, verification, verify

__all__ = [
    "LOOP_COLUMNS",
    "REASONS",
    "Ledger",
    "LedgerEntry",
    "LocalMaps",
    "LoopDecision",
    "LoopEvidence",
    "LoopStart",
    "RelativePose",
    "Submaps",
    "Verdict",
    "agreements",
    "cycle_mahalanobis",
    "diagonal",
    "finished",
    "gate_of",
    "judge",
    "judge_together",
    "local_map",
    "loop_align_config",
    "maximum_clique",
    "rank_places",
    "read_ledger",
    "verification",
    "verify",
    "within_reach",
    "write_ledger",
]
