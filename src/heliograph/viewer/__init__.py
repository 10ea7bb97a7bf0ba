"""A run in Rerun's viewer: live as a sink, afterwards from its folder, and as a file to share."""

from heliograph.viewer.live import LiveView
from heliograph.viewer.replay import show_run
from heliograph.viewer.screen import Screen

__all__ = ["LiveView", "Screen", "show_run"]
