"""Merging: several runs in one map, from their stores alone."""

from heliograph.merging.links import Link, find_links
from heliograph.merging.merge import MergedRuns, merge_runs
from heliograph.merging.sessions import RunSession, open_session, session_of_keyframes

__all__ = ["Link", "MergedRuns", "RunSession", "find_links", "merge_runs", "open_session", "session_of_keyframes"]
