"""The report of a run: one HTML file that needs nothing else, and the map as a picture."""

from heliograph.report.page import write_report

__all__ = ["write_report"]
