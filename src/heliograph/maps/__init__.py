"""Heliograph: maps."""
