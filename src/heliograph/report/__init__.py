"""Heliograph: report."""
